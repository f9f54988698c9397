"""The built-in walking figure: a good mesh, a moderate and faithful motion, the same every time."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from warpdef.errors import InputError, MissingPackageError
from warpdef.geometry.triangles import unique_edges
from warpdef.mesh import MeshSequence, TriMesh
from warpdef.truth.figure import walking_figure
from warpdef.truth.skinning import chain_motions, skin, smooth_weights


@pytest.fixture(scope="module")
def figure() -> MeshSequence:
    pytest.importorskip("gpytoolbox")
    return walking_figure()


def lengths(figure: MeshSequence) -> np.ndarray:
    i, j = unique_edges(figure.faces).T
    return np.linalg.norm(figure.vertices[:, i] - figure.vertices[:, j], axis=2)


def test_the_mesh_is_closed_in_one_piece_and_of_genus_0(figure: MeshSequence) -> None:
    vertex_count, faces = figure.vertices.shape[1], figure.faces
    assert figure.vertices.shape[0] == 17
    assert 9_000 < vertex_count < 11_000
    directed = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    assert len(np.unique(directed, axis=0)) == len(directed)  # no edge twice in one direction
    there, back = {tuple(e) for e in directed}, {tuple(e[::-1]) for e in directed}
    assert there == back  # every edge has its opposite
    assert vertex_count - len(directed) // 2 + len(faces) == 2  # Euler
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    graph = coo_matrix((np.ones(len(directed)), directed.T), shape=(vertex_count, vertex_count))
    assert connected_components(graph, directed=False)[0] == 1


def test_triangles_are_nearly_equilateral_and_never_degenerate(figure: MeshSequence) -> None:
    corners = figure.vertices[:, figure.faces]
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0]), axis=2
    )
    squared = ((corners - np.roll(corners, 1, axis=2)) ** 2).sum(axis=(2, 3))
    quality = 4.0 * np.sqrt(3.0) * area / squared  # 1 for an equilateral triangle
    assert quality[0].mean() > 0.95
    assert quality.min() > 0.3
    assert area.min() > 0.2 * area.mean()


def test_the_body_keeps_its_height_and_volume(figure: MeshSequence) -> None:
    corners = figure.vertices[:, figure.faces]
    volume = np.einsum("tfi,tfi->t", corners[:, :, 0], np.cross(corners[:, :, 1], corners[:, :, 2])) / 6.0
    assert 0.04 < volume.min() < 0.08
    assert np.ptp(volume) < 0.01 * volume.mean()
    height = np.ptp(figure.vertices[:, :, 1], axis=1)
    assert (height > 1.65).all() and (height < 1.80).all()
    assert np.abs(figure.vertices[:, :, 1].min(axis=1)).max() < 0.02  # it stands on the ground


def test_the_motion_is_moderate_and_smooth(figure: MeshSequence) -> None:
    step = np.linalg.norm(np.diff(figure.vertices, axis=0), axis=2)
    assert 0.05 < step.max() / 1.75 < 0.09
    edge = lengths(figure)
    assert 0.8 < (edge[1:] / edge[:-1]).min() and (edge[1:] / edge[:-1]).max() < 1.25
    assert 0.5 < (edge / edge[0]).min() and (edge / edge[0]).max() < 1.8


def test_it_turns_by_72_degrees_and_walks_forward(figure: MeshSequence) -> None:
    from scipy.spatial.transform import Rotation

    head = figure.vertices[0, :, 1] > 1.58
    first, last = figure.vertices[0, head], figure.vertices[-1, head]
    rotation = Rotation.align_vectors(last - last.mean(axis=0), first - first.mean(axis=0))[0]
    assert 60.0 < np.degrees(rotation.magnitude()) < 90.0
    walked = last.mean(axis=0) - first.mean(axis=0)
    assert np.linalg.norm(walked[[0, 2]]) > 0.3


def test_limbs_never_touch_another_part(figure: MeshSequence) -> None:
    """Places far apart along the surface stay apart in space; touching or crossing would bring them together."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import dijkstra
    from scipy.spatial import cKDTree

    i, j = unique_edges(figure.faces).T
    graph = coo_matrix((lengths(figure)[0], (i, j)), shape=(figure.vertices.shape[1],) * 2).tocsr()
    for frame in range(17):
        pairs = cKDTree(figure.vertices[frame]).query_pairs(0.015, output_type="ndarray")
        sources = np.unique(pairs[:, 0])[::3]
        pairs = pairs[np.isin(pairs[:, 0], sources)]
        assert len(pairs) > 1_000
        way = dijkstra(graph, directed=False, indices=sources, limit=0.1)
        met = ~np.isfinite(way[np.searchsorted(sources, pairs[:, 0]), pairs[:, 1]])
        assert not met.any(), f"frame {frame}: {figure.vertices[frame][pairs[met][0]]}"


def test_the_same_call_gives_the_same_numbers(figure: MeshSequence) -> None:
    again = walking_figure(17)
    assert np.array_equal(again.faces, figure.faces)
    assert np.array_equal(again.vertices, figure.vertices)


def test_one_frame_is_refused() -> None:
    with pytest.raises(InputError, match="at least 2 frames, got 1"):
        walking_figure(1)


def test_a_missing_mesher_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gpytoolbox", None)
    with pytest.raises(MissingPackageError, match="pip install gpytoolbox"):
        walking_figure()


# Skinning -----------------------------------------------------------------------------------------------------------


def strip(count: int = 41) -> TriMesh:
    """A flat ribbon along x, from 0 to 4."""
    x = np.repeat(np.linspace(0.0, 4.0, count), 2)
    vertices = np.column_stack([x, np.tile([0.0, 0.1], count), np.zeros(2 * count)])
    a = 2 * np.arange(count - 1)
    faces = np.concatenate([np.stack([a, a + 2, a + 1], axis=1), np.stack([a + 1, a + 2, a + 3], axis=1)])
    return TriMesh(vertices, faces)


def turn_z(degrees: float) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def test_weights_blend_over_the_joint_and_sum_to_1() -> None:
    mesh = strip()
    right = (mesh.vertices[:, 0] > 2.0).astype(int)
    weights = smooth_weights(mesh, right, 2, 4.0)
    assert weights.min() >= 0.0
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    along = weights[::2, 1]
    assert (np.diff(along) > 0.0).all()  # monotone along the ribbon
    assert along[0] < 0.01 and along[-1] > 0.99 and 0.3 < along[20] < 0.7


def test_skinning_with_one_motion_is_that_motion(rng: np.random.Generator) -> None:
    points, rotation, shift = rng.normal(size=(50, 3)), turn_z(130.0), np.array([1.0, -2.0, 3.0])
    weights = rng.random((50, 2))
    weights /= weights.sum(axis=1, keepdims=True)
    moved = skin(points, weights, np.stack([rotation] * 2), np.stack([shift] * 2))
    np.testing.assert_allclose(moved, points @ rotation.T + shift, atol=1e-12)


def test_blending_keeps_every_motion_rigid() -> None:
    """Half way between two turns about one axis lies the mean turn: the distance from the axis is kept."""
    points = np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 0.5]])
    moved = skin(points, np.full((2, 2), 0.5), np.stack([turn_z(-70.0), turn_z(70.0)]), np.zeros((2, 3)))
    np.testing.assert_allclose(moved, points, atol=1e-12)  # blended matrices would shrink them to cos 70


def test_opposite_signs_of_a_quaternion_blend_the_short_way() -> None:
    points = np.array([[1.0, 0.0, 0.0]])
    moved = skin(points, np.full((1, 2), 0.5), np.stack([turn_z(170.0), turn_z(190.0)]), np.zeros((2, 3)))
    np.testing.assert_allclose(moved, points @ turn_z(180.0).T, atol=1e-12)


def test_a_chain_carries_its_children() -> None:
    joints = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    local = np.stack([turn_z(90.0), turn_z(90.0)])
    rotations, translations = chain_motions((-1, 0), joints, local, np.array([0.0, 0.0, 5.0]))
    moved = rotations[1] @ np.array([2.0, 0.0, 0.0]) + translations[1]
    np.testing.assert_allclose(rotations[1], turn_z(180.0), atol=1e-12)
    np.testing.assert_allclose(moved, [-1.0, 1.0, 5.0], atol=1e-12)
