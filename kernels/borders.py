"""Where a mesh ends its cloud ends too: planes across the border of an open mesh, added to the normal equations.

Point-to-plane residuals leave the border free to slide along the surface, and it slides inwards. A border vertex x with
outward direction b (in the surface, across the border) asks for two residuals more, of the weights in ``pairs``:

    of its own pair:                r = b . (x - q) - gap
    of points q that lie outside:   r = b . (x - q), only where r < 0

Among points thrown at random on one side of a line, the nearest to a place on the line lies 0.45 / sqrt(density) inside
of it on average, which is 0.9 times the mean distance of points to their nearest fellows: the gap. With it both
residuals vanish on average where the mesh ends with the surface.
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS, launch
from warpdef.kernels.pairs import Pairs, own_weight, pair_plane, pair_weight
from warpdef.kernels.sizes import sizes

wp.set_module_options(MODULE_OPTIONS)


@wp.func
def outward(before: wp.vec3, x: wp.vec3, after: wp.vec3, inner: wp.vec3) -> wp.vec3:
    """Unit direction from ``inner`` to the border vertex x, across its border neighbours; zero where there is none."""
    along = wp.normalize(after - before)
    o = x - inner
    return wp.normalize(o - wp.dot(o, along) * along)


@wp.func
def outward_of(vertices: wp.array[wp.vec3], border: wp.array2d[wp.int32], first: int, v: int) -> wp.vec3:
    """The same of vertex v of the frame whose vertices begin at ``first``; zero for one that is not on the border."""
    b = wp.vec3(0.0, 0.0, 0.0)
    if border[v, 0] >= 0:
        before = vertices[first + border[v, 0]]
        after = vertices[first + border[v, 1]]
        b = outward(before, vertices[first + v], after, vertices[first + border[v, 2]])
    return b


@sizes("threads: K=P; border: V 3; gap: T; matrix_out: P=T*V; rhs_out: P")
@wp.kernel
def _vertex_borders(
    # In:
    begin: int,
    pairs: Pairs,
    border: wp.array2d[wp.int32],
    stiffness: float,
    gap: wp.array[wp.float32],
    # Out, added to:
    matrix_out: wp.array[wp.mat33],
    rhs_out: wp.array[wp.vec3],
):
    """One thread a vertex of a frame."""
    i = begin + wp.tid()
    t = pairs.frame[i]
    j = pairs.nearest[i]
    b = outward_of(pairs.vertices, border, t * border.shape[0], i - t * border.shape[0])
    if j >= 0 and wp.length_sq(b) > 0.0:
        if wp.length_sq(pair_plane(pairs, i, j)) > 0.0:
            d = pairs.vertices[i] - pairs.cloud[j]
            w = stiffness * own_weight(pairs, i, j, t)
            matrix_out[i] = matrix_out[i] + w * wp.outer(b, b)
            rhs_out[i] = rhs_out[i] + (w * (gap[t] - wp.dot(b, d))) * b


@sizes("threads: K=N; border: V 3; matrix_out: P=T*V; rhs_out: P")
@wp.kernel
def _cloud_borders(
    # In:
    begin: int,
    pairs: Pairs,
    border: wp.array2d[wp.int32],
    stiffness: float,
    # Out, added to:
    matrix_out: wp.array[wp.mat33],
    rhs_out: wp.array[wp.vec3],
):
    """One thread a cloud point, with its nearest vertex, which others may share."""
    i = begin + wp.tid()
    j = pairs.nearest[i]
    if j >= 0:
        t = pairs.frame[i]
        b = outward_of(pairs.vertices, border, t * border.shape[0], j - t * border.shape[0])
        d = pairs.vertices[j] - pairs.cloud[i]
        if wp.dot(b, d) < 0.0:
            if wp.length_sq(pair_plane(pairs, j, i)) > 0.0:
                w = stiffness * pair_weight(pairs, j, i, t)
                wp.atomic_add(matrix_out, j, w * wp.outer(b, b))
                wp.atomic_add(rhs_out, j, (-w * wp.dot(b, d)) * b)


def vertex_borders(
    begin: int, count: int, pairs: Pairs, border: wp.array, stiffness: float, gap: wp.array, matrix_out: wp.array,
    rhs_out: wp.array,
) -> None:  # fmt: skip
    """Add the border's part of vertex-to-cloud pairs, vertices ``begin .. begin + count`` of all frames.

    Args:
        pairs: by vertex, see ``pairs_of``.
        border: shape (V, 3) int32: for a border vertex those before and after it on the border, and one inside; -1 for
            all others. stiffness: weight against one plane of ``planes``. gap: shape (T,) float32, cube units.
        matrix_out: shape (T V,) mat33. rhs_out: shape (T V,) vec3.
    """
    launch(_vertex_borders, count, [begin, pairs, border, stiffness, gap, matrix_out, rhs_out], matrix_out.device)


def cloud_borders(
    begin: int, count: int, pairs: Pairs, border: wp.array, stiffness: float, matrix_out: wp.array,
    rhs_out: wp.array,
) -> None:  # fmt: skip
    """Add what cloud points beyond the border ask for, points ``begin .. begin + count``; pairs by point."""
    launch(_cloud_borders, count, [begin, pairs, border, stiffness, matrix_out, rhs_out], matrix_out.device)
