"""Frames in other units than the rest are refused by name; bodies that grow or are seen in part are not."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic import bending_bar

from warpdef.cleaning.mixed_units import require_one_unit
from warpdef.config import Config
from warpdef.errors import InputError
from warpdef.prepare import clean
from warpdef.sequence import PointSequence

FRAMES = 6


@pytest.fixture
def bar(rng: np.random.Generator) -> list[np.ndarray]:
    return list(bending_bar(FRAMES, 400, rng).clouds)


@pytest.mark.parametrize("factor", [1000.0, 0.001, 100.0, 25.4, 1 / 39.37])
@pytest.mark.parametrize("which", [[0], [5], [3, 4, 5], [0, 2, 4]])
def test_frames_in_other_units_are_refused_by_name(bar, factor, which):
    clouds = [cloud * (factor if t in which else 1.0) for t, cloud in enumerate(bar)]
    with pytest.raises(InputError, match=r"frames? [0-9].*expected the units of the other frames, got .* times"):
        clean(PointSequence.from_arrays(clouds), Config())


def test_the_message_names_the_smaller_group(bar):
    clouds = [bar[t] * (1000.0 if t > 3 else 1.0) for t in range(FRAMES)]
    with pytest.raises(InputError, match=r"frames 4-5 \(frame 4\): .* [0-9.]+ times larger; convert them"):
        require_one_unit(PointSequence.from_arrays(clouds))
    clouds = [bar[t] * (1000.0 if t > 1 else 1.0) for t in range(FRAMES)]
    with pytest.raises(InputError, match=r"frames 0-1 .* [0-9.]+ times smaller"):
        require_one_unit(PointSequence.from_arrays(clouds))


def test_growth_and_parts_are_no_other_units(bar):
    require_one_unit(PointSequence.from_arrays(bar))
    require_one_unit(PointSequence.from_arrays([cloud * 4.0**t for t, cloud in enumerate(bar)]))
    ends = [cloud[np.argsort(cloud[:, 0])[:60]] if t < 2 else cloud for t, cloud in enumerate(bar)]
    require_one_unit(PointSequence.from_arrays(ends))
