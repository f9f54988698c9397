"""Normals given that point to the other side in some frames than in others: estimated frame by frame, as a rule.

Programs that orient normals of one cloud alone may begin on either side. A frame's normals are held against those of
the nearest points of the frame before it; where these oppose in the mean, one of both is on the wrong side. The fewer
frames are turned over. Then all are, if those of the middle frame oppose an estimate of the outer side. A frame in
which normals are mixed is left as it is: there sides are looked at point by point, later.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from warpdef.geometry.cloud_normals import repair_normals
from warpdef.geometry.sampling import spread_evenly
from warpdef.sequence import PointSequence, name_frames

SEEN = 1000  # points of a frame
INWARDS = 0.8  # share of the points of a frame whose normals oppose the estimate
CLEAR = 0.4  # |mean of cos| between two frames: they are on the same side, or on opposite ones


def opposed_frames(points: list[np.ndarray], normals: list[np.ndarray]) -> np.ndarray:
    """Which frames are on the other side than most, shape (T,) bool; T of (N_t, 3), unit normals."""
    from scipy.spatial import cKDTree

    side = np.ones(len(points))
    for t in range(1, len(points)):
        some = slice(None, None, max(len(points[t]) // SEEN, 1))
        nearest = cKDTree(points[t - 1]).query(points[t][some])[1]
        agreement = float(np.einsum("ni,ni->n", normals[t][some], normals[t - 1][nearest]).mean())
        side[t] = -side[t - 1] if agreement < -CLEAR else side[t - 1]
    return side < 0 if (side > 0).sum() >= (side < 0).sum() else side > 0


def point_inwards(points: np.ndarray, normals: np.ndarray, neighbours: int) -> bool:
    """Whether the unit normals (N, 3) of a frame nearly all oppose an estimate of the outer side."""
    some = spread_evenly(points, SEEN)
    return repair_normals(points[some], normals[some], neighbours)[1] > INWARDS * len(some)


def turn_to_one_side(sequence: PointSequence, neighbours: int) -> PointSequence:
    """The sequence with such normals turned over; notes name the frames. ``neighbours``: of the estimate."""
    places = [t for t, given in enumerate(sequence.normals) if given is not None]
    given = [n for n in sequence.normals if n is not None]
    if not given:
        return sequence
    notes, turned = [], list(sequence.normals)
    opposed = opposed_frames([sequence.points[t] for t in places], given)
    if opposed.any():
        which = name_frames([sequence.numbers[t] for t, bad in zip(places, opposed, strict=True) if bad])
        notes.append(f"normals given for {which} point to the other side than those of the frames around: turned over")
    given = [-n if bad else n for n, bad in zip(given, opposed, strict=True)]
    middle = len(places) // 2
    if point_inwards(sequence.points[places[middle]], given[middle], neighbours):
        notes.append("normals given point inwards: turned over in all frames")
        given = [-n for n in given]
    if not notes:
        return sequence
    for t, n in zip(places, given, strict=True):
        turned[t] = n
    return replace(sequence, normals=tuple(turned), notes=(*sequence.notes, *notes))
