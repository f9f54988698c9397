"""Exact nearest neighbours in a hash grid, for many clouds at once; no gradient (paper, argmin of CD_R).

Every group of targets (a frame's cloud, a frame's vertices) is sorted into R^3 cells over [-1, 1]^3, a cell being
(z R + y) R + x, so that cells along x are neighbours in memory and a row of them is one run of points. A position
outside the cube falls into the nearest border cell; since clamping to a box never lengthens a distance, all bounds
below hold for it too, and the answer is exact at any distance. Ties go to the lowest index.

A search starts from a candidate (the last answer, or the first point found in growing rings) and looks only at the
cells that the ball through it touches, shrinking the ball as better points turn up. It also learns how near any other
target can be. As long as query and targets have moved less than that allows, the next search of that query is one
comparison: exact, and most of the work once a descent settles. How far the targets of a group have moved in all is
kept on an odometer, the sum over all builds of the largest move of one of them; in float64, lest small moves vanish
in a long sum.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS, launch, require

wp.set_module_options(MODULE_OPTIONS)

# Rounding may put a point just outside a ball drawn with exact arithmetic: search a hair wider.
_WIDEN = wp.constant(1.0001)
# Error of a float32 distance between points in the cube, and of a float32 move per unit travelled.
_ROUNDING = wp.constant(2.0e-6)
_POINTS_PER_CELL = 6.0
_RESOLUTION_MAX = 64
_MARGIN_IN_CELLS = 0.1


@wp.func
def axis_cell(u: float, resolution: int) -> int:
    """Cell along one axis of a coordinate in [-1, 1]; clamped outside; NaN falls into cell 0."""
    g = (u + 1.0) * 0.5 * float(resolution)
    cell = int(0)
    if g > 0.0:
        cell = wp.min(int(wp.min(g, float(resolution))), resolution - 1)
    return cell


@wp.func
def cell_of(p: wp.vec3, resolution: int) -> int:
    x = axis_cell(p[0], resolution)
    y = axis_cell(p[1], resolution)
    return (axis_cell(p[2], resolution) * resolution + y) * resolution + x


@wp.kernel
def _sort_group(
    # In:
    first_group: int,
    resolution: int,
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
    cells = resolution * resolution * resolution
    begin = offset[g]
    end = offset[g + 1]
    for c in range(cells + 1):
        start_out[g, c] = 0
    farthest = float(0.0)
    for i in range(begin, end):
        p = points[i]
        farthest = wp.max(farthest, wp.length_sq(p - last[i]))
        last[i] = p
        c = cell_of(p, resolution)
        cell[i] = c
        start_out[g, c] = start_out[g, c] + 1
    odometer[g] = odometer[g] + wp.float64(wp.sqrt(farthest))
    total = begin
    for c in range(cells + 1):
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
    resolution: int,
    points: wp.array(dtype=wp.vec3),
    group: wp.array(dtype=wp.int32),
    cell_out: wp.array(dtype=wp.int32),
    start_out: wp.array2d(dtype=wp.int32),
):
    """One thread a point."""
    i = wp.tid()
    c = cell_of(points[i], resolution)
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
def gap(u: float, cell: int, resolution: int) -> float:
    """Distance along one axis from u (clamped into the cube) to a cell; 0 inside."""
    size = 2.0 / float(resolution)
    low = float(cell) * size - 1.0
    return wp.max(wp.max(low - u, u - low - size), 0.0)


@wp.func
def first_candidate(
    q: wp.vec3,
    group: int,
    resolution: int,
    start: wp.array2d(dtype=wp.int32),
) -> int:
    """Slot of some point in the nearest ring of cells that has one; -1 if the group is empty."""
    cx = axis_cell(q[0], resolution)
    cy = axis_cell(q[1], resolution)
    cz = axis_cell(q[2], resolution)
    found = int(-1)
    ring = int(0)
    while found < 0 and ring < resolution:
        x0 = wp.max(cx - ring, 0)
        x1 = wp.min(cx + ring, resolution - 1)
        for z in range(wp.max(cz - ring, 0), wp.min(cz + ring, resolution - 1) + 1):
            for y in range(wp.max(cy - ring, 0), wp.min(cy + ring, resolution - 1) + 1):
                row = (z * resolution + y) * resolution
                if start[group, row + x1 + 1] > start[group, row + x0]:
                    found = start[group, row + x0]
        ring = ring + 1
    return found


@wp.func
def search_ball(
    q: wp.vec3,
    group: int,
    candidate: int,
    margin: float,
    resolution: int,
    points: wp.array(dtype=wp.vec3),
    start: wp.array2d(dtype=wp.int32),
    order: wp.array(dtype=wp.int32),
    sorted_points: wp.array(dtype=wp.vec3),
):
    """Nearest target and its distance, starting from some candidate, and a distance no other target undercuts.

    The ball reaches ``margin`` beyond the best point, so that the third answer is up to ``margin`` above the second.
    """
    best = candidate
    best_sq = wp.length_sq(points[candidate] - q)
    other_sq = float(wp.inf)
    reach = (wp.sqrt(best_sq) + margin) * _WIDEN
    reach_sq = reach * reach
    ux = wp.clamp(q[0], -1.0, 1.0)
    uy = wp.clamp(q[1], -1.0, 1.0)
    uz = wp.clamp(q[2], -1.0, 1.0)
    y0 = axis_cell(uy - reach, resolution)
    y1 = axis_cell(uy + reach, resolution)
    for z in range(axis_cell(uz - reach, resolution), axis_cell(uz + reach, resolution) + 1):
        gap_z = gap(uz, z, resolution)
        for y in range(y0, y1 + 1):
            gap_y = gap(uy, y, resolution)
            room = reach_sq - gap_z * gap_z - gap_y * gap_y
            if room >= 0.0:
                span = wp.sqrt(room) * _WIDEN
                row = (z * resolution + y) * resolution
                last = start[group, row + axis_cell(ux + span, resolution) + 1]
                for slot in range(start[group, row + axis_cell(ux - span, resolution)], last):
                    d_sq = wp.length_sq(sorted_points[slot] - q)
                    if d_sq <= other_sq:
                        found = order[slot]
                        if d_sq < best_sq:
                            other_sq = best_sq
                            best_sq = d_sq
                            best = found
                            reach = (wp.sqrt(best_sq) + margin) * _WIDEN
                            reach_sq = reach * reach
                        elif found != best:
                            other_sq = d_sq
                            if d_sq == best_sq:
                                best = wp.min(best, found)
    best_distance = wp.sqrt(best_sq)
    return best, best_distance, wp.min(wp.sqrt(other_sq), best_distance + margin)


@wp.kernel
def _nearest(
    # In:
    begin: int,
    queries: wp.array(dtype=wp.vec3),
    query_group: wp.array(dtype=wp.int32),
    resolution: int,
    points: wp.array(dtype=wp.vec3),
    start: wp.array2d(dtype=wp.int32),
    order: wp.array(dtype=wp.int32),
    sorted_points: wp.array(dtype=wp.vec3),
    odometer: wp.array(dtype=wp.float64),
    margin: float,
    # In and out: what is known from the last search of a query
    anchor: wp.array(dtype=wp.vec3),
    bound: wp.array(dtype=wp.float32),
    reading: wp.array(dtype=wp.float64),
    # In as the last answer or -1; out:
    index_out: wp.array(dtype=wp.int32),
):
    """One thread a query; a negative group asks nothing and answers -1."""
    i = begin + wp.tid()
    group = query_group[i]
    best = int(-1)
    if group >= 0:
        q = queries[i]
        best = index_out[i]
        known = float(-1.0)
        if best >= 0:
            # Nothing can have come nearer than the bound, less how far the query and any target have moved since.
            travelled = float(odometer[group] - reading[i])
            drift = wp.length(q - anchor[i]) + travelled
            known = bound[i] - _WIDEN * drift - _ROUNDING * (1.0 + travelled)
        if best < 0:
            slot = first_candidate(q, group, resolution, start)
            if slot >= 0:
                best = order[slot]
        if best >= 0:
            if not (wp.length(points[best] - q) < known):
                best, distance, other = search_ball(
                    q, group, best, margin, resolution, points, start, order, sorted_points
                )
                anchor[i] = q
                bound[i] = other
                reading[i] = odometer[group]
    index_out[i] = best


def cells_per_axis(points_per_group: float) -> int:
    """Cells an axis so that an occupied cell of a surface holds about six points; 4 to 64."""
    return int(min(max(round(math.sqrt(points_per_group / _POINTS_PER_CELL)), 4), _RESOLUTION_MAX))


class PointGrid:
    """Targets of a search, grouped; ``build`` sorts them anew where they moved.

    Args:
        points: shape (N,) vec3, cube units, groups behind each other; read at every ``build``.
        sizes: points in each group, G integers that sum to N.
    """

    def __init__(self, points: wp.array, sizes: Sequence[int] | np.ndarray) -> None:
        require(points, "points", wp.vec3, (int(np.sum(sizes)),))
        device = points.device
        self.points = points
        self.offset = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int32)
        self.resolution = cells_per_axis(float(np.max(sizes)))
        self.odometer = wp.zeros(len(sizes), dtype=wp.float64, device=device)
        self.start = wp.zeros((len(sizes), self.resolution**3 + 1), dtype=wp.int32, device=device)
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
        launch(_sort_group, count, [first, self.resolution, self.points, self._offset, *moved, *targets], device)

    def build_in_parallel(self) -> None:
        """The same for all groups, one thread a point: what CUDA runs."""
        device, count = self.points.device, len(self.points)
        launch(_measure_moves, count, [self.points, self._group, self._last, self._farthest], device)
        launch(_turn_odometers, len(self._farthest), [self._farthest, self.odometer], device)
        flat = self.start.flatten()
        launch(_clear_cells, len(flat), [flat], device)
        launch(_count_points, count, [self.resolution, self.points, self._group, self._cell, self.start], device)
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
        self._margin = _MARGIN_IN_CELLS * 2.0 / grid.resolution
        self._anchor = wp.zeros(count, dtype=wp.vec3, device=device)
        self._bound = wp.zeros(count, dtype=wp.float32, device=device)
        self._reading = wp.zeros(count, dtype=wp.float64, device=device)

    def run(self, begin: int = 0, count: int | None = None) -> None:
        """Answer queries ``begin .. begin + count`` (None: all) for the grid as last built."""
        g = self._grid
        targets = [g.resolution, g.points, g.start, g.order, g.sorted, g.odometer, self._margin]
        known = [self._anchor, self._bound, self._reading]
        count = len(self.index) - begin if count is None else count
        inputs = [begin, self._queries, self._group, *targets, *known, self.index]
        launch(_nearest, count, inputs, self._queries.device)
