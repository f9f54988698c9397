"""Frames that are unlike those before and after them, while those are alike: a slip of the calibration, another take.

Between two frames the distance d is the mean from the points of one to the nearest of the other, in the direction in
which it is smaller, so that a frame which shows only a part is not far from one that shows all. A frame t is odd if

    min(d(t - 1, t), d(t, t + 1))  >  RATIO max(d(t - 1, t + 1), usual d)     and     >  LEAST of the object's size;

two frames in a row are odd in the same way between t - 1 and t + 2. Fast motion is not odd: then the frames to either
side are as far from each other. The first and the last frame have no two neighbours and are never odd.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from warpdef.cleaning.mixed_units import is_unit, size_of
from warpdef.sequence import PointSequence, name_frames

RATIO = 3.0
LEAST = 0.04  # of the median frame's longest side
LONGEST = 2  # odd frames in a row
USUAL = 0.25  # quantile of d between neighbours: an odd frame spoils two of them
MOST = 0.25  # of the frames: more than that are no slips
SAMPLE = 1000  # points of a frame that are compared


def find_odd(clouds: Sequence[np.ndarray]) -> dict[int, float]:
    """Odd frames of a sequence of clouds (N_t, 3), and how many times as far as usual each is."""
    from scipy.spatial import cKDTree

    if len(clouds) < 4:
        return {}
    thin = [cloud[:: max(len(cloud) // SAMPLE, 1)] for cloud in clouds]
    trees = [cKDTree(cloud) for cloud in thin]

    def distance(a: int, b: int) -> float:
        return min(float(trees[b].query(thin[a])[0].mean()), float(trees[a].query(thin[b])[0].mean()))

    steps = np.array([distance(t, t + 1) for t in range(len(clouds) - 1)])
    size = float(np.median([np.ptp(cloud, axis=0).max() for cloud in thin]))
    usual = float(np.quantile(steps, USUAL))
    least = max(LEAST * size, RATIO * usual)
    odd: dict[int, float] = {}
    for first in np.flatnonzero(steps[:-1] > least) + 1:
        if first in odd:
            continue
        for length in range(1, min(LONGEST, len(clouds) - 1 - first) + 1):
            last = first + length - 1
            near = min(steps[first - 1], steps[last])
            if near > least and near > RATIO * distance(first - 1, last + 1):
                odd |= {int(t): float(near / max(usual, 1e-300)) for t in range(first, last + 1)}
                break
    return odd if len(odd) <= MOST * len(clouds) else {}


def leave_out_odd(sequence: PointSequence) -> PointSequence:
    """The sequence with its odd frames as gaps, each with a sentence that says why."""
    odd = find_odd(sequence.points)
    if not odd:
        return sequence
    usual = float(np.median([size_of(cloud) for cloud in sequence.points]))
    reasons = {sequence.numbers[t]: _why(sequence, t, times, usual) for t, times in odd.items()}
    return sequence.without(reasons, judged=True)


def _why(sequence: PointSequence, t: int, times: float, usual: float) -> str:
    """The sentence that says why frame t is left out; ``times``: as ``find_odd``, ``usual``: size of the frames."""
    size = size_of(sequence.points[t])
    ratio, what = (size / usual, "larger") if size > usual else (usual / max(size, 1e-300), "smaller")
    how = f"{times:.2g} times as far from them as frames are here, while those are alike"
    if is_unit(ratio):
        how = f"{ratio:.4g} times {what}, as in other units"
    which = f"{name_frames([sequence.numbers[t]])} ({sequence.names[t]})"
    return f"{which} is unlike the frames around it, {how}; --no-drop-odd-frames keeps it"
