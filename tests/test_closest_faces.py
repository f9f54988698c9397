"""The nearest face by Warp's tree: distances as exact as by the other; what is measured with them on any way."""

from __future__ import annotations

import numpy as np
import synthetic
import warp as wp

from warpdef.device import Way, find_device, going
from warpdef.geometry.closest import closest_on_surface
from warpdef.kernels.closest_faces import closest_faces
from warpdef.quality.coverage import measure_coverage


def surface(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points about an ellipsoid far from the origin, its vertices and faces; some faces have no area."""
    moving = synthetic.turning_ellipsoid(3, 400, rng, subdivisions=2)
    vertices = 3.0 * moving.vertices[0].astype(np.float64) + [70.0, -20.0, 5.0]
    points = 3.0 * moving.clouds[0].astype(np.float64) + [70.0, -20.0, 5.0]
    faces = np.concatenate([moving.faces, [[0, 0, 1], [5, 5, 5]]])
    return points + rng.normal(scale=0.05, size=points.shape), vertices, faces


def test_distances_are_those_of_the_other_tree(device: str, rng: np.random.Generator) -> None:
    points, vertices, faces = surface(rng)
    expected, _, _ = closest_on_surface(points, vertices, faces)
    found, face, weights = closest_on_surface(points, vertices, faces, find_device(device))
    extent = np.ptp(vertices, axis=0).max()
    # A face that float32 takes for as near is no nearer than the nearest, and farther by its rounding at most.
    assert (found >= expected - 1e-12).all()
    assert (found <= expected + 8 * np.finfo(np.float32).eps * extent).all()
    places = np.einsum("nk,nki->ni", weights, vertices[faces[face]])
    np.testing.assert_allclose(np.linalg.norm(points - places, axis=1), found, rtol=0, atol=1e-9)


def test_what_is_no_number_has_no_face(device: str) -> None:
    at = find_device(device)
    corners = wp.array(np.eye(3, dtype=np.float32), dtype=wp.vec3, device=at)
    mesh = wp.Mesh(corners, wp.array([0, 1, 2], dtype=wp.int32, device=at))
    asked = wp.array([[0.0, 0.0, 0.0], [np.nan, 0.0, 0.0]], dtype=wp.vec3, device=at)
    found = wp.full(2, 7, dtype=wp.int32, device=at)
    closest_faces(0, 2, mesh.id, asked, found)
    assert found.numpy()[0] == 0 and found.numpy()[1] in (-1, 0)


def test_coverage_is_the_same_on_a_device(rng: np.random.Generator) -> None:
    """By trees, by Warp's tree of the mesh, and by grids of the points, too."""
    points, vertices, faces = surface(rng)
    expected, cpu = measure_coverage(points, vertices, faces), find_device("cpu")
    some = measure_coverage(points, vertices, faces, cpu)
    with going(Way.WHOLE):
        all_of_it = measure_coverage(points, vertices, faces, cpu)
    assert (some.spacing == expected.spacing).all() and not (all_of_it.spacing == expected.spacing).all()
    for found in (some, all_of_it):
        assert (found.nearest == expected.nearest).mean() > 0.99
        for name in ("spacing", "residual", "away", "far_faces", "areas"):
            mine, theirs = getattr(found, name), getattr(expected, name)
            np.testing.assert_allclose(mine, theirs, rtol=1e-4, atol=1e-5 * np.abs(theirs).max())
        assert (found.seen == expected.seen).mean() > 0.99 and abs(found.far - expected.far) < 1e-6
