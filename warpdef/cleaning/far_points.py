"""Points so far away that distance alone is enough to leave them out, before they set the scale of everything.

False depths and the values that some programs write for "nothing seen" (-9999, or 0 0 0 in map coordinates) lie many
sizes of the object away from it. A handful of them would blow up the cube that the sequence is normalised into, and
with it voxels, Poisson cells and the last digit of float32. In each frame:

1. The body is the box between the 10th and the 90th percentile of each axis, of size E (its longest side), and what
   hangs together with it: sorted by their distance outside the box, the points up to the first gap above E / 2.
2. Those beyond the gap are far. They are left out if they are few and no dense surface (a ball in the air is one), or
   few and very far, or if one coordinate of all of them is the same number, which no scanner measures.

A cloud without such a gap keeps every point. What lies closer is for ``strays``, which looks at spacings.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warpdef.cloud import SPACING_NEIGHBOURS
from warpdef.sequence import MIN_POINTS, PointSequence, name_frames

BULK = (10.0, 90.0)  # percentiles
GAP = 0.5  # of E
FEW = 0.03  # of the points, but 3 at least
VERY_FAR = 5.0  # gap, in sizes of all that is not far
MARKED_MOST = 0.5  # of the points: more than that is not a mark but the cloud
DENSE = 3.0  # spacing of a far surface over that of the body
SAMPLE = 500  # points of the body whose spacing is looked at


@dataclass(frozen=True)
class FarPoints:
    """What was found in one frame.

    kept: which points stay, shape (N,) bool
    gap:  between the body and the nearest far point, in sizes of the body; 0 without any
    mark: the coordinates of all that was left out, NaN on axes on which they differ, shape (3,); None without any
    """

    kept: np.ndarray
    gap: float = 0.0
    mark: np.ndarray | None = None


def find_far(points: np.ndarray) -> FarPoints:
    """Points of one frame, shape (N, 3), any units, that are left out for their distance."""
    points = np.asarray(points, dtype=np.float64)
    every = FarPoints(np.ones(len(points), dtype=bool))
    low, high = np.percentile(points, BULK, axis=0)
    size = float((high - low).max())
    outside = np.maximum(low - points, points - high).max(axis=1)
    limit = _first_gap(outside, GAP * size)
    if limit is None or not size > 0:
        return every
    far = outside > limit
    near = points[~far]
    if len(near) < MIN_POINTS:
        return every
    gap = (float(outside[far].min()) - max(limit, 0.0)) / float(np.ptp(near, axis=0).max())
    mark = _mark(points[far])
    if far.sum() <= max(FEW * len(points), 3):
        if gap <= VERY_FAR:
            far[far] = ~_is_dense(points[far], near)
    elif gap <= VERY_FAR or np.isnan(mark).all() or far.mean() > MARKED_MOST:
        return every
    return FarPoints(~far, gap, _mark(points[far])) if far.any() else every


def _first_gap(outside: np.ndarray, least: float) -> float | None:
    """Where, among the distances above 0, the first gap above ``least`` begins; None without one."""
    steps = np.concatenate([[0.0], np.sort(outside[outside > 0])])
    wide = np.flatnonzero(np.diff(steps) > least)
    return float(steps[wide[0]]) if len(wide) else None


def _mark(far: np.ndarray) -> np.ndarray:
    same = len(far) > 0 and (far == far[:1]).all(axis=0)
    return np.where(same, far[0] if len(far) else np.nan, np.nan)


def _is_dense(far: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Which of the far points belong to a surface as dense as the body's, shape (M,) bool."""
    from scipy.spatial import cKDTree

    if len(far) <= SPACING_NEIGHBOURS:
        return np.zeros(len(far), dtype=bool)
    step = max(len(near) // SAMPLE, 1)
    usual = np.median(cKDTree(near).query(near[::step], k=min(SPACING_NEIGHBOURS, len(near) - 1) + 1)[0][:, -1])
    return cKDTree(far).query(far, k=SPACING_NEIGHBOURS + 1)[0][:, -1] <= DENSE * usual


def drop_far(sequence: PointSequence) -> PointSequence:
    """The sequence without points that lie far from all others; notes say how many, how far, and in which frames."""
    found = [find_far(points) for points in sequence.points]
    if all(f.mark is None for f in found):
        return sequence
    told = [(number, f) for number, f in zip(sequence.numbers, found, strict=True) if f.mark is not None]
    count = sum(int((~f.kept).sum()) for _, f in told)
    which, gap = name_frames([number for number, _ in told]), min(f.gap for _, f in told)
    points = "point" if count == 1 else "points"
    note = f"{which}: {count} {points} {gap:.2g} or more sizes of the object away left out{_named(told)}"
    return sequence.keep([f.kept for f in found], f"{note}; --no-drop-strays keeps them")


def _named(told: list[tuple[int, FarPoints]]) -> str:
    """The number that stands for nothing in these frames, if there is one."""
    marks = np.stack([f.mark for _, f in told if f.mark is not None])
    same = (marks == marks[:1]).all(axis=0)
    if len(marks) < 2 or not same.any():
        return ""
    axes = [f"{axis} = {value:g}" for axis, value, is_same in zip("xyz", marks[0], same, strict=True) if is_same]
    return f"; all have {', '.join(axes)}, which is taken for a mark of nothing seen"
