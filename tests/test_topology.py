"""Facts about triangle lists, on meshes whose facts are known."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic import icosphere

from warpdef.template import topology


def torus(n: int = 24, m: int = 12) -> tuple[np.ndarray, np.ndarray]:
    i, j = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
    a, b = 2 * np.pi * i.ravel() / n, 2 * np.pi * j.ravel() / m
    vertices = np.column_stack([(1 + 0.3 * np.cos(b)) * np.cos(a), (1 + 0.3 * np.cos(b)) * np.sin(a), 0.3 * np.sin(b)])
    right, up = ((i + 1) % n * m + j).ravel(), (i * m + (j + 1) % m).ravel()
    here, corner = (i * m + j).ravel(), ((i + 1) % n * m + (j + 1) % m).ravel()
    return vertices, np.concatenate([np.column_stack([here, right, corner]), np.column_stack([here, corner, up])])


def test_a_sphere_and_a_torus():
    sphere, ring = icosphere(3), torus()
    assert topology.is_watertight(sphere[1]) and topology.is_watertight(ring[1])
    assert topology.euler_number(sphere[1]) == 2
    assert topology.euler_number(ring[1]) == 0
    assert topology.signed_volume(*sphere) == pytest.approx(4 / 3 * np.pi, rel=0.02)
    assert topology.signed_volume(*ring) == pytest.approx(2 * np.pi**2 * 0.09, rel=0.06)
    assert topology.face_areas(*sphere).sum() == pytest.approx(4 * np.pi, rel=0.02)
    assert (topology.edge_use(sphere[1]) == 2).all()


def test_volume_keeps_its_digits_far_away():
    vertices, faces = icosphere(2)
    near = topology.signed_volume(vertices, faces)
    assert topology.signed_volume(vertices + 1e6, faces) == pytest.approx(near, rel=1e-6)
    assert topology.signed_volume(vertices, faces[:, ::-1]) == pytest.approx(-near)


def test_holes_turned_faces_and_doubled_faces_are_not_watertight():
    _, faces = icosphere(1)
    turned = faces.copy()
    turned[0] = turned[0, ::-1]
    for bad in (faces[1:], turned, np.concatenate([faces, faces[:1]])):
        assert not topology.is_watertight(bad)


def test_quality_is_one_for_equilateral_triangles_only():
    triangle = np.array([[0, 0, 0], [1, 0, 0], [0.5, np.sqrt(3) / 2, 0]])
    assert topology.triangle_quality(triangle, np.array([[0, 1, 2]])) == pytest.approx(1.0)
    assert topology.triangle_quality(triangle * [1, 0.1, 1], np.array([[0, 1, 2]])) < 0.3
    assert topology.triangle_quality(triangle * 0, np.array([[0, 1, 2]])) == 0.0


def test_the_largest_component_is_the_one_with_most_area():
    small, large = icosphere(3), icosphere(1)
    vertices = np.concatenate([0.1 * small[0], large[0] + 5])
    faces = np.concatenate([small[1], large[1] + len(small[0])])
    kept, kept_faces, left_out = topology.largest_component(vertices, faces)
    assert len(np.unique(topology.face_components(faces))) == 2
    np.testing.assert_array_equal(kept, large[0] + 5)
    np.testing.assert_array_equal(kept_faces, large[1])
    assert left_out == pytest.approx(0.01, rel=0.2)


def test_compact_drops_degenerate_and_doubled_faces_and_unused_vertices():
    vertices = np.arange(18.0).reshape(6, 3)
    faces = np.array([[5, 1, 2], [2, 5, 1], [1, 1, 3], [1, 2, 4]])
    kept, kept_faces = topology.compact(vertices, faces)
    np.testing.assert_array_equal(kept, vertices[[1, 2, 4, 5]])
    np.testing.assert_array_equal(kept_faces, [[3, 0, 1], [0, 1, 2]])


def test_compact_of_nothing_is_nothing():
    vertices, faces = topology.compact(np.zeros((3, 3)), np.zeros((0, 3), dtype=np.int32))
    assert vertices.shape == (0, 3) and faces.shape == (0, 3)
