"""The material of a surface: a stiffness a vertex, for what strains most in all frames yields most.

An edge of ``rigidity`` weighs the mean of what its ends weigh. Of a vertex i ``strains`` tells the mean square strain
of its edges over all frames,

    sum_t sum_j | (x_i,t - x_j,t) - (R_i,t + R_j,t)/2 (y_i - y_j) |^2  /  (T sum_j |y_i - y_j|^2)
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS, launch
from warpdef.kernels.sizes import sizes

wp.set_module_options(MODULE_OPTIONS)


@wp.func
def edge_stiffness(stiffness: wp.array[wp.float32], i: int, j: int) -> float:
    """Of the edge between i and j; 1 where no stiffness is given."""
    weight = float(1.0)
    if stiffness.shape[0] > 0:
        weight = 0.5 * (stiffness[i] + stiffness[j])
    return weight


@wp.func
def stiffness_around(stiffness: wp.array[wp.float32], i: int, row: wp.array[wp.int32], column: wp.array[wp.int32]):
    """The sum over the edges of vertex i: how many there are, where no stiffness is given."""
    total = float(row[i + 1] - row[i])
    if stiffness.shape[0] > 0:
        total = float(0.0)
        for e in range(row[i], row[i + 1]):
            total += edge_stiffness(stiffness, i, column[e])
    return total


@sizes("threads rest strain_out: V; row: V+1; column: E; rotation vertices: T V")
@wp.kernel
def _strains(
    # In:
    begin: int,
    row: wp.array[wp.int32],
    column: wp.array[wp.int32],
    rest: wp.array[wp.vec3],
    rotation: wp.array2d[wp.mat33],
    vertices: wp.array2d[wp.vec3],
    # Out:
    strain_out: wp.array[wp.float32],
):
    """One thread a vertex."""
    i = begin + wp.tid()
    strained = float(0.0)
    whole = float(0.0)
    for e in range(row[i], row[i + 1]):
        j = column[e]
        edge = rest[i] - rest[j]
        whole += wp.length_sq(edge)
        for t in range(vertices.shape[0]):
            turned = 0.5 * ((rotation[t, i] + rotation[t, j]) * edge)
            strained += wp.length_sq(turned - (vertices[t, i] - vertices[t, j]))
    strain = float(0.0)
    if whole > 0.0:
        strain = strained / (float(vertices.shape[0]) * whole)
    strain_out[i] = strain


def strains(
    begin: int, count: int, row: wp.array, column: wp.array, rest: wp.array, rotation: wp.array, vertices: wp.array,
    strain_out: wp.array,
) -> None:  # fmt: skip
    """Mean square strain of vertices ``begin .. begin + count``; 0 without edges, or where these have no length.

    Args:
        row, column: neighbours, as in ``Graph``. rest: shape (V,) vec3. rotation: shape (T, V) mat33.
        vertices: shape (T, V) vec3. strain_out: shape (V,) float32.
    """
    launch(_strains, count, [begin, row, column, rest, rotation, vertices, strain_out], vertices.device)
