"""Points together far off the surface."""

from __future__ import annotations

import numpy as np
import pytest
from judged import assess, frames, names

from warpdef.geometry.sampling import sample_surface
from warpdef.quality.astray import TOGETHER

pytest.importorskip("gpytoolbox")
VERTICES = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
FACES = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
POINTS = 3000


def judged(more: np.ndarray):
    """A sheet in three frames, with more points in the second."""
    clouds = [sample_surface(VERTICES, FACES, POINTS, np.random.default_rng(t))[0] for t in range(3)]
    clouds[1] = np.concatenate([clouds[1], more])
    return assess(clouds, np.stack([VERTICES] * 3), FACES, 0)


def group(count: int, height: float) -> np.ndarray:
    """Points as dense as those of the sheet, that high over it."""
    side = np.sqrt(4.0 / POINTS) * np.ceil(np.sqrt(count))
    place = np.random.default_rng(7).random((count, 2)) * side
    return np.column_stack([place, np.full(count, height)])


def test_a_few_points_together_far_off_are_a_lost_part() -> None:
    found = judged(group(12, 0.6))
    assert names(found) == ["good", "doubtful", "good"] and frames(found)[1].uncovered < 0.01
    assert frames(found)[1].astray > 15.0 and "points together lie" in found.verdicts[1].reasons[0]
    assert frames(found)[0].astray == 0.0


@pytest.mark.parametrize(
    "more",
    [group(TOGETHER - 1, 0.6), group(25, 0.1), np.random.default_rng(3).uniform(-1.0, 1.0, (25, 3)) + [0.0, 0.0, 1.5]],
    ids=["fewer", "close by", "scattered"],
)
def test_single_strays_and_what_lies_close_by_are_none(more: np.ndarray) -> None:
    found = judged(more)
    assert names(found) == ["good"] * 3 and frames(found)[1].uncovered > 0.002 and frames(found)[1].astray < 8.0
