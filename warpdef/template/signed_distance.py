"""What oriented points say about the space around them: which side a place is on, and how far from the surface.

Near the points their planes answer (Kolluri 2008, implicit moving least squares), elsewhere the winding number.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import warp as wp

PLANE_NEIGHBOURS = 8
SHAPE_NEIGHBOURS = 16
WINDING_POINTS = 20_000  # at most, evenly taken


class OrientedCloud:
    """Oriented points, and what they say about places around them; the points' units."""

    def __init__(self, points: np.ndarray, normals: np.ndarray) -> None:
        from scipy.spatial import cKDTree

        self.points = np.asarray(points, dtype=np.float64)
        self.normals = np.asarray(normals, dtype=np.float64)
        self.tree = cKDTree(self.points)
        self.neighbours = min(PLANE_NEIGHBOURS, len(self.points))
        distance = self.tree.query(self.points, k=[2, self.neighbours])[0]
        self.spacing = float(distance[:, 0].mean())
        # A disc to the k-th neighbour, the point itself counted as the first, holds k - 1 points' areas.
        area = np.pi * distance[:, 1] ** 2 / max(self.neighbours - 1, 1)
        chosen = np.arange(0, len(points), -(-len(points) // WINDING_POINTS))
        self.sources = self.points[chosen]
        self.area_normals = (area[chosen] * len(points) / len(chosen))[:, None] * self.normals[chosen]

    def thickness(self) -> float:
        """Thickness over width of the points' neighbourhoods, median: what noise adds to."""
        near = self.points[self.tree.query(self.points, k=min(SHAPE_NEIGHBOURS, len(self.points)))[1]]
        near = near - near.mean(axis=1, keepdims=True)
        spread = np.linalg.eigvalsh(np.einsum("nki,nkj->nij", near, near))
        thin, wide = np.sqrt(np.maximum(np.median(spread[:, :2], axis=0), 0.0))
        return float(thin / max(wide, 1e-300))

    def signed_distance(self, places: np.ndarray) -> np.ndarray:
        """Distance of places (K, 3) to the planes of the points around them, below 0 inside, shape (K,).

        The planes count by a Gaussian as wide as the points are away (Kolluri 2008, implicit moving least squares).
        Beyond the spacing from any point a plane may reach round a limb: there the winding number says which side.
        """
        distance, index = self.tree.query(places, k=list(range(1, self.neighbours + 1)))
        width = np.maximum(distance[:, [self.neighbours // 2]], 1e-12)
        weight = np.exp(-((distance / width) ** 2))
        height = np.einsum("kni,kni->kn", self.normals[index], places[:, None] - self.points[index])
        height = (weight * height).sum(axis=1) / weight.sum(axis=1)
        away = distance[:, 0] > self.spacing
        side = np.where(self._winding(places[away]) > 0.5, -1.0, 1.0)
        # Where the two disagree, neither is near: the surface must not pass here.
        height[away] = side * np.where(side * height[away] > 0, np.abs(height[away]), distance[away, 0])
        return height

    def _winding(self, places: np.ndarray) -> np.ndarray:
        import warp as wp

        from warpdef.kernels.winding import winding_numbers

        # In spacings about the middle: float32 then has digits to spare, whatever the units.
        centre, unit = self.sources.mean(axis=0), self.spacing
        sources, sides = (self.sources - centre) / unit, self.area_normals / unit**2
        found = wp.zeros(len(places), dtype=wp.float32, device="cpu")
        at = (places - centre) / unit
        winding_numbers(0, len(places), _vectors(sources), _vectors(sides), _vectors(at), found)
        return found.numpy()


def _vectors(array: np.ndarray) -> wp.array:
    import warp as wp

    return wp.array(np.ascontiguousarray(array, dtype=np.float32), dtype=wp.vec3, device="cpu")
