"""How well a cloud supports a surface, place by place: 1 on the sampled surface, 1/2 on its border, 0 beyond.

    f(x) = sum_i a_i max(0, n(x) . n_i) g(|x - p_i| / s_i) / median

with a_i the area that point i stands for, s_i its bandwidth in units of sqrt(a_i), and g a Gaussian. On a straight
border a Gaussian has half its weight on either side, whatever the density: the contour f = 1/2 is the border without
bias, where a mere distance to the nearest point would leave a rim or eat one. The facing of the normals keeps a sheet
that passes close behind the points (the lining of a balloon) from being taken for the sampled one.

NumPy and SciPy only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warpdef.geometry.coverage import point_areas

BANDWIDTH = 1.5  # standard deviation of the Gaussian, in sqrt(area of a point)
SUM_NEIGHBOURS = 48  # hold more than the Gaussian reaches
BORDER_NEIGHBOURS = 24
BORDER_GAP = 2.1  # radians without a neighbour, seen from a border point; 120 degrees
BORDER_SHIFT = 0.3  # of the neighbourhood's radius; the centroid of half a disc lies at 0.42


@dataclass(frozen=True)
class Support:
    """The function f of one cloud.

    points, normals: shape (N, 3), consistently oriented
    area:            shape (N,), ``point_areas``
    scale:           the median of the sum on the points, to which f is relative
    """

    points: np.ndarray
    normals: np.ndarray
    area: np.ndarray
    scale: float

    @classmethod
    def of(cls, points: np.ndarray, normals: np.ndarray) -> Support:
        """For points (N, 3) with unit normals (N, 3) whose side is consistent."""
        raw = cls(points, normals, point_areas(points), 1.0)
        return cls(points, normals, raw.area, float(max(np.median(raw.at(points, normals)), 1e-300)))

    def at(self, places: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """f at places (M, 3) of a surface with unit normals (M, 3), shape (M,)."""
        distance, index = self._nearest(places, SUM_NEIGHBOURS)
        facing = np.maximum(np.einsum("mi,mki->mk", normals, self.normals[index]), 0.0)
        spread = BANDWIDTH**2 * self.area[index]
        weight = np.exp(-0.5 * distance**2 / spread) / (2.0 * np.pi * BANDWIDTH**2)
        return (weight * facing).sum(axis=1) / self.scale

    def local_area(self, places: np.ndarray) -> np.ndarray:
        """The area of a point near each place (M, 3), shape (M,)."""
        return self.area[self._nearest(places, 1)[1][:, 0]]

    def distance(self, places: np.ndarray) -> np.ndarray:
        """From each place (M, 3) to the nearest point, in sqrt(that point's area), shape (M,)."""
        distance, index = self._nearest(places, 1)
        return distance[:, 0] / np.sqrt(self.area[index[:, 0]])

    def _nearest(self, places: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
        from scipy.spatial import cKDTree

        return cKDTree(self.points).query(places, k=np.arange(1, min(count, len(self.points)) + 1))


def border_points(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Which points lie on a border of the sampled surface, shape (N,) bool.

    Seen from a border point, in the plane of its normal, the neighbours leave an angle free and their centroid is far
    off. Where limbs are thinner than the neighbourhood that happens too: compare clouds, do not trust the number.

    Args:
        points: shape (N, 3).
        normals: shape (N, 3), unit length; their side does not matter.
    """
    from scipy.spatial import cKDTree

    count = min(BORDER_NEIGHBOURS, len(points) - 1)
    index = cKDTree(points).query(points, k=count + 1)[1][:, 1:]
    step = points[index] - points[:, None]
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
