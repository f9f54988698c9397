"""Rotations are rotations and the best ones; both right-hand sides are minus half the gradient of the rigid energy."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import reference_refine as twin
import synthetic
import warp as wp
import witness_refine
from gradients import assert_gradients_close, finite_differences, gradient_of

from warpdef.geometry.triangles import unique_edges
from warpdef.kernels.graphs import mesh_graph
from warpdef.kernels.rigidity import fit_rotations, rest_rhs, rigid_rhs, trusted_rest_rhs
from warpdef.kernels.ways import Way, going

WHOLE = (0, None)


class Mesh:
    """Edges on a device, and the three kernels over spans cut at the given places (None: the end)."""

    def __init__(self, edges: np.ndarray, count: int, device: str) -> None:
        graph = mesh_graph(edges, count, 1.0)
        self.edges, self.count, self.device = edges, count, device
        self.row, self.column = (wp.array(a, dtype=wp.int32, device=device) for a in (graph.row, graph.column))

    def put(self, a: np.ndarray, dtype: type = wp.vec3) -> wp.array:
        return wp.array(np.asarray(a, np.float32), dtype=dtype, device=self.device)

    def spans(self, cuts, total: int):
        places = [total if c is None else c for c in cuts]
        return [(a, b - a) for a, b in zip(places[:-1], places[1:], strict=True)]

    def fit(
        self, x: np.ndarray, y: np.ndarray, cuts=WHOLE, start: np.ndarray | None = None, tie: float = 0.0
    ) -> np.ndarray:
        scratch = (self.put(np.zeros(x.shape)), self.put(np.zeros(x.shape))) if tie else None
        start = np.full((*x.shape, 3), np.nan) if start is None else start
        moving, rest, out = self.put(x), self.put(y), self.put(start, wp.mat33)
        for begin, count in self.spans(cuts, len(x) * self.count):
            fit_rotations(begin, count, self.row, self.column, rest, moving, out, tie, scratch)
        return out.numpy().astype(np.float64)

    def rhs(self, x, y, rotation, weight: float = 1.0, start: float = 0.0, cuts=WHOLE, stiffness=None) -> np.ndarray:
        moving, rest, turned = self.put(x), self.put(y), self.put(rotation, wp.mat33)
        out = self.put(np.full(x.shape, start))
        stiff = None if stiffness is None else self.put(stiffness, wp.float32)
        for begin, count in self.spans(cuts, len(x) * self.count):
            rigid_rhs(begin, count, weight, self.row, self.column, rest, turned, moving, out, stiff)
        return out.numpy()

    def rest_rhs(self, x, rotation, cuts=WHOLE, frames=None) -> np.ndarray:
        moving, turned, out = self.put(x), self.put(rotation, wp.mat33), self.put(np.full(x.shape[1:], np.nan))
        asked = np.arange(len(x)) if frames is None else np.asarray(frames)
        asked = wp.array(asked.astype(np.int32), dtype=wp.int32, device=self.device)
        for begin, count in self.spans(cuts, self.count):
            rest_rhs(begin, count, asked, self.row, self.column, turned, moving, out)
        return out.numpy()

    def trusted_rest_rhs(self, x, y, rotation, trust, staying: float = 0.05, cuts=WHOLE) -> np.ndarray:
        moving, rest, turned = self.put(x), self.put(y), self.put(rotation, wp.mat33)
        weight, out = self.put(trust, wp.float32), self.put(np.full(y.shape, np.nan))
        for begin, count in self.spans(cuts, self.count):
            trusted_rest_rhs(begin, count, staying, self.row, self.column, rest, weight, turned, moving, out)
        return out.numpy()


@pytest.fixture(autouse=True, params=Way)
def way(request: pytest.FixtureRequest) -> Iterator[None]:
    """Sixteen vertices at a time, and one by one."""
    with going(request.param):
        yield


@pytest.fixture
def mesh(device: str) -> Mesh:
    """A small sphere of 42 vertices."""
    vertices, faces = synthetic.icosphere(1)
    return Mesh(unique_edges(faces), len(vertices), device)


@pytest.fixture
def state(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x, y and R that do not fit one another: three frames, turned far and shaken, float32 numbers."""
    sphere, _ = synthetic.icosphere(1)
    rest = sphere + 0.1 * rng.normal(size=sphere.shape)
    x = np.stack([sphere @ turn.T for turn in turns(3, rng)]) + 0.1 * rng.normal(size=(3, *sphere.shape))
    rotation = turns(3 * len(sphere), rng).reshape(3, -1, 3, 3)
    x, rest, rotation = (a.astype(np.float32).astype(np.float64) for a in (x, rest, rotation))
    return x, rest, rotation


@pytest.fixture
def stiffness(state, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(0.5, 2.0, len(state[1])).astype(np.float32).astype(np.float64)


def turns(count: int, rng: np.random.Generator) -> np.ndarray:
    """Rotations about any axis by any angle, (count, 3, 3)."""
    return np.stack([synthetic.turn_about(rng.normal(size=3), rng.uniform(0, np.pi)) for _ in range(count)])


def assert_rotations(found: np.ndarray) -> None:
    assert np.isfinite(found).all()
    product = found @ np.swapaxes(found, -1, -2)
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(3), product.shape), rtol=0, atol=1e-5)
    np.testing.assert_allclose(np.linalg.det(found), 1, rtol=0, atol=1e-5)


def stars(count: int, rng: np.random.Generator, extent=(1.0, 1.0, 1.0)) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices with six neighbours of their own: rest (7 count, 3), edges, centres. ``extent``: of the axes."""
    spokes = rng.normal(size=(count, 7, 3)) * extent
    spokes[:, 0] = 0
    centres = 7 * np.arange(count)
    edges = np.stack([np.repeat(centres, 6), np.delete(np.arange(7 * count), centres)], axis=1)
    return spokes.reshape(-1, 3), edges, centres


# Rotations.


def test_rotations_match_the_twin(mesh: Mesh, state) -> None:
    x, y, _ = state
    found = mesh.fit(x, y)
    assert_rotations(found)
    np.testing.assert_allclose(found, twin.fit_rotations(x, y, mesh.edges), rtol=0, atol=1e-5)


@pytest.mark.parametrize("off", [0.0, 0.05, 0.5, 2.0, np.pi, np.nan, "zero", "mirror", "longer"])
def test_rotations_do_not_depend_on_where_they_are_looked_for(mesh: Mesh, state, rng, off) -> None:
    """From any rotation, and from what is none."""
    x, y, _ = state
    expected = twin.fit_rotations(x, y, mesh.edges)
    if isinstance(off, str):
        start = {"zero": 0.0, "mirror": -1.0, "longer": 1.5}[off] * expected
    else:
        by = synthetic.turn_about(rng.normal(size=3), off) if np.isfinite(off) else np.full((3, 3), np.nan)
        start = expected @ by
    found = mesh.fit(x, y, start=start)
    assert_rotations(found)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5)


@pytest.mark.parametrize("tie", [0.3, 5.0])
def test_rotations_tied_to_their_neighbours_match_the_twin(mesh: Mesh, state, tie: float) -> None:
    """To those that the neighbours had before; of zeros, which are none yet, to nothing."""
    x, y, before = state
    found, free = mesh.fit(x, y, start=before, tie=tie), twin.fit_rotations(x, y, mesh.edges)
    assert_rotations(found)
    np.testing.assert_allclose(found, twin.fit_rotations(x, y, mesh.edges, tie, before), rtol=0, atol=1e-4)
    assert np.abs(found - free).max() > 0.1
    np.testing.assert_allclose(mesh.fit(x, y, start=np.zeros(before.shape), tie=tie), free, rtol=0, atol=1e-4)


def test_frames_tied_one_after_the_other_give_the_same_bits(mesh: Mesh, state) -> None:
    x, y, before = state
    cuts = [0, mesh.count, 2 * mesh.count, None]
    np.testing.assert_array_equal(mesh.fit(x, y, cuts, before, 1.0), mesh.fit(x, y, start=before, tie=1.0))


def test_a_strong_tie_makes_neighbours_turn_together(mesh: Mesh, state) -> None:
    """Again and again, until all vertices of a frame have one rotation: the best of the whole."""
    x, y, _ = state
    turned = mesh.fit(x, y)
    for _ in range(400):
        turned = mesh.fit(x, y, start=turned, tie=100.0)
    assert np.abs(turned - turned[:, :1]).max() < 0.1 < np.abs(mesh.fit(x, y) - mesh.fit(x, y)[:, :1]).max()


def test_no_rotation_nearby_is_better(mesh: Mesh, state, rng: np.random.Generator) -> None:
    """The definition itself: sum_j |x_ij - R y_ij|^2 rises with any small turn, at every vertex."""
    x, y, _ = state
    found = mesh.fit(x, y)

    def misfit(rotation: np.ndarray) -> np.ndarray:
        total = np.zeros(x.shape[:2])
        for i, j in np.concatenate([mesh.edges, mesh.edges[:, ::-1]]):
            total[:, i] += ((x[:, i] - x[:, j] - rotation[:, i] @ (y[i] - y[j])) ** 2).sum(axis=1)
        return total

    for _ in range(10):
        small = synthetic.turn_about(rng.normal(size=3), 0.01)
        assert (misfit(found @ small) > misfit(found)).all()


@pytest.mark.parametrize("size", [1.0, 1e-2, 1e-4, 1e-6])
def test_a_rigid_turn_is_found(size: float, device: str, rng: np.random.Generator) -> None:
    """However short the edges are: their squares must not fall below anybody's threshold."""
    y, edges, centres = stars(500, rng)
    truth = turns(2 * 500, rng).reshape(2, 500, 3, 3)
    x = np.einsum("tvab,vb->tva", np.repeat(truth, 7, axis=1), y)
    found = Mesh(edges, len(y), device).fit(size * x, size * y)
    assert_rotations(found)
    np.testing.assert_allclose(found[:, centres], truth, rtol=0, atol=2e-5)


@pytest.mark.parametrize("slim", [1.0, 0.1], ids=["round", "slim"])
def test_a_flat_neighbourhood_turns_whole(slim: float, device: str, rng: np.random.Generator) -> None:
    """Rank 2: the third axis follows. Slim ones are what an iterative decomposition finds hardest."""
    y, edges, centres = stars(1000, rng, extent=(1, slim, 0))
    truth = turns(1000, rng)
    y = np.einsum("vab,vb->va", np.repeat(turns(1000, rng), 7, axis=0), y)
    x = np.einsum("vab,vb->va", np.repeat(truth, 7, axis=0), y)
    found = Mesh(edges, len(y), device).fit(x[None], y)
    assert_rotations(found)
    # float32 edges leave an angle of about 1e-7 / slim, a sum of six squares some times that.
    np.testing.assert_allclose(found[0, centres], truth, rtol=0, atol=2e-5 / slim)


def test_a_mirrored_neighbourhood_gets_a_rotation(device: str, rng: np.random.Generator) -> None:
    """The best that is no reflection; extents differ, so that it is one and no other."""
    y, edges, centres = stars(500, rng, extent=(1, 0.7, 0.3))
    truth = turns(500, rng)
    x = np.einsum("vab,vb->va", np.repeat(truth, 7, axis=0), y * [1, 1, -1])
    mesh = Mesh(edges, len(y), device)
    found = mesh.fit(x[None], y)
    assert_rotations(found)
    s = np.einsum("nka,nkb->nab", x.reshape(-1, 7, 3), y.reshape(-1, 7, 3))  # centres are at 0
    best, got = (np.einsum("nab,nab->n", r, s) for r in (twin.nearest_rotation(s), found[0, centres]))
    assert (got >= best - 1e-5 * np.linalg.norm(s, axis=(1, 2))).all()


def test_no_edges_and_no_lengths_give_the_identity(device: str) -> None:
    """Vertex 4 has no edge; the others' edges have no length in x, in y, or in both."""
    edges, y = np.array([[0, 1], [1, 2], [2, 3], [0, 3]]), np.arange(15.0).reshape(5, 3)
    mesh, together = Mesh(edges, 5, device), np.ones((5, 3))
    for x, rest in ((together, y), (y, together), (together, together)):
        np.testing.assert_array_equal(mesh.fit(x[None], rest)[0], np.tile(np.eye(3), (5, 1, 1)))
    np.testing.assert_array_equal(mesh.fit(y[None], y)[0, 4], np.eye(3))


def test_a_single_edge_gets_a_rotation_that_turns_it(device: str, rng: np.random.Generator) -> None:
    y, x = rng.normal(size=(2, 3)), rng.normal(size=(2, 3))
    found = Mesh(np.array([[0, 1]]), 2, device).fit(x[None], y)
    assert_rotations(found)
    units = [(a[0] - a[1]) / np.linalg.norm(a[0] - a[1]) for a in (x, y)]
    np.testing.assert_allclose(found[0] @ units[1], np.tile(units[0], (2, 1)), rtol=0, atol=1e-5)


# Pulls.


def test_rigid_rhs_matches_the_twin_and_is_added(mesh: Mesh, state) -> None:
    x, y, rotation = state
    expected = twin.rigid_rhs(x, y, rotation, mesh.edges)
    assert_gradients_close(mesh.rhs(x, y, rotation), expected)
    assert_gradients_close(mesh.rhs(x, y, rotation, weight=0.5, start=2.0), 2.0 + 0.5 * expected)


@pytest.mark.parametrize("even", [True, False])
def test_rigid_rhs_is_minus_half_the_gradient(mesh: Mesh, state, stiffness: np.ndarray, even: bool) -> None:
    (x, y, rotation), stiff = state, None if even else stiffness
    slope = finite_differences(lambda a: twin.rigid_energy(a, y, rotation, mesh.edges, stiff), x)
    found = mesh.rhs(x, y, rotation, stiffness=stiff)
    assert_gradients_close(found, -0.5 * slope)
    assert_gradients_close(found, twin.rigid_rhs(x, y, rotation, mesh.edges, stiff))


def test_a_stiffness_of_one_is_none(mesh: Mesh, state) -> None:
    np.testing.assert_array_equal(mesh.rhs(*state, stiffness=np.ones(mesh.count)), mesh.rhs(*state))


def test_rest_rhs_matches_the_twin(mesh: Mesh, state) -> None:
    x, _, rotation = state
    assert_gradients_close(mesh.rest_rhs(x, rotation), twin.rest_rhs(x, rotation, mesh.edges))


@pytest.mark.parametrize("frames", [[1], [0, 2], [2, 0, 1]])
def test_only_frames_asked_say_what_the_shape_is(frames, mesh: Mesh, state) -> None:
    x, _, rotation = state
    found = mesh.rest_rhs(x, rotation, frames=frames)
    assert_gradients_close(found, twin.rest_rhs(x[frames], rotation[frames], mesh.edges))
    np.testing.assert_array_equal(mesh.rest_rhs(x[frames], rotation[frames]), found)


def test_rest_rhs_is_minus_half_the_gradient_at_zero_over_the_frames(mesh: Mesh, state) -> None:
    x, y, rotation = state
    slope = finite_differences(lambda a: twin.rigid_energy(x, a, rotation, mesh.edges), np.zeros_like(y))
    assert_gradients_close(mesh.rest_rhs(x, rotation), -0.5 * slope / len(x))


def test_an_edge_is_asked_of_the_frames_that_show_it(mesh: Mesh, state, rng: np.random.Generator) -> None:
    x, y, rotation = state
    trust = rng.random(x.shape[:2]) * (rng.random(x.shape[:2]) > 0.3)
    found = mesh.trusted_rest_rhs(x, y, rotation, trust)
    assert_gradients_close(found, twin.trusted_rest_rhs(x, y, rotation, trust, 0.05, mesh.edges))
    spans = mesh.trusted_rest_rhs(x, y, rotation, trust, cuts=(0, 1, 30, None))
    np.testing.assert_array_equal(spans, found)
    # A frame that shows nothing is never heard.
    other, trust[1] = x.copy(), 0.0
    other[1] = rng.normal(size=x[1].shape)
    heard = [mesh.trusted_rest_rhs(places, y, rotation, trust) for places in (x, other)]
    np.testing.assert_array_equal(heard[0], heard[1])


def test_frames_that_show_all_say_what_they_say_together_and_what_none_shows_stays(mesh: Mesh, state) -> None:
    x, y, rotation = state
    whole = mesh.trusted_rest_rhs(x, y, rotation, np.ones(x.shape[:2]), staying=1e-6)
    assert_gradients_close(whole, twin.rest_rhs(x, rotation, mesh.edges))
    nothing = mesh.trusted_rest_rhs(x, y, rotation, np.zeros(x.shape[:2]))
    assert_gradients_close(nothing, twin.laplacian(mesh.edges, mesh.count) @ y)


def test_both_right_hand_sides_match_autodiff(mesh: Mesh, state, stiffness: np.ndarray) -> None:
    x, y, rotation = state

    def gradients(rest: np.ndarray, stiffness: np.ndarray) -> list[np.ndarray]:
        """To x and to y."""
        values = [
            wp.array(a.astype(np.float32), dtype=wp.vec3, device=mesh.device, requires_grad=True) for a in (x, rest)
        ]
        pairs = wp.array(mesh.edges, dtype=wp.int32, ndim=2, device=mesh.device)
        loss = wp.zeros(1, dtype=wp.float32, device=mesh.device, requires_grad=True)
        with wp.Tape() as tape:
            inputs = [*values, mesh.put(rotation, wp.mat33), pairs, mesh.put(stiffness, wp.float32), loss]
            wp.launch(witness_refine.rigid_edges, (len(x), len(mesh.edges)), inputs=inputs, device=mesh.device)
        tape.backward(loss)
        return [gradient_of(v) for v in values]

    even = np.ones(mesh.count)
    assert_gradients_close(mesh.rhs(x, y, rotation), -0.5 * gradients(y, even)[0])
    assert_gradients_close(mesh.rhs(x, y, rotation, stiffness=stiffness), -0.5 * gradients(y, stiffness)[0])
    assert_gradients_close(mesh.rest_rhs(x, rotation), -0.5 / len(x) * gradients(np.zeros_like(y), even)[1])


def test_a_rigidly_turned_mesh_is_at_rest(mesh: Mesh, rng: np.random.Generator) -> None:
    """Nothing asked of x, and the shape itself solves L y = b."""
    sphere, _ = synthetic.icosphere(1)
    truth = turns(3, rng)
    x = np.stack([sphere @ turn.T + shift for turn, shift in zip(truth, rng.normal(size=(3, 1, 3)), strict=True)])
    rotation = mesh.fit(x, sphere)
    np.testing.assert_allclose(rotation, np.repeat(truth[:, None], mesh.count, axis=1), rtol=0, atol=2e-5)
    np.testing.assert_allclose(mesh.rhs(x, sphere, rotation), 0, atol=2e-5)
    expected = twin.laplacian(mesh.edges, mesh.count) @ sphere
    np.testing.assert_allclose(mesh.rest_rhs(x, rotation), expected, rtol=0, atol=2e-5)


def test_edges_of_no_length_and_vertices_without_edges_pull_nothing(device: str) -> None:
    mesh, together = Mesh(np.array([[0, 1]]), 3, device), np.ones((2, 3, 3))
    turned = np.tile(np.eye(3), (2, 3, 1, 1))
    np.testing.assert_array_equal(mesh.rhs(together, together[0], turned, start=4.0), 4.0)
    np.testing.assert_array_equal(mesh.rest_rhs(together, turned), 0)


@pytest.mark.parametrize("cuts", [(0, 42, 84, None), (0, 10, 50, 51, None)], ids=["frames", "anywhere"])
def test_spans_are_the_whole(cuts, mesh: Mesh, state) -> None:
    x, y, rotation = state
    np.testing.assert_array_equal(mesh.fit(x, y, cuts), mesh.fit(x, y))
    np.testing.assert_array_equal(mesh.rhs(x, y, rotation, cuts=cuts), mesh.rhs(x, y, rotation))
    np.testing.assert_array_equal(mesh.rest_rhs(x, rotation, (0, 1, 30, None)), mesh.rest_rhs(x, rotation))


def test_a_span_writes_nothing_else(mesh: Mesh, state) -> None:
    x, y, rotation = state
    found = mesh.fit(x, y, (42, 84)).reshape(-1, 9)
    assert np.isfinite(found[42:84]).all() and np.isnan(found[:42]).all() and np.isnan(found[84:]).all()
    assert (mesh.rhs(x, y, rotation, start=7.0, cuts=(42, 84))[[0, 2]] == 7).all()
    assert np.isnan(mesh.rest_rhs(x, rotation, (5, 9))[9:]).all()
