"""Vertices through all transitions at once, from the keyframe to both ends and back: the way of CUDA.

What ``motion.move_vertices`` and its adjoint do to one transition, a thread here does to a vertex in all transitions of
one direction, one after the other. A launch a transition would leave a device idle between two of them. The CPU goes
transition by transition, whose grid then stays in the cache.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from warpdef.kernels.cayley import rotate, rotate_along
from warpdef.kernels.launching import MODULE_OPTIONS, launch
from warpdef.kernels.levels import node8
from warpdef.kernels.motion import motion_gradient
from warpdef.kernels.sizes import sizes
from warpdef.kernels.trilinear import part_jacobian, sample_part

wp.set_module_options(MODULE_OPTIONS)


@sizes("order source target: S; bounds: 3")
@wp.struct
class Routes:
    """Both ways outwards from the keyframe; made by ``routes_of``.

    order: transitions in the order in which they are gone, forwards, then backwards     (S,)
    bounds: where in ``order`` a direction begins, and the last one ends                  (3,)
    source, target: frames of each transition                                             (S,)
    """

    order: wp.array[wp.int32]
    bounds: wp.array[wp.int32]
    source: wp.array[wp.int32]
    target: wp.array[wp.int32]


@sizes("threads: 2*V; nodes: S M; levels: 2*L; level_count: L; vertices: T V; rotation_out jacobian_out: S V")
@wp.kernel(launch_bounds=(256, 4))
def _move_chains(
    # In:
    routes: Routes,
    nodes: wp.array2d[node8],
    levels: wp.array[wp.int32],
    level_count: int,
    # In and out: the keyframe's row is read, all others written
    vertices: wp.array2d[wp.vec3],
    # Out:
    rotation_out: wp.array2d[wp.vec3],
    jacobian_out: wp.array2d[wp.mat33],
):
    """One thread a vertex and direction."""
    k = wp.tid()
    d = k // vertices.shape[1]
    i = k - d * vertices.shape[1]
    for step in range(routes.bounds[d], routes.bounds[d + 1]):
        s = routes.order[step]
        x = vertices[routes.source[s], i]
        # First all of the rotation; the translation is then added to what is there already.
        r = sample_part(nodes, s, levels, level_count, 0, x[0], x[1], x[2], part_jacobian())
        z = wp.vec3(r[0, 0], r[0, 1], r[0, 2])
        rotation_out[s, i] = z
        moved = wp.matrix_from_rows(
            rotate(z, x),
            rotate(z, wp.vec3(1.0, 0.0, 0.0)) + rotate_along(z, x, wp.vec3(r[1, 0], r[1, 1], r[1, 2])),
            rotate(z, wp.vec3(0.0, 1.0, 0.0)) + rotate_along(z, x, wp.vec3(r[2, 0], r[2, 1], r[2, 2])),
            rotate(z, wp.vec3(0.0, 0.0, 1.0)) + rotate_along(z, x, wp.vec3(r[3, 0], r[3, 1], r[3, 2])),
        )
        y = sample_part(nodes, s, levels, level_count, 3, x[0], x[1], x[2], moved)
        vertices[routes.target[s], i] = wp.vec3(y[0, 0], y[0, 1], y[0, 2])
        jacobian_out[s, i] = wp.matrix_from_rows(y[1], y[2], y[3])


@sizes(
    "threads: 2*V; vertices adj_weighed adj_plain: T V; confidence: T; "
    "rotation jacobian adj_motion_out: S V; carry: T+1 V"
)
@wp.kernel
def _adj_move_chains(
    # In:
    routes: Routes,
    vertices: wp.array2d[wp.vec3],
    rotation: wp.array2d[wp.vec3],
    jacobian: wp.array2d[wp.mat33],
    confidence: wp.array[wp.float32],
    adj_weighed: wp.array2d[wp.vec3],
    adj_plain: wp.array2d[wp.vec3],
    # In and out: rows of the last frames are read, all others written
    carry: wp.array2d[wp.vec3],
    # Out:
    adj_motion_out: wp.array2d[node8],
):
    """One thread a vertex and direction, from the end inwards."""
    k = wp.tid()
    d = k // vertices.shape[1]
    i = k - d * vertices.shape[1]
    first = routes.bounds[d]
    step = routes.bounds[d + 1] - 1
    if step >= first:
        beyond = carry[routes.target[routes.order[step]], i]
        while step >= first:
            s = routes.order[step]
            t = routes.target[s]
            a = confidence[t] * adj_weighed[t, i] + adj_plain[t, i] + beyond
            adj_motion_out[s, i] = motion_gradient(rotation[s, i], vertices[routes.source[s], i], a)
            beyond = jacobian[s, i] * a
            to = routes.source[s]
            if d == 1 and step == first:
                to = carry.shape[0] - 1  # at the keyframe, which two chains reach
            carry[to, i] = beyond
            step = step - 1


def routes_of(
    forward: range, backward: range, source: np.ndarray, target: np.ndarray, device: wp.Device
) -> Routes:  # fmt: skip
    """Routes on a device from the transitions of each direction, in order; source and target, shape (S,) int."""
    routes, bounds = Routes(), [0, len(forward), len(forward) + len(backward)]
    arrays = ([*forward, *backward], bounds, source, target)
    on_device = (wp.array(np.asarray(a, dtype=np.int32), dtype=wp.int32, device=device) for a in arrays)
    routes.order, routes.bounds, routes.source, routes.target = on_device
    return routes


def move_chains(
    routes: Routes,
    nodes: wp.array,
    levels: wp.array,
    vertices: wp.array,
    rotation_out: wp.array,
    jacobian_out: wp.array,
) -> None:
    """Move all vertices from the keyframe to all frames; arrays as in ``motion.move_vertices``."""
    inputs = [routes, nodes, levels, len(levels) // 2, vertices, rotation_out, jacobian_out]
    launch(_move_chains, 2 * vertices.shape[1], inputs, nodes.device)


def adj_move_chains(
    routes: Routes, vertices: wp.array, rotation: wp.array, jacobian: wp.array, confidence: wp.array,
    adj_weighed: wp.array, adj_plain: wp.array, carry: wp.array, adj_motion_out: wp.array,
) -> None:  # fmt: skip
    """Adjoint of ``move_chains``, all but its scatter; arrays as in ``motion.adj_move_vertices``."""
    inputs = [routes, vertices, rotation, jacobian, confidence, adj_weighed, adj_plain, carry, adj_motion_out]
    launch(_adj_move_chains, 2 * vertices.shape[1], inputs, vertices.device)
