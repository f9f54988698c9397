"""A room: furniture goes with floor and walls; a body that rests, on a floor or alone, loses nothing."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic import icosphere, sample_surface

from warpdef.cleaning.furniture import furniture_masks
from warpdef.cleaning.static_planes import cut_static_planes, find_surroundings
from warpdef.cleaning.strays import drop_strays
from warpdef.config import Config
from warpdef.prepare import clean
from warpdef.sequence import PointSequence

FRAMES = 10
SPHERE = icosphere(3)


def ball(rng, centre, radius=1.0, count=1200) -> np.ndarray:
    return np.asarray(centre) + radius * sample_surface(*SPHERE, count, rng)[0]


def box(rng, low, high, count=1500) -> np.ndarray:
    """The surface of a box, with noise of a thousandth of a unit."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    points = rng.random((count, 3))
    points[np.arange(count), rng.integers(0, 3, count)] = rng.integers(0, 2, count)
    return low + points * (high - low) + rng.normal(scale=0.001, size=(count, 3))


def floor(rng, count=6000) -> np.ndarray:
    return np.column_stack([rng.uniform(-5, 5, (count, 2)), rng.normal(scale=0.002, size=count)])


def wall(rng, count=6000) -> np.ndarray:
    flat = rng.uniform(-5, 5, (count, 2))
    return np.column_stack([flat[:, 0], 5 + rng.normal(scale=0.002, size=count), 2.5 + flat[:, 1] / 2])


def chairs(rng) -> np.ndarray:
    return np.concatenate([box(rng, [2.5, 2, 0.02], [4, 3.5, 1.2]), box(rng, [-4, 3, 0.02], [-2, 4.5, 2])])


def moving(rng, t: int) -> np.ndarray:
    return ball(rng, [0.25 * t - 1, -1.0, 1.3 + 0.2 * np.sin(t)])


def standing(rng, t: int) -> np.ndarray:
    """A trunk that stands still below a head that moves."""
    return np.concatenate([box(rng, [-0.4, -0.4, 0.02], [0.4, 0.4, 2]), ball(rng, [0.1 * np.sin(t), 0, 2.4], 0.5, 600)])


def leaving(rng, t: int) -> np.ndarray:
    """It stands for more than half of the film, then goes."""
    return ball(rng, [0.3 * max(t - 5, 0) - 1, -1.0, 1.1])


BODIES = {"moving": moving, "standing": standing, "leaving": leaving}


def room(body, *things, seed=5):
    """The frames of a room, and which of their points are the body's."""
    rng = np.random.default_rng(seed)
    bodies = [body(rng, t) for t in range(FRAMES)]
    clouds = [np.concatenate([b, *(thing(rng) for thing in things)]) for b in bodies]
    return clouds, [np.arange(len(c)) < len(b) for b, c in zip(bodies, clouds, strict=True)]


@pytest.mark.parametrize("things", [(floor, chairs), (floor, wall, chairs)])
@pytest.mark.parametrize("name", BODIES)
def test_furniture_goes_with_the_planes_and_the_body_stays(name, things):
    clouds, own = room(BODIES[name], *things)
    scene = find_surroundings(clouds)
    assert len(scene.planes) == len(things) - 1
    for taken, body in zip(scene.masks(clouds), own, strict=True):
        assert taken[body].mean() < 0.01
        assert taken[~body].mean() > 0.99
    (note,) = cut_static_planes(PointSequence.from_arrays(clouds)).notes
    assert "what stands still beside (furniture, " in note and "--no-cut-static keeps it" in note


@pytest.mark.parametrize("things", [(), (floor,), (floor, wall)])
@pytest.mark.parametrize("name", BODIES)
def test_a_body_beside_no_furniture_loses_nothing(name, things):
    clouds, own = room(BODIES[name], *things)
    for taken, body in zip(find_surroundings(clouds).masks(clouds), own, strict=True):
        assert taken[body].mean() < 0.01
    if not things:
        sequence = PointSequence.from_arrays(clouds)
        assert cut_static_planes(sequence) is sequence


def test_a_body_that_stands_still_altogether_is_no_furniture():
    clouds, _ = room(lambda rng, t: standing(rng, 0), floor)
    assert len(find_surroundings(clouds).planes) == 1
    assert not any(mask.any() for mask in find_surroundings(clouds).furniture)


def test_without_a_plane_nothing_is_cut():
    """What stands beside a body and no plane may be the object's other half."""
    clouds, own = room(moving, chairs)
    assert any(mask.any() for mask in furniture_masks(clouds))
    sequence = PointSequence.from_arrays(clouds)
    assert cut_static_planes(sequence) is sequence


def test_a_chair_that_is_touched_for_a_while_goes_and_one_that_is_held_stays():
    def beside(rng) -> np.ndarray:
        return box(rng, [1.9, -2, 0.02], [3.4, 0, 2.2])

    passing, own = room(lambda rng, t: ball(rng, [0.9 - 0.6 * abs(t - 2), -1, 1.1]), floor, beside)
    for taken, body, cloud in zip(find_surroundings(passing).masks(passing), own, passing, strict=True):
        assert taken[~body].mean() > 0.95
        assert taken[body].mean() < 0.05 and (cloud[taken & body][:, 0] > 1.9 - 0.45).all()  # within a cell of it
    held, _ = room(lambda rng, t: ball(rng, [0.87, -1, 1.1 + 0.4 * np.sin(t)]), floor, beside)
    for taken in find_surroundings(held).furniture:
        assert not taken.any()


@pytest.mark.parametrize("scale", [1e-3, 1e3])
@pytest.mark.parametrize("place", [0.0, 1e5])
def test_units_and_place_do_not_matter(scale, place):
    clouds, _ = room(moving, floor, wall, chairs)
    expected = find_surroundings(clouds).masks(clouds)
    there = [scale * (cloud + place) for cloud in clouds]
    for mask, same in zip(find_surroundings(there).masks(there), expected, strict=True):
        assert (mask != same).mean() < 2e-3


def test_few_frames_and_points_that_lie_apart_are_left():
    clouds, _ = room(moving, chairs)
    assert not any(mask.any() for mask in furniture_masks(clouds[:4]))
    apart = [np.concatenate([cloud, [[1e9, 1e9, 1e9]]]) for cloud in clouds]
    assert not any(mask.any() for mask in furniture_masks(apart))
    assert [mask.shape for mask in furniture_masks([np.empty((0, 3))] * FRAMES)] == [(0,)] * FRAMES


def test_dense_frames_are_judged_by_a_part_of_their_points():
    rng = np.random.default_rng(2)
    clouds = [
        np.concatenate([ball(rng, [0.25 * t - 1, -1, 1.3], 1, 12000), box(rng, [3, 3, 0], [4, 4, 1], 14000)])
        for t in range(FRAMES)
    ]
    for mask in furniture_masks(clouds):
        assert not mask[:12000].any() and mask[12000:].mean() > 0.99


def test_an_outline_that_flies_before_the_background_is_dropped_beside_a_scene():
    """Points on a curve look like a sparse part of a surface, and are kept of an object alone."""
    rng = np.random.default_rng(8)
    clouds, own = room(moving, floor, wall)
    flying = []
    for t in range(FRAMES):
        turn = rng.uniform(0, 2 * np.pi, 30)
        flying.append(np.stack([1.4 * np.cos(turn) + 0.25 * t - 1, np.full(30, 2.0), 1.4 * np.sin(turn) + 2.0], axis=1))
    sequence = PointSequence.from_arrays([np.concatenate([c, f]) for c, f in zip(clouds, flying, strict=True)])
    left = clean(sequence, Config())
    for points, body in zip(left.points, own, strict=True):
        assert (points[:, 1] > 0.5).sum() == 0
        assert 0.97 * body.sum() <= len(points) <= body.sum()
    assert drop_strays(cut_static_planes(sequence)).notes == cut_static_planes(sequence).notes
    kept = clean(sequence, Config(cut_static=False))
    assert all(len(points) > 12000 for points in kept.points)
