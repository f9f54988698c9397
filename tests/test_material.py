"""Strains against their twin; and a bar that bends in one place is found to be soft there."""

from __future__ import annotations

import numpy as np
import pytest
import reference_refine as twin
import synthetic
import warp as wp

from warpdef.fit.material import stiffness_of
from warpdef.geometry.triangles import unique_edges
from warpdef.kernels.graphs import mesh_graph
from warpdef.kernels.material import strains

State = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def strains_of(state: State, device: str, spans=None) -> np.ndarray:
    """(V,), NaN where nobody wrote."""
    x, y, rotation, edges = state
    graph = mesh_graph(edges, len(y), 1.0)
    row, column = (wp.array(a, dtype=wp.int32, device=device) for a in (graph.row, graph.column))
    arrays = [
        wp.array(a.astype(np.float32), dtype=dtype, device=device)
        for a, dtype in ((y, wp.vec3), (rotation, wp.mat33), (x, wp.vec3))
    ]
    out = wp.full(len(y), float("nan"), dtype=wp.float32, device=device)
    for begin, count in spans or [(0, len(y))]:
        strains(begin, count, row, column, arrays[0], arrays[1], arrays[2], out)
    return out.numpy()


@pytest.fixture
def state(rng: np.random.Generator) -> State:
    """x, y, R and edges that do not fit one another, of three frames."""
    sphere, faces = synthetic.icosphere(1)
    y = sphere + 0.1 * rng.normal(size=sphere.shape)
    turns = [synthetic.turn_about(rng.normal(size=3), 0.3) for _ in range(3 * len(y))]
    x = y + 0.2 * rng.normal(size=(3, *y.shape))
    return x, y, np.reshape(turns, (3, len(y), 3, 3)), unique_edges(faces)


def test_strains_match_the_twin(state, device: str) -> None:
    found = strains_of(state, device)
    np.testing.assert_allclose(found, twin.strains(*state), rtol=1e-5)
    spans = strains_of(state, device, [(0, 10), (10, 1), (11, 31)])
    np.testing.assert_array_equal(spans, found)
    assert np.isnan(strains_of(state, device, [(5, 4)])[9:]).all()


def test_what_moves_rigidly_has_no_strain_and_what_is_twice_as_long_strains_by_one(state, device: str) -> None:
    _, y, _, edges = state
    turn = synthetic.turn_about(np.array([1.0, 2.0, 3.0]), 2.0)
    turned = np.broadcast_to(turn, (1, len(y), 3, 3))
    np.testing.assert_allclose(strains_of(((y @ turn.T + 1)[None], y, turned, edges), device), 0, atol=1e-9)
    np.testing.assert_allclose(strains_of(((2 * y @ turn.T)[None], y, turned, edges), device), 1, rtol=1e-4)


def test_without_edges_and_without_length_nothing_strains(device: str) -> None:
    edges, turned = np.array([[0, 1]]), np.broadcast_to(np.eye(3), (2, 3, 3, 3))
    together = np.zeros((3, 3))
    np.testing.assert_array_equal(strains_of((np.ones((2, 3, 3)), together, turned, edges), device), 0)
    apart = np.arange(18.0).reshape(2, 3, 3)
    assert np.isfinite(strains_of((apart, together, turned, edges), device)).all()


def test_stiffness_falls_where_strain_is_and_stays_in_bounds() -> None:
    strain = np.concatenate([np.full(50, 0.1), np.full(10, 0.15), np.full(10, 9.0), np.zeros(10)]) ** 2
    found = stiffness_of(strain)
    np.testing.assert_allclose(found[:50], 1)
    assert (found[50:60] < 0.8).all() and (found[60:70] == 0.5).all()
    assert ((found[70:] > 1.2) & (found[70:] <= 2)).all()
    # Strains as small as what triangles themselves leave tell nothing.
    np.testing.assert_allclose(stiffness_of(np.linspace(0, 1e-4, 20)), 1, atol=0.02)


def test_a_bar_that_bends_in_one_place_is_soft_there(device: str) -> None:
    """Two frames, bent to either side; rotations are each vertex's best."""
    along, around = np.meshgrid(np.arange(20), np.arange(8), indexing="ij")
    bar = np.stack([0.3 * along, np.cos(np.pi / 4 * around), np.sin(np.pi / 4 * around)], axis=-1)
    middle = 0.3 * 9.5
    frames = []
    for angle in (0.9, -0.9):
        turned = (bar - [middle, 0, 0]) @ synthetic.turn_about(np.array([0.0, 0.0, 1.0]), angle).T + [middle, 0, 0]
        frames.append(np.where(bar[..., :1] > middle, turned, bar).reshape(-1, 3))
    x, y, number = np.stack(frames), bar.reshape(-1, 3), 8 * along + around
    edges = np.concatenate([np.stack([number, np.roll(number, 1, axis=1)], -1).reshape(-1, 2),
                            np.stack([number[1:], number[:-1]], -1).reshape(-1, 2)])  # fmt: skip
    found = stiffness_of(strains_of((x, y, twin.fit_rotations(x, y, edges), edges), device)).reshape(20, 8)
    assert found[9:11].mean() < 0.7 and (found[:8] == found.max()).all() and (found[12:] == found.max()).all()
