"""Points sorted into the cells of a box, for many groups at once: the grid under the nearest-neighbour search.

Every group of targets (a frame's cloud, a frame's vertices) is sorted into the cubic cells of one box, numbered
(z ny + y) nx + x, so that cells along x are neighbours in memory and a row of them is one run of points. A position
outside the box falls into the nearest border cell. How far the targets of a group have moved in all is kept on an
odometer, the sum over all builds of the largest move of one of them; in float64, lest small moves vanish in a long sum.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS, launch, require

wp.set_module_options(MODULE_OPTIONS)

_CELLS_PER_POINT = 8.0  # a surface fills few of a box's cells: some three points in each of those
_CELLS_MAX = 2**18


@wp.struct
class Cells:
    """The cells of a box.

    lower: corner of the box. size: edge of a cell. nx, ny, nz: cells an axis.
    """

    lower: wp.vec3
    size: float
    nx: int
    ny: int
    nz: int


@wp.func
def axis_cell(u: float, lower: float, size: float, count: int) -> int:
    """Cell along one axis; clamped outside the box; NaN falls into cell 0."""
    g = (u - lower) / size
    cell = int(0)
    if g > 0.0:
        cell = int(wp.min(g, float(count) - 0.5))
    return cell


@wp.func
def cell_of(p: wp.vec3, cells: Cells) -> int:
    x = axis_cell(p[0], cells.lower[0], cells.size, cells.nx)
    y = axis_cell(p[1], cells.lower[1], cells.size, cells.ny)
    return (axis_cell(p[2], cells.lower[2], cells.size, cells.nz) * cells.ny + y) * cells.nx + x


@wp.kernel
def _sort_group(
    # In:
    first_group: int,
    cells: Cells,
    points: wp.array(dtype=wp.vec3),
    offset: wp.array(dtype=wp.int32),
    # Scratch:
    cell: wp.array(dtype=wp.int32),
    # In and out: positions at the last build, and how far they have moved since the first
    last: wp.array(dtype=wp.vec3),
    odometer: wp.array(dtype=wp.float64),
    # Out:
    start_out: wp.array2d(dtype=wp.int32),
    order_out: wp.array(dtype=wp.int32),
    sorted_out: wp.array(dtype=wp.vec3),
):
    """One thread a group: a counting sort, stable, as one CPU core does it best."""
    g = first_group + wp.tid()
    count = cells.nx * cells.ny * cells.nz
    begin = offset[g]
    end = offset[g + 1]
    for c in range(count + 1):
        start_out[g, c] = 0
    farthest = float(0.0)
    for i in range(begin, end):
        p = points[i]
        farthest = wp.max(farthest, wp.length_sq(p - last[i]))
        last[i] = p
        c = cell_of(p, cells)
        cell[i] = c
        start_out[g, c] = start_out[g, c] + 1
    odometer[g] = odometer[g] + wp.float64(wp.sqrt(farthest))
    total = begin
    for c in range(count + 1):
        total = total + start_out[g, c]
        start_out[g, c] = total
    # Backwards from each cell's end keeps the order within a cell.
    for k in range(end - begin):
        i = end - 1 - k
        slot = start_out[g, cell[i]] - 1
        start_out[g, cell[i]] = slot
        order_out[slot] = i
        sorted_out[slot] = points[i]


@wp.kernel
def _measure_moves(
    points: wp.array(dtype=wp.vec3),
    group: wp.array(dtype=wp.int32),
    last: wp.array(dtype=wp.vec3),
    farthest: wp.array(dtype=wp.float32),
):
    """One thread a point."""
    i = wp.tid()
    wp.atomic_max(farthest, group[i], wp.length(points[i] - last[i]))
    last[i] = points[i]


@wp.kernel
def _turn_odometers(farthest: wp.array(dtype=wp.float32), odometer: wp.array(dtype=wp.float64)):
    """One thread a group."""
    g = wp.tid()
    odometer[g] = odometer[g] + wp.float64(farthest[g])
    farthest[g] = 0.0


@wp.kernel
def _clear_cells(start_out: wp.array(dtype=wp.int32)):
    start_out[wp.tid()] = 0


@wp.kernel
def _count_points(
    cells: Cells,
    points: wp.array(dtype=wp.vec3),
    group: wp.array(dtype=wp.int32),
    cell_out: wp.array(dtype=wp.int32),
    start_out: wp.array2d(dtype=wp.int32),
):
    """One thread a point."""
    i = wp.tid()
    c = cell_of(points[i], cells)
    cell_out[i] = c
    wp.atomic_add(start_out, group[i], c, 1)


@wp.kernel
def _place_points(
    points: wp.array(dtype=wp.vec3),
    group: wp.array(dtype=wp.int32),
    cell: wp.array(dtype=wp.int32),
    start_out: wp.array2d(dtype=wp.int32),
    order_out: wp.array(dtype=wp.int32),
    sorted_out: wp.array(dtype=wp.vec3),
):
    """One thread a point. The order within a cell is not fixed; the search does not depend on it."""
    i = wp.tid()
    slot = wp.atomic_sub(start_out, group[i], cell[i], 1) - 1
    order_out[slot] = i
    sorted_out[slot] = points[i]


def fit_cells(lower: np.ndarray, upper: np.ndarray, points_per_group: int) -> Cells:
    """Cells for a box, about eight a point of a group, at most 2^18; a flat box gets a few layers.

    Args:
        lower, upper: corners of the box, shape (3,).
    """
    widest = max(float((upper - lower).max()), 1e-6)
    extent = np.maximum(upper - lower, 0.02 * widest)
    wanted = min(max(_CELLS_PER_POINT * points_per_group, 8.0), _CELLS_MAX)
    size = float(np.cbrt(extent.prod() / wanted))
    count = np.maximum(np.floor(extent / size).astype(int), 1)
    cells = Cells()
    cells.size = max(float((extent / count).max()), 1e-9)
    cells.lower = wp.vec3(*(0.5 * (lower + upper - count * cells.size)))
    cells.nx, cells.ny, cells.nz = (int(c) for c in count)
    return cells


class PointGrid:
    """Targets of a search, grouped; ``build`` sorts them anew where they moved.

    Args:
        points: shape (N,) vec3, cube units, groups behind each other; read at every ``build``.
        sizes: points in each group, G integers that sum to N.
        box: lower and upper corner, (2, 3), where points are expected, which is a matter of speed alone; None: around
            the points as they are.
    """

    def __init__(self, points: wp.array, sizes: Sequence[int] | np.ndarray, box: np.ndarray | None = None) -> None:
        require(points, "points", wp.vec3, (int(np.sum(sizes)),))
        device = points.device
        self.points = points
        self.offset = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int32)
        if box is None:
            finite = points.numpy()[np.isfinite(points.numpy()).all(axis=1)].astype(float)
            box = np.stack([finite.min(axis=0), finite.max(axis=0)]) if len(finite) else np.zeros((2, 3))
        self.cells = fit_cells(box[0], box[1], int(np.max(sizes)))
        cell_count = self.cells.nx * self.cells.ny * self.cells.nz
        self.odometer = wp.zeros(len(sizes), dtype=wp.float64, device=device)
        self.start = wp.zeros((len(sizes), cell_count + 1), dtype=wp.int32, device=device)
        self.order = wp.zeros(len(points), dtype=wp.int32, device=device)
        self.sorted = wp.clone(points)
        group = np.repeat(np.arange(len(sizes), dtype=np.int32), sizes)
        self._group = wp.array(group, dtype=wp.int32, device=device)
        self._offset = wp.array(self.offset, dtype=wp.int32, device=device)
        self._cell = wp.zeros(len(points), dtype=wp.int32, device=device)
        self._last = wp.clone(points)
        self._farthest = wp.zeros(len(sizes), dtype=wp.float32, device=device)

    def build(self, first: int = 0, last: int | None = None) -> None:
        """Sort the points of groups ``first .. last`` (last excluded; None: all) into their cells.

        On CUDA all groups are always sorted: spans are a matter of CPU threads.
        """
        device = self.points.device
        if not device.is_cpu:
            self.build_in_parallel()
            return
        count = (len(self.offset) - 1 if last is None else last) - first
        moved = [self._cell, self._last, self.odometer]
        targets = [self.start, self.order, self.sorted]
        launch(_sort_group, count, [first, self.cells, self.points, self._offset, *moved, *targets], device)

    def build_in_parallel(self) -> None:
        """The same for all groups, one thread a point: what CUDA runs."""
        device, count = self.points.device, len(self.points)
        launch(_measure_moves, count, [self.points, self._group, self._last, self._farthest], device)
        launch(_turn_odometers, len(self._farthest), [self._farthest, self.odometer], device)
        flat = self.start.flatten()
        launch(_clear_cells, len(flat), [flat], device)
        launch(_count_points, count, [self.cells, self.points, self._group, self._cell, self.start], device)
        wp.utils.array_scan(flat, flat, inclusive=True)
        placing = [self.points, self._group, self._cell, self.start, self.order, self.sorted]
        launch(_place_points, count, placing, device)
