"""Moving points by the deformation grids, forwards and back (paper, eq. of sec. Transformation Parameterization).

    y = R(z) x + t,   (z, t) = T(x)                       sampled at the point itself
    dy/dx = R(z) + d(R x)/dz dz/dx + dt/dx                the gradient flows through the sampling position
    adjoint:  adj T += ((d(R x)/dz)^T adj y, adj y),   adj x += (dy/dx)^T adj y

Clouds move one step and need no derivative to x: their positions are data. Template vertices run through a chain of
steps; each stores dy/dx on the way out, so that the way back gathers nothing.
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.cayley import adj_rotate, rotate, rotate_along
from warpdef.kernels.launching import MODULE_OPTIONS, launch
from warpdef.kernels.levels import node8
from warpdef.kernels.sizes import sizes
from warpdef.kernels.trilinear import adj_sample, sample, sample_with_derivative

wp.set_module_options(MODULE_OPTIONS)


@wp.func
def motion_gradient(z: wp.vec3, x: wp.vec3, adj: wp.vec3) -> node8:
    """Adjoint of y = R(z) x + t to (z, t), padded."""
    r = adj_rotate(z, x, adj)
    return node8(r[0], r[1], r[2], adj[0], adj[1], adj[2], 0.0, 0.0)


@sizes("threads points transition rotation_out moved_out: N; nodes: S M; levels: 2*L; level_count: L")
@wp.kernel
def _move_points(
    # In:
    begin: int,
    nodes: wp.array2d[node8],
    levels: wp.array[wp.int32],
    level_count: int,
    points: wp.array[wp.vec3],
    transition: wp.array[wp.int32],
    # Out:
    rotation_out: wp.array[wp.vec3],
    moved_out: wp.array[wp.vec3],
):
    """One thread a point."""
    i = begin + wp.tid()
    x = points[i]
    t = sample(nodes, transition[i], levels, level_count, x[0], x[1], x[2])
    z = wp.vec3(t[0], t[1], t[2])
    rotation_out[i] = z
    moved_out[i] = rotate(z, x) + wp.vec3(t[3], t[4], t[5])


@sizes("threads points transition rotation adj_moved: N; levels: 2*L; level_count: L; adj_nodes_out: S M")
@wp.kernel
def _adj_move_points(
    # In:
    begin: int,
    levels: wp.array[wp.int32],
    level_count: int,
    points: wp.array[wp.vec3],
    transition: wp.array[wp.int32],
    rotation: wp.array[wp.vec3],
    adj_moved: wp.array[wp.vec3],
    # Out, added to:
    adj_nodes_out: wp.array2d[node8],
):
    """One thread a point. On the CPU a transition's points belong to one thread: nothing else adds to its nodes."""
    i = begin + wp.tid()
    x = points[i]
    g = motion_gradient(rotation[i], x, adj_moved[i])
    adj_sample(adj_nodes_out, transition[i], levels, level_count, x[0], x[1], x[2], g)


@wp.func
def move_vertex(
    nodes: wp.array2d[node8],
    transition: int,
    levels: wp.array[wp.int32],
    level_count: int,
    i: int,
    source: int,
    target: int,
    vertices: wp.array2d[wp.vec3],
    rotation_out: wp.array2d[wp.vec3],
    jacobian_out: wp.array2d[wp.mat33],
):
    """Vertex i over one transition, from frame source to frame target, and what the way back needs."""
    x = vertices[source, i]
    s = sample_with_derivative(nodes, transition, levels, level_count, x[0], x[1], x[2])
    z = wp.vec3(s[0, 0], s[0, 1], s[0, 2])
    rotation_out[transition, i] = z
    vertices[target, i] = rotate(z, x) + wp.vec3(s[0, 3], s[0, 4], s[0, 5])
    zx = wp.vec3(s[1, 0], s[1, 1], s[1, 2])
    zy = wp.vec3(s[2, 0], s[2, 1], s[2, 2])
    zz = wp.vec3(s[3, 0], s[3, 1], s[3, 2])
    jx = rotate(z, wp.vec3(1.0, 0.0, 0.0)) + rotate_along(z, x, zx) + wp.vec3(s[1, 3], s[1, 4], s[1, 5])
    jy = rotate(z, wp.vec3(0.0, 1.0, 0.0)) + rotate_along(z, x, zy) + wp.vec3(s[2, 3], s[2, 4], s[2, 5])
    jz = rotate(z, wp.vec3(0.0, 0.0, 1.0)) + rotate_along(z, x, zz) + wp.vec3(s[3, 3], s[3, 4], s[3, 5])
    # Rows are the derivatives along x, y, z: the transpose of dy/dx, which is what the way back multiplies by.
    jacobian_out[transition, i] = wp.matrix_from_rows(jx, jy, jz)


@sizes(
    "threads: V; transition: <S; source target: <T; nodes: S M; levels: 2*L; level_count: L; vertices: T V; "
    "rotation_out jacobian_out: S V"
)
@wp.kernel
def _move_vertices(
    # In:
    begin: int,
    transition: int,
    source: int,
    target: int,
    nodes: wp.array2d[node8],
    levels: wp.array[wp.int32],
    level_count: int,
    # In and out: row source is read, row target written
    vertices: wp.array2d[wp.vec3],
    # Out:
    rotation_out: wp.array2d[wp.vec3],
    jacobian_out: wp.array2d[wp.mat33],
):
    """One thread a vertex, one step of the chain."""
    i = begin + wp.tid()
    move_vertex(nodes, transition, levels, level_count, i, source, target, vertices, rotation_out, jacobian_out)


@sizes("threads: V; transition: <S; source target: <T; nodes: S M; levels: 2*L; level_count: L; vertices: T V")
@wp.kernel
def _place_vertices(
    # In:
    begin: int,
    transition: int,
    source: int,
    target: int,
    nodes: wp.array2d[node8],
    levels: wp.array[wp.int32],
    level_count: int,
    # In and out: row source is read, row target written
    vertices: wp.array2d[wp.vec3],
):
    """One thread a vertex, one step of the chain that nothing goes back through; on the CPU bits as with a way back."""
    i = begin + wp.tid()
    x = vertices[source, i]
    s = sample_with_derivative(nodes, transition, levels, level_count, x[0], x[1], x[2])
    vertices[target, i] = rotate(wp.vec3(s[0, 0], s[0, 1], s[0, 2]), x) + wp.vec3(s[0, 3], s[0, 4], s[0, 5])


@sizes(
    "threads: V; transition: <S; source target: <T; carry_target carry_source: <T+1; vertices adj_weighed "
    "adj_plain: T V; rotation jacobian adj_motion_out: S V; confidence: T; carry: T+1 V"
)
@wp.kernel
def _adj_move_vertices(
    # In:
    begin: int,
    transition: int,
    source: int,
    target: int,
    carry_target: int,
    carry_source: int,
    vertices: wp.array2d[wp.vec3],
    rotation: wp.array2d[wp.vec3],
    jacobian: wp.array2d[wp.mat33],
    confidence: wp.array[wp.float32],
    adj_weighed: wp.array2d[wp.vec3],
    adj_plain: wp.array2d[wp.vec3],
    # In and out: row carry_target is read, row carry_source written
    carry: wp.array2d[wp.vec3],
    # Out:
    adj_motion_out: wp.array2d[node8],
):
    """One thread a vertex, one step back: what frame target wants, plus what frames beyond it want."""
    i = begin + wp.tid()
    a = confidence[target] * adj_weighed[target, i] + adj_plain[target, i] + carry[carry_target, i]
    adj_motion_out[transition, i] = motion_gradient(rotation[transition, i], vertices[source, i], a)
    carry[carry_source, i] = jacobian[transition, i] * a


@sizes("threads: S*V; levels: 2*L; level_count: L; source: S; vertices: T V; adj_motion: S V; adj_nodes_out: S M")
@wp.kernel
def _scatter_vertices(
    # In:
    begin: int,
    levels: wp.array[wp.int32],
    level_count: int,
    source: wp.array[wp.int32],
    vertices: wp.array2d[wp.vec3],
    adj_motion: wp.array2d[node8],
    # Out, added to:
    adj_nodes_out: wp.array2d[node8],
):
    """One thread a vertex of a transition: its six-vector gradient to the nodes around it."""
    k = begin + wp.tid()
    s = k // vertices.shape[1]
    i = k - s * vertices.shape[1]
    x = vertices[source[s], i]
    adj_sample(adj_nodes_out, s, levels, level_count, x[0], x[1], x[2], adj_motion[s, i])


def move_points(
    begin: int, count: int, nodes: wp.array, levels: wp.array, points: wp.array, transition: wp.array,
    rotation_out: wp.array, moved_out: wp.array,
) -> None:  # fmt: skip
    """Move ``count`` cloud points from ``begin``, each by its own transition's grid.

    Args:
        nodes: shape (S, M) node8. levels: ``LevelTable.to_device``, shape (2 L,) int32.
        points: shape (N,) vec3, cube units. transition: shape (N,) int32, the row of ``nodes`` that moves a point.
        rotation_out: shape (N,) vec3, the sampled Cayley vector, kept for the adjoint. moved_out: shape (N,) vec3.
    """
    inputs = [begin, nodes, levels, len(levels) // 2, points, transition, rotation_out, moved_out]
    launch(_move_points, count, inputs, nodes.device)


def adj_move_points(
    begin: int, count: int, levels: wp.array, points: wp.array, transition: wp.array, rotation: wp.array,
    adj_moved: wp.array, adj_nodes_out: wp.array,
) -> None:  # fmt: skip
    """Adjoint of ``move_points`` to the nodes; adds to ``adj_nodes_out``, shape (S, M) node8."""
    inputs = [begin, levels, len(levels) // 2, points, transition, rotation, adj_moved, adj_nodes_out]
    launch(_adj_move_points, count, inputs, adj_nodes_out.device)


def move_vertices(
    begin: int, count: int, transition: int, source: int, target: int, nodes: wp.array, levels: wp.array,
    vertices: wp.array, rotation_out: wp.array, jacobian_out: wp.array,
) -> None:  # fmt: skip
    """Move vertices ``begin .. begin + count`` of frame ``source`` to frame ``target`` by grid ``transition``.

    Args:
        vertices: shape (T, V) vec3, cube units; row ``source`` is read, row ``target`` written.
        rotation_out: shape (S, V) vec3. jacobian_out: shape (S, V) mat33, the transpose of dy/dx.
    """
    inputs = [begin, transition, source, target, nodes, levels, len(levels) // 2, vertices, rotation_out, jacobian_out]
    launch(_move_vertices, count, inputs, nodes.device)


def place_vertices(
    begin: int, count: int, transition: int, source: int, target: int, nodes: wp.array, levels: wp.array,
    vertices: wp.array,
) -> None:  # fmt: skip
    """``move_vertices`` where no gradient is asked for: nothing is left for a way back."""
    inputs = [begin, transition, source, target, nodes, levels, len(levels) // 2, vertices]
    launch(_place_vertices, count, inputs, nodes.device)


def adj_move_vertices(
    begin: int, count: int, transition: int, source: int, target: int, carry_target: int, carry_source: int,
    vertices: wp.array, rotation: wp.array, jacobian: wp.array, confidence: wp.array, adj_weighed: wp.array,
    adj_plain: wp.array, carry: wp.array, adj_motion_out: wp.array,
) -> None:  # fmt: skip
    """Adjoint of ``move_vertices``: six-vector gradients of one step, and the gradient carried to frame ``source``.

    Args:
        carry: shape (T + 1, V) vec3; the row of a chain's last frame is 0. The extra row takes the backward chain's
            gradient at the keyframe, which two chains reach.
        confidence: shape (T,) float32, weights of the frames in ``adj_weighed``.
        adj_weighed, adj_plain: shape (T, V) vec3, sums of the terms' gradients. adj_motion_out: shape (S, V) node8.
    """
    inputs = [
        begin, transition, source, target, carry_target, carry_source,
        vertices, rotation, jacobian, confidence, adj_weighed, adj_plain, carry, adj_motion_out,
    ]  # fmt: skip
    launch(_adj_move_vertices, count, inputs, vertices.device)


def scatter_vertices(
    begin: int, count: int, levels: wp.array, source: wp.array, vertices: wp.array, adj_motion: wp.array,
    adj_nodes_out: wp.array,
) -> None:  # fmt: skip
    """Add six-vector gradients to the nodes around the vertices of the frames that transitions start from.

    Args:
        begin, count: of vertices of transitions, counted over all of these (transition s owns V of them).
        source: frame that a transition starts from, shape (S,) int32. adj_motion: shape (S, V) node8.
    """
    inputs = [begin, levels, len(levels) // 2, source, vertices, adj_motion, adj_nodes_out]
    launch(_scatter_vertices, count, inputs, adj_nodes_out.device)


@sizes("threads adj_template_out: V; keyframe: <T; adj_weighed adj_plain: T V; carry: T+1 V")
@wp.kernel
def _template_gradient(
    # In:
    keyframe: int,
    follow: int,
    adj_weighed: wp.array2d[wp.vec3],
    adj_plain: wp.array2d[wp.vec3],
    carry: wp.array2d[wp.vec3],
    # Out:
    adj_template_out: wp.array[wp.vec3],
):
    """One thread a vertex."""
    i = wp.tid()
    a = adj_weighed[keyframe, i]
    if follow != 0:
        a = a + adj_plain[keyframe, i] + carry[keyframe, i] + carry[carry.shape[0] - 1, i]
    adj_template_out[i] = a


def template_gradient(
    keyframe: int, follow: bool, adj_weighed: wp.array, adj_plain: wp.array, carry: wp.array,
    adj_template_out: wp.array,
) -> None:  # fmt: skip
    """Gradient of the template: the weighed terms at the keyframe, or with ``follow`` all that reaches it.

    Args:
        adj_weighed, adj_plain: shape (T, V) vec3, sums of the terms' gradients; the first of the mesh term at least.
        carry: shape (T + 1, V) vec3, see ``adj_move_vertices``.
        adj_template_out: shape (V,) vec3.
    """
    inputs = [keyframe, int(follow), adj_weighed, adj_plain, carry, adj_template_out]
    launch(_template_gradient, len(adj_template_out), inputs, adj_template_out.device)
