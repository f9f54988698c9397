"""Scans in no order are found out and put in order by their poses; films are left alone, however they move."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic import bending_bar, icosphere, turning_ellipsoid

from warpdef.cleaning import order, shuffles
from warpdef.cleaning.order import LEAST_FRAMES, order_by_pose, put_in_order
from warpdef.cleaning.shuffles import orderly
from warpdef.config import Config
from warpdef.geometry.poses import differences, pose_fields, shared_differences
from warpdef.motion.gaps import fill_gaps
from warpdef.prepare import clean
from warpdef.sequence import PointSequence

FRAMES = 13


@pytest.fixture
def bar(rng: np.random.Generator) -> list[np.ndarray]:
    return list(bending_bar(FRAMES, 600, rng).clouds)


@pytest.mark.parametrize("seed", range(4))
def test_a_shuffled_film_comes_back_in_its_order(bar: list[np.ndarray], seed: int) -> None:
    shuffled = np.random.default_rng(seed).permutation(FRAMES)
    order = order_by_pose([bar[t] for t in shuffled])
    assert order is not None
    found = shuffled[order].tolist()
    assert found in (list(range(FRAMES)), list(range(FRAMES))[::-1])


def test_films_stay_as_they_are(bar: list[np.ndarray], rng: np.random.Generator) -> None:
    still = [cloud + rng.normal(scale=0.02, size=cloud.shape) for cloud in [bar[0]] * FRAMES]
    slip = [cloud + [2.0 * (t == 5), 0, 0] for t, cloud in enumerate(bar)]
    turn = [np.stack([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]]) for a in np.arange(FRAMES)]
    fast = [cloud @ r for cloud, r in zip(bar, turn, strict=True)]  # by 57 degrees a frame
    takes = [*bar[:5], *(cloud + [3.0, 0, 0] for cloud in bar[5:])]
    turning = turning_ellipsoid(FRAMES, 500, rng).clouds
    for film in (bar, bar[::-1], [*bar, *bar[-2::-1], *bar], still, slip, takes, turning, fast):
        assert order_by_pose(film) is None


def test_two_bodies_that_meet_and_part_are_a_film(rng: np.random.Generator) -> None:
    """Its second half is the first one backwards: most frames are as like a later one as their neighbours."""
    body = icosphere(3)[0] * [0.5, 1.0, 0.5]
    ways = [1.2, 1.1, 1.0, 0.9, 0.8, 0.8, 0.9, 1.0, 1.1, 1.2]
    film = [np.concatenate([body - [way, 0.0, 0.0], body[:, [2, 0, 1]] + [way, 0.0, 0.0]]) for way in ways]
    assert order_by_pose([cloud + rng.normal(scale=0.01, size=cloud.shape) for cloud in film]) is None


@pytest.mark.parametrize("every", [2, 3])
def test_a_film_whose_frames_lack_a_part_by_turns_is_one(bar: list[np.ndarray], every: int) -> None:
    """By whole clouds, halves are more like other halves than like their neighbours."""
    film = [cloud if t % every else cloud[cloud[:, 0] > np.median(cloud[:, 0])] for t, cloud in enumerate(bar)]
    fields, _ = pose_fields(film)
    apart = differences(fields)
    assert np.median(np.diagonal(apart, 1)) > 0.6 * np.median(apart[np.triu_indices(FRAMES, 1)])
    assert order_by_pose(film) is None
    mixed = [np.random.default_rng(seed).permutation(FRAMES) for seed in range(8)]
    assert sum(order_by_pose([film[t] for t in shuffled]) is not None for shuffled in mixed) >= 6


def test_a_cloud_and_its_part_are_the_same_in_what_both_show(bar: list[np.ndarray]) -> None:
    fields, _ = pose_fields([bar[0], bar[0][bar[0][:, 0] > 0.0], bar[6]])
    _, part, pose = shared_differences(fields)[0]
    assert part < 1e-12 < differences(fields)[0, 1] and pose > 1e-3


def test_few_scans_tell_too_little(bar: list[np.ndarray]) -> None:
    shuffled = [bar[t] for t in np.random.default_rng(0).permutation(FRAMES)]
    assert order_by_pose(shuffled[: LEAST_FRAMES - 1]) is None


def test_branches_of_poses_are_walked_one_after_the_other(rng: np.random.Generator) -> None:
    """A ball that goes off in three directions from one place, far, farther, farthest."""
    ball = icosphere(3)[0]
    ways = [np.eye(3)[axis] * step for axis, steps in enumerate((3, 5, 7)) for step in range(1, steps + 1)]
    poses = np.array([np.zeros(3), *ways])
    shuffled = np.random.default_rng(1).permutation(len(poses))
    order = order_by_pose([ball + poses[t] for t in shuffled])
    assert order is not None
    found = poses[shuffled[order]]
    back = np.flatnonzero(np.linalg.norm(np.diff(found, axis=0), axis=1) > 1.5)
    assert 1 <= len(back) <= 2 and sorted(order) == list(range(len(poses)))


def test_fields_know_poses_and_hardly_see_samples(rng: np.random.Generator) -> None:
    scene = bending_bar(5, 2000, rng)
    fields, halves = pose_fields([*scene.clouds, *bending_bar(5, 2000, np.random.default_rng(9)).clouds])
    apart = differences(fields)
    same, other = np.diagonal(apart, 5), np.diagonal(apart, 6)[:4]
    assert (same < halves).all() and (other > 2.0 * same[:4]).all()


def test_numbers_stay_with_their_clouds_and_one_line_says_so(bar: list[np.ndarray]) -> None:
    shuffled = np.random.default_rng(2).permutation(FRAMES)
    given = PointSequence.from_arrays([bar[0][:0], *(bar[t] for t in shuffled)])
    sequence = put_in_order(given)
    assert sorted(sequence.numbers) == list(given.numbers) and sequence.numbers != given.numbers
    for before, after in zip(given.all_frames(), sequence.all_frames(), strict=True):
        np.testing.assert_array_equal(before, after)
    assert given.frame_names == sequence.frame_names
    assert len([line for line in sequence.warnings if "in no order" in line]) == 1
    assert sequence.select(slice(1, 5)).numbers == (0, 1, 2, 3)
    without = sequence.without({sequence.numbers[3]: "a trial"})
    assert without.numbers == sequence.numbers[:3] + sequence.numbers[4:]
    placed = np.array(sequence.numbers, dtype=float)[:, None, None] * np.ones((1, 2, 3))
    np.testing.assert_array_equal(fill_gaps(placed, sequence.numbers, 14)[1:, 0, 0], np.arange(1, 14))


def test_cleaning_puts_scans_in_order_before_it_looks_for_odd_ones(bar: list[np.ndarray]) -> None:
    shuffled = [bar[t] for t in np.random.default_rng(2).permutation(FRAMES)]
    sequence = clean(PointSequence.from_arrays(shuffled), Config())
    assert len(sequence) == FRAMES and len(sequence.order) == FRAMES
    assert not clean(PointSequence.from_arrays(bar), Config()).order


def test_short_branches_of_the_walk_come_first() -> None:
    """From one end of the longest way: behind a fork the side that ends soon, then the way on."""
    trunk, side = [(float(t), 0.0) for t in range(7)], [(3.0, 1.0), (3.0, 2.0)]
    assert order._walk(np.array([*trunk, *side])) == [0, 1, 2, 3, 7, 8, 4, 5, 6]


def test_neighbours_that_are_somewhat_alike_are_a_film(rng: np.random.Generator) -> None:
    """Three quarters as far apart as any two frames, but nearly all of them: by their medians alone no film."""
    fields = rng.normal(size=(20, 400))
    for t in range(1, 20):
        fields[t] = 0.45 * fields[t - 1] + np.sqrt(1.0 - 0.45**2) * fields[t]
    apart = differences(fields)
    assert np.median(np.diagonal(apart, 1)) > shuffles.HALF_AS_FAR * np.median(apart[np.triu_indices(20, 1)])
    assert orderly(fields, 0.0)
    assert not orderly(fields[rng.permutation(20)], 0.0)


def swinging(phases: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Fields of a body that swings to and fro, its parts one after the other, each seen with a little noise."""
    lag, amount = rng.uniform(0.0, 0.8, 300), rng.normal(size=300)
    return amount * np.sin(phases[:, None] - lag) + rng.normal(scale=0.02, size=(len(phases), 300))


@pytest.mark.parametrize("frames", [6.5, 7.0, 8.0])
def test_a_cycle_of_few_frames_is_a_film(frames: float, rng: np.random.Generator) -> None:
    """A pose comes twice in a cycle, so that neighbours are not much more alike than any two frames."""
    fields = swinging(2.0 * np.pi * np.arange(14) / frames, rng)
    apart = differences(fields)
    assert np.median(np.diagonal(apart, 1)) > shuffles.HALF_AS_FAR * np.median(apart[np.triu_indices(14, 1)])
    assert orderly(fields, 0.03)
    assert sum(orderly(fields[rng.permutation(14)], 0.03) for _ in range(40)) <= 4


def test_scans_in_no_order_are_told_at_a_known_rate(rng: np.random.Generator) -> None:
    """Three tests of one chance in a hundred each, whatever the poses: of 300 sets at most 9 pass."""
    told = [orderly(rng.normal(size=(int(rng.integers(8, 18)), 60)) ** 3, 0.0) for _ in range(300)]
    assert sum(told) <= 9


def test_halfway_between_is_the_median_of_a_triangle(rng: np.random.Generator) -> None:
    fields = rng.normal(size=(6, 50))
    orders = np.array([rng.permutation(6) for _ in range(3)])
    expected = [np.linalg.norm(f[1:-1] - (f[:-2] + f[2:]) / 2.0, axis=1).mean() for f in fields[orders]]
    np.testing.assert_allclose(shuffles._between(fields, orders), expected, rtol=1e-12)


def test_of_a_long_film_its_middle_is_judged(bar: list[np.ndarray], monkeypatch: pytest.MonkeyPatch) -> None:
    judged: list[int] = []
    real = order.pose_fields
    monkeypatch.setattr(order, "pose_fields", lambda clouds: judged.append(len(clouds)) or real(clouds))
    assert order_by_pose([*bar, *bar[-2::-1]] * 8) is None
    assert judged == [64]
