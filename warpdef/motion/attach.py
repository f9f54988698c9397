"""Which vertices of a surface a point goes with.

On the surface a point goes with its triangle, by barycentric coordinates. Off it that would jump wherever the nearest
triangle changes, so that beyond an edge length the nearest vertices take over, with weights that fall to 0 at the first
one left out (Sumner, Schmid and Pauly 2007, Embedded Deformation, eq. 4).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

_NEIGHBOURS = 64
_FULL, _NONE = 1.0, 3.0  # mean edge lengths within which the triangle alone counts, and beyond which not at all


@dataclass(frozen=True)
class Attachment:
    """N points held by the V vertices of a mesh.

    weights:  of every vertex on every point, rows of sum 1       sparse (N, V)
    spread:   the part of them that does not come from a triangle sparse (N, V)
    on:       how much a point goes with its triangle, 1 to 0     (N,)
    foot:     nearest place of the surface                        (N, 3)
    distance: from there                                          (N,)
    """

    weights: Any
    spread: Any
    on: np.ndarray
    foot: np.ndarray
    distance: np.ndarray


def attach(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> Attachment:
    """Attach points to a mesh.

    Args:
        points: shape (N, 3). vertices: shape (V, 3), the points' units. faces: shape (F, 3).

    Raises:
        MissingPackageError: gpytoolbox cannot be imported.
    """
    from scipy import sparse
    from scipy.spatial import cKDTree

    from warpdef.geometry.closest import closest_on_surface

    points, vertices = np.asarray(points, dtype=np.float64), np.asarray(vertices, dtype=np.float64)
    faces = np.asarray(faces, dtype=np.int64)
    count, total = len(points), len(vertices)
    distance, face, corner = closest_on_surface(points, vertices, faces)
    edge = np.linalg.norm(vertices[faces] - vertices[np.roll(faces, 1, axis=1)], axis=2).mean()
    fade = np.clip((distance / max(edge, np.finfo(float).tiny) - _FULL) / (_NONE - _FULL), 0.0, 1.0)
    on = 1.0 - fade * fade * (3.0 - 2.0 * fade)

    number = min(_NEIGHBOURS, total - 1)
    near, index = cKDTree(vertices).query(points, k=number + 1)
    # A point that is a vertex stays one, whatever rounding makes of its barycentric coordinates.
    same = near[:, 0] == 0.0
    corners = faces[face]
    corners[same], corner[same] = index[same, :1], [1.0, 0.0, 0.0]
    distance[same], on[same] = 0.0, 1.0
    foot = np.einsum("nc,nci->ni", corner, vertices[corners])
    foot[same] = points[same]

    share = (1.0 - near[:, :-1] / np.maximum(near[:, -1:], np.finfo(float).tiny)) ** 2 + 1e-12
    share *= (1.0 - on)[:, None] / share.sum(axis=1, keepdims=True)

    def matrix(values: np.ndarray, columns: np.ndarray):
        rows = np.repeat(np.arange(count), columns.shape[1])
        return sparse.csr_array((values.ravel(), (rows, columns.ravel())), shape=(count, total))

    spread = matrix(share, index[:, :-1])
    spread.eliminate_zeros()
    return Attachment(matrix(corner * on[:, None], corners) + spread, spread, on, foot, distance)
