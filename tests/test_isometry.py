"""Change of edge lengths between frames, and its gradient."""

from __future__ import annotations

import numpy as np
import pytest
import reference
import synthetic
import warp as wp
import witness
from gradients import assert_gradients_close, finite_differences, gradient_of

from warpdef.geometry.triangles import unique_edges
from warpdef.kernels.graphs import mesh_graph
from warpdef.kernels.isometry import isometry, isometry_of_vertices, lay_paths, path_width

by_vertex = {"on": False}


@pytest.fixture(params=["edge by edge", "vertex by vertex"], autouse=True)
def _both_ways(request: pytest.FixtureRequest, device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The way of CUDA, which the CPU can go, too, and the CPU's own."""
    wanted = request.param == "vertex by vertex"
    if wanted and device != "cpu":
        pytest.skip("the CPU's own way")
    monkeypatch.setitem(by_vertex, "on", wanted)


def run(
    vertices: np.ndarray,
    edges: np.ndarray,
    device: str,
    share: float = 1.0,
    weight: float = 1.0,
    split: int = 7,
    before: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Losses (T,) and gradient (T, V, 3), in two spans; ``before`` is what stood in the gradient."""
    frames, count = vertices.shape[:2]
    moving = wp.array(vertices.astype(np.float32), dtype=wp.vec3, ndim=2, device=device)
    adj = wp.full((frames, count), wp.vec3(before, before, before), dtype=wp.vec3, device=device)
    if by_vertex["on"]:
        graph = mesh_graph(edges, count, 1.0)
        row, column = (wp.array(a, dtype=wp.int32, device=device) for a in (graph.row, graph.column))
        paths = wp.full((count, 3, path_width(frames)), np.nan, dtype=wp.float32, device=device)
        loss = wp.zeros((2, frames), dtype=wp.float64, device=device)
        split = min(split, count - 1)
        spans = [(0, 0, split), (1, split, count - split)]
        for _, begin, size in spans:
            lay_paths(begin, size, moving, paths)
        for part, begin, size in spans:
            isometry_of_vertices(begin, size, paths, row, column, share, weight, part, loss, adj)
        return loss.numpy().sum(axis=0), adj.numpy()
    pairs = wp.array(edges.astype(np.int32), dtype=wp.int32, ndim=2, device=device)
    loss = wp.zeros(frames, dtype=wp.float64, device=device)
    total = frames * len(edges)
    for begin, size in ((0, split), (split, total - split)):
        isometry(begin, size, moving, pairs, share, weight, loss, adj)
    return loss.numpy(), adj.numpy()


def stretched(rng: np.random.Generator, frames: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Some frames of a small sphere, every edge of another length in every frame."""
    sphere, faces = synthetic.icosphere(0)
    vertices = sphere[None] + rng.normal(size=(frames, *sphere.shape)) * 0.2
    return vertices.astype(np.float32).astype(np.float64), unique_edges(faces)


@pytest.mark.parametrize("frames", [2, 4, 14, 15, 28, 31])  # a register holds fourteen
def test_loss_and_gradient_match_the_twin(frames: int, device: str, rng: np.random.Generator) -> None:
    vertices, edges = stretched(rng, frames)
    loss, adj = run(vertices, edges, device, share=0.01, weight=250.0)
    np.testing.assert_allclose(loss[:-1], 0.01 * reference.isometry(vertices, edges), rtol=1e-5)
    assert loss[-1] == 0
    assert_gradients_close(adj, 2.5 * reference.adj_isometry(vertices, edges))


def test_gradient_matches_finite_differences(device: str, rng: np.random.Generator) -> None:
    vertices, edges = stretched(rng)
    expected = finite_differences(lambda v: float(reference.isometry(v, edges).sum()), vertices)
    assert_gradients_close(run(vertices, edges, device)[1], expected)


def test_gradient_matches_finite_differences_of_the_kernel(device: str, rng: np.random.Generator) -> None:
    vertices, edges = stretched(rng)
    _, adj = run(vertices, edges, device)
    step, directions = 1e-3, rng.normal(size=(20, *vertices.shape)) * 0.3
    ends = [[run(vertices + s * step * d, edges, device)[0].sum() for s in (1, -1)] for d in directions]
    found = [(above - below) / (2 * step) for above, below in ends]
    expected = np.einsum("dtvc,tvc->d", directions, adj)
    assert_gradients_close(np.array(found), expected, elementwise=0.02, direction=1e-3, relative=0.02)


def test_gradient_matches_autodiff(device: str, rng: np.random.Generator) -> None:
    vertices, edges = stretched(rng)
    moving = wp.array(vertices.astype(np.float32), dtype=wp.vec3, ndim=2, device=device, requires_grad=True)
    pairs = wp.array(edges.astype(np.int32), dtype=wp.int32, ndim=2, device=device)
    loss = wp.zeros(1, dtype=wp.float32, device=device, requires_grad=True)
    with wp.Tape() as tape:
        wp.launch(witness.edge_changes, (3, len(edges)), inputs=[moving, pairs, 1.0, loss], device=device)
    tape.backward(loss)
    assert_gradients_close(run(vertices, edges, device)[1], gradient_of(moving))


def test_gradients_are_added_to_what_there_is(device: str, rng: np.random.Generator) -> None:
    vertices, edges = stretched(rng, 16)
    adj, onto = (run(vertices, edges, device, before=before)[1] for before in (0.0, 4.0))
    # Six edges meet at a vertex, and each may be added to the sum by itself.
    np.testing.assert_allclose(onto, adj + 4.0, rtol=0, atol=6 * np.spacing(np.float32(np.abs(onto).max())))
    assert np.abs(adj).max() > 1


def test_a_rigid_motion_costs_next_to_nothing(device: str, rng: np.random.Generator) -> None:
    moving = synthetic.turning_ellipsoid(3, 10, rng, subdivisions=1)
    loss, _ = run(moving.vertices, unique_edges(moving.faces), device)
    assert loss.max() < 1e-5


def test_equal_lengths_and_edges_of_no_length_have_no_gradient(device: str) -> None:
    still = np.tile(np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, 0]]), (3, 1, 1))
    edges = np.array([[0, 1], [1, 2]])
    loss, adj = run(still, edges, device, split=2)
    np.testing.assert_array_equal(loss, 0)
    np.testing.assert_array_equal(adj, 0)
    # The edge of no length in frame 1 opens in frame 2: the loss counts, and only the frame with a direction pulls.
    still[2, 2] = [1, 0.5, 0]
    loss, adj = run(still, edges, device, split=2)
    np.testing.assert_allclose(loss, [0, 0.5, 0])
    np.testing.assert_array_equal(adj[:2], 0)
    np.testing.assert_allclose(adj[2], [[0, 0, 0], [0, -1, 0], [0, 1, 0]])


def test_one_edge_two_frames(device: str) -> None:
    vertices = np.array([[[0.0, 0, 0], [1, 0, 0]], [[0, 0, 0], [0, 3, 0]]])
    loss, adj = run(vertices, np.array([[0, 1]]), device, split=1)
    np.testing.assert_allclose(loss, [2, 0])
    np.testing.assert_allclose(adj, [[[1, 0, 0], [-1, 0, 0]], [[0, -1, 0], [0, 1, 0]]])
