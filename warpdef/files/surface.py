"""What one file of points or of a mesh holds, before anything is decided about it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warpdef.errors import InputError


@dataclass(frozen=True)
class Surface:
    """Contents of one cloud or mesh file, vertex order as in the file, nothing merged.

    points:  positions, input units          (N, 3) float64
    normals: as stored, any length, or None  (N, 3) float64
    faces:   polygons cut into fans, or None (F, 3) int64
    """

    points: np.ndarray
    normals: np.ndarray | None = None
    faces: np.ndarray | None = None


def fan_triangles(indices: np.ndarray, counts: np.ndarray, where: str) -> np.ndarray:
    """Polygons to triangles, each polygon a fan around its first vertex, in the order given.

    Args:
        indices: the polygons' vertex indices one after the other, shape (sum of counts,).
        counts: vertices of each polygon, shape (P,).
        where: file name for errors.

    Returns:
        Triangles, shape (F, 3) int64.

    Raises:
        InputError: a polygon of fewer than three vertices.
    """
    counts = np.asarray(counts, dtype=np.int64)
    if len(counts) and counts.min() < 3:
        face = int(counts.argmin())
        raise InputError(f"{where}: face {face}: expected at least 3 vertices, got {counts[face]}; remove it")
    triangles = counts - 2
    start = np.cumsum(counts) - counts
    first = np.repeat(start, triangles)
    step = np.arange(len(first)) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    return np.asarray(indices, dtype=np.int64)[np.stack([first, first + step + 1, first + step + 2], axis=1)]
