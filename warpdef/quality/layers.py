"""Two layers of points where the mesh has one: the front and the back of cloth, or of a wall.

Fitted to both at once a surface lies between them, no farther from either than noise would be. But noise lies around a
surface, and layers on either side of it: heights of points over the mesh fall into two classes, each narrow against
the gap between them.
"""

from __future__ import annotations

import numpy as np

from warpdef.geometry.triangles import face_normals
from warpdef.quality.coverage import Coverage

SPLIT = 0.15
"""Variance within two classes of heights over that of all, below which they are layers, five times as far apart as
they are thick: 0.36 for a normal distribution, 0.25 where heights are spread evenly."""
_SAMPLED = 2000  # points that say it for all
_FELLOWS = 24  # points around each that are looked at, itself among them
_LEAST = 0.25  # share of them in either class
_APART = 0.5  # least distance between the classes, in lengths: what is closer is how a surface bends between points


def merged_share(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray, coverage: Coverage) -> float:
    """Share of the points that lie in two layers of which the surface makes one.

    Args:
        points: shape (N, 3). vertices: shape (V, 3). faces: shape (F, 3). coverage: of these.
    """
    from scipy.spatial import cKDTree

    if len(points) < _FELLOWS:
        return 0.0
    met = faces[coverage.face]
    normal = face_normals(vertices, met)[0]
    foot = np.einsum("nk,nki->ni", coverage.weights, vertices[met])
    height = ((points - foot) * normal).sum(axis=1)
    asked = slice(None, None, -(-len(points) // _SAMPLED))
    around = height[cKDTree(points).query(points[asked], k=_FELLOWS)[1]]
    within, gap = two_classes(around, int(_LEAST * _FELLOWS))
    return float(np.mean((within < SPLIT) & (gap > _APART * coverage.length[asked])))


def two_classes(values: np.ndarray, least: int) -> tuple[np.ndarray, np.ndarray]:
    """Each row's values (n, k) in two classes by a threshold, so that they vary least within (Otsu 1979, *A threshold
    selection method from gray-level histograms*).

    Args:
        least: values in either class, 1 or more.

    Returns:
        Variance within the classes over that of all, and the distance between their means, (n,) each.
    """
    values = np.sort(values - values.mean(axis=1, keepdims=True), axis=1)
    count = values.shape[1]
    low = np.arange(least, count - least + 1)
    below = np.cumsum(values, axis=1)[:, low - 1] / low
    above = -below * low / (count - low)
    total = np.maximum((values**2).sum(axis=1), np.finfo(float).tiny)
    between = low * below**2 + (count - low) * above**2
    best = between.argmax(axis=1)
    row = np.arange(len(values))
    return 1.0 - between[row, best] / total, (above - below)[row, best]
