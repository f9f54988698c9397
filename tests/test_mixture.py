"""Noisy points against all vertices around them: a mixture of Gaussians."""

from __future__ import annotations

import numpy as np
import pytest
import reference_refine as twin
import synthetic
import warp as wp
from gradients import assert_gradients_close, finite_differences
from test_planes import put

from warpdef.kernels.cells import PointGrid
from warpdef.kernels.mixture import clear_sums, mixture_planes, mixture_sums

WEIGHT = 2.0


def run(cloud, frame, deviation, vertices, normals, device: str) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations of vertices (T, V, 3), by the kernels frame by frame, over what had been there."""
    frames, count = vertices.shape[:2]
    grid = PointGrid(put(vertices.reshape(-1, 3), wp.vec3, device), [count] * frames)
    grid.build()
    matrix, rhs = (
        put(np.ones((frames * count, 3, 3)), wp.mat33, device),
        put(np.ones((frames * count, 3)), wp.vec3, device),
    )
    points = put(cloud, wp.vec3, device), put(frame, wp.int32, device), put(deviation, wp.float32, device)
    facing, begins = put(normals.reshape(-1, 3), wp.vec3, device), np.searchsorted(frame, np.arange(frames + 1))
    for t in range(frames):
        of_frame = int(begins[t]), int(begins[t + 1] - begins[t])
        clear_sums(t * count, count, rhs)
        mixture_sums(*of_frame, WEIGHT, *points, grid.targets, facing, rhs)
        mixture_planes(t * count, count, facing, rhs, matrix)
    return matrix.numpy(), rhs.numpy()


def residuals(cloud, frame, deviation, vertices, normals) -> twin.Planes:
    """What the kernel adds up, pair by pair, in float64."""
    per_frame = vertices.shape[1]
    owner, a, w, r = [], [], [], []
    for q, t in zip(cloud, frame, strict=True):
        away, s = q - vertices[t], deviation[t]
        squared = (away**2).sum(axis=1)
        near = np.flatnonzero(squared < (3.0 * s) ** 2)
        likely = np.exp(-0.5 * squared[near] / s**2)
        owner.append(t * per_frame + near)
        a.append(normals[t][near])
        w.append(WEIGHT * likely / (likely.sum() + 0.05))
        r.append(-(normals[t][near] * away[near]).sum(axis=1))
    return twin.Planes(*(np.concatenate(part) for part in (owner, a, w, r)))


@pytest.fixture
def scene(rng: np.random.Generator):
    vertices = rng.uniform(-1.0, 1.0, (2, 200, 3))
    normals = rng.normal(size=vertices.shape)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    # Some beyond the box of the vertices, one far from all.
    cloud = rng.uniform(-1.2, 1.2, (60, 3))
    cloud[7] = 9.0
    return cloud, np.repeat([0, 1], 30), np.array([0.2, 0.3]), vertices, normals


def test_equations_match_the_twin(scene: tuple[np.ndarray, ...], device: str) -> None:
    cloud, frame, deviation, vertices, normals = scene
    pairs = residuals(cloud, frame, deviation, vertices, normals)
    assert 5.0 < len(pairs.owner) / len(cloud) < 100.0
    sums = run(cloud, frame, deviation, vertices, normals, device)
    for found, expected in zip(sums, pairs.normal_equations(400), strict=True):
        np.testing.assert_allclose(found, expected, rtol=0, atol=2e-5)


def test_the_right_hand_side_is_half_the_descent(scene: tuple[np.ndarray, ...], device: str) -> None:
    cloud, frame, deviation, vertices, normals = scene
    rhs = run(cloud, frame, deviation, vertices, normals, device)[1]
    energy = residuals(cloud, frame, deviation, vertices, normals).energy
    assert_gradients_close(-2.0 * rhs, finite_differences(energy, np.zeros((400, 3))))


def test_a_curved_surface_is_not_drawn_outwards(rng: np.random.Generator, device: str) -> None:
    """More of the noise around a sphere lies outside: the nearest vertices of all points would move by s^2."""
    sphere, _ = synthetic.icosphere(3)
    deviation = 0.2
    points = rng.normal(size=(20_000, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    points += rng.normal(0.0, deviation, points.shape)
    assert np.linalg.norm(points, axis=1).mean() - 1.0 > 0.8 * deviation**2
    frame = np.zeros(len(points), dtype=int)
    matrix, rhs = run(points, frame, np.array([deviation]), sphere[None], sphere[None], device)
    moved = (rhs * sphere).sum() / np.trace(matrix.sum(axis=0))
    assert abs(moved) < 0.2 * deviation**2
