"""Local rigidity: every vertex keeps its edges up to a rotation of its own (Sorkine and Alexa 2007, ARAP).

    E = sum_t sum_(i,j) | (x_i,t - x_j,t) - (R_i,t + R_j,t)/2 (y_i - y_j) |^2

over the edges of the mesh, with x the vertices of frame t, y one rest shape for all frames, R rotations. Each of the
three unknowns has its own step: ``fit_rotations`` is the best R for x and y (by Newton's method from the last one, else
by singular values); ``rigid_rhs`` is minus half the gradient to x; ``rest_rhs`` is minus half the gradient to y, at
y = 0, over the number of frames. Where frames show parts, ``trusted_rest_rhs`` takes the mean of each edge over those
that show it, so that the same L y = b is solved.

Rotations may be tied to those of their neighbours as they were, by tie |R_i - R_j|^2 |y_i - y_j|^2 / 2 more an edge
(Levi and Gotsman 2015, SR-ARAP): what turns takes its surroundings along, and bending costs.
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.edge_lanes import rest_rhs_in_lanes, rigid_rhs_in_lanes
from warpdef.kernels.launching import MODULE_OPTIONS, launch
from warpdef.kernels.material import edge_stiffness
from warpdef.kernels.rotation_lanes import LANES_OF_ROTATIONS, following
from warpdef.kernels.sizes import require_span, sizes
from warpdef.kernels.ways import Way, way_of

wp.set_module_options(MODULE_OPTIONS)


NEWTON_STEPS = wp.constant(5)
LEAST_CURVATURE = wp.constant(1.0e-4)  # of trace(R^T s), its largest entry 1: below, Newton's steps say nothing
STILL_SQ = wp.constant(1.0e-6)  # a turn below a thousandth of a radian leaves its square to the next


@wp.func
def nearest_rotation(s: wp.mat33) -> wp.mat33:
    """The rotation R that maximises trace(R^T s); of a rank-2 matrix the third axis follows by handedness.

    The identity for s = 0.
    """
    # svd3 compares with absolute thresholds (1e-6), which the squares of short edges would fall below; its four Jacobi
    # sweeps are too few for one vertex in a hundred, hence a second call; and of a rank-1 matrix, where its squares
    # underflow, its factors are not quite orthogonal. They never are reflections: a mirrored s has sigma[2] < 0.
    largest = wp.max(wp.max(wp.abs(s[0]), wp.abs(s[1])), wp.abs(s[2]))
    scale = wp.max(largest)
    rotation = wp.identity(n=3, dtype=wp.float32)
    if scale > 0.0:
        u, sigma, v = wp.svd3(s / scale)
        u_left, sigma_left, v_left = wp.svd3(wp.transpose(u) * (s / scale) * v)
        nearly = (u * u_left) * wp.transpose(v * v_left)
        rotation = wp.quat_to_matrix(wp.normalize(wp.quat_from_matrix(nearly)))
    return rotation


@wp.func
def is_rotation(r: wp.mat33) -> bool:
    """Whether r is orthogonal, no reflection, and no number is missing; to 1e-3, which Newton's steps then mend."""
    off = wp.ddot(wp.transpose(r) * r - wp.identity(n=3, dtype=wp.float32), wp.identity(n=3, dtype=wp.float32))
    return wp.abs(off) < 1.0e-3 and wp.abs(wp.determinant(r) - 1.0) < 1.0e-3


@wp.func
def followed_rotation(s: wp.mat33, start: wp.mat33) -> wp.mat33:
    """The same as ``nearest_rotation``, found by Newton's method from a rotation that is near; a third of the cost.

    With M = R^T s, a turn by w changes the trace by v . w - w^T H w / 2, v twice the axis of M's antisymmetric part and
    H = trace(M) I - sym(M). A step is H^-1 v. trace(R^T s) has one maximum on the rotations and no other local one, so
    where H is positive definite at the end it is found; else, or where the start is no rotation, the singular values
    are asked.
    """
    largest = wp.max(wp.max(wp.abs(s[0]), wp.abs(s[1])), wp.abs(s[2]))
    scale = wp.max(largest)
    found = bool(False)
    rotation = start
    if scale > 0.0 and is_rotation(start):
        going = bool(True)
        for _step in range(NEWTON_STEPS):
            if going:
                m = wp.transpose(rotation) * (s / scale)
                h = wp.trace(m) * wp.identity(n=3, dtype=wp.float32) - 0.5 * (m + wp.transpose(m))
                minor = h[0, 0] * h[1, 1] - h[0, 1] * h[0, 1]
                whole = wp.determinant(h)
                if h[0, 0] > LEAST_CURVATURE and minor > LEAST_CURVATURE and whole > LEAST_CURVATURE:
                    w = wp.inverse(h) * wp.vec3(m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1])
                    # The rotation by w to second order, a quaternion; its error is of third order and vanishes with w.
                    turn = wp.normalize(wp.quat(0.5 * w[0], 0.5 * w[1], 0.5 * w[2], 1.0))
                    rotation = wp.quat_to_matrix(wp.normalize(wp.quat_from_matrix(rotation) * turn))
                    size = wp.length_sq(w)
                    found = size < STILL_SQ
                    going = not found and size < 1.0
                else:
                    going = False
    if not found:
        rotation = nearest_rotation(s)
    return rotation


@wp.func
def edges_turned(
    t: int,
    i: int,
    row: wp.array[wp.int32],
    column: wp.array[wp.int32],
    rest: wp.array[wp.vec3],
    vertices: wp.array2d[wp.vec3],
    tie: float,
    first_axis: wp.array2d[wp.vec3],
    second_axis: wp.array2d[wp.vec3],
) -> wp.mat33:
    """What the best rotation of vertex i in frame t is that of: the sum of the edges' outer products, and of the
    neighbours' rotations as far as they are tied to."""
    s = wp.mat33()
    for e in range(row[i], row[i + 1]):
        j = column[e]
        edge = rest[i] - rest[j]
        s += wp.outer(vertices[t, i] - vertices[t, j], edge)
        if tie > 0.0:
            a = first_axis[t, j]
            b = second_axis[t, j]
            s += (tie * wp.length_sq(edge)) * wp.matrix_from_rows(a, b, wp.cross(a, b))
    return s


@sizes("threads: T*V; rotation first_out second_out: T V")
@wp.kernel
def _keep_axes(
    # In:
    begin: int,
    rotation: wp.array2d[wp.mat33],
    # Out:
    first_out: wp.array2d[wp.vec3],
    second_out: wp.array2d[wp.vec3],
):
    """One thread a vertex of a frame: two rows of its rotation, of which the third is the cross product."""
    k = begin + wp.tid()
    t = k // rotation.shape[1]
    i = k - t * rotation.shape[1]
    r = rotation[t, i]
    first_out[t, i] = r[0]
    second_out[t, i] = r[1]


@sizes("threads: T*V; row: V+1; column: E; rest: V; vertices rotation: T V; first_axis second_axis: T V?")
@wp.kernel
def _fit_rotations(
    # In:
    begin: int,
    row: wp.array[wp.int32],
    column: wp.array[wp.int32],
    rest: wp.array[wp.vec3],
    vertices: wp.array2d[wp.vec3],
    tie: float,
    first_axis: wp.array2d[wp.vec3],
    second_axis: wp.array2d[wp.vec3],
    # In and out: from those that are there
    rotation: wp.array2d[wp.mat33],
):
    """One thread a vertex of a frame."""
    k = begin + wp.tid()
    t = k // rest.shape[0]
    i = k - t * rest.shape[0]
    s = edges_turned(t, i, row, column, rest, vertices, tie, first_axis, second_axis)
    rotation[t, i] = followed_rotation(s, rotation[t, i])


@wp.func_native(following(NEWTON_STEPS, LEAST_CURVATURE, STILL_SQ))
def follow_rotations(
    first: int,
    last: int,
    row: wp.array[wp.int32],
    column: wp.array[wp.int32],
    rest: wp.array[wp.vec3],
    vertices: wp.array2d[wp.vec3],
    tie: float,
    first_axis: wp.array2d[wp.vec3],
    second_axis: wp.array2d[wp.vec3],
    rotation: wp.array2d[wp.mat33],
) -> int: ...


@sizes("threads: T*V; row: V+1; column: E; rest: V; vertices rotation: T V; first_axis second_axis: T V?")
@wp.kernel
def _fit_rotations_in_lanes(
    # In:
    begin: int,
    count: int,
    row: wp.array[wp.int32],
    column: wp.array[wp.int32],
    rest: wp.array[wp.vec3],
    vertices: wp.array2d[wp.vec3],
    tie: float,
    first_axis: wp.array2d[wp.vec3],
    second_axis: wp.array2d[wp.vec3],
    # In and out: from those that are there
    rotation: wp.array2d[wp.mat33],
):
    """CPU: one thread a run of vertices, counted over all frames."""
    first = begin + LANES_OF_ROTATIONS * wp.tid()
    last = wp.min(first + LANES_OF_ROTATIONS, begin + count)
    left = follow_rotations(first, last, row, column, rest, vertices, tie, first_axis, second_axis, rotation)
    lane = int(0)
    while left != 0:
        if left % 2 == 1:
            k = first + lane
            t = k // rest.shape[0]
            i = k - t * rest.shape[0]
            s = edges_turned(t, i, row, column, rest, vertices, tie, first_axis, second_axis)
            rotation[t, i] = nearest_rotation(s)
        left = left // 2
        lane = lane + 1


@sizes("threads: T*V; row: V+1; column: E; stiffness: V?; rest: V; rotation vertices rhs_out: T V")
@wp.kernel
def _rigid_rhs(
    # In:
    begin: int,
    weight: float,
    row: wp.array[wp.int32],
    column: wp.array[wp.int32],
    stiffness: wp.array[wp.float32],
    rest: wp.array[wp.vec3],
    rotation: wp.array2d[wp.mat33],
    vertices: wp.array2d[wp.vec3],
    # Out, added to:
    rhs_out: wp.array2d[wp.vec3],
):
    """One thread a vertex of a frame."""
    k = begin + wp.tid()
    t = k // rest.shape[0]
    i = k - t * rest.shape[0]
    total = wp.vec3(0.0, 0.0, 0.0)
    for e in range(row[i], row[i + 1]):
        j = column[e]
        turned = 0.5 * ((rotation[t, i] + rotation[t, j]) * (rest[i] - rest[j]))
        total += edge_stiffness(stiffness, i, j) * (turned - (vertices[t, i] - vertices[t, j]))
    rhs_out[t, i] = rhs_out[t, i] + weight * total


@sizes("threads rhs_out: V; frames: A; row: V+1; column: E; rotation vertices: T V")
@wp.kernel
def _rest_rhs(
    # In:
    begin: int,
    frames: wp.array[wp.int32],
    row: wp.array[wp.int32],
    column: wp.array[wp.int32],
    rotation: wp.array2d[wp.mat33],
    vertices: wp.array2d[wp.vec3],
    # Out:
    rhs_out: wp.array[wp.vec3],
):
    """One thread a vertex: what the frames asked, turned back, say of its edges."""
    i = begin + wp.tid()
    total = wp.vec3(0.0, 0.0, 0.0)
    for f in range(frames.shape[0]):
        t = frames[f]
        for e in range(row[i], row[i + 1]):
            j = column[e]
            d = vertices[t, i] - vertices[t, j]
            total += 0.5 * (wp.transpose(rotation[t, i] + rotation[t, j]) * d)
    rhs_out[i] = total / float(frames.shape[0])


@sizes("threads rest rhs_out: V; row: V+1; column: E; trust rotation vertices: T V")
@wp.kernel
def _trusted_rest_rhs(
    # In:
    begin: int,
    staying: float,
    row: wp.array[wp.int32],
    column: wp.array[wp.int32],
    rest: wp.array[wp.vec3],
    trust: wp.array2d[wp.float32],
    rotation: wp.array2d[wp.mat33],
    vertices: wp.array2d[wp.vec3],
    # Out:
    rhs_out: wp.array[wp.vec3],
):
    """One thread a vertex: what the frames that show an edge, turned back, say of it."""
    i = begin + wp.tid()
    total = wp.vec3(0.0, 0.0, 0.0)
    for e in range(row[i], row[i + 1]):
        j = column[e]
        asked = staying * (rest[i] - rest[j])
        sum = staying
        for t in range(vertices.shape[0]):
            w = trust[t, i] * trust[t, j]
            if w > 0.0:
                d = vertices[t, i] - vertices[t, j]
                asked += (0.5 * w) * (wp.transpose(rotation[t, i] + rotation[t, j]) * d)
                sum += w
        total += asked / sum
    rhs_out[i] = total


def keep_axes(begin: int, count: int, rotation: wp.array, first_out: wp.array, second_out: wp.array) -> None:
    """Two rows of ``count`` rotations from ``begin``, counted over all frames; both out (T, V) vec3."""
    launch(_keep_axes, count, [begin, rotation, first_out, second_out], rotation.device)


def fit_rotations(
    begin: int, count: int, row: wp.array, column: wp.array, rest: wp.array, vertices: wp.array,
    rotation: wp.array, tie: float = 0.0, scratch: tuple[wp.array, wp.array] | None = None,
) -> None:  # fmt: skip
    """Best rotation of ``count`` vertices from ``begin``, counted over all frames (frame t owns V of them).

    Args:
        row, column: neighbours, as in ``Graph``. rest: shape (V,) vec3. vertices: shape (T, V) vec3.
        rotation: shape (T, V) mat33; where they are near they are followed, and where they are none, found anew.
        tie: weight that ties a rotation to those of its neighbours, zeros for such as are not known yet. With it a span
            is of whole frames, and needs
        scratch: two arrays (T, V) vec3, for the neighbours' rotations as they were.
    """
    device = vertices.device
    first, second = scratch or (None, None)
    if scratch is not None:
        keep_axes(begin, count, rotation, *scratch)
    edges = [row, column, rest, vertices, tie, first, second, rotation]
    if way_of(device) is Way.SPANS:
        require_span("fit_rotations_in_lanes: threads", begin, count, rotation.size)
        launch(_fit_rotations_in_lanes, -(-count // LANES_OF_ROTATIONS), [begin, count, *edges], device)
        return
    launch(_fit_rotations, count, [begin, *edges], device)


def rigid_rhs(
    begin: int, count: int, weight: float, row: wp.array, column: wp.array, rest: wp.array, rotation: wp.array,
    vertices: wp.array, rhs_out: wp.array, stiffness: wp.array | None = None,
) -> None:  # fmt: skip
    """Add ``weight`` times minus half the gradient to the vertices; shapes as in ``fit_rotations``.

    Args:
        stiffness: shape (V,) float32, of the material; an edge weighs the mean of its ends. None: 1 everywhere.
    """
    kernel = rigid_rhs_in_lanes if way_of(vertices.device) is Way.SPANS else _rigid_rhs
    launch(kernel, count, [begin, weight, row, column, stiffness, rest, rotation, vertices, rhs_out], vertices.device)


def rest_rhs(
    begin: int, count: int, frames: wp.array, row: wp.array, column: wp.array, rotation: wp.array, vertices: wp.array,
    rhs_out: wp.array,
) -> None:  # fmt: skip
    """Right-hand side of L y = b for the best rest shape, vertices ``begin .. begin + count``; shape (V,) vec3.

    Args:
        frames: those that are asked, shape (A,) int32, at least one. All else as in ``fit_rotations``.
    """
    kernel = rest_rhs_in_lanes if way_of(vertices.device) is Way.SPANS else _rest_rhs
    launch(kernel, count, [begin, frames, row, column, rotation, vertices, rhs_out], vertices.device)


def trusted_rest_rhs(
    begin: int, count: int, staying: float, row: wp.array, column: wp.array, rest: wp.array, trust: wp.array,
    rotation: wp.array, vertices: wp.array, rhs_out: wp.array,
) -> None:  # fmt: skip
    """The same, where each edge is asked of the frames that show it.

    Args:
        staying: weight of the edge as it is in ``rest``, above 0, against one frame that shows it.
        trust: shape (T, V) float32, how well a frame shows a vertex, from 0 to 1; an edge by the product of its ends.
    """
    inputs = [begin, staying, row, column, rest, trust, rotation, vertices, rhs_out]
    launch(_trusted_rest_rhs, count, inputs, vertices.device)
