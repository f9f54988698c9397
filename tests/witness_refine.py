"""The vertex stage's energies in plain Warp, for Warp's own autodiff: a third witness beside twin and differences."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": True, "max_unroll": 0})


@wp.kernel
def rigid_edges(
    vertices: wp.array2d(dtype=wp.vec3),
    rest: wp.array(dtype=wp.vec3),
    rotation: wp.array2d(dtype=wp.mat33),
    edges: wp.array2d(dtype=wp.int32),
    stiffness: wp.array(dtype=wp.float32),
    loss_out: wp.array(dtype=wp.float32),
):
    """One thread an edge of a frame."""
    t, e = wp.tid()
    i = edges[e, 0]
    j = edges[e, 1]
    mean = 0.5 * (rotation[t, i] + rotation[t, j])
    residual = vertices[t, i] - vertices[t, j] - mean * (rest[i] - rest[j])
    wp.atomic_add(loss_out, 0, 0.5 * (stiffness[i] + stiffness[j]) * wp.dot(residual, residual))


@wp.kernel
def plane_pairs(
    move: wp.array(dtype=wp.vec3),
    owner: wp.array(dtype=wp.int32),
    offset: wp.array(dtype=wp.vec3),
    plane: wp.array(dtype=wp.vec3),
    weight: wp.array(dtype=wp.float32),
    loss_out: wp.array(dtype=wp.float32),
):
    """One thread a pair; ``offset`` is x - q; plane and weight are given, hence constant."""
    k = wp.tid()
    r = wp.dot(plane[k], offset[k] + move[owner[k]])
    wp.atomic_add(loss_out, 0, weight[k] * r * r)
