"""Scans in no order: a set of poses, not a film. Found out, and put into an order in which neighbours are alike.

Neighbours of a film are more alike than frames picked at random (``geometry.poses``). Scans are in no order if they
are not: the mean rank of the T - 1 differences of neighbours among all differences is what chance gives, less than
``CHANCE`` deviations below one half, their median is not far below that of all, and poses differ by more than sampling.
A frame or two from elsewhere do not change ranks or medians; a body that stands still differs by sampling alone; one
that moves so fast that a frame tells nothing of the next is a set of poses, too. But what turns is a film, however
fast: one rotation about an axis of the coordinates, the same for all neighbours, makes them alike. And frames that lack
now one part, now another, are unlike by that alone: in what both show neighbours must be no more alike either.

The order is a walk through the minimum spanning tree of the differences, small branches first: each scan stands behind
one that is like it, but for the returns from the ends of branches.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from warpdef.geometry.poses import differences, pose_fields, shared_differences
from warpdef.sequence import PointSequence

CHANCE = 3.0
RATIO = 0.6  # of the medians; films have 0.06 to 0.56, 0.67 on a turntable by 30 degrees a frame (rank 4.4 deviations)
STANDS_OUT = 2.0  # of the difference between halves of a cloud: what the median difference must be
LEAST_FRAMES = 8  # fewer tell too little
_PAIRS = 800  # that speak for all
_TURN_STEP = 15.0  # degrees between the rotations tried
_TURN_PAIRS, _TURN_POINTS = 12, 500  # neighbours on which they are, and points of each


def order_by_pose(clouds: Sequence[np.ndarray]) -> list[int] | None:
    """An order of scans (N_t, 3) in which neighbours are alike, None where they are a film."""
    if len(clouds) < LEAST_FRAMES:
        return None
    fields, halves = pose_fields(clouds)
    return _walk(fields) if _in_no_order(fields, halves) and not turns(clouds) else None


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


def _in_no_order(fields: np.ndarray, halves: float) -> bool:
    count = len(fields)
    one, other = np.triu_indices(count, 1)
    if len(one) > _PAIRS:
        chosen = np.random.default_rng(0).choice(len(one), _PAIRS, replace=False)
        one, other = one[chosen], other[chosen]
    for apart in (differences, shared_differences):
        pairs = np.sort(apart(fields, one, other))
        near = apart(fields, np.arange(count - 1), np.arange(1, count))
        rank = (np.searchsorted(pairs, near, "left") + np.searchsorted(pairs, near, "right")) / (2.0 * len(pairs))
        below = (0.5 - float(rank.mean())) * np.sqrt(12.0 * (count - 1))
        middle = float(np.median(pairs))
        if below >= CHANCE or float(np.median(near)) <= RATIO * middle:
            return False
        if apart is differences and middle <= STANDS_OUT * halves:
            return False
    return True


def turns(clouds: Sequence[np.ndarray]) -> bool:
    """Whether one rotation of each scan makes it more like the one before: the median difference of neighbours, their
    centres on one place, falls below ``RATIO`` of what it is."""
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
    return bool(medians[1:].min() < RATIO * medians[0])


def _walk(fields: np.ndarray) -> list[int]:
    """All frames, from an end of the longest way through the tree."""
    from scipy.sparse.csgraph import minimum_spanning_tree, shortest_path

    apart = np.array([np.abs(fields - field).mean(axis=1) for field in fields])
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
