"""Frames in other units than the rest: metres and millimetres in one sequence, which no fit can make one.

Sizes of frames, the mean distance of points from their middle, fall into two groups with a jump between them, and the
jump is the ratio of two units in use. A body that grows has no such jump, and one that a camera sees a part of would
have to show that very share of it.
"""

from __future__ import annotations

import numpy as np

from warpdef.errors import InputError
from warpdef.sequence import PointSequence, name_frames

RATIOS = (25.4, 30.48, 39.37, 100.0, 304.8, 1000.0, 1e6)
"""Of units: metres, centimetres and millimetres, inches and feet. A hand is a tenth of a body: no smaller ones."""
NEAR = 0.15  # how far from such a ratio that of the groups' medians may be: a body that moves has many sizes
GROUP = 3.0  # sizes within a group differ by less


def size_of(cloud: np.ndarray) -> float:
    """Mean distance of points (N, 3) from their middle, which a few strays do not move."""
    return float(np.linalg.norm(cloud - np.median(cloud, axis=0), axis=1).mean())


def is_unit(ratio: float) -> bool:
    """Whether one size over another is near the ratio of two units in use."""
    return any(abs(ratio / known - 1.0) <= NEAR for known in RATIOS)


def require_one_unit(sequence: PointSequence) -> None:
    """Refuse clouds of which some are in other units than the others.

    Raises:
        InputError: they are; it names the frames of the smaller group.
    """
    size = np.array([size_of(cloud) for cloud in sequence.points])
    ordered = np.sort(size)
    jumps = ordered[1:] / np.maximum(ordered[:-1], 1e-300)
    if not len(jumps):
        return
    at = int(jumps.argmax())
    small, large = ordered[: at + 1], ordered[at + 1 :]
    ratio = float(np.median(large) / max(np.median(small), 1e-300))
    alike = small[-1] < GROUP * small[0] and large[-1] < GROUP * large[0]
    if not alike or not is_unit(ratio):
        return
    is_large = size > ordered[at]
    few = is_large if is_large.sum() <= len(size) / 2 else ~is_large
    which = name_frames([n for n, odd in zip(sequence.numbers, few, strict=True) if odd])
    what = "larger" if few is is_large else "smaller"
    raise InputError(
        f"{which} ({sequence.names[int(few.argmax())]}): expected the units of the other frames, got points that are "
        f"{ratio:.4g} times {what}; convert them, or leave them out"
    )
