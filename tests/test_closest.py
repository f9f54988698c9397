"""Exact distances from points to triangles, against brute force over finely divided triangles and all triangles."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from warpdef.geometry.closest import closest_on_surface, closest_on_triangles


def by_division(point: np.ndarray, triangle: np.ndarray, steps: int = 400) -> float:
    """Smallest distance to a lattice of places on the triangle: never less than the exact one."""
    v, w = np.meshgrid(np.linspace(0.0, 1.0, steps + 1), np.linspace(0.0, 1.0, steps + 1))
    v, w = v[v + w <= 1.0 + 1e-12], w[v + w <= 1.0 + 1e-12]
    a, b, c = triangle
    return float(np.linalg.norm(a + v[:, None] * (b - a) + w[:, None] * (c - a) - point, axis=1).min())


def exact(points: np.ndarray, triangle: np.ndarray) -> tuple[np.ndarray, ...]:
    a, b, c = (np.broadcast_to(corner, points.shape) for corner in triangle)
    return closest_on_triangles(points, a, b - a, c - a)


@pytest.mark.parametrize(
    "triangle",
    [
        np.array([[0.0, 0, 0], [1, 0, 0], [0.2, 0.8, 0.1]]),
        np.array([[0.0, 0, 0], [1, 0, 0], [-2.0, 0.1, 0]]),  # obtuse
        np.array([[0.0, 0, 0], [1, 1, 1], [0.5, 0.5, 0.5]]),  # a segment
        np.array([[0.0, 0, 0], [0, 0, 0], [1, 0, 0]]),  # a segment with a double corner
        np.array([[0.3, 0.2, 0.1]] * 3),  # a point
    ],
)
def test_the_closest_place_on_a_triangle(triangle: np.ndarray, rng: np.random.Generator) -> None:
    points = rng.normal(size=(60, 3)) * 1.5
    squared, v, w = exact(points, triangle)
    assert (v >= 0).all() and (w >= 0).all() and (v + w <= 1 + 1e-12).all()
    a, b, c = triangle
    place = a + v[:, None] * (b - a) + w[:, None] * (c - a)
    np.testing.assert_allclose(np.linalg.norm(points - place, axis=1), np.sqrt(squared), atol=1e-12)
    brute = np.array([by_division(p, triangle) for p in points])
    assert (np.sqrt(squared) <= brute + 1e-12).all()
    # A lattice place lies within half a cell of the closest one; the error is of second order away from the surface.
    assert (np.sqrt(squared) >= brute - 0.01).all()


def test_known_regions() -> None:
    triangle = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    points = np.array([[0.2, 0.2, 3.0], [-1, -1, 0], [2, -0.5, 0], [0.5, -2, 0], [1, 1, 0], [0.25, 0.25, 0]])
    squared, _, _ = exact(points, triangle)
    np.testing.assert_allclose(squared, [9.0, 2.0, 1.25, 4.0, 0.5, 0.0], atol=1e-15)


def test_the_search_finds_the_closest_triangle_of_all(rng: np.random.Generator) -> None:
    pytest.importorskip("gpytoolbox")
    vertices = rng.normal(size=(60, 3))
    faces = rng.integers(0, 60, size=(80, 3))  # a soup, with degenerate triangles among them
    faces[:5, 1] = faces[:5, 0]
    points = rng.normal(size=(500, 3)) * 2.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        distance, face, barycentric = closest_on_surface(points, vertices, faces)
    every = np.array([exact(points, vertices[f])[0] for f in faces])
    np.testing.assert_allclose(distance, np.sqrt(every.min(axis=0)), atol=1e-12)
    place = np.einsum("nk,nki->ni", barycentric, vertices[faces[face]])
    np.testing.assert_allclose(np.linalg.norm(points - place, axis=1), distance, atol=1e-12)
    assert barycentric.min() >= 0.0
    np.testing.assert_allclose(barycentric.sum(axis=1), 1.0)
