"""Noisy points belong to all of the surface around them: the normal equations of a mixture of Gaussians.

A point q that noise of standard deviation s moved off the surface in any direction may have come from every vertex x
around it, from each with the probability of the expectation step (Myronenko and Song 2010, *Coherent Point Drift*):

    p_i = exp(-|q - x_i|^2 / 2 s^2) / (u + sum_j exp(-|q - x_j|^2 / 2 s^2))

and asks each for its part, across the surface alone: A_i += w p_i m_i m_i^T, b_i += w p_i m_i . (q - x_i) m_i, with m
the vertex's normal and u for points that belong to nothing. Two sums a vertex are enough for that. The nearest vertex
in place of all draws a curved surface outwards by its mean curvature times s^2, as more of the noise lies outside;
this does not. Vertices beyond three s are not asked. No gradient: p and m are held.
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.cells import Targets, axis_cell
from warpdef.kernels.launching import MODULE_OPTIONS, launch
from warpdef.kernels.sizes import sizes

wp.set_module_options(MODULE_OPTIONS)

_ASKED_WITHIN = wp.constant(3.0)  # standard deviations
_NOTHING = wp.constant(0.05)  # u: a vertex 2.4 of them away says as much


@sizes("threads cloud frame: K; deviation: G; normals sums_out: N")
@wp.kernel
def _mixture_sums(
    # In:
    begin: int,
    weight: float,
    cloud: wp.array[wp.vec3],
    frame: wp.array[wp.int32],
    deviation: wp.array[wp.float32],
    targets: Targets,
    normals: wp.array[wp.vec3],
    # Out, added to:
    sums_out: wp.array[wp.vec3],
):
    """One thread a cloud point, whose vertices others share: what they sum to first, then each one's part."""
    i = begin + wp.tid()
    q = cloud[i]
    group = frame[i]
    s = deviation[group]
    reach = _ASKED_WITHIN * s
    cells = targets.cells
    x0 = axis_cell(q[0] - reach, cells.lower[0], cells.size, cells.nx)
    x1 = axis_cell(q[0] + reach, cells.lower[0], cells.size, cells.nx) + 1
    y0 = axis_cell(q[1] - reach, cells.lower[1], cells.size, cells.ny)
    y1 = axis_cell(q[1] + reach, cells.lower[1], cells.size, cells.ny) + 1
    z0 = axis_cell(q[2] - reach, cells.lower[2], cells.size, cells.nz)
    z1 = axis_cell(q[2] + reach, cells.lower[2], cells.size, cells.nz) + 1
    limit = reach * reach
    fall = -0.5 / (s * s)
    total = float(_NOTHING)
    part = float(0.0)
    for turn in range(2):
        if turn == 1:
            part = weight / total
        for z in range(z0, z1):
            for y in range(y0, y1):
                line = (z * cells.ny + y) * cells.nx
                for slot in range(targets.start[group, line + x0], targets.start[group, line + x1]):
                    r = q - targets.sorted_points[slot]
                    d = wp.length_sq(r)
                    if d < limit:
                        p = wp.exp(fall * d)
                        if turn == 0:
                            total += p
                        else:
                            j = targets.order[slot]
                            share = part * p
                            wp.atomic_add(sums_out, j, wp.vec3(share, share * wp.dot(normals[j], r), 0.0))


@sizes("threads normals rhs matrix_out: N")
@wp.kernel
def _mixture_planes(
    # In:
    begin: int,
    normals: wp.array[wp.vec3],
    # In and out: sums, then the right-hand side
    rhs: wp.array[wp.vec3],
    # Out:
    matrix_out: wp.array[wp.mat33],
):
    """One thread a vertex of a frame: its equations by its sums, which they replace."""
    i = begin + wp.tid()
    m = normals[i]
    sums = rhs[i]
    rhs[i] = sums[1] * m
    matrix_out[i] = sums[0] * wp.outer(m, m)


@sizes("threads sums_out: N")
@wp.kernel
def _clear_sums(
    # In:
    begin: int,
    # Out:
    sums_out: wp.array[wp.vec3],
):
    """One thread a vertex of a frame."""
    sums_out[begin + wp.tid()] = wp.vec3()


def clear_sums(begin: int, count: int, sums_out: wp.array) -> None:
    """Zero the sums of vertices ``begin .. begin + count``; (T V,) vec3."""
    launch(_clear_sums, count, [begin, sums_out], sums_out.device)


def mixture_sums(
    begin: int, count: int, weight: float, cloud: wp.array, frame: wp.array, deviation: wp.array, targets: Targets,
    normals: wp.array, sums_out: wp.array,
) -> None:  # fmt: skip
    """Add what cloud points ``begin .. begin + count`` ask of the vertices around them: sum of w p, and of w p m . r.

    Args:
        weight: of a point. cloud: shape (N,) vec3. frame: shape (N,) int32, the group of targets a point belongs to.
        deviation: shape (T,) float32, of each frame's noise, above 0. targets: vertices, sorted (``cells``).
        normals: of the vertices, shape (T V,) vec3. sums_out: shape (T V,) vec3, its third component left alone.
    """
    inputs = [begin, weight, cloud, frame, deviation, targets, normals, sums_out]
    launch(_mixture_sums, count, inputs, cloud.device)


def mixture_planes(begin: int, count: int, normals: wp.array, rhs: wp.array, matrix_out: wp.array) -> None:
    """Normal equations of vertices ``begin .. begin + count``, by their sums, which are where the right-hand side goes.

    Args:
        normals: shape (T V,) vec3. rhs: shape (T V,) vec3, of ``mixture_sums``. matrix_out: shape (T V,) mat33.
    """
    launch(_mixture_planes, count, [begin, normals, rhs, matrix_out], rhs.device)
