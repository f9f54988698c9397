"""Where a mesh ends its cloud ends too: planes across the border of an open mesh, added to the normal equations.

Point-to-plane residuals leave the border free to slide along the surface, and it slides inwards. A border vertex x with
outward direction b (in the surface, across the border) asks for two residuals more, of the weights in ``planes``:

    of its own pair:                r = b . (x - q) - gap
    of points q that lie outside:   r = b . (x - q), only where r < 0

Among points thrown at random on one side of a line, the nearest to a place on the line lies 0.45 / sqrt(density) inside
of it on average, which is 0.9 times the mean distance of points to their nearest fellows: the gap. With it both
residuals vanish on average where the mesh ends with the surface.
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.chamfer import BOTH_SIDES, mutual_weight
from warpdef.kernels.launching import MODULE_OPTIONS, launch
from warpdef.kernels.planes import pair_plane, pair_weight

wp.set_module_options(MODULE_OPTIONS)


@wp.func
def outward(before: wp.vec3, x: wp.vec3, after: wp.vec3, inner: wp.vec3) -> wp.vec3:
    """Unit direction from ``inner`` to the border vertex x, across its border neighbours; zero where there is none."""
    along = wp.normalize(after - before)
    o = x - inner
    return wp.normalize(o - wp.dot(o, along) * along)


@wp.func
def outward_of(vertices: wp.array(dtype=wp.vec3), border: wp.array2d(dtype=wp.int32), first: int, v: int) -> wp.vec3:
    """The same of vertex v of the frame whose vertices begin at ``first``; zero for one that is not on the border."""
    b = wp.vec3(0.0, 0.0, 0.0)
    if border[v, 0] >= 0:
        before = vertices[first + border[v, 0]]
        after = vertices[first + border[v, 1]]
        b = outward(before, vertices[first + v], after, vertices[first + border[v, 2]])
    return b


@wp.kernel
def _vertex_borders(
    # In:
    begin: int,
    agreement: float,
    share: float,
    reach: wp.array(dtype=wp.float32),
    vertices: wp.array(dtype=wp.vec3),
    vertex_normals: wp.array(dtype=wp.vec3),
    vertex_frame: wp.array(dtype=wp.int32),
    nearest: wp.array(dtype=wp.int32),
    cloud: wp.array(dtype=wp.vec3),
    cloud_normals: wp.array(dtype=wp.vec3),
    back: wp.array(dtype=wp.int32),
    mutual_reach: wp.array(dtype=wp.float32),
    border: wp.array2d(dtype=wp.int32),
    stiffness: float,
    gap: wp.array(dtype=wp.float32),
    # Out, added to:
    matrix_out: wp.array(dtype=wp.mat33),
    pull_out: wp.array(dtype=wp.vec3),
):
    """One thread a vertex of a frame."""
    i = begin + wp.tid()
    t = vertex_frame[i]
    j = nearest[i]
    b = outward_of(vertices, border, t * border.shape[0], i - t * border.shape[0])
    if j >= 0 and wp.length_sq(b) > 0.0:
        if wp.length_sq(pair_plane(cloud_normals[j], vertex_normals[i], agreement, share)) > 0.0:
            d = vertices[i] - cloud[j]
            w = stiffness * pair_weight(d, reach[t])
            w *= mutual_weight(vertices, i, back, j, mutual_reach, t)
            matrix_out[i] = matrix_out[i] + w * wp.outer(b, b)
            pull_out[i] = pull_out[i] + (w * (gap[t] - wp.dot(b, d))) * b


@wp.kernel
def _cloud_borders(
    # In:
    begin: int,
    agreement: float,
    share: float,
    reach: wp.array(dtype=wp.float32),
    vertices: wp.array(dtype=wp.vec3),
    vertex_normals: wp.array(dtype=wp.vec3),
    cloud_frame: wp.array(dtype=wp.int32),
    nearest: wp.array(dtype=wp.int32),
    cloud: wp.array(dtype=wp.vec3),
    cloud_normals: wp.array(dtype=wp.vec3),
    border: wp.array2d(dtype=wp.int32),
    stiffness: float,
    # Out, added to:
    matrix_out: wp.array(dtype=wp.mat33),
    pull_out: wp.array(dtype=wp.vec3),
):
    """One thread a cloud point, with its nearest vertex, which others may share."""
    i = begin + wp.tid()
    j = nearest[i]
    if j >= 0:
        t = cloud_frame[i]
        b = outward_of(vertices, border, t * border.shape[0], j - t * border.shape[0])
        d = vertices[j] - cloud[i]
        if wp.dot(b, d) < 0.0:
            if wp.length_sq(pair_plane(cloud_normals[i], vertex_normals[j], agreement, share)) > 0.0:
                w = stiffness * pair_weight(d, reach[t])
                wp.atomic_add(matrix_out, j, w * wp.outer(b, b))
                wp.atomic_add(pull_out, j, (-w * wp.dot(b, d)) * b)


def vertex_borders(
    begin,
    count,
    pairing,
    vertices,
    normals,
    frame,
    nearest,
    cloud,
    cloud_normals,
    border,
    stiffness,
    gap,
    matrix_out,
    pull_out,
    one_sided=BOTH_SIDES,
):
    """Add the border's part of vertex-to-cloud pairs, vertices ``begin .. begin + count`` of all frames.

    Args:
        border: shape (V, 3) int32: for a border vertex those before and after it on the border, and one inside; -1 for
            all others. stiffness: weight against one plane of ``planes``. gap: shape (T,) float32, cube units.
        matrix_out, pull_out: shape (T V,), added to. All else as in ``planes.vertex_planes``.
    """
    inputs = [begin, *pairing, vertices, normals, frame, nearest, cloud, cloud_normals, *one_sided]
    launch(_vertex_borders, count, [*inputs, border, stiffness, gap, matrix_out, pull_out], vertices.device)


def cloud_borders(
    begin,
    count,
    pairing,
    vertices,
    normals,
    frame,
    nearest,
    cloud,
    cloud_normals,
    border,
    stiffness,
    matrix_out,
    pull_out,
):
    """Add what cloud points beyond the border ask for, points ``begin .. begin + count``; frame, nearest: (N,)."""
    inputs = [begin, *pairing, vertices, normals, frame, nearest, cloud, cloud_normals]
    launch(_cloud_borders, count, [*inputs, border, stiffness, matrix_out, pull_out], vertices.device)
