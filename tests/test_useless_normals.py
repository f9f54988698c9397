"""Normals that point anywhere, or all one way on what is not flat, are left out; wrong sides and noise are not."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic import icosphere, sample_surface

from warpdef.cleaning.useless_normals import leave_out_useless_normals
from warpdef.sequence import PointSequence

RNG = np.random.default_rng(0)
POINTS, NORMALS = sample_surface(*icosphere(3), 800, RNG)
ANY = RNG.normal(size=POINTS.shape)
ONE = np.tile([0.0, 0.0, 1.0], (len(POINTS), 1))
FLAT = np.where(np.arange(3) == 2, 0.0, POINTS)


@pytest.mark.parametrize("bad", [ANY, ONE, -ONE])
def test_useless_ones_are_estimated(bad):
    sequence = leave_out_useless_normals(PointSequence.from_arrays([POINTS] * 3, [NORMALS, bad, NORMALS]))
    assert [n is None for n in sequence.normals] == [False, True, False]
    (note,) = sequence.notes
    assert note == "normals given for frame 1 agree neither with each other nor with the points: estimated instead"


@pytest.mark.parametrize(
    ("points", "normals"),
    [
        (POINTS, NORMALS),
        (POINTS, NORMALS * RNG.choice([-1.0, 1.0], (len(POINTS), 1))),
        (POINTS + 0.1 * RNG.normal(size=POINTS.shape), NORMALS),
        (POINTS, NORMALS + 0.5 * ANY),
        (FLAT + 0.02 * ANY * [0, 0, 1], ONE),
        (POINTS[:40], ANY[:40]),
    ],
)
def test_others_stay(points, normals):
    sequence = PointSequence.from_arrays([points] * 2, [normals] * 2)
    assert leave_out_useless_normals(sequence) is sequence
