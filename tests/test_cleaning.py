"""Strays: found among surfaces of every kind, and never seen where there are none."""

from __future__ import annotations

import numpy as np
import pytest
from present import present
from synthetic import bending_bar, icosphere, sample_surface

from warpdef.cleaning import strays
from warpdef.cleaning.strays import drop_strays, inlier_mask
from warpdef.sequence import PointSequence


def with_strays(points: np.ndarray, share: float, rng: np.random.Generator) -> np.ndarray:
    """The points first, then strays, uniform over twice their bounding box, ``share`` of the whole."""
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    half = (points.max(axis=0) - points.min(axis=0)) / 2
    count = round(len(points) * share / (1 - share))
    return np.concatenate([points, centre + 2 * half * rng.uniform(-1, 1, (count, 3))])


def body(rng: np.random.Generator, count: int) -> np.ndarray:
    """A ball with two thin fingers."""
    sphere = icosphere(3)
    shares = [int(0.8 * count), int(0.1 * count), count - int(0.8 * count) - int(0.1 * count)]
    scales, places = ([1, 1, 1], [0.05, 0.05, 0.5], [0.5, 0.05, 0.05]), ([0, 0, 0], [0, 0, 1.4], [1.4, 0, 0])
    parts = [
        sample_surface(sphere[0] * scale + place, sphere[1], n, rng)[0]
        for n, scale, place in zip(shares, scales, places, strict=True)
    ]
    return np.concatenate(parts)


@pytest.mark.parametrize("count", [120, 500, 3000])
def test_a_clean_cloud_loses_nothing(rng, count):
    for _ in range(5):
        assert inlier_mask(body(rng, count)).all()
        assert inlier_mask(bending_bar(2, count, rng).clouds[1]).all()


def test_what_half_of_the_links_hold_together_needs_no_second_look(rng, monkeypatch):
    def second_look(*_) -> None:
        raise AssertionError

    monkeypatch.setattr(strays, "_hangs_together", second_look)
    assert inlier_mask(body(rng, 3000)).all()
    with pytest.raises(AssertionError):
        inlier_mask(with_strays(body(rng, 3000), 0.05, rng))


def test_an_uneven_cloud_loses_nothing(rng):
    points = body(rng, 12000)
    height = (points[:, 2] - points[:, 2].min()) / np.ptp(points[:, 2])
    thinned = points[rng.random(len(points)) < 0.1 + 0.9 * height]
    assert inlier_mask(thinned).all()


def test_noise_and_a_second_object_are_no_strays(rng):
    points = body(rng, 3000)
    assert inlier_mask(points + rng.normal(size=points.shape) * 0.03).all()
    assert inlier_mask(np.concatenate([points, points[:300] * 0.3 + [5, 0, 0]])).all()


@pytest.mark.parametrize("share", [0.02, 0.1, 0.3])
def test_strays_far_from_the_surface_are_found(rng, share):
    points = body(rng, 3000)
    cloud = with_strays(points, share, rng)
    mask = inlier_mask(cloud)
    assert (~mask[: len(points)]).sum() <= 0.02 * len(points)
    assert mask[len(points) :].mean() < 0.15  # those that happen to lie on the surface or close to it
    from scipy.spatial import cKDTree

    left = cloud[len(points) :][mask[len(points) :]]
    distance = cKDTree(points).query(left)[0]
    assert len(left) == 0 or np.quantile(distance, 0.9) < 0.3


def test_units_do_not_matter(rng):
    cloud = with_strays(body(rng, 1000), 0.1, rng)
    assert (inlier_mask(cloud * 1e-6) == inlier_mask(cloud)).all()


def test_tiny_clouds_and_equal_distances_are_left_alone(rng):
    assert inlier_mask(rng.normal(size=(30, 3))).all()
    grid = np.stack(np.meshgrid(*[np.arange(9.0)] * 3), axis=-1).reshape(-1, 3)
    assert inlier_mask(grid).all()


def test_a_sequence_is_told_which_frames_lost_how_many(rng):
    clean = body(rng, 800)
    dirty = with_strays(clean, 0.2, rng)
    sequence = PointSequence.from_arrays([clean, dirty, dirty], [clean, dirty + 9.0, None])
    kept = drop_strays(sequence)
    assert kept.points[0].shape == clean.shape
    assert 750 < len(kept.points[1]) < 850 and len(present(kept.normals[1])) == len(kept.points[1])
    assert kept.normals[2] is None
    assert kept.notes[0].startswith("frames 1-2: ") and "stray points (" in kept.notes[0]
    assert kept.warnings[0] == kept.notes[0]
    untouched = PointSequence.from_arrays([clean, clean])
    assert drop_strays(untouched) is untouched


@pytest.mark.parametrize(
    ("shares", "kept"), [((0.3, 0.5, 0.3), [2, 2, 2]), ((0.5, 0.5, 0.3), [20, 20, 2]), ((0.3, 0.8, 0.3), [2, 20, 2])]
)
def test_one_scanner_made_the_strays_of_all_frames(rng, monkeypatch, shares, kept):
    """What a frame leaves open, whether strays or a sparse part of the surface, is as in most frames."""
    told = iter(shares)
    monkeypatch.setattr(strays, "MIN_POINTS", 1)
    monkeypatch.setattr(strays, "_suspected", lambda points, *_: (np.arange(len(points)) < 2, next(told)))
    sequence = PointSequence.from_arrays(list(rng.normal(size=(3, 20, 3))))
    assert [len(points) for points in drop_strays(sequence).points] == kept
