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

    def normals_near(self, places: np.ndarray, count: int) -> np.ndarray:
        """The mean normal of so many points nearest to each place (M, 3), shape (M, 3), not of unit length."""
        return self.normals[self._nearest(places, count)[1]].mean(axis=1)

    def distance(self, places: np.ndarray) -> np.ndarray:
        """From each place (M, 3) to the nearest point, in sqrt(that point's area), shape (M,)."""
        distance, index = self._nearest(places, 1)
        return distance[:, 0] / np.sqrt(self.area[index[:, 0]])

    def _nearest(self, places: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
        from scipy.spatial import cKDTree

        return cKDTree(self.points).query(places, k=np.arange(1, min(count, len(self.points)) + 1))
