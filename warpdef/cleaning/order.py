"""Scans in no order: a set of poses, not a film. Found out, and put into an order in which neighbours are alike.

Neighbours of a film are more alike than frames picked at random (``geometry.poses``). Scans are in no order if they
are not: the mean rank of the T - 1 differences of neighbours among all differences is what chance gives, less than
``CHANCE`` deviations below one half, their median is not far below that of all, and poses differ by more than sampling.
A frame or two from elsewhere do not change ranks or medians; a body that stands still differs by sampling alone; one
that moves so fast that a frame tells nothing of the next is a set of poses, too.

The order is a walk through the minimum spanning tree of the differences, small branches first: each scan stands behind
one that is like it, but for the returns from the ends of branches.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from warpdef.geometry.poses import differences, pose_fields
from warpdef.sequence import PointSequence

CHANCE = 3.0
RATIO = 0.6  # of the medians; films have 0.06 to 0.56, 0.67 on a turntable by 30 degrees a frame (rank 4.4 deviations)
STANDS_OUT = 2.0  # of the difference between halves of a cloud: what the median difference must be
LEAST_FRAMES = 8  # fewer tell too little
_PAIRS = 800  # that speak for all


def order_by_pose(clouds: Sequence[np.ndarray]) -> list[int] | None:
    """An order of scans (N_t, 3) in which neighbours are alike, None where they are a film."""
    if len(clouds) < LEAST_FRAMES:
        return None
    fields, halves = pose_fields(clouds)
    return _walk(fields) if _in_no_order(fields, halves) else None


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
    pairs = np.sort(differences(fields, one, other))
    near = differences(fields, np.arange(count - 1), np.arange(1, count))
    rank = (np.searchsorted(pairs, near, "left") + np.searchsorted(pairs, near, "right")) / (2.0 * len(pairs))
    below = (0.5 - float(rank.mean())) * np.sqrt(12.0 * (count - 1))
    middle = float(np.median(pairs))
    return below < CHANCE and float(np.median(near)) > RATIO * middle and middle > STANDS_OUT * halves


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
