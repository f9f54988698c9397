"""Symmetric point-to-plane residuals and their normal equations (Rusinkiewicz 2019, symmetric ICP).

Every pair of ``pairs`` with plane a and weight w asks for r = a . (x - q) = 0. A vertex x + d that minimises the sum
of w r^2 solves A d = b with A = sum w a a^T and b = -sum w r a; A and b are what the kernels add up, so b is minus half
the gradient at d = 0, with a, w and the pairs held.

A vertex whose normal disagrees with its point's has no common plane. Where a frame shows all of the surface it lies in
a fold that the cloud does not have; the point's own plane draws it out, by the small weight ``Pairs.folded``.
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS, launch
from warpdef.kernels.pairs import Pairs, own_weight, pair_plane, pair_weight
from warpdef.kernels.sizes import sizes

wp.set_module_options(MODULE_OPTIONS)


@sizes("threads: T*V; faces: F 3; face_row: V+1; face_of: H; vertices normals_out: T V")
@wp.kernel
def _vertex_normals(
    # In:
    begin: int,
    faces: wp.array2d[wp.int32],
    face_row: wp.array[wp.int32],
    face_of: wp.array[wp.int32],
    vertices: wp.array2d[wp.vec3],
    # Out:
    normals_out: wp.array2d[wp.vec3],
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


@sizes("threads: K=P; matrix_out rhs_out: P")
@wp.kernel
def _vertex_planes(
    # In:
    begin: int,
    pairs: Pairs,
    # Out:
    matrix_out: wp.array[wp.mat33],
    rhs_out: wp.array[wp.vec3],
):
    """One thread a vertex of a frame, with its nearest cloud point; written, not added."""
    i = begin + wp.tid()
    j = pairs.nearest[i]
    matrix = wp.mat33()
    rhs = wp.vec3(0.0, 0.0, 0.0)
    if j >= 0:
        a = pair_plane(pairs, i, j)
        w = own_weight(pairs, i, j, pairs.frame[i])
        matrix = w * wp.outer(a, a)
        rhs = (-w * wp.dot(a, pairs.vertices[i] - pairs.cloud[j])) * a
        if wp.length_sq(a) == 0.0:
            n = pairs.cloud_normals[j]
            f = pairs.folded[pairs.frame[i]] * w
            matrix = f * wp.outer(n, n)
            rhs = (-f * wp.dot(n, pairs.vertices[i] - pairs.cloud[j])) * n
    matrix_out[i] = matrix
    rhs_out[i] = rhs


@sizes("threads: K=N; matrix_out rhs_out: P")
@wp.kernel
def _cloud_planes(
    # In:
    begin: int,
    pairs: Pairs,
    # Out, added to:
    matrix_out: wp.array[wp.mat33],
    rhs_out: wp.array[wp.vec3],
):
    """One thread a cloud point, with its nearest vertex, which others may share."""
    i = begin + wp.tid()
    j = pairs.nearest[i]
    if j >= 0:
        a = pair_plane(pairs, j, i)
        w = pair_weight(pairs, j, i, pairs.frame[i])
        wp.atomic_add(matrix_out, j, w * wp.outer(a, a))
        wp.atomic_add(rhs_out, j, (-w * wp.dot(a, pairs.vertices[j] - pairs.cloud[i])) * a)


def vertex_normals(
    begin: int, count: int, faces: wp.array, face_row: wp.array, face_of: wp.array, vertices: wp.array,
    normals_out: wp.array,
) -> None:  # fmt: skip
    """Unit normals of ``count`` vertices from ``begin``, counted over all frames.

    Args:
        faces: shape (F, 3) int32. face_row, face_of: faces around each vertex, compressed rows.
        vertices, normals_out: shape (T, V) vec3.
    """
    launch(_vertex_normals, count, [begin, faces, face_row, face_of, vertices, normals_out], vertices.device)


def vertex_planes(begin: int, count: int, pairs: Pairs, matrix_out: wp.array, rhs_out: wp.array) -> None:
    """Normal equations of vertex-to-cloud pairs, vertices ``begin .. begin + count`` of all frames.

    Args:
        pairs: by vertex, see ``pairs_of``. matrix_out: shape (T V,) mat33. rhs_out: shape (T V,) vec3.
    """
    launch(_vertex_planes, count, [begin, pairs, matrix_out, rhs_out], matrix_out.device)


def cloud_planes(begin: int, count: int, pairs: Pairs, matrix_out: wp.array, rhs_out: wp.array) -> None:
    """Add the normal equations of cloud-to-vertex pairs, by point, for points ``begin .. begin + count``."""
    launch(_cloud_planes, count, [begin, pairs, matrix_out, rhs_out], matrix_out.device)
