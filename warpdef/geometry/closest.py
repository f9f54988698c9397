"""Exact distances from points to surfaces; none of the method's own kernels, so an independent witness of them."""

from __future__ import annotations

import numpy as np

from warpdef.errors import MissingPackageError


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
    points: np.ndarray, vertices: np.ndarray, faces: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Exact closest place of a triangle mesh to each point (gpytoolbox's bounding-volume tree).

    Args:
        points: shape (N, 3).
        vertices: shape (V, 3), the points' units.
        faces: shape (F, 3); degenerate triangles are welcome.

    Returns:
        Distances (N,), face indices (N,), and barycentric coordinates (N, 3), none negative.

    Raises:
        MissingPackageError: gpytoolbox cannot be imported.
    """
    try:
        import gpytoolbox
    except ImportError as error:
        raise MissingPackageError(
            f"distances to a surface need gpytoolbox, which failed to import ({error}); "
            "install it: pip install gpytoolbox"
        ) from error
    points, vertices = np.asarray(points, dtype=np.float64), np.asarray(vertices, dtype=np.float64)
    # Its own barycentric coordinates are NaN on degenerate triangles; only the face is taken.
    with np.errstate(divide="ignore", invalid="ignore"):
        _, face, _ = gpytoolbox.squared_distance(points, vertices, np.asarray(faces, dtype=np.int32), use_cpp=True)
    a, b, c = np.moveaxis(vertices[faces[face]], 1, 0)
    squared, v, w = closest_on_triangles(points, a, b - a, c - a)
    return np.sqrt(squared), face, np.column_stack([np.maximum(1.0 - v - w, 0.0), v, w])
