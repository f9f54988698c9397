"""Exact nearest neighbours in a hash grid, for many clouds at once; no gradient (paper, argmin of CD_R).

Every group of targets (a frame's cloud, a frame's vertices) is sorted into the cubic cells of one box, numbered
(z ny + y) nx + x, so that cells along x are neighbours in memory and a row of them is one run of points. A position
outside the box falls into the nearest border cell; since clamping to a box never lengthens a distance, all bounds
below hold for it too, and the answer is exact at any distance. Ties go to the lowest index.

A search starts from a candidate (the last answer, or the first point found in growing rings) and looks only at the
cells that the ball through it touches, shrinking the ball as better points turn up. It also learns how near any other
target can be. As long as query and targets have moved less than that allows, the next search of that query is one
comparison: exact, and most of the work once a descent settles. How far the targets of a group have moved in all is
kept on an odometer, the sum over all builds of the largest move of one of them; in float64, lest small moves vanish
in a long sum.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS, launch, require

wp.set_module_options(MODULE_OPTIONS)

# Rounding may put a point just outside a ball drawn with exact arithmetic: search a hair wider.
_WIDEN = wp.constant(1.0001)
# Error of a float32 distance between points in the cube, and of a float32 move per unit travelled.
_ROUNDING = wp.constant(2.0e-6)
_MARGIN_IN_CELLS = 0.15
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


@wp.func
def first_candidate(q: wp.vec3, group: int, cells: Cells, start: wp.array2d(dtype=wp.int32)) -> int:
    """Slot of some point in the nearest ring of cells that has one; -1 if the group is empty."""
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
                if start[group, row + x1 + 1] > start[group, row + x0]:
                    found = start[group, row + x0]
        ring = ring + 1
    return found


# The ball around query q through a first candidate and `margin` beyond, row of cells by row of cells. Writes the
# nearest target (ties: lowest index) and a distance that no other target undercuts. Plain C, for CPU and CUDA alike:
# Warp's own loops are half as fast here.
_SEARCH_BALL = """
    const float qx = q[0], qy = q[1], qz = q[2];
    const float size = cells.size, inverse = 1.0f / size;
    const int nx = cells.nx, ny = cells.ny, nz = cells.nz;
    const int* const begin = start.data + (size_t)group * start.shape[1];
    const wp::vec3* const target = sorted_points.data;
    int best = candidate;
    const wp::vec3 c = points.data[candidate];
    float dx = c[0] - qx, dy = c[1] - qy, dz = c[2] - qz;
    float best_sq = dx * dx + dy * dy + dz * dz, other_sq = 3.0e38f;
    float reach = (sqrtf(best_sq) + margin) * WIDEN, reach_sq = reach * reach;
    // In cells from the lower corner, clamped into the box, whose border cells hold what lies outside. A comparison
    // that NaN fails sends NaN to the corner.
    const float gx = (qx - cells.lower[0]) * inverse, gy = (qy - cells.lower[1]) * inverse;
    const float gz = (qz - cells.lower[2]) * inverse;
    const float ux = gx > 0.0f ? (gx < (float)nx ? gx : (float)nx) : 0.0f;
    const float uy = gy > 0.0f ? (gy < (float)ny ? gy : (float)ny) : 0.0f;
    const float uz = gz > 0.0f ? (gz < (float)nz ? gz : (float)nz) : 0.0f;
    const float r = (reach < 1.0e9f * size ? reach * inverse : 1.0e9f) + 1.0e-3f;
    #define FIRST(u) ((u) - r > 0.0f ? (int)((u) - r) : 0)
    #define LAST(u, n) ((u) + r < (float)(n) - 0.5f ? (int)((u) + r) : (n) - 1)
    const int y0 = FIRST(uy), y1 = LAST(uy, ny), z1 = LAST(uz, nz);
    for (int z = FIRST(uz); z <= z1; ++z) {
        const float az = (float)z - uz, bz = az > 0.0f ? az : (az < -1.0f ? -1.0f - az : 0.0f);
        const float gap_z = bz * size;
        for (int y = y0; y <= y1; ++y) {
            const float ay = (float)y - uy, by = ay > 0.0f ? ay : (ay < -1.0f ? -1.0f - ay : 0.0f);
            const float gap_y = by * size;
            const float room = reach_sq - gap_z * gap_z - gap_y * gap_y;
            if (!(room >= 0.0f)) continue;
            const float span = sqrtf(room) * inverse + 1.0e-3f;
            const float left = ux - span, right = ux + span;
            const int row = (z * ny + y) * nx;
            const int x0 = left > 0.0f ? (int)left : 0;
            const int x1 = right < (float)nx - 0.5f ? (int)right : nx - 1;
            const int last = begin[row + x1 + 1];
            for (int slot = begin[row + x0]; slot < last; ++slot) {
                const wp::vec3 p = target[slot];
                dx = p[0] - qx; dy = p[1] - qy; dz = p[2] - qz;
                const float d_sq = dx * dx + dy * dy + dz * dz;
                if (d_sq <= other_sq) {
                    const int found = order.data[slot];
                    if (d_sq < best_sq) {
                        other_sq = best_sq; best_sq = d_sq; best = found;
                        reach = (sqrtf(best_sq) + margin) * WIDEN; reach_sq = reach * reach;
                    } else if (found != best) {
                        other_sq = d_sq;
                        if (d_sq == best_sq && found < best) best = found;
                    }
                }
            }
        }
    }
    #undef FIRST
    #undef LAST
    const float nearest = sqrtf(best_sq), other = sqrtf(other_sq);
    index_out.data[query] = best;
    bound_out.data[query] = other < nearest + margin ? other : nearest + margin;
""".replace("WIDEN", "1.0001f")


@wp.func_native(_SEARCH_BALL)
def search_ball(
    query: int,
    q: wp.vec3,
    group: int,
    candidate: int,
    margin: float,
    cells: Cells,
    points: wp.array(dtype=wp.vec3),
    start: wp.array2d(dtype=wp.int32),
    order: wp.array(dtype=wp.int32),
    sorted_points: wp.array(dtype=wp.vec3),
    index_out: wp.array(dtype=wp.int32),
    bound_out: wp.array(dtype=wp.float32),
): ...


@wp.kernel
def _nearest(
    # In:
    begin: int,
    queries: wp.array(dtype=wp.vec3),
    query_group: wp.array(dtype=wp.int32),
    cells: Cells,
    points: wp.array(dtype=wp.vec3),
    start: wp.array2d(dtype=wp.int32),
    order: wp.array(dtype=wp.int32),
    sorted_points: wp.array(dtype=wp.vec3),
    odometer: wp.array(dtype=wp.float64),
    margin: float,
    # In and out: what is known from the last search of a query
    anchor: wp.array(dtype=wp.vec3),
    reading: wp.array(dtype=wp.float64),
    bound: wp.array(dtype=wp.float32),
    # In as the last answer or -1; out:
    index_out: wp.array(dtype=wp.int32),
):
    """One thread a query; a negative group asks nothing and answers -1."""
    i = begin + wp.tid()
    group = query_group[i]
    if group < 0:
        index_out[i] = -1
        return
    q = queries[i]
    best = index_out[i]
    if best >= 0:
        # Nothing can have come nearer than the bound, less how far the query and any target have moved since.
        travelled = float(odometer[group] - reading[i])
        drift = wp.length(q - anchor[i]) + travelled
        known = bound[i] - _WIDEN * drift - _ROUNDING * (1.0 + travelled)
        if wp.length(points[best] - q) < known:
            return
    else:
        slot = first_candidate(q, group, cells, start)
        if slot < 0:
            return
        best = order[slot]
    search_ball(i, q, group, best, margin, cells, points, start, order, sorted_points, index_out, bound)
    anchor[i] = q
    reading[i] = odometer[group]


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


class NearestSearch:
    """The nearest target of every query, asked again and again while both move.

    Args:
        grid: the targets. queries: shape (Q,) vec3, cube units, read at every ``run``.
        query_group: shape (Q,) int32, the group a query asks; negative: it asks nothing and the answer is -1.

    ``index``, shape (Q,) int32, holds the answers, counted over all groups; -1 for none.
    """

    def __init__(self, grid: PointGrid, queries: wp.array, query_group: wp.array) -> None:
        require(queries, "queries", wp.vec3, (None,))
        require(query_group, "query_group", wp.int32, (len(queries),))
        device, count = queries.device, len(queries)
        self.index = wp.full(count, -1, dtype=wp.int32, device=device)
        self._grid, self._queries, self._group = grid, queries, query_group
        self._margin = _MARGIN_IN_CELLS * grid.cells.size
        self._anchor = wp.zeros(count, dtype=wp.vec3, device=device)
        self._bound = wp.zeros(count, dtype=wp.float32, device=device)
        self._reading = wp.zeros(count, dtype=wp.float64, device=device)

    def run(self, begin: int = 0, count: int | None = None) -> None:
        """Answer queries ``begin .. begin + count`` (None: all) for the grid as last built."""
        g = self._grid
        targets = [g.cells, g.points, g.start, g.order, g.sorted, g.odometer, self._margin]
        known = [self._anchor, self._reading, self._bound]
        count = len(self.index) - begin if count is None else count
        inputs = [begin, self._queries, self._group, *targets, *known, self.index]
        launch(_nearest, count, inputs, self._queries.device)
