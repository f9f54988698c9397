"""Scans in no order: a set of poses, not a film. Found out, and put into an order in which neighbours are alike.

A film's order shows (``shuffles``): neighbours are alike, or motion goes on from frame to frame. Scans are in no order
if theirs shows no more than if they were shuffled, and if poses differ by more than sampling. One that
moves so fast that a frame tells nothing of the next is a set of poses, too. But what turns is a film, however fast: one
rotation about an axis of the coordinates, the same for all neighbours, makes them alike.

The order is a walk through the minimum spanning tree of the differences, small branches first: each scan stands behind
one that is like it, but for the returns from the ends of branches.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from warpdef.cleaning.shuffles import orderly
from warpdef.geometry.poses import differences, pose_fields
from warpdef.sequence import PointSequence

LEAST_FRAMES = 8  # fewer tell too little
_JUDGED = 64  # frames in the middle that speak for all
_TURNED = 0.6  # of the median difference of neighbours: what is left where they only turn, at most
_TURN_STEP = 15.0  # degrees between the rotations tried
_TURN_PAIRS, _TURN_POINTS = 12, 500  # neighbours on which they are, and points of each


def order_by_pose(clouds: Sequence[np.ndarray]) -> list[int] | None:
    """An order of scans (N_t, 3) in which neighbours are alike, None where they are a film."""
    if len(clouds) < LEAST_FRAMES:
        return None
    first = max((len(clouds) - _JUDGED) // 2, 0)
    middle = clouds[first : first + _JUDGED]
    fields, halves = pose_fields(middle)
    if orderly(fields, halves) or turns(clouds):
        return None
    return _walk(fields if len(middle) == len(clouds) else pose_fields(clouds)[0])


def put_in_order(sequence: PointSequence) -> PointSequence:
    """The sequence, its clouds by pose if they are in no order, with a note that says so; their numbers stay."""
    order = order_by_pose(sequence.points)
    if order is None:
        return sequence
    note = (
        "frames are no more like their neighbours than like any others: they are taken as scans in no order, each "
        "followed from one that is like it, and nothing is smoothed in time; of a film, more frames a second would help"
    )
    return sequence.in_order(order, note)


def turns(clouds: Sequence[np.ndarray]) -> bool:
    """Whether one rotation of each scan makes it more like the one before: the median difference of neighbours, their
    centres on one place, falls below ``_TURNED`` of what it is."""
    from scipy.spatial.transform import Rotation

    at = np.unique(np.linspace(0, len(clouds) - 2, _TURN_PAIRS).astype(int))
    centred = {t: clouds[t][:: max(len(clouds[t]) // _TURN_POINTS, 1)] for t in {*at, *(at + 1)}}
    centred = {t: cloud - cloud.mean(axis=0) for t, cloud in centred.items()}
    angles = np.radians(np.arange(_TURN_STEP, 360.0, _TURN_STEP))
    tried = [np.eye(3), *(Rotation.from_rotvec(a * axis).as_matrix() for axis in np.eye(3) for a in angles)]
    turned = [centred[t + 1] @ turn for turn in tried for t in at]
    fields, _ = pose_fields([*(centred[t] for t in at), *turned])
    apart = [np.abs(fields[k % len(at)] - field).mean() for k, field in enumerate(fields[len(at) :])]
    medians = np.median(np.reshape(apart, (len(tried), len(at))), axis=1)
    return bool(medians[1:].min() < _TURNED * medians[0])


def _walk(fields: np.ndarray) -> list[int]:
    """All frames, from an end of the longest way through the tree."""
    from scipy.sparse.csgraph import minimum_spanning_tree, shortest_path

    apart = differences(fields)
    # An edge of length 0 would be none.
    tree = minimum_spanning_tree(np.maximum(apart, 1e-12)).tocoo()
    ways = shortest_path(tree, directed=False)
    start = int(np.argmax(ways.max(axis=1)))
    beside: list[list[int]] = [[] for _ in fields]
    for a, b in zip(tree.row.tolist(), tree.col.tolist(), strict=True):
        beside[a].append(b)
        beside[b].append(a)
    # Behind a frame its branches, the one that reaches farthest last.
    outwards = np.argsort(ways[start], kind="stable")
    before = {start: start}
    reach = np.zeros(len(fields))
    for t in outwards:
        before |= {b: int(t) for b in beside[t] if b not in before}
    for t in outwards[:0:-1]:
        reach[before[int(t)]] = max(reach[before[int(t)]], reach[t] + apart[t, before[int(t)]])
    order, left = [], [start]
    while left:
        t = left.pop()
        order.append(t)
        branches = [b for b in beside[t] if before[b] == t]
        left += sorted(branches, key=lambda b: (-(reach[b] + apart[t, b]), b))
    return order
