"""The face of a mesh that is nearest to each of some points: Warp's tree of bounding volumes; no gradient.

Which face it is float32 decides: of two equally far ones, as two beside an edge, either is an answer.
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS, launch
from warpdef.kernels.sizes import sizes

wp.set_module_options(MODULE_OPTIONS)

_ANYWHERE = wp.constant(1.0e12)


@sizes("threads points face_out: K")
@wp.kernel
def _closest_faces(
    # In:
    begin: int,
    mesh: wp.uint64,
    points: wp.array[wp.vec3],
    # Out:
    face_out: wp.array[wp.int32],
):
    """One thread a point."""
    i = begin + wp.tid()
    found = wp.mesh_query_point_no_sign(mesh, points[i], _ANYWHERE)
    face_out[i] = wp.where(found.result, found.face, -1)


def closest_faces(begin: int, count: int, mesh: int, points: wp.array, face_out: wp.array) -> None:
    """Faces for points ``begin .. begin + count``.

    Args:
        mesh: ``wp.Mesh.id`` of triangles on the points' device; degenerate ones are passed over.
        points: shape (K,) vec3, the mesh's units.
        face_out: shape (K,) int32; -1 where no face has a distance, as to a point that is no number.
    """
    launch(_closest_faces, count, [begin, mesh, points, face_out], points.device)
