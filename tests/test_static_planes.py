"""A floor, a wall, a table are cut; an object's own flat and resting parts are not. And the box of the user's."""

from __future__ import annotations

import numpy as np
import pytest
from present import present
from synthetic import bending_bar, icosphere, sample_surface, turning_ellipsoid

from warpdef.cleaning.crop import crop
from warpdef.cleaning.static_planes import cut_static_planes, find_surroundings
from warpdef.config import Config
from warpdef.errors import InputError
from warpdef.prepare import clean
from warpdef.sequence import PointSequence

FRAMES = 8


def plane(rng: np.random.Generator, count: int, across: tuple, at: np.ndarray, noise: float = 0.002) -> np.ndarray:
    first, second = (np.asarray(a, dtype=float) for a in across)
    normal = np.cross(first, second) / np.linalg.norm(np.cross(first, second))
    u, v = rng.uniform(-1, 1, (2, count, 1))
    return at + u * first + v * second + rng.normal(scale=noise, size=(count, 1)) * normal


@pytest.fixture
def body(rng: np.random.Generator) -> list[np.ndarray]:
    """A ball that bounces from a floor at z = 0, 2 across."""
    sphere, faces = icosphere(3)
    return [sample_surface(sphere, faces, 800, rng)[0] + [0, 0, 1.0 + 0.5 * abs(np.sin(t))] for t in range(FRAMES)]


FLOOR = (([3, 0, 0], [0, 3, 0]), np.zeros(3))
WALL = (([3, 0, 0], [0, 0, 1.5]), np.array([0, -2.5, 1.5]))
SLOPE = (([3, 0, 1.0], [0, 3, 0]), np.array([0.0, 0, -1.2]))


@pytest.mark.parametrize("planes", [[FLOOR], [WALL], [SLOPE], [FLOOR, WALL]])
@pytest.mark.parametrize("noise", [0.0, 0.002, 0.02])
@pytest.mark.parametrize("place", [0.0, 1e6])
def test_planes_are_cut_and_the_body_stays(rng, body, planes, noise, place):
    scene = [
        np.concatenate([b, *(plane(rng, 1500, sides, centre, noise) for sides, centre in planes)]) + place for b in body
    ]
    kept = cut_static_planes(PointSequence.from_arrays(scene))
    for points, ball in zip(kept.points, body, strict=True):
        distance = np.linalg.norm(points - place - ball.mean(axis=0), axis=1)
        assert 0.93 * len(ball) <= len(points) <= 1.02 * len(ball)
        assert (np.abs(distance - 1.0) < 0.1).mean() > 0.99
    what = "a plane that stands" if len(planes) == 1 else "2 planes that stand"
    assert f"{what} still in all of them" in kept.notes[0]


def test_an_object_alone_keeps_all(rng, body):
    bar, egg = bending_bar(FRAMES, 900, rng).clouds, turning_ellipsoid(FRAMES, 900, rng).clouds
    brick = [plane(rng, 300, ([1, 0, 0], [0, 1, 0]), np.array([0, 0, h]), 0.0) for h in (0.0, 0.4)]
    sides = [plane(rng, 200, ([1, 0, 0], [0, 0, 0.2]), np.array([0, y, 0.2]), 0.0) for y in (-1, 1)]
    sheets = [
        np.column_stack([xy, 0.2 * np.sin(3 * xy[:, 0] + t) * np.linspace(0, 1, len(xy))])
        for t, xy in enumerate(rng.uniform(-1, 1, (FRAMES, 900, 2)))
    ]
    foot = plane(rng, 300, ([0.3, 0, 0], [0, 0.3, 0]), np.zeros(3))
    lamp = [np.concatenate([b * 0.3 + [0, 0, 1.0], foot]) for b in body]
    ends = [plane(rng, 150, ([0, 1, 0], [0, 0, 0.2]), np.array([x, 0, 0.2]), 0.0) for x in (-1, 1)]
    boxes = [np.concatenate([*brick, *sides])] * 3, [np.concatenate([*brick, *sides, *ends])] * 4
    for clouds in (body, bar, egg, *boxes, sheets, lamp):
        assert find_surroundings(clouds).planes == []
        sequence = PointSequence.from_arrays(clouds)
        assert cut_static_planes(sequence) is sequence


def test_a_flat_thing_upon_a_table_stays(rng):
    """Though it holds as many points as the table, and so would leave nothing."""
    card = [plane(rng, 800, ([0.4, 0, 0], [0, 0.3, 0]), np.array([0.1 * t, 0, 0.3])) for t in range(FRAMES)]
    scene = [np.concatenate([plane(rng, 800, *FLOOR), c]) for c in card]
    kept = cut_static_planes(PointSequence.from_arrays(scene))
    for points, c in zip(kept.points, card, strict=True):
        np.testing.assert_array_equal(points, c)


def test_a_plane_that_moves_or_comes_late_is_no_floor(rng, body):
    moving = [np.concatenate([b, plane(rng, 1500, *FLOOR) - [0, 0, 0.3 * t]]) for t, b in enumerate(body)]
    late = [np.concatenate([b, plane(rng, 1500 if t > 3 else 0, *FLOOR)]) for t, b in enumerate(body)]
    assert find_surroundings(moving).planes == [] and find_surroundings(late).planes == []


def test_it_can_be_kept(rng, body):
    scene = PointSequence.from_arrays([np.concatenate([b, plane(rng, 1500, *FLOOR)]) for b in body])
    assert max(map(len, clean(scene, Config()).points)) < 900
    assert [len(p) for p in clean(scene, Config(cut_static=False)).points] == [2300] * FRAMES


def test_crop(body):
    clouds = [*body, body[0] + [50, 0, 0]]
    sequence = PointSequence.from_arrays(clouds, clouds)
    kept = crop(sequence, "-0.5:0.5,:,0.1:")
    for points, normals, whole in zip(kept.points, kept.normals, clouds, strict=False):
        inside = (np.abs(whole[:, 0]) <= 0.5) & (whole[:, 2] >= 0.1)
        np.testing.assert_array_equal(points, whole[inside])
        assert len(present(normals)) == len(points)
    assert [gap.number for gap in kept.gaps] == [FRAMES] and "inside the box of --crop" in kept.warnings[-1]
    with pytest.raises(InputError, match=r"--crop 90:91,:,:: expected points inside.*they lie in -0\.\d+:51"):
        crop(sequence, "90:91,:,:")
    assert clean(sequence, Config(crop=":40,:,:")).frame_count == FRAMES + 1
