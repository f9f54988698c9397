"""What a frame does not show is where the frames around it say: vertices without points are held on the way between.

    A += h u I,   b += h u (e - x),   u = 1 - w |a|^2

x a vertex, e the place expected of it, w and a the weight and the plane of its pair (``pairs``): u is 0 on the points
and 1 far from them. e is where a screw motion through the vertex's places p and q in two other frames puts it, whose
rotation Q from p to q is that of the mesh around it: its Cayley vector z has the length of the tangent of half the
angle a, and s is the share of the time from p to q that has passed, below 0 before p.

    e = p + s l + sin(s a/2) / sin(a/2) R(z, (s - 1) a/2) c         l along z, c across it: l + c = q - p
    s = 1/2:   e = (p + q) / 2 + (q - p) x z / 2 (1 + sqrt(1 + z^2))    the middle of the arc, not of its chord
    s = -1:    e = p + Q^T (p - q)                                      at either end of the sequence
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS, launch
from warpdef.kernels.pairs import Pairs, own_weight, pair_plane
from warpdef.kernels.sizes import sizes

wp.set_module_options(MODULE_OPTIONS)


LEAST_TRACE = wp.constant(0.1)  # of a rotation, plus 1: the arc's height is bounded near half a turn
LEAST_TANGENT = wp.constant(1e-4)  # of half an angle: below it the way is straight as far as float32 can tell


@wp.func
def middle_of_arc(p: wp.vec3, q: wp.vec3, turn: wp.mat33) -> wp.vec3:
    """Halfway from p to q on the screw motion with the rotation ``turn``."""
    twist = wp.vec3(turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1])
    z = twist / wp.max(1.0 + wp.trace(turn), LEAST_TRACE)
    return 0.5 * (p + q) + (0.5 / (1.0 + wp.sqrt(1.0 + wp.length_sq(z)))) * wp.cross(q - p, z)


@wp.func
def on_screw(p: wp.vec3, q: wp.vec3, turn: wp.mat33, share: float) -> wp.vec3:
    """Where the screw motion from p to q with the rotation ``turn`` is after a share of its time."""
    if share == 0.5:
        return middle_of_arc(p, q, turn)
    if share == -1.0:
        return p + wp.transpose(turn) * (p - q)
    twist = wp.vec3(turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1])
    z = twist / wp.max(1.0 + wp.trace(turn), LEAST_TRACE)
    tangent = wp.length(z)
    way = q - p
    if tangent < LEAST_TANGENT:
        return p + share * way
    axis = z / tangent
    half = wp.atan(tangent)
    along = wp.dot(axis, way) * axis
    arc = wp.quat_rotate(wp.quat_from_axis_angle(axis, (share - 1.0) * half), way - along)
    return p + share * along + wp.sin(share * half) / wp.sin(half) * arc


@sizes("threads: T*V; near far share: T; vertices rotation expected_out: T V")
@wp.kernel
def _expected_places(
    # In:
    begin: int,
    near: wp.array[wp.int32],
    far: wp.array[wp.int32],
    share: wp.array[wp.float32],
    vertices: wp.array2d[wp.vec3],
    rotation: wp.array2d[wp.mat33],
    # Out:
    expected_out: wp.array2d[wp.vec3],
):
    """One thread a vertex of a frame."""
    k = begin + wp.tid()
    t = k // vertices.shape[1]
    i = k - t * vertices.shape[1]
    p = vertices[near[t], i]
    q = vertices[far[t], i]
    turn = rotation[far[t], i] * wp.transpose(rotation[near[t], i])
    expected_out[t, i] = on_screw(p, q, turn, share[t])


@wp.func
def seen_weight(pairs: Pairs, vertex: int, frame: int) -> float:
    """How well a frame shows a vertex: 1 on its points, 0 far from them, on their other side and beyond their end."""
    j = pairs.nearest[vertex]
    seen = float(0.0)
    if j >= 0:
        seen = wp.length_sq(pair_plane(pairs, vertex, j)) * own_weight(pairs, vertex, j, frame)
    return seen


@sizes("threads: K=P; trust_out: P")
@wp.kernel
def _seen_weights(
    # In:
    begin: int,
    pairs: Pairs,
    # Out:
    trust_out: wp.array[wp.float32],
):
    """One thread a vertex of a frame."""
    i = begin + wp.tid()
    trust_out[i] = seen_weight(pairs, i, pairs.frame[i])


@sizes("threads: K=P; expected matrix_out rhs_out: P; hold: T")
@wp.kernel
def _hold_unseen(
    # In:
    begin: int,
    pairs: Pairs,
    expected: wp.array[wp.vec3],
    hold: wp.array[wp.float32],
    # Out, added to:
    matrix_out: wp.array[wp.mat33],
    rhs_out: wp.array[wp.vec3],
):
    """One thread a vertex of a frame."""
    i = begin + wp.tid()
    t = pairs.frame[i]
    if hold[t] > 0.0:
        h = hold[t] * wp.max(1.0 - seen_weight(pairs, i, t), 0.0)
        matrix_out[i] = matrix_out[i] + h * wp.identity(n=3, dtype=float)
        rhs_out[i] = rhs_out[i] + h * (expected[i] - pairs.vertices[i])


def expected_places(
    begin: int, count: int, near: wp.array, far: wp.array, share: wp.array, vertices: wp.array, rotation: wp.array,
    expected_out: wp.array,
) -> None:  # fmt: skip
    """Expected places of ``count`` vertices from ``begin``, counted over all frames.

    Args:
        near, far: shape (T,) int32, the frames of p and q. share: shape (T,) float32, s; below 0 for a frame before p.
        vertices, expected_out: shape (T, V) vec3. rotation: shape (T, V) mat33, from the rest shape to each frame.
    """
    inputs = [begin, near, far, share, vertices, rotation, expected_out]
    launch(_expected_places, count, inputs, vertices.device)


def seen_weights(begin: int, count: int, pairs: Pairs, trust_out: wp.array) -> None:
    """1 - u of vertices ``begin .. begin + count`` of all frames: shape (T V,) float32; pairs by vertex."""
    launch(_seen_weights, count, [begin, pairs, trust_out], trust_out.device)


def hold_unseen(
    begin: int, count: int, pairs: Pairs, expected: wp.array, hold: wp.array, matrix_out: wp.array,
    rhs_out: wp.array,
) -> None:  # fmt: skip
    """Hold what has no points, vertices ``begin .. begin + count`` of all frames; added to what is there.

    Args:
        pairs: by vertex, see ``pairs_of``.
        expected: shape (T V,) vec3. hold: shape (T,) float32, weight against one plane; 0 leaves a frame alone.
        matrix_out: shape (T V,) mat33. rhs_out: shape (T V,) vec3.
    """
    launch(_hold_unseen, count, [begin, pairs, expected, hold, matrix_out, rhs_out], matrix_out.device)
