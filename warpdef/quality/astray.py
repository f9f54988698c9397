"""Points together far off the surface: a limb of which little was seen, and that the mesh has put elsewhere.

They may be too few to count among all that are not covered. But strays and what a fit leaves open are single points, or
lie close by: ten that lie side by side, and all far off, are a part of the body.
"""

from __future__ import annotations

import numpy as np

from warpdef.quality.coverage import COVERED, Coverage

TOGETHER = 10
"""Points of a group that are that far off at least."""
_BESIDE = 5.0  # lengths between neighbours of a group
_FELLOWS = 8  # nearest points among which they are looked for, the point itself among them


def astray_lengths(points: np.ndarray, coverage: Coverage) -> float:
    """How far off the surface ``TOGETHER`` points of one group are at least, in lengths; 0 where there is no such one.

    Args:
        points: shape (N, 3). coverage: of these.
    """
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    depth = coverage.residual / coverage.length
    off = np.flatnonzero(depth > COVERED)
    if len(off) < TOGETHER:
        return 0.0
    distance, fellow = cKDTree(points[off]).query(points[off], k=_FELLOWS)
    near = distance <= _BESIDE * coverage.length[off, None]
    start = np.repeat(np.arange(len(off)), near.sum(axis=1))
    links = csr_matrix((np.ones(len(start)), (start, fellow[near])), shape=(len(off), len(off)))
    group = connected_components(links, directed=False)[1]
    deepest = 0.0
    for number in np.flatnonzero(np.bincount(group) >= TOGETHER):
        deepest = max(deepest, float(np.sort(depth[off[group == number]])[-TOGETHER]))
    return deepest
