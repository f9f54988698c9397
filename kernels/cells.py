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

from warpdef.kernels.blocks import block_max, block_options, lane, lanes, sum_before, wait
from warpdef.kernels.launching import MODULE_OPTIONS, launch
from warpdef.kernels.sizes import require, sizes
from warpdef.kernels.ways import Way, lanes_of, way_of

wp.set_module_options(MODULE_OPTIONS)

# A surface fills few of a box's cells: some six points in each of those on the CPU, which searches for many queries at
# once, and three on CUDA, where every query searches on its own.
_CELLS_PER_POINT = {Way.SPANS: 3.0, Way.WHOLE: 8.0}
CELLS_MAX = 2**18
"""Cells of a search grid, a frame."""
RUN = wp.constant(8)


@sizes("nx: X; ny: Y; nz: Z")
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


@sizes("points order sorted_points: N; start: G X*Y*Z+1; odometer: G")
@wp.struct
class Targets:
    """What a search reads of a ``PointGrid``, which fills it.

    cells: of the box. points: shape (N,). start: first slot of each cell of a group, shape (G, cells + 1). order,
    sorted_points: index and place of the point in each slot, shape (N,). odometer: shape (G,).
    """

    cells: Cells
    points: wp.array[wp.vec3]
    start: wp.array2d[wp.int32]
    order: wp.array[wp.int32]
    sorted_points: wp.array[wp.vec3]
    odometer: wp.array[wp.float64]


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


@wp.func
def first_candidate(q: wp.vec3, group: int, targets: Targets) -> int:
    """Slot of some point in the nearest ring of cells that has one; -1 if the group is empty."""
    cells = targets.cells
    cx = axis_cell(q[0], cells.lower[0], cells.size, cells.nx)
    cy = axis_cell(q[1], cells.lower[1], cells.size, cells.ny)
    cz = axis_cell(q[2], cells.lower[2], cells.size, cells.nz)
    found = int(-1)
    ring = int(0)
    while found < 0 and ring < wp.max(cells.nx, wp.max(cells.ny, cells.nz)):
        x0 = wp.max(cx - ring, 0)
        x1 = wp.min(cx + ring, cells.nx - 1)
        for z in range(wp.max(cz - ring, 0), wp.min(cz + ring, cells.nz - 1) + 1):
            for y in range(wp.max(cy - ring, 0), wp.min(cy + ring, cells.ny - 1) + 1):
                row = (z * cells.ny + y) * cells.nx
                if targets.start[group, row + x1 + 1] > targets.start[group, row + x0]:
                    found = targets.start[group, row + x0]
        ring = ring + 1
    return found


# A counting sort, stable, as one CPU core does it best; and the largest squared move since the last build.
_SORT_GROUP = """
#if !defined(__CUDA_ARCH__)
    const int nx = cells.nx, ny = cells.ny, nz = cells.nz, count = nx * ny * nz;
    const float lx = cells.lower[0], ly = cells.lower[1], lz = cells.lower[2], inverse = 1.0f / cells.size;
    const float tx = (float)nx - 0.5f, ty = (float)ny - 0.5f, tz = (float)nz - 0.5f;
    const float* const p = (const float*)points.data;
    float* const before = (float*)last.data;
    int* const of = cell.data;
    int* const end_of = start_out.data + (size_t)group * start_out.shape[1];
    __builtin_memset(end_of, 0, sizeof(int) * (count + 1));
    float farthest = 0.0f;
    for (int i = begin; i < end; ++i) {
        const float x = p[3 * i], y = p[3 * i + 1], z = p[3 * i + 2];
        const float dx = x - before[3 * i], dy = y - before[3 * i + 1], dz = z - before[3 * i + 2];
        const float moved = dx * dx + dy * dy + dz * dz;
        // A move that is no number: no bound holds any more.
        farthest = !(moved < 3.0e38f) ? INFINITY : (moved > farthest ? moved : farthest);
        before[3 * i] = x; before[3 * i + 1] = y; before[3 * i + 2] = z;
        // A comparison that NaN fails sends NaN to the corner.
        const float gx = (x - lx) * inverse, gy = (y - ly) * inverse, gz = (z - lz) * inverse;
        const int cx = (int)(gx > 0.0f ? (gx < tx ? gx : tx) : 0.0f);
        const int cy = (int)(gy > 0.0f ? (gy < ty ? gy : ty) : 0.0f);
        const int cz = (int)(gz > 0.0f ? (gz < tz ? gz : tz) : 0.0f);
        of[i] = (cz * ny + cy) * nx + cx;
    }
    for (int i = begin; i < end; ++i) ++end_of[of[i]];
    int total = begin;
    for (int c = 0; c <= count; ++c) end_of[c] = total += end_of[c];
    // Backwards from each cell's end keeps the order within a cell, and leaves where it begins.
    float* const sorted = (float*)sorted_out.data;
    for (int i = end - 1; i >= begin; --i) {
        const int slot = --end_of[of[i]];
        order_out.data[slot] = i;
        sorted[3 * slot] = p[3 * i]; sorted[3 * slot + 1] = p[3 * i + 1]; sorted[3 * slot + 2] = p[3 * i + 2];
    }
    odometer.data[group] += (double)sqrtf(farthest);
#endif
"""


@wp.func_native(_SORT_GROUP)
def sort_group(
    group: int,
    begin: int,
    end: int,
    cells: Cells,
    points: wp.array[wp.vec3],
    cell: wp.array[wp.int32],
    last: wp.array[wp.vec3],
    odometer: wp.array[wp.float64],
    start_out: wp.array2d[wp.int32],
    order_out: wp.array[wp.int32],
    sorted_out: wp.array[wp.vec3],
): ...


@sizes("threads odometer: G; points cell last order_out sorted_out: N; offset: G+1; start_out: G X*Y*Z+1")
@wp.kernel
def _sort_groups(
    # In:
    begin: int,
    cells: Cells,
    points: wp.array[wp.vec3],
    offset: wp.array[wp.int32],
    # In and out: scratch
    cell: wp.array[wp.int32],
    # In and out: positions at the last build, and how far they have moved since the first
    last: wp.array[wp.vec3],
    odometer: wp.array[wp.float64],
    # Out:
    start_out: wp.array2d[wp.int32],
    order_out: wp.array[wp.int32],
    sorted_out: wp.array[wp.vec3],
):
    """CPU: one thread a group."""
    g = begin + wp.tid()
    sort_group(g, offset[g], offset[g + 1], cells, points, cell, last, odometer, start_out, order_out, sorted_out)


@sizes("threads odometer: G; points cell last order_out sorted_out: N; offset: G+1; start_out: G X*Y*Z+1")
@wp.kernel(**block_options())
def _sort_groups_in_blocks(
    # In:
    begin: int,
    cells: Cells,
    points: wp.array[wp.vec3],
    offset: wp.array[wp.int32],
    # In and out: scratch
    cell: wp.array[wp.int32],
    # In and out: positions at the last build, and how far they have moved since the first
    last: wp.array[wp.vec3],
    odometer: wp.array[wp.float64],
    # Out:
    start_out: wp.array2d[wp.int32],
    order_out: wp.array[wp.int32],
    sorted_out: wp.array[wp.vec3],
):
    """One block a group: count, add up, place. The order within a cell is not fixed; no search depends on it."""
    g = begin + wp.tid() // lanes()
    lowest = offset[g]
    end = offset[g + 1]
    farthest = float(0.0)
    for i in range(lowest + lane(), end, lanes()):
        moved = wp.length(points[i] - last[i])
        if not moved < 3.0e38:
            moved = wp.inf  # a move that is no number: no bound holds any more
        farthest = wp.max(farthest, moved)
        last[i] = points[i]
    farthest = block_max(farthest)
    if lane() == 0:
        odometer[g] = odometer[g] + wp.float64(farthest)
    count = start_out.shape[1]
    for c in range(lane(), count, lanes()):
        start_out[g, c] = 0
    wait()
    for i in range(lowest + lane(), end, lanes()):
        c = cell_of(points[i], cells)
        cell[i] = c
        wp.atomic_add(start_out, g, c, 1)
    wait()
    # Where each cell ends: eight in a row a lane, which is what memory gives at a time, then all lanes further on.
    total = lowest
    for run in range(0, count, RUN * lanes()):
        first = wp.min(run + RUN * lane(), count)
        after = wp.min(first + RUN, count)
        mine = int(0)
        for c in range(first, after):
            mine = mine + start_out[g, c]
        sums = sum_before(mine)
        end_of = total + sums[0]
        for c in range(first, after):
            end_of = end_of + start_out[g, c]
            start_out[g, c] = end_of
        total = total + sums[1]
    wait()
    # From each cell's end downwards, which leaves where it begins.
    for i in range(lowest + lane(), end, lanes()):
        slot = wp.atomic_sub(start_out, g, cell[i], 1) - 1
        order_out[slot] = i
        sorted_out[slot] = points[i]


def fit_cells(lower: np.ndarray, upper: np.ndarray, wanted: float) -> Cells:
    """Cubic cells for a box, about as many as wanted, but 8 to 2^18; a flat box gets a few layers.

    Args:
        lower, upper: corners of the box, shape (3,).
    """
    widest = max(float((upper - lower).max()), 1e-6)
    extent = np.maximum(upper - lower, 0.02 * widest)
    wanted = min(max(wanted, 8.0), CELLS_MAX)
    size = float(np.cbrt(extent.prod() / wanted))
    count = np.maximum(np.floor(extent / size).astype(int), 1)
    cells = Cells()
    cells.size = max(float((extent / count).max()), 1e-9)
    cells.lower = wp.vec3(*(0.5 * (lower + upper - count * cells.size)))
    cells.nx, cells.ny, cells.nz = (int(c) for c in count)
    return cells


def box_around(places: np.ndarray) -> np.ndarray:
    """Lower and upper corner (2, 3) of those places (N, 3) that are finite; zeros if none is."""
    finite = places[np.isfinite(places).all(axis=1)].astype(float)
    return np.stack([finite.min(axis=0), finite.max(axis=0)]) if len(finite) else np.zeros((2, 3))


class PointGrid:
    """Targets of a search, grouped; ``build`` sorts them anew where they moved.

    Args:
        points: shape (N,) vec3, cube units, groups behind each other; read at every ``build``.
        sizes: points in each group, G integers that sum to N.
        box: lower and upper corner, (2, 3), where points are expected, which is a matter of speed alone; None: around
            the points as they are, which waits for the device.
    """

    def __init__(self, points: wp.array, sizes: Sequence[int] | np.ndarray, box: np.ndarray | None = None) -> None:
        require(points, "points", wp.vec3, (int(np.sum(sizes)),))
        device = points.device
        self.points = points
        self.offset = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int32)
        if box is None:
            box = box_around(points.numpy())
        self._way = way_of(device)
        per_point = _CELLS_PER_POINT[self._way]
        self.cells = fit_cells(box[0], box[1], per_point * int(np.max(sizes)))
        cell_count = self.cells.nx * self.cells.ny * self.cells.nz
        self.odometer = wp.zeros(len(sizes), dtype=wp.float64, device=device)
        self.start = wp.zeros((len(sizes), cell_count + 1), dtype=wp.int32, device=device)
        self.order = wp.zeros(len(points), dtype=wp.int32, device=device)
        self.sorted = wp.clone(points)
        self.targets = Targets()
        self.targets.cells, self.targets.odometer = self.cells, self.odometer
        self.targets.points, self.targets.sorted_points = points, self.sorted
        self.targets.start, self.targets.order = self.start, self.order
        self._offset = wp.array(self.offset, dtype=wp.int32, device=device)
        self._cell = wp.zeros(len(points), dtype=wp.int32, device=device)
        self._last = wp.clone(points)
        self._lanes = lanes_of(device)

    def forget(self) -> None:
        """Begin to measure moves anew; searches must forget, too."""
        self.odometer.zero_()

    def build(self, first: int = 0, last: int | None = None) -> None:
        """Sort the points of groups ``first .. last`` (last excluded; None: all) into their cells."""
        if self._way is Way.WHOLE:
            self.build_in_blocks(first, last)
            return
        self._launch(_sort_groups, first, last)

    def build_in_blocks(self, first: int = 0, last: int | None = None) -> None:
        """The same, a block a group: what CUDA runs."""
        self._launch(_sort_groups_in_blocks, first, last, self._lanes)

    def _launch(self, kernel: wp.Kernel, first: int, last: int | None, lanes: int = 0) -> None:
        count = (len(self.offset) - 1 if last is None else last) - first
        moved = [self._cell, self._last, self.odometer]
        targets = [self.start, self.order, self.sorted]
        inputs = [first, self.cells, self.points, self._offset, *moved, *targets]
        launch(kernel, count, inputs, self.points.device, lanes)
