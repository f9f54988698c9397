"""Points drawn from a surface, uniform by area."""

from __future__ import annotations

import numpy as np

from warpdef.errors import InputError


def sample_surface(
    vertices: np.ndarray, faces: np.ndarray, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Independent points, uniform by area.

    Args:
        vertices: shape (V, 3).
        faces: shape (F, 3).
        count: number of points N.
        rng: source of randomness; the same state gives the same points.

    Returns:
        Points (N, 3) float64 in the vertices' units, unit face normals (N, 3), face indices (N,) int64, and barycentric
        coordinates (N, 3).

    Raises:
        InputError: ``count`` below 1, or a surface without area.
    """
    if count < 1:
        raise InputError(f"surface samples: expected at least 1 point, got {count}")
    corners = np.asarray(vertices, dtype=np.float64)[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    double_area = np.linalg.norm(normals, axis=1)
    total = double_area.sum()
    if not total > 0.0:
        raise InputError("surface samples: expected a surface with an area above 0, got only degenerate triangles")
    # A face without area owns an empty interval and is never drawn.
    face = np.searchsorted(np.cumsum(double_area), rng.random(count) * total, side="right")
    face = np.minimum(face, np.flatnonzero(double_area)[-1])
    root, second = np.sqrt(rng.random(count)), rng.random(count)
    barycentric = np.column_stack([1.0 - root, root * (1.0 - second), root * second])
    points = np.einsum("nk,nki->ni", barycentric, corners[face])
    return points, normals[face] / double_area[face, None], face, barycentric
