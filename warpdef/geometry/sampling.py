"""Points drawn from a surface, uniform by area; and from a cloud, evenly in space; how far apart its points are."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from warpdef.errors import InputError

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

_VOXEL_TRIALS = 8


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


def spread_evenly(points: np.ndarray, count: int) -> np.ndarray:
    """Indices of at most ``count`` points (N, 3), evenly spread whatever the density: one a voxel; ascending.

    Voxels are as large as leaves about ``count`` of them occupied; what is over is dropped at equal intervals. The same
    points give the same indices.
    """
    if len(points) <= count:
        return np.arange(len(points))
    low = points.min(axis=0)
    size = float(np.ptp(points, axis=0).max()) / np.sqrt(count)
    chosen = np.arange(len(points))
    # A surface occupies about as many voxels as the inverse square of their size.
    for _ in range(_VOXEL_TRIALS):
        cell = ((points - low) / max(size, 1e-30)).astype(np.int64)
        key = (cell[:, 0] << 42) + (cell[:, 1] << 21) + cell[:, 2]
        chosen = np.unique(key, return_index=True)[1]
        if count <= len(chosen) <= 1.1 * count:
            break
        size *= float(np.clip(np.sqrt(len(chosen) / (1.05 * count)), 0.25, 4.0))
    chosen = np.sort(chosen)
    if len(chosen) > count:
        chosen = chosen[np.linspace(0, len(chosen) - 1, count).astype(int)]
    return chosen


def mean_spacing(points: np.ndarray, tree: cKDTree | None = None) -> float:
    """Mean distance of points (N, 3), at least two, to their nearest fellow. tree: of them, where there is one."""
    if tree is None:
        from scipy.spatial import cKDTree

        tree = cKDTree(points)
    return float(tree.query(points, k=2)[0][:, 1].mean())
