"""Robust Chamfer residuals on frozen nearest neighbours, both directions (paper, eq. of CD_R).

A moving set (template vertices, moved clouds) meets a fixed cloud. With r = moving - fixed and n the fixed normal,

    e = w ((n . r)^2 + tau (|r|^2 - (n . r)^2)),    w = exp(-alpha |r|^power), a constant to the gradient
    adjoint: adj moving += 2 w ((1 - tau) (n . r) n + tau r)

tau = 1 is the plain squared distance of the paper. tau < 1 damps the part of a residual along the surface, which says
where the fixed cloud happens to be sampled rather than where the surface is. Not differentiated: which neighbour is
nearest (piecewise constant), and w.

One-sided: where the other set shows only part of the surface, a point of the hidden part has a nearest one all the
same. What tells is the way back: that one's own nearest point is far from where the question came from. A pair then
counts by a further weight exp(-(b / reach)^4), b the distance between the point and its partner's partner.
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS, launch
from warpdef.kernels.sizes import sizes
from warpdef.kernels.warp_sums import add_loss

wp.set_module_options(MODULE_OPTIONS)


@wp.func
def robust_weight(r_sq: float, alpha: float, power: int) -> float:
    """exp(-alpha d^2) (power 2, as printed) or exp(-alpha d^4) (power 4)."""
    x = r_sq
    if power == 4:
        x = r_sq * r_sq
    return wp.exp(-alpha * x)


@wp.func
def mutual_weight(
    points: wp.array[wp.vec3],
    i: int,
    back: wp.array[wp.int32],
    j: int,
    reach: wp.array[wp.float32],
    s: int,
) -> float:
    """Of the pair of point i with point j of the other set: 1 for partners that choose each other, 1/e at reach[s].

    ``back``: the nearest of ``points`` to each of the other set, -1 for none; empty where every pair counts. No way
    back and an infinite reach give exactly 1.
    """
    w = float(1.0)
    if back.shape[0] > 0 and back[j] >= 0:
        x = wp.length_sq(points[back[j]] - points[i]) / (reach[s] * reach[s])
        w = wp.exp(-x * x)
    return w


@wp.func
def residual_energy(r: wp.vec3, n: wp.vec3, tangential: float) -> float:
    along = wp.dot(n, r)
    return (1.0 - tangential) * along * along + tangential * wp.length_sq(r)


@wp.func
def adj_residual_energy(r: wp.vec3, n: wp.vec3, tangential: float, adj: float) -> wp.vec3:
    return (2.0 * adj) * ((1.0 - tangential) * wp.dot(n, r) * n + tangential * r)


@sizes(
    "threads moving slot nearest adj_moving_out: A; fixed normals: B; share weight loss_out: S; back: B?; "
    "mutual_reach: S?"
)
@wp.kernel
def _moving_to_fixed(
    # In:
    begin: int,
    moving: wp.array[wp.vec3],
    slot: wp.array[wp.int32],
    nearest: wp.array[wp.int32],
    fixed: wp.array[wp.vec3],
    normals: wp.array[wp.vec3],
    share: wp.array[wp.float32],
    weight: wp.array[wp.float32],
    alpha: float,
    power: int,
    tangential: float,
    back: wp.array[wp.int32],
    mutual_reach: wp.array[wp.float32],
    # Out, added to:
    loss_out: wp.array[wp.float64],
    adj_moving_out: wp.array[wp.vec3],
):
    """One thread a moving point."""
    i = begin + wp.tid()
    j = nearest[i]
    if j >= 0:
        s = slot[i]
        r = moving[i] - fixed[j]
        w = robust_weight(wp.length_sq(r), alpha, power) * share[s]
        w *= mutual_weight(moving, i, back, j, mutual_reach, s)
        add_loss(s, wp.float64(w * residual_energy(r, normals[j], tangential)), loss_out)
        adj_moving_out[i] = adj_moving_out[i] + adj_residual_energy(r, normals[j], tangential, w * weight[s])


@sizes(
    "threads fixed normals slot nearest: B; moving adj_moving_out: A; share weight loss_out: S; back: A?; "
    "mutual_reach: S?"
)
@wp.kernel
def _fixed_to_moving(
    # In:
    begin: int,
    fixed: wp.array[wp.vec3],
    normals: wp.array[wp.vec3],
    slot: wp.array[wp.int32],
    nearest: wp.array[wp.int32],
    moving: wp.array[wp.vec3],
    share: wp.array[wp.float32],
    weight: wp.array[wp.float32],
    alpha: float,
    power: int,
    tangential: float,
    back: wp.array[wp.int32],
    mutual_reach: wp.array[wp.float32],
    # Out, added to:
    loss_out: wp.array[wp.float64],
    adj_moving_out: wp.array[wp.vec3],
):
    """One thread a fixed point; its gradient lands on its nearest moving point, which others may share."""
    i = begin + wp.tid()
    j = nearest[i]
    if j >= 0:
        s = slot[i]
        r = moving[j] - fixed[i]
        w = robust_weight(wp.length_sq(r), alpha, power) * share[s]
        w *= mutual_weight(fixed, i, back, j, mutual_reach, s)
        add_loss(s, wp.float64(w * residual_energy(r, normals[i], tangential)), loss_out)
        wp.atomic_add(adj_moving_out, j, adj_residual_energy(r, normals[i], tangential, w * weight[s]))


OneSided = tuple[wp.array | None, wp.array | None]
BOTH_SIDES: OneSided = (None, None)  # every pair counts


def moving_to_fixed(
    begin: int, count: int, moving: wp.array, slot: wp.array, nearest: wp.array, fixed: wp.array, normals: wp.array,
    share: wp.array, weight: wp.array, robust: tuple[float, int, float], loss_out: wp.array, adj_moving_out: wp.array,
    one_sided: OneSided = BOTH_SIDES,
) -> None:  # fmt: skip
    """First half of CD_R, from every moving point to its nearest fixed one.

    Args:
        moving, adj_moving_out: shape (A,) vec3, cube units; the gradient is added to.
        slot: shape (A,) int32, which pair of sets a point belongs to. nearest: shape (A,) int32, -1 for none.
        fixed, normals: shape (B,) vec3.
        share: shape (slots,) float32, 1 for a sum over points, 1/|A| for a mean; part of the loss.
        weight: shape (slots,) float32, weight of the slot in the objective; in the gradient, not in the loss.
        robust: (alpha, power, tangential).
        loss_out: shape (slots,) float64, added to.
        one_sided: (back, reach): nearest moving point of every fixed one, shape (B,) int32, -1 for none; and shape
            (slots,) float32, cube units, infinite where every pair counts.
    """
    inputs = [begin, moving, slot, nearest, fixed, normals, share, weight, *robust, *one_sided]
    launch(_moving_to_fixed, count, [*inputs, loss_out, adj_moving_out], moving.device)


def fixed_to_moving(
    begin: int, count: int, fixed: wp.array, normals: wp.array, slot: wp.array, nearest: wp.array, moving: wp.array,
    share: wp.array, weight: wp.array, robust: tuple[float, int, float], loss_out: wp.array, adj_moving_out: wp.array,
    one_sided: OneSided = BOTH_SIDES,
) -> None:  # fmt: skip
    """Second half of CD_R, from every fixed point to its nearest moving one; adds to ``adj_moving_out``.

    Shapes as in ``moving_to_fixed``, with slot and nearest of shape (B,) and the way back of shape (A,).
    """
    inputs = [begin, fixed, normals, slot, nearest, moving, share, weight, *robust, *one_sided]
    launch(_fixed_to_moving, count, [*inputs, loss_out, adj_moving_out], fixed.device)
