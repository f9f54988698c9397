"""A handful of points far away sets the scale of nothing, and clean clouds keep all they have."""

from __future__ import annotations

import numpy as np
import pytest
from present import present
from synthetic import icosphere, sample_surface

from warpdef.cleaning.far_points import drop_far, find_far
from warpdef.config import Config
from warpdef.prepare import clean
from warpdef.sequence import PointSequence, Similarity


def body(rng: np.random.Generator, count: int = 1500) -> np.ndarray:
    """A ball with a thin long arm, 5 long in all."""
    sphere, faces = icosphere(3)
    head = sample_surface(sphere, faces, int(0.95 * count), rng)[0]
    arm = sample_surface(sphere * [0.05, 0.05, 1.5] + [0, 0, 2.4], faces, count - len(head), rng)[0]
    return np.concatenate([head, arm])


def far(rng: np.random.Generator, count: int, near: float = 20.0, beyond: float = 60.0) -> np.ndarray:
    away = rng.normal(size=(count, 3))
    return away / np.linalg.norm(away, axis=1, keepdims=True) * rng.uniform(near, beyond, (count, 1))


@pytest.mark.parametrize("count", [1, 3, 8, 30, 150])
def test_few_or_many_far_points_do_not_change_the_cube(rng, count):
    clean_clouds = [body(rng) for _ in range(3)]
    dirty = PointSequence.from_arrays([np.concatenate([c, far(rng, count)]) for c in clean_clouds])
    kept = clean(dirty, Config())
    expected, found = (Similarity.into_cube(c, 0.95) for c in (clean_clouds, kept.points))
    assert 0.9 * expected.scale < found.scale < 1.05 * expected.scale
    assert all(abs(len(p) - len(c)) <= 3 for p, c in zip(kept.points, clean_clouds, strict=True))
    assert kept.warnings and kept.warnings[0].startswith("frames 0-2: ")


def test_clean_clouds_lose_nothing(rng):
    for count in (60, 300, 3000):
        cloud = body(rng, count)
        assert find_far(cloud).kept.all()
        assert find_far(cloud * [1, 1, 1e-3]).kept.all()
        assert find_far(cloud + rng.normal(scale=0.05, size=cloud.shape)).kept.all()
    sequence = PointSequence.from_arrays([body(rng), body(rng)])
    assert drop_far(sequence) is sequence


def test_a_small_object_in_the_air_is_kept_and_a_speck_far_out_is_not(rng):
    cloud = body(rng, 4000)
    ball = icosphere(2)
    small = sample_surface(ball[0] * 0.15, ball[1], 60, rng)[0]
    assert find_far(np.concatenate([cloud, small + [6.0, 0, 0]])).kept.all()
    assert find_far(np.concatenate([cloud, small + [80.0, 0, 0]])).kept.sum() == len(cloud)
    other = np.concatenate([cloud, cloud * 0.3 + [400.0, 0, 0]])
    assert find_far(other).kept.all()  # half of the points are no handful


@pytest.mark.parametrize("row", [(-9999.0,) * 3, (0.0, 0.0, 0.0), (65535.0, 0.0, 0.0)])
def test_a_row_that_stands_for_nothing_is_named(rng, row):
    place = np.array([512_345.0, 5_412_000.0, 130.0])
    clouds = [np.concatenate([body(rng) + place, [row]]) for _ in range(4)]
    kept = drop_far(PointSequence.from_arrays(clouds))
    assert [len(p) for p in kept.points] == [1500] * 4
    assert f"all have x = {row[0]:g}, y = {row[1]:g}, z = {row[2]:g}" in kept.warnings[0]


def test_one_coordinate_that_stands_for_nothing_is_named(rng):
    """A depth that was not seen, of a tenth of the pixels: a flat, dense sheet far away."""
    clouds = []
    for _ in range(3):
        cloud = body(rng)
        cloud[::12, 2] = -9999.0
        clouds.append(cloud)
    kept = drop_far(PointSequence.from_arrays(clouds))
    assert [len(p) for p in kept.points] == [1375] * 3 and "all have z = -9999, which" in kept.warnings[0]


def test_normals_go_with_their_points(rng):
    cloud = body(rng)
    both = PointSequence.from_arrays(
        [np.concatenate([far(rng, 2), cloud])] * 2, [np.concatenate([np.ones((2, 3)), cloud])] * 2
    )
    kept = drop_far(both)
    np.testing.assert_array_equal(kept.points[0], cloud)
    np.testing.assert_allclose(
        present(kept.normals[0]), cloud / np.linalg.norm(cloud, axis=1, keepdims=True), atol=1e-12
    )
