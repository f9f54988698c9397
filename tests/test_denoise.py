"""Clouds whose noise is wider than their points stand apart: the surface behind them, and the fit to it."""

from __future__ import annotations

import numpy as np
import pytest

import warpdef
from warpdef.cleaning.wide_noise import without_wide_noise
from warpdef.geometry.cloud_normals import estimate_normals
from warpdef.geometry.denoise import POINTS, denoised, noise_if_wide
from warpdef.sequence import PointSequence, Similarity

NOISE = 0.08


def ellipsoid(count: int, noise: float, seed: int = 0) -> np.ndarray:
    """Points (N, 3) on a sphere, stretched along x, moved off it in any direction."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return points * [1.5, 1.0, 1.0] + rng.normal(0.0, noise, points.shape)


def off_surface(points: np.ndarray) -> np.ndarray:
    """Distance of points (N, 3) to the ellipsoid, to first order, above 0 outside."""
    scaled = points / [1.5, 1.0, 1.0]
    length = np.linalg.norm(scaled, axis=1)
    return (length - 1.0) * length / np.linalg.norm(scaled / [1.5, 1.0, 1.0], axis=1)


@pytest.mark.parametrize("count", [5000, 20_000])
def test_noise_is_taken_off(count: int) -> None:
    points = ellipsoid(count, NOISE)
    noise = noise_if_wide(points)
    assert noise == pytest.approx(NOISE, rel=0.3)
    found, normals = denoised(points, noise)
    assert POINTS <= len(found) <= count
    off = off_surface(found)
    assert np.sqrt((off**2).mean()) < 0.35 * NOISE
    assert abs(off.mean()) < 0.15 * NOISE
    true = found / [1.5**2, 1.0, 1.0]
    cosine = (normals * true).sum(axis=1) / np.linalg.norm(true, axis=1)
    assert (cosine > 0).mean() > 0.995
    assert cosine.mean() > 0.98


def test_a_dense_cloud_says_more_than_a_sparse_one() -> None:
    """Normals of a fixed number of neighbours are worse, the denser a noisy cloud is."""
    errors = []
    for count in (3000, 30_000):
        points = ellipsoid(count, NOISE)
        errors.append(np.sqrt((off_surface(denoised(points, noise_if_wide(points))[0]) ** 2).mean()))
    assert errors[1] < 0.9 * errors[0]
    points = ellipsoid(30_000, NOISE)
    of_neighbours = (estimate_normals(points) * points / [1.5**2, 1.0, 1.0]).sum(axis=1)
    assert (of_neighbours > 0).mean() < 0.95


def test_what_is_clean_or_sparse_stays() -> None:
    assert noise_if_wide(ellipsoid(5000, 0.0)) == 0.0
    assert noise_if_wide(ellipsoid(5000, 0.01)) == 0.0
    assert noise_if_wide(ellipsoid(500, NOISE)) == 0.0
    sequence = PointSequence.from_arrays([ellipsoid(2500, 0.0, seed) for seed in range(3)])
    scattered, same = without_wide_noise(sequence, Similarity.into_cube(sequence.points, 0.95), 16)
    assert scattered is None
    assert same is sequence


def test_the_units_do_not_matter() -> None:
    points = ellipsoid(3000, NOISE)
    found, normals = denoised(points, noise_if_wide(points))
    far, same = denoised(1000.0 * points + 7.0, noise_if_wide(1000.0 * points + 7.0))
    np.testing.assert_allclose(far, 1000.0 * found + 7.0, rtol=0, atol=1e-3)
    np.testing.assert_allclose(same, normals, rtol=0, atol=1e-5)


def test_the_fit_is_unbiased_and_smooth() -> None:
    pytest.importorskip("gpytoolbox")
    clouds = [ellipsoid(2500, NOISE, seed) + [0.05 * seed, 0.0, 0.0] for seed in range(4)]
    result = warpdef.reconstruct(clouds, device="cpu", threads=1)
    off = np.stack([off_surface(v - [0.05 * t, 0.0, 0.0]) for t, v in enumerate(result.vertices)])
    assert np.sqrt((off**2).mean()) < 0.35 * NOISE
    assert abs(off.mean()) < 0.1 * NOISE
    assert result.report["template"]["gate"]["handles"] == 0
    assert result.report["template"]["normals"] == "given"
