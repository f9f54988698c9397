"""Facts about triangle lists, on meshes whose facts are known."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic import icosphere

from warpdef.geometry import triangles


def torus(n: int = 24, m: int = 12) -> tuple[np.ndarray, np.ndarray]:
    i, j = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
    a, b = 2 * np.pi * i.ravel() / n, 2 * np.pi * j.ravel() / m
    vertices = np.column_stack([(1 + 0.3 * np.cos(b)) * np.cos(a), (1 + 0.3 * np.cos(b)) * np.sin(a), 0.3 * np.sin(b)])
    right, up = ((i + 1) % n * m + j).ravel(), (i * m + (j + 1) % m).ravel()
    here, corner = (i * m + j).ravel(), ((i + 1) % n * m + (j + 1) % m).ravel()
    return vertices, np.concatenate([np.column_stack([here, right, corner]), np.column_stack([here, corner, up])])


def test_a_sphere_and_a_torus():
    sphere, ring = icosphere(3), torus()
    assert triangles.is_watertight(sphere[1]) and triangles.is_watertight(ring[1])
    assert triangles.euler_number(sphere[1]) == 2
    assert triangles.euler_number(ring[1]) == 0
    assert triangles.signed_volume(*sphere) == pytest.approx(4 / 3 * np.pi, rel=0.02)
    assert triangles.signed_volume(*ring) == pytest.approx(2 * np.pi**2 * 0.09, rel=0.06)
    assert triangles.face_areas(*sphere).sum() == pytest.approx(4 * np.pi, rel=0.02)
    assert (triangles.edge_use(sphere[1]) == 2).all()


def test_volume_keeps_its_digits_far_away():
    vertices, faces = icosphere(2)
    near = triangles.signed_volume(vertices, faces)
    assert triangles.signed_volume(vertices + 1e6, faces) == pytest.approx(near, rel=1e-6)
    assert triangles.signed_volume(vertices, faces[:, ::-1]) == pytest.approx(-near)


def test_holes_turned_faces_and_doubled_faces_are_not_watertight():
    _, faces = icosphere(1)
    turned = faces.copy()
    turned[0] = turned[0, ::-1]
    for bad in (faces[1:], turned, np.concatenate([faces, faces[:1]])):
        assert not triangles.is_watertight(bad)


def test_quality_is_one_for_equilateral_triangles_only():
    triangle = np.array([[0, 0, 0], [1, 0, 0], [0.5, np.sqrt(3) / 2, 0]])
    assert triangles.triangle_quality(triangle, np.array([[0, 1, 2]])) == pytest.approx(1.0)
    assert triangles.triangle_quality(triangle * [1, 0.1, 1], np.array([[0, 1, 2]])) < 0.3
    assert triangles.triangle_quality(triangle * 0, np.array([[0, 1, 2]])) == 0.0


def opened(subdivisions: int = 2, height: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    """A sphere without the faces above and below that height: two boundary loops."""
    vertices, faces = icosphere(subdivisions)
    return triangles.compact(vertices, faces[np.abs(vertices[faces].mean(axis=1)[:, 2]) < height])


def test_boundaries_are_counted_and_found():
    vertices, faces = opened()
    assert triangles.boundary_loops(faces) == 2
    assert triangles.boundary_loops(icosphere(2)[1]) == 0
    assert triangles.euler_number(faces) == 0
    ends = vertices[np.unique(triangles.boundary_edges(faces))]
    assert np.abs(ends[:, 2]).min() > 0.3


def test_components_of_faces_and_of_chosen_vertices():
    small, large = icosphere(2), icosphere(1)
    faces = np.concatenate([small[1], large[1] + len(small[0])])
    assert len(np.unique(triangles.face_components(faces))) == 2
    vertices = small[0]
    patch = triangles.vertex_components(small[1], np.abs(vertices[:, 2]) > 0.7)
    assert set(patch) == {-1, 0, 1}
    assert (patch[np.abs(vertices[:, 2]) <= 0.7] == -1).all()
    top = patch[vertices[:, 2] > 0.7]
    assert (top == top[0]).all() and (patch[vertices[:, 2] < -0.7] != top[0]).all()


def test_fans_that_meet_in_one_vertex_get_one_each():
    vertices = np.arange(15.0).reshape(5, 3)
    bow_tie = np.array([[0, 1, 2], [0, 3, 4]])
    apart, faces = triangles.separate_touching(vertices, bow_tie)
    assert len(apart) == 6 and len(np.unique(faces)) == 6
    np.testing.assert_array_equal(apart[faces], vertices[bow_tie])
    whole = icosphere(1)
    same, same_faces = triangles.separate_touching(*whole)
    assert len(same) == len(whole[0])
    np.testing.assert_array_equal(same[same_faces], whole[0][whole[1]])


def test_vertex_normals_of_a_sphere_and_of_nothing():
    vertices, faces = icosphere(3)
    assert (triangles.vertex_normals(vertices, faces) * vertices).sum(axis=1).min() > 0.999
    assert (triangles.vertex_normals(vertices * 0, faces) == 0).all()


def test_compact_drops_degenerate_and_doubled_faces_and_unused_vertices():
    vertices = np.arange(18.0).reshape(6, 3)
    faces = np.array([[5, 1, 2], [2, 5, 1], [1, 1, 3], [1, 2, 4]])
    kept, kept_faces = triangles.compact(vertices, faces)
    np.testing.assert_array_equal(kept, vertices[[1, 2, 4, 5]])
    np.testing.assert_array_equal(kept_faces, [[3, 0, 1], [0, 1, 2]])


def test_compact_of_nothing_is_nothing():
    vertices, faces = triangles.compact(np.zeros((3, 3)), np.zeros((0, 3), dtype=np.int32))
    assert vertices.shape == (0, 3) and faces.shape == (0, 3)


def test_components_are_the_same_whatever_the_order_of_links(rng):
    for _ in range(30):
        count, many = rng.integers(1, 40), rng.integers(0, 60)
        i, j = rng.integers(0, count, (2, many))
        order = np.argsort(i, kind="stable")
        in_rows, shuffled = (triangles.component_labels(*links, count) for links in ((i[order], j[order]), (i, j)))
        np.testing.assert_array_equal(in_rows, shuffled)
        assert (in_rows[i] == in_rows[j]).all() and len(in_rows) == count
