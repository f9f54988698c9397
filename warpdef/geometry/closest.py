"""Exact distances from points to surfaces; none of the method's own kernels, so an independent witness of them.

Where Warp runs it may be asked which face is nearest, in single precision, by its own tree; distances are those to that
face, in double precision. Of two faces as near as float32 tells, either is taken: 2e-8 of the extent on a body.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from warpdef.errors import MissingPackageError

if TYPE_CHECKING:
    import warp as wp


def closest_on_triangles(points: np.ndarray, a: np.ndarray, ab: np.ndarray, ac: np.ndarray) -> tuple[np.ndarray, ...]:
    """Closest place on a triangle, one triangle a point (Ericson, Real-Time Collision Detection, sec. 5.1.5).

    Args:
        points, a, ab, ac: shape (N, 3): the point, the triangle's first corner, and its edges from there.

    Returns:
        Squared distances (N,) and the barycentric coordinates v, w (N,) each of the second and third corner.
    """
    ap = points - a
    d1, d2 = np.einsum("ni,ni->n", ab, ap), np.einsum("ni,ni->n", ac, ap)
    bb, cc, bc = np.einsum("ni,ni->n", ab, ab), np.einsum("ni,ni->n", ac, ac), np.einsum("ni,ni->n", ab, ac)
    tiny = np.finfo(np.float64).tiny
    determinant = bb * cc - bc * bc
    # A sliver has no stable inside; its edges, tried below, hold its closest place.
    solid = determinant > 1e-14 * bb * cc
    scale = 1.0 / np.where(solid, determinant, 1.0)
    v, w = (cc * d1 - bc * d2) * scale, (bb * d2 - bc * d1) * scale
    inside = solid & (v >= 0.0) & (w >= 0.0) & (v + w <= 1.0)
    outside = np.flatnonzero(~inside)
    if len(outside):
        d1, d2, bb, cc, bc = d1[outside], d2[outside], bb[outside], cc[outside], bc[outside]
        on_ab = np.clip(d1 / np.maximum(bb, tiny), 0.0, 1.0)
        on_ac = np.clip(d2 / np.maximum(cc, tiny), 0.0, 1.0)
        along = np.clip((d2 - d1 + bb - bc) / np.maximum(bb + cc - 2.0 * bc, tiny), 0.0, 1.0)
        zero = np.zeros_like(on_ab)
        edge_v, edge_w = np.stack([on_ab, zero, 1.0 - along]), np.stack([zero, on_ac, along])
        # Squared distance less the constant part |ap|^2.
        value = edge_v**2 * bb + edge_w**2 * cc + 2.0 * edge_v * edge_w * bc - 2.0 * (edge_v * d1 + edge_w * d2)
        best = value.argmin(axis=0), np.arange(len(outside))
        v[outside], w[outside] = edge_v[best], edge_w[best]
    gap = ap - v[:, None] * ab - w[:, None] * ac
    return np.einsum("ni,ni->n", gap, gap), v, w


def closest_on_surface(
    points: np.ndarray, vertices: np.ndarray, faces: np.ndarray, device: wp.Device | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Exact closest place of a triangle mesh to each point (gpytoolbox's bounding-volume tree, or Warp's).

    Args:
        points: shape (N, 3).
        vertices: shape (V, 3), the points' units.
        faces: shape (F, 3); degenerate triangles are welcome.
        device: where Warp is to ask its tree; None: without Warp.

    Returns:
        Distances (N,), face indices (N,), and barycentric coordinates (N, 3), none negative.

    Raises:
        MissingPackageError: gpytoolbox cannot be imported.
    """
    points, vertices = np.asarray(points, dtype=np.float64), np.asarray(vertices, dtype=np.float64)
    face = None if device is None else _faces_on_device(points, vertices, faces, device)
    if face is None:
        face = _faces_by_tree(points, vertices, faces)
    a, b, c = np.moveaxis(vertices[faces[face]], 1, 0)
    squared, v, w = closest_on_triangles(points, a, b - a, c - a)
    return np.sqrt(squared), face, np.column_stack([np.maximum(1.0 - v - w, 0.0), v, w])


def closest_kernels() -> list[wp.Kernel]:
    """What ``closest_on_surface`` launches on a device."""
    import warp as wp

    from warpdef.kernels.closest_faces import closest_faces
    from warpdef.kernels.launching import listing

    with listing() as found:
        host = wp.get_device("cpu")
        point, face = wp.zeros(1, dtype=wp.vec3, device=host), wp.zeros(1, dtype=wp.int32, device=host)
        closest_faces(0, 1, 0, point, face)
    return found


def load_closest(device: wp.Device) -> None:
    """Let Warp compile and load that, before several threads ask."""
    for kernel in closest_kernels():
        kernel.module.load(device)


def _faces_on_device(
    points: np.ndarray, vertices: np.ndarray, faces: np.ndarray, device: wp.Device
) -> np.ndarray | None:
    """Nearest faces (N,); None where float32 cannot tell them."""
    import warp as wp

    from warpdef.device import on_host
    from warpdef.kernels.closest_faces import closest_faces

    if not len(points) or not len(faces):
        return None
    middle = np.median(vertices, axis=0)
    scale = float(np.abs(vertices - middle).max()) or 1.0

    def uploaded(places: np.ndarray) -> wp.array:
        return wp.array(((places - middle) / scale).astype(np.float32), dtype=wp.vec3, device=device)

    corners = wp.array(np.ascontiguousarray(faces, dtype=np.int32).ravel(), dtype=wp.int32, device=device)
    mesh, asked = wp.Mesh(uploaded(vertices), corners), uploaded(points)
    found = wp.zeros(len(points), dtype=wp.int32, device=device)
    closest_faces(0, len(points), mesh.id, asked, found)
    face = on_host(found)
    return None if (face < 0).any() else face


def _faces_by_tree(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    try:
        import gpytoolbox
    except ImportError as error:
        raise MissingPackageError(
            f"distances to a surface need gpytoolbox, which failed to import ({error}); "
            "install it: pip install gpytoolbox"
        ) from error
    # Its own barycentric coordinates are NaN on degenerate triangles; only the face is taken.
    with np.errstate(divide="ignore", invalid="ignore"):
        _, face, _ = gpytoolbox.squared_distance(points, vertices, np.asarray(faces, dtype=np.int32), use_cpp=True)
    return face
