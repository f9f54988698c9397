"""Which points of a cloud lie on a border of the surface that it samples. NumPy and SciPy only."""

from __future__ import annotations

import numpy as np

BORDER_NEIGHBOURS = 24
BORDER_GAP = 2.1  # radians without a neighbour, seen from a border point; 120 degrees
BORDER_SHIFT = 0.3  # of the neighbourhood's radius; the centroid of half a disc lies at 0.42


def border_points(points: np.ndarray, normals: np.ndarray, asked: np.ndarray | None = None) -> np.ndarray:
    """Which points lie on a border of the sampled surface, shape (Q,) bool.

    Seen from a border point, in the plane of its normal, the neighbours leave an angle free and their centroid is far
    off. Where limbs are thinner than the neighbourhood that happens too: compare clouds, do not trust the number.

    Args:
        points: shape (N, 3).
        normals: of those asked, shape (Q, 3), unit length; their side does not matter.
        asked: only these points, (Q,); None: all.
    """
    from scipy.spatial import cKDTree

    count = min(BORDER_NEIGHBOURS, len(points) - 1)
    places = points if asked is None else points[asked]
    index = cKDTree(points).query(places, k=count + 1)[1][:, 1:]
    step = points[index] - places[:, None]
    # Any two axes across the normal.
    helper = np.where(np.abs(normals[:, :1]) < 0.7, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = np.cross(normals, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    x = np.einsum("nki,ni->nk", step, first)
    y = np.einsum("nki,ni->nk", step, np.cross(normals, first))
    angle = np.sort(np.arctan2(y, x), axis=1)
    gap = np.maximum(np.diff(angle, axis=1).max(axis=1), angle[:, 0] + 2.0 * np.pi - angle[:, -1])
    radius = np.maximum(np.hypot(x, y).max(axis=1), 1e-300)
    return (gap > BORDER_GAP) & (np.hypot(x.mean(axis=1), y.mean(axis=1)) > BORDER_SHIFT * radius)
