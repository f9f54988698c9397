"""Frames whose normals point to the other side than those around them, or inwards, are turned over; mixed are left."""

from __future__ import annotations

import numpy as np
from present import present
from synthetic import icosphere, sample_surface

from warpdef.cleaning.frame_sides import turn_to_one_side
from warpdef.sequence import PointSequence

RNG = np.random.default_rng(0)
FRAMES = [sample_surface(*icosphere(3), 500, RNG) for _ in range(6)]
POINTS = [p * [1.0, 0.5, 0.7] + [0.2 * t, 0, 0] for t, (p, _) in enumerate(FRAMES)]
NORMALS = [n for _, n in FRAMES]


def test_the_fewer_are_turned_over():
    sides = (1, -1, -1, 1, 1, -1)
    given = [s * n for s, n in zip(sides, NORMALS, strict=True)]
    for frames in (given, [-n for n in given], [-n for n in NORMALS]):
        sequence = turn_to_one_side(PointSequence.from_arrays(POINTS, frames), 16)
        for found, expected in zip(sequence.normals, NORMALS, strict=True):
            np.testing.assert_allclose(present(found), expected, atol=1e-12)
    assert sequence.notes == ("normals given point inwards: turned over in all frames",)
    (note,) = turn_to_one_side(PointSequence.from_arrays(POINTS, [None, *given[1:2], *NORMALS[2:]]), 16).notes
    assert note == "normals given for frame 1 point to the other side than those of the frames around: turned over"


def test_mixed_and_unknown_ones_are_left():
    mixed = [n * RNG.choice([-1.0, 1.0], (len(n), 1)) for n in NORMALS]
    for normals in (mixed, [None] * 6, NORMALS):
        sequence = PointSequence.from_arrays(POINTS, normals)
        assert turn_to_one_side(sequence, 16) is sequence
