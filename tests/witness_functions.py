"""Kernels that call single device functions of ours, so that tests can ask for them alone, and one that is no one's."""

from __future__ import annotations

import warp as wp

from warpdef.kernels.cayley import adj_rotate, rotate, rotate_along
from warpdef.kernels.launching import MODULE_OPTIONS
from warpdef.kernels.levels import node8
from warpdef.kernels.trilinear import adj_sample, sample, sample_jacobian, sample_with_derivative

wp.set_module_options(MODULE_OPTIONS)


@wp.kernel
def sample_points(
    nodes: wp.array2d[node8],
    transition: int,
    levels: wp.array[wp.int32],
    points: wp.array[wp.vec3],
    value_out: wp.array[node8],
    jacobian_out: wp.array[sample_jacobian],
):
    i = wp.tid()
    p = points[i]
    count = levels.shape[0] / 2
    value_out[i] = sample(nodes, transition, levels, count, p[0], p[1], p[2])
    jacobian_out[i] = sample_with_derivative(nodes, transition, levels, count, p[0], p[1], p[2])


@wp.kernel
def scatter_points(
    transition: int,
    levels: wp.array[wp.int32],
    points: wp.array[wp.vec3],
    adj_value: wp.array[node8],
    adj_nodes_out: wp.array2d[node8],
):
    i = wp.tid()
    p = points[i]
    adj_sample(adj_nodes_out, transition, levels, levels.shape[0] / 2, p[0], p[1], p[2], adj_value[i])


@wp.kernel
def turn(
    z: wp.array[wp.vec3],
    x: wp.array[wp.vec3],
    other: wp.array[wp.vec3],
    turned_out: wp.array[wp.vec3],
    along_out: wp.array[wp.vec3],
    adj_out: wp.array[wp.vec3],
):
    i = wp.tid()
    turned_out[i] = rotate(z[i], x[i])
    along_out[i] = rotate_along(z[i], x[i], other[i])
    adj_out[i] = adj_rotate(z[i], x[i], other[i])


@wp.kernel(module="unique")
def plain(begin: int, source: int, row: wp.array[wp.int32], vertices: wp.array2d[wp.vec3]):
    vertices[source, begin] = float(row[0]) * vertices[source, begin]
