"""Marching tetrahedra's vertices in plain Warp, for Warp's own autodiff."""

from __future__ import annotations

import warp as wp

from warpdef.kernels.levels import node8

wp.set_module_options({"enable_backward": True, "max_unroll": 0})


@wp.kernel
def weighted_vertices(
    edges: wp.array2d(dtype=wp.int32),
    rest: wp.array(dtype=wp.vec3),
    field: wp.array(dtype=node8),
    bound: float,
    weight: wp.array(dtype=wp.vec3),
    loss_out: wp.array(dtype=wp.float32),
):
    """Adds weight . v of every edge."""
    e = wp.tid()
    a = field[edges[e, 0]]
    b = field[edges[e, 1]]
    x = rest[edges[e, 0]] + bound * wp.vec3(wp.tanh(a[1]), wp.tanh(a[2]), wp.tanh(a[3]))
    y = rest[edges[e, 1]] + bound * wp.vec3(wp.tanh(b[1]), wp.tanh(b[2]), wp.tanh(b[3]))
    v = (a[0] * y - b[0] * x) / (a[0] - b[0])
    wp.atomic_add(loss_out, 0, wp.dot(weight[e], v))
