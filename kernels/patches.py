"""What is smooth in time: a vertex's place in the moving frame of the patch of surface around it.

    pose of patch n in frame t:   x ~ Q_n,t y + s_n,t           the best rigid motion of its members, weighted
    local place of vertex i:      r_i,t = R_i,t^T (x_i,t - p_i,t)
    where its patches carry it:   p_i,t = sum_n w_in (Q_n,t y_i + s_n,t),   so that x = p + R r
    its course, off the even one: d_i,t = sum_u F_tu p_i,u - p_i,t
    how even it is:               q = k^2 / (k^2 + |d|^2)
    share of d given up:          s = c + (1 - c) q
    smooth place:                 e_i,t = p_i,t + s d_i,t + o R_i,t sum_u F_tu r_i,u
    held there:                   A += g I,   b = g (e - x),   g = h (1 + f q)

x a vertex, y its place in the rest shape, R its own rotation (``rigidity``), w its weights in at most four patches, F a
filter over the frames around t, c and o shares from 0 to 1, k a length. With c = 0, k = 0 and o = 1 patches carry
vertices along whatever they do, so that arcs stay arcs and a kick stays a kick: only what is left of a vertex's motion
in its neighbourhood is filtered. With k above 0 the patches' course is smoothed where it is off by k or less, as by
chance, with c above 0 wherever it goes; with o below 1 less is left of the vertex's own. Where the course is even a
vertex is held the more firmly, by f: smooth places are surer there.
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS, launch
from warpdef.kernels.rigidity import followed_rotation
from warpdef.kernels.sizes import sizes

wp.set_module_options(MODULE_OPTIONS)


@sizes("threads: T*M; row: M+1; member share: K; rest: V; vertices rotation: T V; turn_out shift_out: T M")
@wp.kernel
def _fit_patches(
    # In:
    begin: int,
    row: wp.array[wp.int32],
    member: wp.array[wp.int32],
    share: wp.array[wp.float32],
    rest: wp.array[wp.vec3],
    vertices: wp.array2d[wp.vec3],
    rotation: wp.array2d[wp.mat33],
    # Out:
    turn_out: wp.array2d[wp.mat33],
    shift_out: wp.array2d[wp.vec3],
):
    """One thread a patch of a frame."""
    k = begin + wp.tid()
    patches = turn_out.shape[1]
    t = k // patches
    n = k - t * patches
    whole = float(0.0)
    at = wp.vec3(0.0, 0.0, 0.0)
    origin = wp.vec3(0.0, 0.0, 0.0)
    for e in range(row[n], row[n + 1]):
        whole += share[e]
        at += share[e] * vertices[t, member[e]]
        origin += share[e] * rest[member[e]]
    at = at / whole
    origin = origin / whole
    s = wp.mat33()
    for e in range(row[n], row[n + 1]):
        i = member[e]
        s += wp.outer(share[e] * (vertices[t, i] - at), rest[i] - origin)
    turn = followed_rotation(s, rotation[t, member[row[n]]])
    turn_out[t, n] = turn
    shift_out[t, n] = at - turn * origin


@sizes("threads: T*V; patch weight: V W; rest: V; vertices rotation carried_out local_out: T V; turn shift: T M")
@wp.kernel
def _local_places(
    # In:
    begin: int,
    patch: wp.array2d[wp.int32],
    weight: wp.array2d[wp.float32],
    rest: wp.array[wp.vec3],
    vertices: wp.array2d[wp.vec3],
    rotation: wp.array2d[wp.mat33],
    turn: wp.array2d[wp.mat33],
    shift: wp.array2d[wp.vec3],
    # Out:
    carried_out: wp.array2d[wp.vec3],
    local_out: wp.array2d[wp.vec3],
):
    """One thread a vertex of a frame."""
    k = begin + wp.tid()
    t = k // rest.shape[0]
    i = k - t * rest.shape[0]
    carried = wp.vec3(0.0, 0.0, 0.0)
    for c in range(patch.shape[1]):
        n = patch[i, c]
        carried += weight[i, c] * (turn[t, n] * rest[i] + shift[t, n])
    carried_out[t, i] = carried
    local_out[t, i] = wp.transpose(rotation[t, i]) * (vertices[t, i] - carried)


@sizes("threads: T*V; first: T; filter: T W; rotation carried local matrix_out rhs_out: T V")
@wp.kernel
def _smooth_rhs(
    # In:
    begin: int,
    hold: float,
    own: float,
    course: float,
    chance: float,
    firmer: float,
    first: wp.array[wp.int32],
    filter: wp.array2d[wp.float32],
    rotation: wp.array2d[wp.mat33],
    carried: wp.array2d[wp.vec3],
    local: wp.array2d[wp.vec3],
    # Out, the matrix added to:
    matrix_out: wp.array2d[wp.mat33],
    rhs_out: wp.array2d[wp.vec3],
):
    """One thread a vertex of a frame."""
    k = begin + wp.tid()
    t = k // local.shape[1]
    i = k - t * local.shape[1]
    smooth = -local[t, i]
    off = -carried[t, i]
    for c in range(filter.shape[1]):
        smooth += own * filter[t, c] * local[first[t] + c, i]
        off += filter[t, c] * carried[first[t] + c, i]
    even = float(0.0)
    if chance > 0.0:
        even = chance * chance / (chance * chance + wp.length_sq(off))
    share = course + (1.0 - course) * even
    weight = hold * (1.0 + firmer * even)
    matrix_out[t, i] = matrix_out[t, i] + weight * wp.identity(n=3, dtype=float)
    rhs_out[t, i] = weight * (rotation[t, i] * smooth + share * off)


def fit_patches(
    begin: int, count: int, row: wp.array, member: wp.array, share: wp.array, rest: wp.array, vertices: wp.array,
    rotation: wp.array, turn_out: wp.array, shift_out: wp.array,
) -> None:  # fmt: skip
    """Best rigid motion from the rest shape of ``count`` patches from ``begin``, counted over all frames.

    Args:
        row, member, share: vertices of each patch in compressed rows, at least one each, and their weights, above 0.
        rest: shape (V,) vec3. vertices: shape (T, V) vec3.
        rotation: shape (T, V) mat33; a patch's is looked for from that of its first member.
        turn_out, shift_out: Q (T, M) mat33 and s (T, M) vec3.
    """
    inputs = [begin, row, member, share, rest, vertices, rotation, turn_out, shift_out]
    launch(_fit_patches, count, inputs, vertices.device)


def local_places(
    begin: int, count: int, patch: wp.array, weight: wp.array, rest: wp.array, vertices: wp.array, rotation: wp.array,
    turn: wp.array, shift: wp.array, carried_out: wp.array, local_out: wp.array,
) -> None:  # fmt: skip
    """Places p and r of ``count`` vertices from ``begin``, counted over all frames; both out (T, V) vec3.

    Args:
        patch, weight: of each vertex, shape (V, W) int32 and float32; weights sum to 1. All else as in ``fit_patches``.
    """
    inputs = [begin, patch, weight, rest, vertices, rotation, turn, shift, carried_out, local_out]
    launch(_local_places, count, inputs, vertices.device)


def smooth_rhs(
    begin: int, count: int, hold: float, own: float, course: float, chance: float, firmer: float, first: wp.array,
    filter: wp.array, rotation: wp.array, carried: wp.array, local: wp.array, matrix_out: wp.array, rhs_out: wp.array,
) -> None:  # fmt: skip
    """What holds ``count`` vertices from ``begin`` at their smooth places: added to the matrix, written to the rhs.

    Args:
        hold: weight h against one plane. own, course, chance, firmer: o, c, k and f.
        first, filter: shape (T,) int32 and (T, W) float32: F of frame t weighs W frames from ``first[t]`` on.
        rotation, matrix_out: shape (T, V) mat33. carried, local, rhs_out: shape (T, V) vec3.
    """
    launch(
        _smooth_rhs,
        count,
        [begin, hold, own, course, chance, firmer, first, filter, rotation, carried, local, matrix_out, rhs_out],
        local.device,
    )
