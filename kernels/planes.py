"""Symmetric point-to-plane residuals and their normal equations (Rusinkiewicz 2019, symmetric ICP).

A vertex x with normal m and a cloud point q with normal n, paired by nearest neighbour, ask for

    r = a . (x - q) = 0,   a = (s n + m) / |s n + m|,   weight w = exp(-(|x - q| / reach)^2)

which for s = 1 vanishes to second order on a curved surface, where the plain n does so to first order only; s falls to
0 for noisy clouds, whose normals say less than the mesh's. Pairs whose normals
differ by more than ``agreement`` (a cosine) are left out: the other side of a thin limb is no partner. A vertex x + d
that minimises the sum of w r^2 solves A d = b with A = sum w a a^T and b = -sum w r a; A and b are what the kernels add
up, so b is minus half the gradient at d = 0, with a, w and the pairs held. Against a cloud that shows only part of the
surface the vertices' own pairs are weighed by the way back, as in ``chamfer``.
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.chamfer import BOTH_SIDES, mutual_weight
from warpdef.kernels.launching import MODULE_OPTIONS, launch

wp.set_module_options(MODULE_OPTIONS)


@wp.func
def pair_plane(n: wp.vec3, m: wp.vec3, agreement: float, share: float) -> wp.vec3:
    """Common unit normal of a pair; zero where the two disagree."""
    a = wp.vec3(0.0, 0.0, 0.0)
    if wp.dot(n, m) > agreement:
        a = wp.normalize(share * n + m)
    return a


@wp.func
def pair_weight(d: wp.vec3, reach: float) -> float:
    return wp.exp(-wp.length_sq(d) / (reach * reach))


@wp.kernel
def _vertex_normals(
    # In:
    begin: int,
    faces: wp.array2d(dtype=wp.int32),
    face_row: wp.array(dtype=wp.int32),
    face_of: wp.array(dtype=wp.int32),
    vertices: wp.array2d(dtype=wp.vec3),
    # Out:
    normals_out: wp.array2d(dtype=wp.vec3),
):
    """One thread a vertex of a frame; area-weighted, zero where all faces around are degenerate."""
    k = begin + wp.tid()
    t = k // vertices.shape[1]
    i = k - t * vertices.shape[1]
    total = wp.vec3(0.0, 0.0, 0.0)
    for e in range(face_row[i], face_row[i + 1]):
        f = face_of[e]
        a = vertices[t, faces[f, 0]]
        total += wp.cross(vertices[t, faces[f, 1]] - a, vertices[t, faces[f, 2]] - a)
    normals_out[t, i] = wp.normalize(total)


@wp.kernel
def _vertex_planes(
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
    # Out:
    matrix_out: wp.array(dtype=wp.mat33),
    pull_out: wp.array(dtype=wp.vec3),
):
    """One thread a vertex of a frame, with its nearest cloud point; written, not added."""
    i = begin + wp.tid()
    j = nearest[i]
    matrix = wp.mat33()
    pull = wp.vec3(0.0, 0.0, 0.0)
    if j >= 0:
        d = vertices[i] - cloud[j]
        a = pair_plane(cloud_normals[j], vertex_normals[i], agreement, share)
        w = pair_weight(d, reach[vertex_frame[i]])
        w *= mutual_weight(vertices, i, back, j, mutual_reach, vertex_frame[i])
        matrix = w * wp.outer(a, a)
        pull = (-w * wp.dot(a, d)) * a
    matrix_out[i] = matrix
    pull_out[i] = pull


@wp.kernel
def _cloud_planes(
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
    # Out, added to:
    matrix_out: wp.array(dtype=wp.mat33),
    pull_out: wp.array(dtype=wp.vec3),
):
    """One thread a cloud point, with its nearest vertex, which others may share."""
    i = begin + wp.tid()
    j = nearest[i]
    if j >= 0:
        d = vertices[j] - cloud[i]
        a = pair_plane(cloud_normals[i], vertex_normals[j], agreement, share)
        w = pair_weight(d, reach[cloud_frame[i]])
        wp.atomic_add(matrix_out, j, w * wp.outer(a, a))
        wp.atomic_add(pull_out, j, (-w * wp.dot(a, d)) * a)


def vertex_normals(begin, count, faces, face_row, face_of, vertices, normals_out):
    """Unit normals of ``count`` vertices from ``begin``, counted over all frames.

    Args:
        faces: shape (F, 3) int32. face_row, face_of: faces around each vertex, compressed rows.
        vertices, normals_out: shape (T, V) vec3.
    """
    launch(_vertex_normals, count, [begin, faces, face_row, face_of, vertices, normals_out], vertices.device)


def vertex_planes(
    begin,
    count,
    pairing,
    vertices,
    normals,
    frame,
    nearest,
    cloud,
    cloud_normals,
    matrix_out,
    pull_out,
    one_sided=BOTH_SIDES,
):
    """Normal equations of vertex-to-cloud pairs, vertices ``begin .. begin + count`` of all frames.

    Args:
        pairing: (agreement, share of the cloud's normal, reach), reach of shape (T,) float32, cube units.
        vertices, normals: shape (T V,) vec3. frame, nearest: shape (T V,) int32, -1 for none.
        cloud, cloud_normals: shape (N,) vec3, oriented. matrix_out: shape (T V,) mat33. pull_out: shape (T V,) vec3.
        one_sided: (back, reach): nearest vertex of every cloud point, shape (N,) int32, -1 for none; and shape (T,)
            float32, cube units, infinite for frames that show all of the surface.
    """
    inputs = [begin, *pairing, vertices, normals, frame, nearest, cloud, cloud_normals]
    launch(_vertex_planes, count, [*inputs, *one_sided, matrix_out, pull_out], vertices.device)


def cloud_planes(begin, count, pairing, vertices, normals, frame, nearest, cloud, cloud_normals, matrix_out, pull_out):
    """Add the normal equations of cloud-to-vertex pairs, points ``begin .. begin + count``; frame, nearest: (N,)."""
    inputs = [begin, *pairing, vertices, normals, frame, nearest, cloud, cloud_normals, matrix_out, pull_out]
    launch(_cloud_planes, count, inputs, vertices.device)
