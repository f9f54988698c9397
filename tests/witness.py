"""The forward formulas in plain Warp, for Warp's own autodiff: a third witness of every hand-written adjoint.

Nothing here shares code with the kernels but the rotation, whose own function is differentiated. One module for all
tests, so that it compiles once. No loops: Warp differentiates straight lines most safely.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from warpdef.kernels.cayley import rotate
from warpdef.kernels.levels import node8

wp.set_module_options({"enable_backward": True, "max_unroll": 0})


@wp.kernel
def sample_level(
    begin: int,
    n: int,
    share: float,
    nodes: wp.array(dtype=node8),
    points: wp.array(dtype=wp.vec3),
    value_out: wp.array(dtype=node8),
):
    """Adds one level's trilinear interpolation."""
    i = wp.tid()
    half = 0.5 * float(n - 1)
    top = float(n - 1)
    p = points[i]
    ux = wp.clamp((p[0] + 1.0) * half, 0.0, top)
    uy = wp.clamp((p[1] + 1.0) * half, 0.0, top)
    uz = wp.clamp((p[2] + 1.0) * half, 0.0, top)
    last = wp.max(n - 2, 0)
    step = wp.min(n - 1, 1)
    ix = wp.min(int(wp.floor(ux)), last)
    iy = wp.min(int(wp.floor(uy)), last)
    iz = wp.min(int(wp.floor(uz)), last)
    fx = ux - float(ix)
    fy = uy - float(iy)
    fz = uz - float(iz)
    c = begin + (ix * n + iy) * n + iz
    sx = step * n * n
    sy = step * n
    low = (1.0 - fy) * ((1.0 - fz) * nodes[c] + fz * nodes[c + step])
    low = low + fy * ((1.0 - fz) * nodes[c + sy] + fz * nodes[c + sy + step])
    high = (1.0 - fy) * ((1.0 - fz) * nodes[c + sx] + fz * nodes[c + sx + step])
    high = high + fy * ((1.0 - fz) * nodes[c + sx + sy] + fz * nodes[c + sx + sy + step])
    wp.atomic_add(value_out, i, share * ((1.0 - fx) * low + fx * high))


@wp.kernel
def apply_motion(value: wp.array(dtype=node8), points: wp.array(dtype=wp.vec3), moved_out: wp.array(dtype=wp.vec3)):
    """y = R(z) x + t."""
    i = wp.tid()
    v = value[i]
    moved_out[i] = rotate(wp.vec3(v[0], v[1], v[2]), points[i]) + wp.vec3(v[3], v[4], v[5])


@wp.kernel
def chamfer_pairs(
    moving: wp.array(dtype=wp.vec3),
    fixed: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    moving_index: wp.array(dtype=wp.int32),
    fixed_index: wp.array(dtype=wp.int32),
    weight: wp.array(dtype=wp.float32),
    tangential: float,
    loss_out: wp.array(dtype=wp.float32),
):
    """One thread a pair; the weight is given, hence constant."""
    k = wp.tid()
    j = fixed_index[k]
    r = moving[moving_index[k]] - fixed[j]
    along = wp.dot(r, normals[j]) * normals[j]
    across = r - along
    wp.atomic_add(loss_out, 0, weight[k] * (wp.dot(along, along) + tangential * wp.dot(across, across)))


@wp.kernel
def edge_changes(
    vertices: wp.array2d(dtype=wp.vec3),
    edges: wp.array2d(dtype=wp.int32),
    weight: float,
    loss_out: wp.array(dtype=wp.float32),
):
    """One thread an edge between two frames."""
    t, e = wp.tid()
    i = edges[e, 0]
    j = edges[e, 1]
    before = wp.length(vertices[t, i] - vertices[t, j])
    after = wp.length(vertices[t + 1, i] - vertices[t + 1, j])
    wp.atomic_add(loss_out, 0, weight * wp.abs(after - before))


def pad(six: np.ndarray) -> np.ndarray:
    """(..., 6) -> (..., 8) float32, the two pads 0."""
    return np.concatenate([six, np.zeros((*six.shape[:-1], 2))], axis=-1).astype(np.float32)


def variable(values: np.ndarray, dtype, device: str) -> wp.array:
    """An array that autodiff may differentiate with respect to."""
    return wp.array(np.ascontiguousarray(values, np.float32), dtype=dtype, device=device, requires_grad=True)


def sample_all(levels: list[int], nodes: wp.array, points: wp.array) -> wp.array:
    """Every level of one transition, inside a tape."""
    value = wp.zeros(len(points), dtype=node8, device=nodes.device, requires_grad=True)
    begin = 0
    for n in levels:
        inputs = [begin, n, 1.0 / len(levels), nodes, points, value]
        wp.launch(sample_level, len(points), inputs=inputs, device=nodes.device)
        begin += n**3
    return value


def move(levels: list[int], nodes: wp.array, points: wp.array) -> wp.array:
    """Points moved by one transition's grid, inside a tape."""
    moved = wp.zeros(len(points), dtype=wp.vec3, device=nodes.device, requires_grad=True)
    value = sample_all(levels, nodes, points)
    wp.launch(apply_motion, len(points), inputs=[value, points, moved], device=nodes.device)
    return moved
