"""Change of edge length between neighbouring frames, and its gradient (paper, eq. of L_isometry).

    L = share sum_t sum_(i,j) | |x_i,t - x_j,t| - |x_i,t-1 - x_j,t-1| |
    adjoint at frame t: share (sign(l_t - l_t-1) + sign(l_t - l_t+1)) (x_i - x_j)/l_t to i, its negative to j

A frame's gradient depends on the lengths before and after it only, so every frame can be done on its own: a frame
reads its neighbours and writes itself. At equal lengths, and for an edge of no length, the gradient is 0.
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS, launch

wp.set_module_options(MODULE_OPTIONS)


@wp.func
def sign_of_change(change: float) -> float:
    s = float(0.0)
    if change > 0.0:
        s = 1.0
    if change < 0.0:
        s = -1.0
    return s


@wp.kernel
def _isometry(
    # In:
    begin: int,
    frame_count: int,
    vertices: wp.array2d(dtype=wp.vec3),
    edges: wp.array2d(dtype=wp.int32),
    share: float,
    weight: float,
    # Out, added to:
    loss_out: wp.array(dtype=wp.float64),
    adj_vertices_out: wp.array2d(dtype=wp.vec3),
):
    """One thread an edge of a frame. The loss between t and t + 1 counts for frame t."""
    k = begin + wp.tid()
    t = k // edges.shape[0]
    e = k - t * edges.shape[0]
    i = edges[e, 0]
    j = edges[e, 1]
    d = vertices[t, i] - vertices[t, j]
    length = wp.length(d)
    pull = float(0.0)
    if t > 0:
        pull = pull + sign_of_change(length - wp.length(vertices[t - 1, i] - vertices[t - 1, j]))
    if t + 1 < frame_count:
        change = length - wp.length(vertices[t + 1, i] - vertices[t + 1, j])
        pull = pull + sign_of_change(change)
        wp.atomic_add(loss_out, t, wp.float64(share * wp.abs(change)))
    if length > 0.0 and pull != 0.0:
        g = (weight * share * pull / length) * d
        wp.atomic_add(adj_vertices_out, t, i, g)
        wp.atomic_add(adj_vertices_out, t, j, -g)


def isometry(begin, count, vertices, edges, share, weight, loss_out, adj_vertices_out):
    """Loss and gradient for ``count`` edges from ``begin``, counted over all frames (frame t owns E of them).

    Args:
        vertices: shape (T, V) vec3, cube units. edges: shape (E, 2) int32.
        share: factor of the loss, 1 / ((T - 1) E) for a mean. weight: in the gradient, not in the loss.
        loss_out: shape (T,) float64, added to. adj_vertices_out: shape (T, V) vec3, added to.
    """
    inputs = [begin, vertices.shape[0], vertices, edges, share, weight, loss_out, adj_vertices_out]
    launch(_isometry, count, inputs, vertices.device)
