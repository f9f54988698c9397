"""Exact nearest neighbours in a hash grid, for many clouds at once; no gradient (paper, argmin of CD_R).

Targets lie in the cells of a ``PointGrid``. Clamping to its box never lengthens a distance, so all bounds below hold
for positions outside it too, and the answer is exact at any distance. Ties go to the lowest index.

A search starts from a candidate (the last answer, or the first point found in growing rings) and looks only at the
cells that the ball through it touches, shrinking the ball as better points turn up. It also learns how near any other
target can be. As long as query and targets have moved less than that allows, the next search of that query is one
comparison: exact, and most of the work once a descent settles.
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.cells import PointGrid, Targets, first_candidate
from warpdef.kernels.launching import MODULE_OPTIONS, launch
from warpdef.kernels.packets import QUERIES_PER_THREAD, nearest_in_packets
from warpdef.kernels.sizes import require, require_span, sizes
from warpdef.kernels.ways import Way, way_of

wp.set_module_options(MODULE_OPTIONS)

# Rounding may put a point just outside a ball drawn with exact arithmetic: search a hair wider.
_WIDEN = wp.constant(1.0001)
# Error of a float32 distance between points in the cube, and of a float32 move per unit travelled.
_ROUNDING = wp.constant(2.0e-6)
# A ball a little too wide costs a little more, and lets the next search be one comparison. A packet's is wider anyway.
_MARGIN_IN_CELLS, _MARGIN_OF_PACKETS = 0.15, 0.05


# The ball around query q through a first candidate and `margin` beyond, row of cells by row of cells. Writes the
# nearest target (ties: lowest index) and a distance that no other target undercuts. Plain C, for CPU and CUDA alike:
# Warp's own loops are half as fast here.
_SEARCH_BALL = """
    const float qx = q[0], qy = q[1], qz = q[2];
    const float size = targets.cells.size, inverse = 1.0f / size;
    const int nx = targets.cells.nx, ny = targets.cells.ny, nz = targets.cells.nz;
    const int* const begin = targets.start.data + (size_t)group * targets.start.shape[1];
    const wp::vec3* const target = targets.sorted_points.data;
    int best = candidate;
    const wp::vec3 c = targets.points.data[candidate];
    float dx = c[0] - qx, dy = c[1] - qy, dz = c[2] - qz;
    float best_sq = dx * dx + dy * dy + dz * dz, other_sq = 3.0e38f;
    float reach = (sqrtf(best_sq) + margin) * WIDEN, reach_sq = reach * reach;
    // In cells from the lower corner, clamped into the box, whose border cells hold what lies outside. A comparison
    // that NaN fails sends NaN to the corner.
    const float gx = (qx - targets.cells.lower[0]) * inverse, gy = (qy - targets.cells.lower[1]) * inverse;
    const float gz = (qz - targets.cells.lower[2]) * inverse;
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
                    const int found = targets.order.data[slot];
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
    targets: Targets,
    index_out: wp.array[wp.int32],
    bound_out: wp.array[wp.float32],
): ...


@sizes("threads queries query_group anchor reading bound index: Q")
@wp.kernel
def _nearest(
    # In:
    begin: int,
    queries: wp.array[wp.vec3],
    query_group: wp.array[wp.int32],
    targets: Targets,
    margin: float,
    # In and out: what is known from the last search of a query
    anchor: wp.array[wp.vec3],
    reading: wp.array[wp.float64],
    bound: wp.array[wp.float32],
    # In and out: the last answer or -1, then the answer
    index: wp.array[wp.int32],
):
    """One thread a query; a negative group asks nothing and answers -1."""
    i = begin + wp.tid()
    group = query_group[i]
    if group < 0:
        index[i] = -1
        return
    q = queries[i]
    best = index[i]
    if best >= 0:
        # Nothing can have come nearer than the bound, less how far the query and any target have moved since.
        travelled = float(targets.odometer[group] - reading[i])
        drift = wp.length(q - anchor[i]) + travelled
        known = bound[i] - _WIDEN * drift - _ROUNDING * (1.0 + travelled)
        if wp.length(targets.points[best] - q) < known:
            return
    else:
        slot = first_candidate(q, group, targets)
        if slot < 0:
            return
        best = targets.order[slot]
    search_ball(i, q, group, best, margin, targets, index, bound)
    anchor[i] = q
    reading[i] = targets.odometer[group]


class NearestSearch:
    """The nearest target of every query, asked again and again while both move.

    Args:
        grid: the targets. queries: shape (Q,) vec3, cube units, read at every ``run``.
        query_group: shape (Q,) int32, the group a query asks; negative: it asks nothing and the answer is -1.
        one_by_one: every query in a thread of its own, the way of CUDA, on the CPU too.

    ``index``, shape (Q,) int32, holds the answers, counted over all groups; -1 for none.
    """

    def __init__(self, grid: PointGrid, queries: wp.array, query_group: wp.array, one_by_one: bool = False) -> None:
        require(queries, "queries", wp.vec3, (None,))
        require(query_group, "query_group", wp.int32, (len(queries),))
        device, count = queries.device, len(queries)
        self.index = wp.full(count, -1, dtype=wp.int32, device=device)
        self._grid, self._queries, self._group = grid, queries, query_group
        self._in_packets = way_of(device) is Way.SPANS and not one_by_one
        self._margin = (_MARGIN_OF_PACKETS if self._in_packets else _MARGIN_IN_CELLS) * grid.cells.size
        self._anchor = wp.zeros(count, dtype=wp.vec3, device=device)
        self._bound = wp.zeros(count, dtype=wp.float32, device=device)
        self._reading = wp.zeros(count, dtype=wp.float64, device=device)

    def forget(self) -> None:
        """Let the next search begin from nothing."""
        self.index.fill_(-1)

    def run(self, begin: int = 0, count: int | None = None) -> None:
        """Answer queries ``begin .. begin + count`` (None: all) for the grid as last built."""
        known = [self._anchor, self._reading, self._bound]
        count = len(self.index) - begin if count is None else count
        require_span("queries", begin, count, len(self.index))
        asked = [self._queries, self._group, self._grid.targets, self._margin, *known, self.index]
        device = self._queries.device
        if self._in_packets:
            runs = -(-count // QUERIES_PER_THREAD)
            launch(nearest_in_packets, runs, [begin, count, QUERIES_PER_THREAD, *asked], device)
            return
        launch(_nearest, count, [begin, *asked], device)
