"""A box of the user's: ``x0:x1,y0:y1,z0:z1`` in input units, any end left out for none."""

from __future__ import annotations

import numpy as np

from warpdef.config_values import parse_box
from warpdef.errors import InputError
from warpdef.sequence import MIN_POINTS, PointSequence


def crop(sequence: PointSequence, box: str) -> PointSequence:
    """The points inside a box, as ``config_values.parse_box`` reads it; frames of which too few are left become gaps.

    Raises:
        ConfigError: the box cannot be read.
        InputError: too little is left.
    """
    low, high = parse_box(box)
    masks: list[np.ndarray] = [np.asarray(((p >= low) & (p <= high)).all(axis=1)) for p in sequence.points]
    cut = sum(int((~mask).sum()) for mask in masks)
    empty = {n: m for n, m in zip(sequence.numbers, masks, strict=True) if m.sum() < MIN_POINTS}
    if len(sequence) - len(empty) < 2:
        every = np.concatenate(sequence.points)
        there = ",".join(f"{a:.4g}:{b:.4g}" for a, b in zip(every.min(axis=0), every.max(axis=0), strict=True))
        raise InputError(f"--crop {box}: expected points inside in at least 2 frames, got none; they lie in {there}")
    cropped = sequence.keep(masks, f"{cut} points outside the box {box} cut")
    reasons = {
        number: f"{int(mask.sum())} of its points lie inside the box of --crop" for number, mask in empty.items()
    }
    return cropped.without(reasons) if reasons else cropped
