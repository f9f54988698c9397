"""Frames whose normals point to the other side than those around them are turned over; mixed ones are left."""

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
    for fewer, sign in ((given, 1), ([-n for n in given[:3]] + NORMALS[3:], 1), ([-n for n in NORMALS], -1)):
        sequence = turn_to_one_side(PointSequence.from_arrays(POINTS, fewer))
        for found, expected in zip(sequence.normals, NORMALS, strict=True):
            np.testing.assert_allclose(present(found), sign * expected, atol=1e-12)
    (note,) = turn_to_one_side(PointSequence.from_arrays(POINTS, [None, *given[1:2], *NORMALS[2:]])).notes
    assert note == "normals given for frame 1 point to the other side than those of the frames around: turned over"


def test_mixed_and_unknown_ones_are_left():
    mixed = [n * RNG.choice([-1.0, 1.0], (len(n), 1)) for n in NORMALS]
    for normals in (mixed, [None] * 6, NORMALS):
        sequence = PointSequence.from_arrays(POINTS, normals)
        assert turn_to_one_side(sequence) is sequence
