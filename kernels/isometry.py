"""Change of edge length between neighbouring frames, and its gradient (paper, eq. of L_isometry).

    L = share sum_t sum_(i,j) | |x_i,t - x_j,t| - |x_i,t-1 - x_j,t-1| |
    adjoint at frame t: share (sign(l_t - l_t-1) + sign(l_t - l_t+1)) (x_i - x_j)/l_t to i, its negative to j

A frame's gradient depends on the lengths before and after it only. CUDA gives an edge of a frame to each thread. The
CPU keeps the path of every vertex, its positions in all frames behind each other, so that one register holds an edge's
lengths in sixteen frames; a vertex then collects its gradient from the edges around it. At equal lengths, and for an
edge of no length, the gradient is 0.
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS, launch
from warpdef.kernels.sizes import sizes
from warpdef.kernels.warp_sums import add_loss

wp.set_module_options(MODULE_OPTIONS)

_FRAMES = 14  # that a register of sixteen is good for: the first and the last only lend their lengths


@wp.func
def sign_of_change(change: float) -> float:
    s = float(0.0)
    if change > 0.0:
        s = 1.0
    if change < 0.0:
        s = -1.0
    return s


@sizes("threads: T*E; frame_count loss_out: T; vertices adj_vertices_out: T V; edges: E 2")
@wp.kernel
def _isometry(
    # In:
    begin: int,
    frame_count: int,
    vertices: wp.array2d[wp.vec3],
    edges: wp.array2d[wp.int32],
    share: float,
    weight: float,
    # Out, added to:
    loss_out: wp.array[wp.float64],
    adj_vertices_out: wp.array2d[wp.vec3],
):
    """One thread an edge of a frame. The loss between t and t + 1 counts for frame t."""
    k = begin + wp.tid()
    t = k // edges.shape[0]
    e = k - t * edges.shape[0]
    i = edges[e, 0]
    j = edges[e, 1]
    d = vertices[t, i] - vertices[t, j]
    length = wp.length(d)
    signs = float(0.0)
    if t > 0:
        signs = signs + sign_of_change(length - wp.length(vertices[t - 1, i] - vertices[t - 1, j]))
    if t + 1 < frame_count:
        change = length - wp.length(vertices[t + 1, i] - vertices[t + 1, j])
        signs = signs + sign_of_change(change)
        add_loss(t, wp.float64(share * wp.abs(change)), loss_out)
    if length > 0.0 and signs != 0.0:
        g = (weight * share * signs / length) * d
        wp.atomic_add(adj_vertices_out, t, i, g)
        wp.atomic_add(adj_vertices_out, t, j, -g)


@sizes("threads: V; vertices: T V; paths_out: V 3 W")
@wp.kernel
def _lay_paths(
    # In:
    begin: int,
    vertices: wp.array2d[wp.vec3],
    # Out:
    paths_out: wp.array3d[wp.float32],
):
    """One thread a vertex. The first and the last frame are repeated: lengths do not change there."""
    i = begin + wp.tid()
    for k in range(paths_out.shape[2]):
        x = vertices[wp.clamp(k - 1, 0, vertices.shape[0] - 1), i]
        for c in range(3):
            paths_out[i, c, k] = x[c]


_VERTEX = """
#if !defined(__CUDA_ARCH__)
    typedef float lanes __attribute__((vector_size(64)));
    typedef int whole __attribute__((vector_size(64)));
    const int width = paths.shape[2], frames = adj_vertices.shape[0], vertices = adj_vertices.shape[1];
    const auto load = [](const float* p) { lanes v; __builtin_memcpy(&v, p, sizeof(v)); return v; };
    const float* const own = paths.data + (size_t)i * 3 * width;
    const float factor = weight * share;
    for (int begin = 0; begin + 2 < width; begin += FRAMES) {
        const lanes x = load(own + begin), y = load(own + width + begin), z = load(own + 2 * width + begin);
        lanes gx = {}, gy = {}, gz = {}, sum = {};
        for (int k = row.data[i]; k < row.data[i + 1]; ++k) {
            const int j = column.data[k];
            const float* const other = paths.data + (size_t)j * 3 * width + begin;
            const lanes dx = x - load(other), dy = y - load(other + width), dz = z - load(other + 2 * width);
            const lanes length = __builtin_elementwise_sqrt(dx * dx + dy * dy + dz * dz);
            const lanes before = length - SHIFT(0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14);
            const lanes after = SHIFT(1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 15) - length;
            // A true comparison is -1: signs of the two changes.
            const whole signs = (before < 0.0f) - (before > 0.0f) + (after > 0.0f) - (after < 0.0f);
            const lanes g = __builtin_convertvector(signs, lanes) * (factor / length);
            const lanes safe = length > 0.0f ? g : lanes{};
            gx += safe * dx; gy += safe * dy; gz += safe * dz;
            if (i < j) sum += after < 0.0f ? -after : after;
        }
        for (int l = 0; l < FRAMES && begin + l < frames; ++l) {
            const int t = begin + l;
            wp::vec3& adj = adj_vertices.data[(size_t)t * vertices + i];
            adj[0] += gx[l + 1]; adj[1] += gy[l + 1]; adj[2] += gz[l + 1];
            loss.data[(size_t)part * frames + t] += (double)(share * sum[l + 1]);
        }
    }
#endif
""".replace("FRAMES", str(_FRAMES)).replace("SHIFT(", "__builtin_shufflevector(length, length, ")


@wp.func_native(_VERTEX)
def keep_lengths(
    i: int,
    paths: wp.array3d[wp.float32],
    row: wp.array[wp.int32],
    column: wp.array[wp.int32],
    share: float,
    weight: float,
    part: int,
    loss: wp.array2d[wp.float64],
    adj_vertices: wp.array2d[wp.vec3],
): ...


@sizes("threads: V; paths: V 3 W; row: V+1; column: E; part: <P; loss_out: P T; adj_vertices_out: T V")
@wp.kernel
def _isometry_of_vertices(
    # In:
    begin: int,
    paths: wp.array3d[wp.float32],
    row: wp.array[wp.int32],
    column: wp.array[wp.int32],
    share: float,
    weight: float,
    part: int,
    # Out, added to:
    loss_out: wp.array2d[wp.float64],
    adj_vertices_out: wp.array2d[wp.vec3],
):
    """CPU: one thread a vertex, all frames."""
    keep_lengths(begin + wp.tid(), paths, row, column, share, weight, part, loss_out, adj_vertices_out)


def path_width(frame_count: int) -> int:
    """Numbers a component of a path takes: all frames, one more at each end, and what fills the last register."""
    return -(-frame_count // _FRAMES) * _FRAMES + 2


def isometry(
    begin: int, count: int, vertices: wp.array, edges: wp.array, share: float, weight: float, loss_out: wp.array,
    adj_vertices_out: wp.array,
) -> None:  # fmt: skip
    """Loss and gradient for ``count`` edges from ``begin``, counted over all frames (frame t owns E of them).

    Args:
        vertices: shape (T, V) vec3, cube units. edges: shape (E, 2) int32.
        share: factor of the loss, 1 / ((T - 1) E) for a mean. weight: in the gradient, not in the loss.
        loss_out: shape (T,) float64, added to. adj_vertices_out: shape (T, V) vec3, added to.
    """
    inputs = [begin, vertices.shape[0], vertices, edges, share, weight, loss_out, adj_vertices_out]
    launch(_isometry, count, inputs, vertices.device)


def lay_paths(begin: int, count: int, vertices: wp.array, paths_out: wp.array) -> None:
    """Positions of ``count`` vertices from ``begin`` over all frames; shape (V, 3, ``path_width(T)``) float32."""
    launch(_lay_paths, count, [begin, vertices, paths_out], vertices.device)


def isometry_of_vertices(
    begin: int, count: int, paths: wp.array, row: wp.array, column: wp.array, share: float, weight: float, part: int,
    loss_out: wp.array, adj_vertices_out: wp.array,
) -> None:  # fmt: skip
    """What ``isometry`` does, on the CPU, for ``count`` vertices from ``begin`` and all frames; other tasks do others.

    Args:
        paths: see ``lay_paths``; of all vertices. row, column: neighbours, as in ``Graph``.
        part: row of ``loss_out`` that belongs to this task. An edge counts where its lower vertex does.
        loss_out: shape (parts, T) float64. adj_vertices_out: shape (T, V) vec3. Both are added to.
    """
    inputs = [begin, paths, row, column, share, weight, part, loss_out, adj_vertices_out]
    launch(_isometry_of_vertices, count, inputs, adj_vertices_out.device)
