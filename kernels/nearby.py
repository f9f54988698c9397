"""The k nearest targets of every query, and the planes through them; no gradient.

A search goes out from the query's cell of a ``PointGrid``, ring by ring, and keeps the k nearest points so far in
order; of equally near ones the lowest index comes first, so that no order of threads or of a cell's points matters. A
ring lies behind walls of cells, whose distance is known: once the k-th point is nearer than that, the answer is exact.
Where a wall is the grid's own, nothing lies beyond it, as border cells hold what is outside.

The plane through a neighbourhood is that of its covariance, taken in float64 about its mean, so that flat ones keep
their digits: its normal is the axis of least variance, and of the variances the two lesser say how flat it is.
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.cells import PointGrid, Targets
from warpdef.kernels.launching import MODULE_OPTIONS, launch
from warpdef.kernels.sizes import require, sizes

wp.set_module_options(MODULE_OPTIONS)

NEARBY_MAX = 64
"""Most neighbours that a search keeps in order."""

# Plain C, for CPU and CUDA alike, as in ``neighbours``. A comparison that NaN fails sends NaN to the corner.
_SEARCH_RINGS = """
    const float q[3] = {place[0], place[1], place[2]};
    const float size = targets.cells.size, inverse = 1.0f / size;
    const int n[3] = {targets.cells.nx, targets.cells.ny, targets.cells.nz};
    const int* const begin = targets.start.data + (size_t)group * targets.start.shape[1];
    const float* const target = (const float*)targets.sorted_points.data;
    float nearest[MOST];
    int found[MOST];
    int filled = 0, centre[3], widest = 0;
    float lower[3];
    for (int a = 0; a < 3; ++a) {
        lower[a] = targets.cells.lower[a];
        const float g = (q[a] - lower[a]) * inverse;
        centre[a] = g > 0.0f ? (int)(g < (float)n[a] - 0.5f ? g : (float)n[a] - 0.5f) : 0;
        widest = n[a] > widest ? n[a] : widest;
    }
    for (int ring = 0; ring < widest; ++ring) {
        const int x0 = centre[0] - ring > 0 ? centre[0] - ring : 0;
        const int x1 = centre[0] + ring < n[0] - 1 ? centre[0] + ring : n[0] - 1;
        const int y0 = centre[1] - ring > 0 ? centre[1] - ring : 0;
        const int y1 = centre[1] + ring < n[1] - 1 ? centre[1] + ring : n[1] - 1;
        const int z0 = centre[2] - ring > 0 ? centre[2] - ring : 0;
        const int z1 = centre[2] + ring < n[2] - 1 ? centre[2] + ring : n[2] - 1;
        for (int z = z0; z <= z1; ++z) {
            for (int y = y0; y <= y1; ++y) {
                const int row = (z * n[1] + y) * n[0];
                const bool outer = z == centre[2] - ring || z == centre[2] + ring || y == centre[1] - ring ||
                                   y == centre[1] + ring;
                // Of a row through the ring's middle only the two ends are new.
                for (int part = 0; part < 2; ++part) {
                    int first = x0, last = x1;
                    if (!outer) {
                        first = last = part == 0 ? centre[0] - ring : centre[0] + ring;
                        if (first < 0 || first >= n[0]) continue;
                    } else if (part == 1) {
                        continue;
                    }
                    const int end = begin[row + last + 1];
                    for (int slot = begin[row + first]; slot < end; ++slot) {
                        const float* const p = target + 3 * (size_t)slot;
                        const float dx = p[0] - q[0], dy = p[1] - q[1], dz = p[2] - q[2];
                        const float d = dx * dx + dy * dy + dz * dz;
                        if (filled == wanted && !(d <= nearest[filled - 1])) continue;
                        const int index = targets.order.data[slot];
                        if (filled == wanted && d == nearest[filled - 1] && index > found[filled - 1]) continue;
                        int at = filled < wanted ? filled++ : filled - 1;
                        while (at > 0 && (d < nearest[at - 1] || (d == nearest[at - 1] && index < found[at - 1]))) {
                            nearest[at] = nearest[at - 1];
                            found[at] = found[at - 1];
                            --at;
                        }
                        nearest[at] = d;
                        found[at] = index;
                    }
                }
            }
        }
        if (filled == wanted) {
            float wall = 3.0e38f;
            for (int a = 0; a < 3; ++a) {
                const float before = q[a] - (lower[a] + (float)(centre[a] - ring) * size);
                const float after = lower[a] + (float)(centre[a] + ring + 1) * size - q[a];
                if (centre[a] - ring > 0 && before < wall) wall = before;
                if (centre[a] + ring < n[a] - 1 && after < wall) wall = after;
            }
            wall -= 1.0e-3f * size;  // which cell a point is in is rounded
            if (wall > 0.0f && nearest[wanted - 1] < wall * wall) break;
        }
    }
    int* const index = index_out.data + (size_t)query * wanted;
    float* const distance = distance_out.data + (size_t)query * wanted;
    for (int k = 0; k < wanted; ++k) {
        index[k] = k < filled ? found[k] : -1;
        distance[k] = k < filled ? sqrtf(nearest[k]) : INFINITY;
    }
""".replace("MOST", str(NEARBY_MAX))


@wp.func_native(_SEARCH_RINGS)
def search_rings(
    query: int,
    place: wp.vec3,
    group: int,
    wanted: int,
    targets: Targets,
    index_out: wp.array2d[wp.int32],
    distance_out: wp.array2d[wp.float32],
): ...


@sizes("threads queries query_group: Q; index_out distance_out: Q K; wanted: K")
@wp.kernel
def _nearby(
    # In:
    begin: int,
    wanted: int,
    queries: wp.array[wp.vec3],
    query_group: wp.array[wp.int32],
    targets: Targets,
    # Out:
    index_out: wp.array2d[wp.int32],
    distance_out: wp.array2d[wp.float32],
):
    """One thread a query."""
    i = begin + wp.tid()
    search_rings(i, queries[i], query_group[i], wanted, targets, index_out, distance_out)


@sizes("threads normal_out variance_out: Q; points: N; index: Q K")
@wp.kernel
def _local_planes(
    # In:
    begin: int,
    points: wp.array[wp.vec3],
    index: wp.array2d[wp.int32],
    # Out:
    normal_out: wp.array[wp.vec3],
    variance_out: wp.array[wp.vec3],
):
    """One thread a neighbourhood."""
    i = begin + wp.tid()
    count = index.shape[1]
    mean = wp.vec3d()
    for k in range(count):
        p = points[index[i, k]]
        mean += wp.vec3d(wp.float64(p[0]), wp.float64(p[1]), wp.float64(p[2]))
    mean = mean / wp.float64(count)
    spread = wp.mat33d()
    for k in range(count):
        p = points[index[i, k]]
        away = wp.vec3d(wp.float64(p[0]), wp.float64(p[1]), wp.float64(p[2])) - mean
        spread += wp.outer(away, away)
    axes, lengths = wp.eig3(spread)
    least = int(0)
    if lengths[1] < lengths[0]:
        least = 1
    if lengths[2] < lengths[least]:
        least = 2
    normal_out[i] = wp.vec3(float(axes[0, least]), float(axes[1, least]), float(axes[2, least]))
    one = wp.max(lengths[(least + 1) % 3], wp.float64(0.0))
    other = wp.max(lengths[(least + 2) % 3], wp.float64(0.0))
    low = float(wp.max(lengths[least], wp.float64(0.0)))
    variance_out[i] = wp.vec3(low, float(wp.min(one, other)), float(wp.max(one, other)))


class NearbySearch:
    """The nearest targets of every query, in order.

    Args:
        grid: the targets, read as last built. queries: shape (Q,) vec3. query_group: shape (Q,) int32, whom each asks.
        wanted: K, from 1 to ``NEARBY_MAX``.

    index: shape (Q, K) int32, counted over all groups; -1 behind the last where a group has fewer than K.
    distance: shape (Q, K) float32, to each of them; infinite where there is none.

    Raises:
        ValueError: another K.
    """

    def __init__(self, grid: PointGrid, queries: wp.array, query_group: wp.array, wanted: int) -> None:
        require(queries, "queries", wp.vec3, (None,))
        require(query_group, "query_group", wp.int32, (len(queries),))
        if not 1 <= wanted <= NEARBY_MAX:
            raise ValueError(f"wanted: expected 1 to {NEARBY_MAX} neighbours, got {wanted}")
        self._grid, self._queries, self._group = grid, queries, query_group
        shape = len(queries), wanted
        self.index = wp.zeros(shape, dtype=wp.int32, device=queries.device)
        self.distance = wp.zeros(shape, dtype=wp.float32, device=queries.device)

    def run(self) -> None:
        """Answer all queries."""
        count, wanted = self.index.shape
        asked = [0, wanted, self._queries, self._group, self._grid.targets, self.index, self.distance]
        launch(_nearby, count, asked, self._queries.device)


def local_planes(
    begin: int, count: int, points: wp.array, index: wp.array, normal_out: wp.array, variance_out: wp.array
) -> None:
    """Planes through neighbourhoods ``begin .. begin + count``.

    Args:
        points: shape (N,) vec3. index: shape (Q, K) int32, all of them points.
        normal_out: shape (Q,) vec3, unit length, of either side. variance_out: shape (Q,) vec3, the sums of squares
            along the principal axes, ascending, the square of the points' unit.
    """
    launch(_local_planes, count, [begin, points, index, normal_out, variance_out], points.device)
