"""Clouds whose noise is wider than their points stand apart: the surface behind them, and the fit to it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from refine_samples import MovingEllipsoid, Rounds

import warpdef
from warpdef.cleaning.wide_noise import noise_facts, noise_note, without_wide_noise
from warpdef.config import Config
from warpdef.cube_clouds import CubeClouds
from warpdef.errors import InputError
from warpdef.fit.measures import mean_edge_length
from warpdef.geometry.cloud_normals import estimate_normals
from warpdef.geometry.denoise import POINTS, Scattered, denoised, noise_if_wide
from warpdef.geometry.triangles import unique_edges
from warpdef.prepare import clean
from warpdef.sequence import PointSequence, Similarity
from warpdef.starting_template import find_template
from warpdef.template.keyframe import rank_keyframes

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
    assert result.report["template"]["normals"] == "estimated"
    told = result.report["noise"]
    assert told["deviation"] == pytest.approx(NOISE, rel=0.3)
    assert (told["points"], told["normals"], told["normals_given"]) == (2500, "estimated", 0)
    assert sum("clouds are noisy" in w for w in result.report["warnings"]) == 1


def test_sides_given_are_replaced_and_told_or_kept() -> None:
    """Of normals that all point inwards."""
    clouds = [ellipsoid(2500, NOISE, seed) for seed in range(3)]
    inwards = [-c / np.linalg.norm(c, axis=1, keepdims=True) for c in clouds]
    for given, trusted, outwards, ending in (
        (inwards, False, True, "(--trust-normals keeps the sides of these)"),
        (inwards, True, False, "given normals keep their sides"),
        ([None] * 3, True, True, "moved onto it"),
    ):
        sequence = PointSequence.from_arrays(clouds, given)
        into = Similarity.into_cube(sequence.points, 0.95)
        scattered, calm = without_wide_noise(sequence, into, 16, trusted)
        assert scattered is not None
        for points, normals in zip(calm.points, calm.normals, strict=True):
            assert normals is not None
            assert (((normals * points).sum(axis=1) > 0).mean() > 0.99) == outwards
            assert (((normals * points).sum(axis=1) < 0).mean() > 0.99) != outwards
        facts = noise_facts(scattered, sequence, calm, into, trusted)
        assert facts["deviation"] == pytest.approx(NOISE, rel=0.3)
        assert facts["share"] == pytest.approx(facts["deviation"] / np.ptp(np.concatenate(clouds), axis=0).max())
        assert noise_note(facts).endswith(ending)


@pytest.mark.parametrize(("noise", "source"), [(0.0, "estimated"), (NOISE, "calm")])
def test_the_keyframe_of_noisy_clouds_is_one_of_the_middle(
    noise: float, source: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Noise fills voxels by chance: the first frame, which fills a few more, comes first of clean clouds alone."""
    clouds = [ellipsoid(2500 if t else 2600, noise, t) for t in range(9)]
    asked = CubeClouds.of(PointSequence.from_arrays(clouds), Config())
    assert (asked.scattered is not None) == (noise > 0)
    told = []

    def draft(points: np.ndarray, normals: Any, config: Any, backend: Any, source: str, frames: int) -> None:
        told.append((points, source))
        raise InputError("no surface")

    monkeypatch.setattr("warpdef.template.choose.draft", draft)
    with pytest.raises(InputError, match="no template"):
        find_template(asked, None, Config())
    points, given = told[0]
    first = [len(p) and np.array_equal(p, points) for p in asked.points_of_all()].index(True)
    assert (first in (3, 4, 5)) == (noise > 0)
    assert given == source
    ranked = rank_keyframes(asked.points_of_all(), Config().keyframe, noisy=True)
    assert all(c.score == c.occupied_voxels * c.weight for c in ranked)  # further ones are taken by it


@pytest.mark.parametrize(("edges", "tied"), [(1.1, True), (1.3, False)])
def test_rotations_are_tied_up_to_noise_as_wide_as_edges_are_long(edges: float, tied: bool) -> None:
    scene = MovingEllipsoid.make(5, 400, np.random.default_rng(0))
    noise = edges * mean_edge_length(scene.body, unique_edges(scene.faces))
    scattered = [Scattered(cloud, noise) for cloud in scene.clouds]
    stage = Rounds(scene, scene.vertices, "cpu", 0, scattered=scattered).stage
    assert bool(stage._tie) == tied


def test_trusted_normals_are_left_as_they_are() -> None:
    """Sides that would be turned over are not, and directions that say nothing stay."""
    clouds = [ellipsoid(2500, 0.0, seed) for seed in range(3)]
    rng = np.random.default_rng(7)
    for given in (
        [-c / np.linalg.norm(c, axis=1, keepdims=True) for c in clouds],
        [rng.normal(size=c.shape) for c in clouds],
    ):
        sequence = PointSequence.from_arrays(clouds, given)
        kept, changed = (clean(sequence, Config(trust_normals=trusted)) for trusted in (True, False))
        for before, after, other in zip(sequence.normals, kept.normals, changed.normals, strict=True):
            np.testing.assert_array_equal(before, after)
            assert other is None or (before is not None and not np.array_equal(before, other))
