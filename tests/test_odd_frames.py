"""A frame from elsewhere is left out and named; motion, however fast, is not."""

from __future__ import annotations

import re

import numpy as np
import pytest
from synthetic import bending_bar, turning_ellipsoid

from warpdef.cleaning.odd_frames import find_odd, leave_out_odd
from warpdef.config import Config
from warpdef.prepare import clean
from warpdef.sequence import PointSequence

FRAMES = 9


@pytest.fixture
def bar(rng: np.random.Generator) -> list[np.ndarray]:
    return list(bending_bar(FRAMES, 600, rng).clouds)


SLIPS = {
    "moved": lambda p: p + [0.4 * np.ptp(p, axis=0).max(), 0, 0],
    "turned on its side": lambda p: (p - p.mean(0))[:, [1, 0, 2]] * [1, -1, 1] + p.mean(0),
    "in other units": lambda p: p * 1000,
    "far away": lambda p: p + [300.0, 0, 0],
}


@pytest.mark.parametrize("slip", SLIPS)
@pytest.mark.parametrize("at", [[4], [1], [FRAMES - 2], [3, 4], [2, 6]])
def test_a_slip_is_found(bar, slip, at):
    for t in at:
        bar[t] = SLIPS[slip](bar[t])
    assert sorted(find_odd(bar)) == at


def test_motion_is_not_odd(rng, bar):
    for step in (1, 2):
        assert find_odd(bar[::step]) == {}
        assert find_odd(turning_ellipsoid(12, 500, rng).clouds[::step]) == {}
    # There and back, each frame as far from the next as it goes; a jump that stays; one that goes on.
    assert find_odd([bar[8 * (t % 2)] for t in range(8)]) == {}
    assert find_odd([bar[0]] * 4 + [bar[8 * (t % 2)] for t in range(8)]) == {}
    assert find_odd([c + [3.0 * (t >= 4), 0, 0] for t, c in enumerate(bar)]) == {}
    assert find_odd([c + [0.2 * 2.0**t, 0, 0] for t, c in enumerate(bar)]) == {}


def test_a_frame_that_shows_a_part_is_not_odd(bar):
    bar[4] = bar[4][bar[4][:, 0] > np.median(bar[4][:, 0])]
    assert find_odd(bar) == {}


def test_an_odd_frame_is_a_gap_with_its_name(bar):
    clouds = [bar[0][:0], *bar]  # a gap before it, so that places and numbers differ
    clouds[5] = SLIPS["moved"](clouds[5])
    sequence = leave_out_odd(PointSequence.from_arrays(clouds, names=[f"scan_{t}.ply" for t in range(10)]))
    assert sequence.frame_count == 10 and [gap.number for gap in sequence.gaps] == [0, 5]
    assert 5 not in sequence.numbers and len(sequence.points) == 8
    np.testing.assert_array_equal(sequence.judged_frames()[5], clouds[5])
    assert not len(sequence.all_frames()[5]) and not len(sequence.judged_frames()[0])
    line = next(line for line in sequence.warnings if line.startswith("frame 5 of 10"))
    assert "interpolated between the neighbours. Why: frame 5 (scan_5.ply) is unlike the frames around it" in line


def test_it_can_be_switched_off(bar):
    bar[4] = SLIPS["moved"](bar[4])
    sequence = PointSequence.from_arrays(bar)
    assert [gap.number for gap in clean(sequence, Config()).gaps] == [4]
    assert clean(sequence, Config(drop_odd_frames=False)).gaps == ()


def test_other_units_are_named_and_nothing_else_is_said_to_stand_still(bar):
    bar[4] = bar[4] * 1000.0
    told = clean(PointSequence.from_arrays(bar), Config()).warnings
    assert [w for w in told if re.search("is unlike the frames around it, [0-9.]+ times larger, as in other units", w)]
    assert not [w for w in told if "stands still" in w]
