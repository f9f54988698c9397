"""Surface drawn out over what the shape lacks: a hand over the ball that it has picked up, a tail over another's coils.

Single edges are longer or shorter for noise alone; patches are not. Around a vertex the edges d of two rings in the
shape go over into the edges e of a frame by the map F of the tangent plane that makes the sum of |F d - e|^2 least. Its
larger singular value is how far the patch is drawn out, a growth of all taken off. F is linear in the frame's vertices,
so that a frame costs two products with a sparse matrix.
"""

from __future__ import annotations

import numpy as np

from warpdef.geometry.triangles import vertex_areas, vertex_normals

DRAWN = 1.8
"""Ratio of a patch's length along one way to that in the shape, from which it counts as drawn out."""
_PATCHES = 2500  # at most: five in a thousand are 12 of them
_FLAT = 1e-6  # share of a patch across its longer way below which it has but one


class Patches:
    """Patches of two rings around some vertices of a shape.

    Args:
        vertices: shape (V, 3) float64. faces: shape (F, 3). edges: each once, shape (E, 2).
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, edges: np.ndarray) -> None:
        from scipy.sparse import csr_matrix, diags, identity

        count = len(vertices)
        asked = np.arange(count)
        if count > _PATCHES:
            asked = np.sort(np.random.default_rng(0).choice(count, _PATCHES, replace=False))
        start, end = np.concatenate([edges, edges[:, ::-1]]).T
        edge = vertices[end] - vertices[start]
        linked = csr_matrix((np.ones(len(start)), (start, end)), shape=(count, count))
        star = csr_matrix(linked + identity(count, format="csr"))
        patch = star[asked] @ star
        patch.data[:] = 1.0

        products = (edge[:, :, None] * edge[:, None, :]).reshape(-1, 9)
        around = np.stack([np.bincount(start, of, count) for of in products.T], axis=1)
        spread = (patch @ around).reshape(-1, 3, 3)
        plane = _tangents(vertex_normals(vertices, faces)[asked])
        within = np.einsum("vai,vab,vbj->vij", plane, spread, plane)
        (one, mixed), (_, other) = within.transpose(1, 2, 0)
        determinant, trace = one * other - mixed**2, one + other
        flat = determinant <= _FLAT * np.maximum(trace, np.finfo(float).tiny) ** 2
        inverse = np.stack([np.stack([other, -mixed], 1), np.stack([-mixed, one], 1)], 1)
        by = np.einsum("vai,vij->vaj", plane, inverse / np.where(flat, 1.0, determinant)[:, None, None])

        sums = []
        for axis in range(3):
            towards = csr_matrix((edge[:, axis], (start, end)), shape=(count, count))
            sums.append(patch @ (towards - diags(np.bincount(start, edge[:, axis], count))))
        along_x, along_y, along_z = sums
        self._maps = [(diags(of[0]) @ along_x + diags(of[1]) @ along_y + diags(of[2]) @ along_z).tocsr() for of in by.T]
        self._weight = np.where(flat, 0.0, vertex_areas(vertices, faces)[asked])

    def drawn_share(self, vertices: np.ndarray) -> float:
        """Share of the shape's surface that a frame (V, 3) has drawn out by more than ``DRAWN``."""
        surface = float(self._weight.sum())
        if not surface > 0.0:
            return 0.0
        first, second = (of @ vertices for of in self._maps)
        one, other, mixed = ((a * b).sum(axis=1) for a, b in ((first, first), (second, second), (first, second)))
        middle, area_sq = 0.5 * (one + other), np.maximum(one * other - mixed**2, 0.0)
        longest_sq = middle + np.sqrt(np.maximum(middle**2 - area_sq, 0.0))
        growth_sq = float(np.median(np.sqrt(area_sq[self._weight > 0.0])))
        return float(self._weight[longest_sq > DRAWN**2 * growth_sq].sum()) / surface


def _tangents(normal: np.ndarray) -> np.ndarray:
    """Two unit vectors across each normal (N, 3), as columns (N, 3, 2)."""
    apart = np.eye(3)[np.abs(normal).argmin(axis=1)]
    first = np.cross(normal, apart)
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), np.finfo(float).tiny)
    return np.stack([first, np.cross(normal, first)], axis=2)
