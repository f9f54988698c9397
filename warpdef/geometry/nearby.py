"""The neighbours that a cloud's points have in it, and the planes through them: on a device (``kernels.nearby``), or by
SciPy and NumPy where Warp is not to be started.

Places on a device are single precision, about the middle of most points, so that what lies far off costs itself its
digits, not the rest. A grid of cells suits a cloud that fills it evenly. Where many points share a cell, as when two
small bodies stand far apart, a k-d tree answers, on the host.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import warp as wp

_CROWDED = 400  # points in the cell of a point, on average, from which a tree is faster
_BOX = 0.02  # share of the points that may lie outside of the grid's box at each end of an axis


class Fellows:
    """The nearest fellows of a cloud's points, in order, the point itself first.

    Args:
        points: shape (N, 3), any units; float32 ones are taken as they are.
        count: of neighbours, the point itself among them; at most N are found. A tree answers beyond 64.
        every: only of each so manieth point.
        device: where to search; None: on the host, without Warp.
        asked: only of these points, (Q,), on the host; None: of all.

    index: of the K neighbours of each of Q points, shape (Q, K).
    distance: to each of them, shape (Q, K) float64, the points' unit.
    """

    def __init__(
        self,
        points: np.ndarray,
        count: int,
        every: int = 1,
        device: wp.Device | None = None,
        asked: np.ndarray | None = None,
    ) -> None:
        if device is not None and asked is not None:
            raise ValueError(f"asked: expected None on a device, got {len(asked)} points")
        self._points, self._every, self._device, self._asked = points, every, device, asked
        self._count = min(count, len(points))
        self.index, self.distance = self._by_tree(points) if device is None else self._on_device(device)

    def planes(self) -> tuple[np.ndarray, np.ndarray]:
        """Normals (Q, 3) of the planes through them, unit length, of either side; and the sums of squares along the
        principal axes (Q, 3), ascending, the square of the points' unit."""
        if self._device is None:
            near = self._points[self.index].astype(np.float64)
            near -= near.mean(axis=1, keepdims=True)
            variance, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", near, near))
            return axes[:, :, 0], np.maximum(variance, 0.0)
        import warp as wp

        from warpdef.kernels.nearby import local_planes

        number = len(self.index)
        index = wp.array(self.index.astype(np.int32), dtype=wp.int32, ndim=2, device=self._device)
        normal, variance = (wp.zeros(number, dtype=wp.vec3, device=self._device) for _ in range(2))
        local_planes(0, number, self._places, index, normal, variance)
        return normal.numpy().astype(np.float64), variance.numpy().astype(np.float64) * self._scale**2

    @cached_property
    def _scale(self) -> float:
        if self._points.dtype == np.float32:
            return 1.0
        return float(np.abs(self._points - self._middle).max()) or 1.0

    @cached_property
    def _middle(self) -> np.ndarray:
        return np.median(self._points, axis=0)

    @cached_property
    def _places(self) -> wp.array:
        """Of all points, on the device."""
        import warp as wp

        places = self._points
        if places.dtype != np.float32:
            places = ((places - self._middle) / self._scale).astype(np.float32)
        return wp.array(np.ascontiguousarray(places), dtype=wp.vec3, device=self._device)

    def _on_device(self, device: wp.Device) -> tuple[np.ndarray, np.ndarray]:
        import warp as wp

        from warpdef.device import on_host
        from warpdef.kernels.cells import PointGrid
        from warpdef.kernels.nearby import NEARBY_MAX, NearbySearch

        places = on_host(self._places)
        box = np.quantile(places, [_BOX, 1.0 - _BOX], axis=0).astype(np.float64)
        edge = 0.1 * (box[1] - box[0])
        grid = PointGrid(self._places, [len(places)], np.stack([box[0] - edge, box[1] + edge]))
        grid.build()
        cells = np.diff(on_host(grid.start)[0]).astype(np.float64)
        if self._count > NEARBY_MAX or (cells**2).sum() > _CROWDED * len(places):
            return self._by_tree(self._points)
        # Those of a cell one after the other: they look at the same cells.
        order = on_host(grid.order)
        order = order[order % self._every == 0]
        asked = wp.array(places[order], dtype=wp.vec3, device=device)
        search = NearbySearch(grid, asked, wp.zeros(len(asked), dtype=wp.int32, device=device), self._count)
        search.run()
        shape = len(asked), self._count
        index, distance = np.empty(shape, dtype=np.int32), np.empty(shape)
        index[order // self._every] = on_host(search.index)
        distance[order // self._every] = self._scale * on_host(search.distance).astype(np.float64)
        return index, distance

    def _by_tree(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        from scipy.spatial import cKDTree

        places = points[:: self._every] if self._asked is None else points[self._asked]
        distance, index = cKDTree(points).query(places, k=np.arange(1, self._count + 1))
        return index, distance


class Nearest:
    """The nearest of some targets, asked for as often as one likes.

    Args:
        targets: shape (N, 3), N above 0, about the size of the cube; single precision on a device.
        device: where to search; None: on the host, without Warp.
    """

    def __init__(self, targets: np.ndarray, device: wp.Device | None) -> None:
        self._targets, self._device = targets, device
        if device is None:
            from scipy.spatial import cKDTree

            self._tree = cKDTree(targets)
            return
        from warpdef.kernels.cells import PointGrid, box_around

        single = np.asarray(targets, dtype=np.float32)
        self._grid = PointGrid(_uploaded(single, device), [len(targets)], box_around(single))
        self._grid.build()

    def query(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances (M,) float64 from places (M, 3) to the nearest targets, and these, (M,)."""
        if self._device is None:
            return self._tree.query(places)
        import warp as wp

        from warpdef.device import on_host
        from warpdef.kernels.neighbours import NearestSearch

        group = wp.zeros(len(places), dtype=wp.int32, device=self._device)
        search = NearestSearch(self._grid, _uploaded(places, self._device), group)
        search.run()
        index = on_host(search.index)
        return np.linalg.norm(places - self._targets[index], axis=1), index


def _uploaded(places: np.ndarray, device: wp.Device) -> wp.array:
    import warp as wp

    return wp.array(np.ascontiguousarray(places, dtype=np.float32), dtype=wp.vec3, device=device)
