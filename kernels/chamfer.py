"""Robust Chamfer residuals on frozen nearest neighbours, both directions (paper, eq. of CD_R).

A moving set (template vertices, moved clouds) meets a fixed cloud. With r = moving - fixed and n the fixed normal,

    e = w ((n . r)^2 + tau (|r|^2 - (n . r)^2)),    w = exp(-alpha |r|^power), a constant to the gradient
    adjoint: adj moving += 2 w ((1 - tau) (n . r) n + tau r)

tau = 1 is the plain squared distance of the paper. tau < 1 damps the part of a residual along the surface, which says
where the fixed cloud happens to be sampled rather than where the surface is. Not differentiated: which neighbour is
nearest (piecewise constant), and w.
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS, launch

wp.set_module_options(MODULE_OPTIONS)


@wp.func
def robust_weight(r_sq: float, alpha: float, power: int) -> float:
    """exp(-alpha d^2) (power 2, as printed) or exp(-alpha d^4) (power 4)."""
    x = r_sq
    if power == 4:
        x = r_sq * r_sq
    return wp.exp(-alpha * x)


@wp.func
def residual_energy(r: wp.vec3, n: wp.vec3, tangential: float) -> float:
    along = wp.dot(n, r)
    return (1.0 - tangential) * along * along + tangential * wp.length_sq(r)


@wp.func
def adj_residual_energy(r: wp.vec3, n: wp.vec3, tangential: float, adj: float) -> wp.vec3:
    return (2.0 * adj) * ((1.0 - tangential) * wp.dot(n, r) * n + tangential * r)


@wp.kernel
def _moving_to_fixed(
    # In:
    begin: int,
    moving: wp.array(dtype=wp.vec3),
    slot: wp.array(dtype=wp.int32),
    nearest: wp.array(dtype=wp.int32),
    fixed: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    share: wp.array(dtype=wp.float32),
    weight: wp.array(dtype=wp.float32),
    alpha: float,
    power: int,
    tangential: float,
    # Out, added to:
    loss_out: wp.array(dtype=wp.float64),
    # Out:
    adj_moving_out: wp.array(dtype=wp.vec3),
):
    """One thread a moving point; its gradient is written, not added."""
    i = begin + wp.tid()
    j = nearest[i]
    adj = wp.vec3(0.0, 0.0, 0.0)
    if j >= 0:
        s = slot[i]
        r = moving[i] - fixed[j]
        w = robust_weight(wp.length_sq(r), alpha, power) * share[s]
        wp.atomic_add(loss_out, s, wp.float64(w * residual_energy(r, normals[j], tangential)))
        adj = adj_residual_energy(r, normals[j], tangential, w * weight[s])
    adj_moving_out[i] = adj


@wp.kernel
def _fixed_to_moving(
    # In:
    begin: int,
    fixed: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    slot: wp.array(dtype=wp.int32),
    nearest: wp.array(dtype=wp.int32),
    moving: wp.array(dtype=wp.vec3),
    share: wp.array(dtype=wp.float32),
    weight: wp.array(dtype=wp.float32),
    alpha: float,
    power: int,
    tangential: float,
    # Out, added to:
    loss_out: wp.array(dtype=wp.float64),
    adj_moving_out: wp.array(dtype=wp.vec3),
):
    """One thread a fixed point; its gradient lands on its nearest moving point, which others may share."""
    i = begin + wp.tid()
    j = nearest[i]
    if j >= 0:
        s = slot[i]
        r = moving[j] - fixed[i]
        w = robust_weight(wp.length_sq(r), alpha, power) * share[s]
        wp.atomic_add(loss_out, s, wp.float64(w * residual_energy(r, normals[i], tangential)))
        wp.atomic_add(adj_moving_out, j, adj_residual_energy(r, normals[i], tangential, w * weight[s]))


def moving_to_fixed(
    begin, count, moving, slot, nearest, fixed, normals, share, weight, robust, loss_out, adj_moving_out
):
    """First half of CD_R, from every moving point to its nearest fixed one.

    Args:
        moving, adj_moving_out: shape (A,) vec3, cube units; the gradient is overwritten.
        slot: shape (A,) int32, which pair of sets a point belongs to. nearest: shape (A,) int32, -1 for none.
        fixed, normals: shape (B,) vec3.
        share: shape (slots,) float32, 1 for a sum over points, 1/|A| for a mean; part of the loss.
        weight: shape (slots,) float32, weight of the slot in the objective; in the gradient, not in the loss.
        robust: (alpha, power, tangential).
        loss_out: shape (slots,) float64, added to.
    """
    inputs = [begin, moving, slot, nearest, fixed, normals, share, weight, *robust, loss_out, adj_moving_out]
    launch(_moving_to_fixed, count, inputs, moving.device)


def fixed_to_moving(
    begin, count, fixed, normals, slot, nearest, moving, share, weight, robust, loss_out, adj_moving_out
):
    """Second half of CD_R, from every fixed point to its nearest moving one; adds to ``adj_moving_out``.

    Shapes as in ``moving_to_fixed``, with slot and nearest of shape (B,).
    """
    inputs = [begin, fixed, normals, slot, nearest, moving, share, weight, *robust, loss_out, adj_moving_out]
    launch(_fixed_to_moving, count, inputs, fixed.device)
