"""Local planes of a cloud: lines of normals, neighbourhoods, and how well the sides of neighbours agree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdef.geometry.nearby import Fellows

if TYPE_CHECKING:
    import warp as wp


def pca_normals(
    points: np.ndarray, neighbours: int = 16, device: wp.Device | None = None, asked: np.ndarray | None = None
) -> np.ndarray:
    """Unit normals of the planes through each point's neighbours, shape (N, 3) float64; their sign means nothing.

    Args:
        points: shape (N, 3), any units.
        neighbours: points a plane is fitted to, the point itself among them; at most N are used.
        device: where they are looked for; None: on the host, without Warp.
        asked: only of these points, (Q,), on the host; None: of all.
    """
    return Fellows(points, max(neighbours, 4), device=device, asked=asked).planes()[0]


def turned_to(normals: np.ndarray, side: np.ndarray) -> np.ndarray:
    """``normals``, each turned over where it opposes the one of ``side``; both (N, 3)."""
    return np.where((normals * side).sum(axis=1, keepdims=True) < 0, -normals, normals)


def unit_vectors(x: np.ndarray) -> np.ndarray:
    """Vectors (N, 3) of length 1; zero where they are zero."""
    return x / np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-300)


def fit_planes(points: np.ndarray, index: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normals (N, 3) of weighted planes through ``points[index]``, and how clear each plane is: 1 flat, 0 a ball."""
    total = np.maximum(weight.sum(axis=1), 1e-300)
    near = points[index]
    near = near - (np.einsum("nk,nki->ni", weight, near) / total[:, None])[:, None]
    spread, axes = np.linalg.eigh(np.einsum("nk,nki,nkj->nij", weight, near, near))
    return axes[:, :, 0], 1.0 - np.clip(spread[:, 0], 0, None) / np.maximum(spread[:, 1], 1e-300)


def agreement_of(
    points: np.ndarray, normals: np.ndarray, i: np.ndarray, j: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """How well the sides of pairs of normals agree, -1 to 1, and how far to trust that, 0 to 1; both of shape (E,).

    The first is n_i . n_j with n_j mirrored across the step from i to j: right across sharp edges and thin walls too.
    The second is high where the step runs along the surface.
    """
    step = unit_vectors(points[j] - points[i])
    n_i, n_j = normals[i], normals[j]
    rise_i, rise_j = (n_i * step).sum(axis=1), (n_j * step).sum(axis=1)
    flatness = (1.0 - np.minimum(np.maximum(np.abs(rise_i), np.abs(rise_j)), 1.0)) ** 2
    return (n_i * n_j).sum(axis=1) - 2.0 * rise_i * rise_j, flatness


@dataclass(frozen=True)
class Neighbourhood:
    """points (N, 3) float64; index: neighbours, the point itself first (N, K); area: relative area a point stands for
    (N,); spacing: mean distance to the nearest six."""

    points: np.ndarray
    index: np.ndarray
    area: np.ndarray
    spacing: float

    @classmethod
    def of(cls, points: np.ndarray, neighbours: int) -> Neighbourhood:
        from scipy.spatial import cKDTree

        points = np.ascontiguousarray(points, dtype=np.float64)
        distance, index = cKDTree(points).query(points, k=min(max(neighbours, 4), len(points)))
        area = distance[:, -1] ** 2
        return cls(points, index, area / max(area.mean(), 1e-300), float(distance[:, 1:7].mean()))

    def edges(self) -> tuple[np.ndarray, np.ndarray]:
        """Undirected neighbour pairs, each once: two arrays of E indices."""
        count = len(self.index)
        i, j = np.repeat(np.arange(count), self.index.shape[1]), self.index.ravel()
        first, second = np.divmod(np.unique((np.minimum(i, j) * count + np.maximum(i, j))[i != j]), count)
        return first, second
