"""Whether poses come in the order of a film: what their order shows, held against that of shuffles of the same poses.

    near      the mean difference of neighbours, mean_t d(t, t + 1): small where each frame is like the next
    shared    the same of what both frames show: of frames that lack now one part, now another
    between   how far a frame is from the middle of the two around it, mean_t | f_t - (f_{t-1} + f_{t+1}) / 2 |: small
              where motion goes on, even if every second frame of a cycle is nearer than the next

Each is a permutation test: the share of shuffles that show as much is, for scans in no order, evenly spread between 0
and 1, whatever the poses are. So the rate at which these are mistaken for a film is known, without a model of films.
"""

from __future__ import annotations

import numpy as np

from warpdef.geometry.poses import differences, shared_differences

CHANCE = 0.01
"""Share of shuffles up to which an order is a film's. With what follows 2 % of scans in no order are let through, of
fewer than 13 frames 6 %."""
HALF_AS_FAR, UNLIKELY = 0.6, 0.2
"""Where neighbours are less than this part of the usual apart, by medians, so many shuffles may be as good: a film that
swings to and fro once has too few frames for the rest."""
STANDS_OUT = 2.0  # of the difference between halves of a cloud: what the median difference must be
_SHUFFLES = 2000
_CAP = 2.0  # median differences: a frame from elsewhere is no farther away


def orderly(fields: np.ndarray, halves: float) -> bool:
    """Whether distance fields (T, K) come as a film's, or differ too little to tell.

    Args:
        halves: the difference between halves of a cloud, as ``geometry.poses.pose_fields`` gives it.
    """
    count = len(fields)
    pairs = np.triu_indices(count, 1)
    whole = differences(fields)
    if float(np.median(whole[pairs])) <= STANDS_OUT * halves:
        return True
    shuffles = np.tile(np.arange(count), (_SHUFFLES + 1, 1))
    np.random.default_rng(0).permuted(shuffles[1:], axis=1, out=shuffles[1:])

    for apart in (whole, shared_differences(fields)):
        usual = float(np.median(apart[pairs]))
        chance = _chance(_near(np.minimum(apart, _CAP * usual), shuffles))
        median = float(np.median(np.diagonal(apart, 1)))
        if chance <= CHANCE or (median <= HALF_AS_FAR * usual and chance <= UNLIKELY):
            return True
    return _chance(_between(fields, shuffles)) <= CHANCE


def _chance(left: np.ndarray) -> float:
    """Share of shuffles that leave no more than the order given, which is the first."""
    return float(np.mean(left[1:] <= left[0] + 1e-9 * abs(left[0])))


def _near(apart: np.ndarray, orders: np.ndarray) -> np.ndarray:
    return apart[orders[:, :-1], orders[:, 1:]].mean(axis=1)


def _between(fields: np.ndarray, orders: np.ndarray) -> np.ndarray:
    """By the median of a triangle: its square is (a^2 + b^2) / 2 - c^2 / 4, c the side that it halves."""
    centred = fields - fields.mean(axis=0)
    product = centred @ centred.T
    square = np.diag(product)[:, None] + np.diag(product) - 2.0 * product
    step = square[orders[:, :-1], orders[:, 1:]]
    across = square[orders[:, :-2], orders[:, 2:]]
    return np.sqrt(np.maximum((step[:, :-1] + step[:, 1:]) / 2.0 - across / 4.0, 0.0)).mean(axis=1)
