"""The grid of tetrahedra and the triangles of a level set on it."""

from __future__ import annotations

import numpy as np
import pytest

from warpdef.geometry import triangles
from warpdef.template.lattice import (
    _TETRAHEDRA,
    AXES,
    CORNERS,
    DIRECTIONS,
    Lattice,
    crossed_cells,
    edges_within,
    march,
    refine,
)


def cube(nodes: int = 17) -> Lattice:
    """Over [-1, 1]^3."""
    return Lattice((nodes, nodes, nodes), np.full(3, -1.0), 2.0 / (nodes - 1))


def positions(lattice: Lattice) -> np.ndarray:
    """(X, Y, Z, 3)."""
    return lattice.from_cells(lattice.places(np.arange(np.prod(lattice.shape)))).reshape(*lattice.shape, 3)


def surface(lattice: Lattice, distance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices by linear interpolation along the crossed edges, and faces."""
    edges, faces = march(lattice, distance)
    x = positions(lattice).reshape(-1, 3)[edges]
    s = distance.ravel()[edges]
    t = (s[:, 0] / (s[:, 0] - s[:, 1]))[:, None]
    return (1 - t) * x[:, 0] + t * x[:, 1], faces


def test_six_tetrahedra_fill_a_cube_the_same_way_round() -> None:
    corners = CORNERS[_TETRAHEDRA]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
    np.testing.assert_allclose(volumes, 1 / 6)
    # Every edge leads along one of the seven directions.
    ends = corners[:, [0, 0, 0, 1, 1, 2]], corners[:, [1, 2, 3, 2, 3, 3]]
    steps = np.abs(ends[1] - ends[0]).reshape(-1, 3)
    assert {tuple(s) for s in steps} == {tuple(d) for d in DIRECTIONS}
    assert all(((e == 0) | (e > 0)).all() or (e <= 0).all() for e in (ends[1] - ends[0]).reshape(-1, 3))
    np.testing.assert_array_equal(DIRECTIONS[AXES], np.eye(3))


@pytest.mark.parametrize("radius", [0.3, 0.71, 0.9])
def test_a_sphere(radius: float) -> None:
    lattice = cube(33)
    vertices, faces = surface(lattice, np.linalg.norm(positions(lattice), axis=3) - radius)
    assert triangles.is_watertight(faces)
    assert triangles.euler_number(faces) == 2
    assert triangles.signed_volume(vertices, faces) == pytest.approx(4 / 3 * np.pi * radius**3, rel=0.03)
    assert np.abs(np.linalg.norm(vertices, axis=1) - radius).max() < 0.01
    normals = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    assert ((normals * vertices[faces].mean(axis=1)).sum(axis=1) > -1e-9).all()


def test_a_ring_has_a_handle_and_two_balls_are_two() -> None:
    lattice = cube(33)
    x, y, z = np.moveaxis(positions(lattice), 3, 0)
    _, ring = surface(lattice, np.hypot(np.hypot(x, y) - 0.6, z) - 0.22)
    assert triangles.is_watertight(ring) and triangles.euler_number(ring) == 0
    two = np.minimum(*(np.sqrt((x - c) ** 2 + y**2 + z**2) - 0.3 for c in (-0.5, 0.5)))
    _, balls = surface(lattice, two)
    assert triangles.face_components(balls).max() == 1 and triangles.euler_number(balls) == 4


@pytest.mark.parametrize("levels", [0, 3])
def test_any_field_gives_a_closed_manifold(levels: int, rng: np.random.Generator) -> None:
    """Noise; and whole numbers, so that many nodes lie exactly on the surface."""
    lattice = Lattice((9, 10, 11), np.zeros(3), 1.0)
    distance = rng.normal(size=lattice.shape)
    if levels:
        distance = np.round(distance)
    for axis in range(3):
        np.moveaxis(distance, axis, 0)[[0, -1]] = 1.0
    edges, faces = march(lattice, distance)
    assert triangles.is_watertight(faces)
    inside = (distance < 0).ravel()
    assert (inside[edges[:, 0]] != inside[edges[:, 1]]).all()
    assert len(np.unique(edges, axis=0)) == len(edges) and len(np.unique(faces)) == len(edges)
    assert triangles.signed_volume(*surface(lattice, np.where(distance < 0, -1.0, 1.0))) > 0


def test_one_node_inside() -> None:
    """It is met by all fourteen edges, and enclosed."""
    lattice = Lattice((3, 3, 3), np.zeros(3), 1.0)
    distance = np.ones(lattice.shape)
    distance[1, 1, 1] = -1
    edges, faces = march(lattice, distance)
    assert (len(edges), len(faces)) == (14, 24)
    assert triangles.is_watertight(faces) and triangles.euler_number(faces) == 2


def test_nothing_inside() -> None:
    lattice = cube(5)
    edges, faces = march(lattice, np.zeros(lattice.shape))  # 0 is outside
    assert edges.shape == (0, 2) and faces.shape == (0, 3)
    assert not crossed_cells(np.zeros(lattice.shape)).any()


def test_crossed_cells_are_those_with_both_sides(rng: np.random.Generator) -> None:
    distance = rng.normal(size=(4, 5, 6)) + 1.0
    found = crossed_cells(distance)
    for i, j, k in np.ndindex(*found.shape):
        inside = distance[i : i + 2, j : j + 2, k : k + 2] < 0
        assert found[i, j, k] == (inside.any() and not inside.all())


def test_refining_keeps_nodes_and_is_linear_between() -> None:
    lattice = Lattice((3, 4, 5), np.array([1.0, 2, 3]), 0.5)
    finer = lattice.finer()
    assert finer.shape == (5, 7, 9) and finer.cell == 0.25
    np.testing.assert_allclose(positions(finer)[::2, ::2, ::2], positions(lattice))
    coarse = positions(lattice) @ np.array([1.0, -2.0, 0.5]) + 3.0
    np.testing.assert_allclose(refine(coarse), positions(finer) @ np.array([1.0, -2.0, 0.5]) + 3.0)
    np.testing.assert_allclose(refine(positions(lattice)), positions(finer))


def test_cells_and_units_are_two_ways() -> None:
    lattice = Lattice((3, 4, 5), np.array([1.0, 2, 3]), 0.5)
    places = lattice.places(np.arange(60))
    np.testing.assert_array_equal(places[1] - places[0], [0, 0, 1])
    np.testing.assert_allclose(lattice.to_cells(lattice.from_cells(places)), places)


def test_edges_lie_between_kept_nodes(rng: np.random.Generator) -> None:
    lattice = Lattice((5, 6, 7), np.zeros(3), 1.0)
    kept = np.zeros(lattice.shape, bool)
    kept[1:-1, 1:-1, 1:-1] = rng.random((3, 4, 5)) < 0.6
    found = {tuple(e) for e in edges_within(lattice, kept, DIRECTIONS)}
    places = lattice.places(np.arange(kept.size)).astype(int)
    expected = set()
    for i in np.flatnonzero(kept):
        for d in DIRECTIONS:
            j = int(np.ravel_multi_index(tuple(places[i] + d), lattice.shape))
            if kept.ravel()[j]:
                expected.add((i, j))
    assert found == expected and len(expected) > 50
