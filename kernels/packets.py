"""Exact nearest neighbours of sixteen queries at a time: how the CPU searches a ``PointGrid``; no gradient.

Queries that stand next to each other in memory are mostly neighbours in space, and their balls overlap. So those that
must be searched are gathered into packets, one query a lane of a 16-float register, and every target in the cells
that the packet's balls touch is compared with all lanes at once, without a branch. A query joins the packet as long
as the cells of the common box cost less than two boxes would.
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.cells import Targets, first_candidate
from warpdef.kernels.launching import MODULE_OPTIONS
from warpdef.kernels.sizes import sizes

wp.set_module_options(MODULE_OPTIONS)

QUERIES_PER_THREAD = 512

# Ties go to the lowest index. What a query learns: its answer, and a distance that no other target undercuts, which
# is either the second nearest or the reach of the packet. Positions below are in cells from the grid's lower corner,
# clamped into its box, whose border cells hold what lies outside.
_SEARCH_PACKETS = (
    """
#if !defined(__CUDA_ARCH__)
    typedef float lanes __attribute__((vector_size(64)));
    typedef int whole __attribute__((vector_size(64)));
    const float size = targets.cells.size, inverse = 1.0f / size, huge = 3.0e38f;
    const int count_of[3] = {targets.cells.nx, targets.cells.ny, targets.cells.nz};
    float lower[3], upper[3], widest = 0.0f, cost = 0.0f;  // of the packet: queries, reach, cells
    int waiting[16], filled = 0, packet_group = -1;
    lanes qx = {}, qy = {}, qz = {};
    whole candidate = {};

    const auto cost_of = [&](const float* low, const float* high, float reach) {
        const float extra = 2.0f * reach * inverse + 1.0f;
        return (high[0] - low[0] + extra + ROW) * (high[1] - low[1] + extra) * (high[2] - low[2] + extra);
    };
    const auto search = [&]() {
        const int nx = targets.cells.nx, ny = targets.cells.ny, nz = targets.cells.nz;
        const int* const begin_of = targets.start.data + (size_t)packet_group * targets.start.shape[1];
        const float* const target = (const float*)targets.sorted_points.data;
        lanes best_sq = huge - lanes{}, other_sq = best_sq;
        whole best = candidate;
        const float reach = widest < 1.0e9f * size ? widest : 1.0e9f * size, reach_sq = reach * reach;
        const float r = reach * inverse + 1.0e-3f;
        const auto first = [&](float u) { return u - r > 0.0f ? (int)(u - r) : 0; };
        const auto last = [&](float u, int n) { return u + r < (float)n - 0.5f ? (int)(u + r) : n - 1; };
        const auto gap = [&](int cell, float low, float high) {
            const float before = low - 1.0f - (float)cell, after = (float)cell - high;
            const float most = before > after ? before : after;
            return most > 0.0f ? most * size : 0.0f;
        };
        const int y0 = first(lower[1]), y1 = last(upper[1], ny), z1 = last(upper[2], nz);
        for (int z = first(lower[2]); z <= z1; ++z) {
            const float gap_z = gap(z, lower[2], upper[2]);
            for (int y = y0; y <= y1; ++y) {
                const float gap_y = gap(y, lower[1], upper[1]);
                const float room = reach_sq - gap_z * gap_z - gap_y * gap_y;
                if (!(room >= 0.0f)) continue;
                const float span = sqrtf(room) * inverse + 1.0e-3f;
                const float left = lower[0] - span, right = upper[0] + span;
                const int row = (z * ny + y) * nx;
                const int x0 = left > 0.0f ? (int)left : 0;
                const int x1 = right < (float)nx - 0.5f ? (int)right : nx - 1;
                const int end = begin_of[row + x1 + 1];
                for (int slot = begin_of[row + x0]; slot < end; ++slot) {
                    const float* const p = target + 3 * (size_t)slot;
                    const whole found = targets.order.data[slot] - whole{};
                    const lanes dx = p[0] - qx, dy = p[1] - qy, dz = p[2] - qz;
                    const lanes d_sq = dx * dx + dy * dy + dz * dz;
                    const whole nearer = d_sq < best_sq, tie = (d_sq == best_sq) & (found < best);
                    const lanes second = nearer ? best_sq : d_sq;
                    other_sq = second < other_sq ? second : other_sq;
                    best_sq = nearer ? d_sq : best_sq;
                    best = (nearer | tie) ? found : best;
                }
            }
        }
        for (int l = 0; l < filled; ++l) {
            const int i = waiting[l];
            const float other = sqrtf(other_sq[l]);
            index_out.data[i] = best[l];
            bound_out.data[i] = other < reach ? other : reach;
            anchor_out.data[i] = queries.data[i];
            reading_out.data[i] = targets.odometer.data[packet_group];
        }
        filled = 0;
    };

    for (int i = begin; i < end; ++i) {
        const int group = query_group.data[i];
        if (group < 0) { index_out.data[i] = -1; continue; }
        const int known = index_out.data[i];
        if (known < 0) continue;  // an empty group
        const wp::vec3 q = queries.data[i], c = targets.points.data[known], a = anchor_out.data[i];
        const float dx = c[0] - q[0], dy = c[1] - q[1], dz = c[2] - q[2];
        const float distance = sqrtf(dx * dx + dy * dy + dz * dz);
        // Nothing can have come nearer than the bound, less how far the query and any target have moved since.
        const float mx = q[0] - a[0], my = q[1] - a[1], mz = q[2] - a[2];
        const float travelled = (float)(targets.odometer.data[group] - reading_out.data[i]);
        const float drift = sqrtf(mx * mx + my * my + mz * mz) + travelled;
        if (distance < bound_out.data[i] - 1.0001f * drift - ROUNDING * (1.0f + travelled)) continue;
        const float sum = q[0] + q[1] + q[2];
        if (!(sum > -huge && sum < huge)) continue;  // not a number: no answer is better than another
        const float reach = distance < huge ? (distance + margin) * 1.0001f : huge;
        float low[3], high[3], own[3];
        for (int k = 0; k < 3; ++k) {
            const float g = (q[k] - targets.cells.lower[k]) * inverse, n = (float)count_of[k];
            own[k] = g > 0.0f ? (g < n ? g : n) : 0.0f;
        }
        const float alone = cost_of(own, own, reach);
        float further = reach;
        if (filled > 0) {
            for (int k = 0; k < 3; ++k) {
                low[k] = own[k] < lower[k] ? own[k] : lower[k];
                high[k] = own[k] > upper[k] ? own[k] : upper[k];
            }
            further = reach > widest ? reach : widest;
            const float together = cost_of(low, high, further);
            if (filled == 16 || group != packet_group || together > cost + alone + PACKET) search();
            else cost = together;
        }
        if (filled == 0) {
            for (int k = 0; k < 3; ++k) low[k] = high[k] = own[k];
            further = reach; cost = alone; packet_group = group;
        }
        for (int k = 0; k < 3; ++k) { lower[k] = low[k]; upper[k] = high[k]; }
        widest = further;
        qx[filled] = q[0]; qy[filled] = q[1]; qz[filled] = q[2]; candidate[filled] = known;
        waiting[filled++] = i;
    }
    if (filled > 0) search();
#endif
""".replace("ROUNDING", "2.0e-6f")
    .replace("ROW", "4.0f")
    .replace("PACKET", "60.0f")
)


@wp.func_native(_SEARCH_PACKETS)
def search_packets(
    begin: int,
    end: int,
    queries: wp.array[wp.vec3],
    query_group: wp.array[wp.int32],
    targets: Targets,
    margin: float,
    anchor_out: wp.array[wp.vec3],
    reading_out: wp.array[wp.float64],
    bound_out: wp.array[wp.float32],
    index_out: wp.array[wp.int32],
): ...


@sizes("threads queries query_group anchor reading bound index: Q; count: <Q+1")
@wp.kernel
def nearest_in_packets(
    # In:
    begin: int,
    count: int,
    per_thread: int,
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
    """CPU: one thread a run of queries; a negative group asks nothing and answers -1."""
    first = begin + per_thread * wp.tid()
    last = wp.min(first + per_thread, begin + count)
    for i in range(first, last):
        if index[i] < 0 and query_group[i] >= 0:
            slot = first_candidate(queries[i], query_group[i], targets)
            if slot >= 0:
                index[i] = targets.order[slot]
            bound[i] = -3.0e38  # whatever the odometer says: search
    search_packets(first, last, queries, query_group, targets, margin, anchor, reading, bound, index)
