"""Surface that the one camera that saw all clouds would have seen, and did not.

What a camera does not see may be anywhere out of its sight: behind what it saw, or turned away. Surface that faces it,
beside or before all that it saw, is wrong even if no point is left uncovered: a hidden arm held up where nothing is.
"""

from __future__ import annotations

import numpy as np

from warpdef.geometry.triangles import vertex_normals
from warpdef.geometry.viewpoint import Picture
from warpdef.quality.coverage import FAR, Coverage

ROOM = 8.0
"""Lengths beside or before the points from which surface is in sight: the view is taken to be from far away."""


def exposed_share(
    points: np.ndarray, vertices: np.ndarray, faces: np.ndarray, coverage: Coverage, view: np.ndarray
) -> float:
    """Share of the surface that stands where the camera saw nothing, or through it to what is behind.

    Args:
        points: shape (N, 3). vertices: shape (V, 3). faces: shape (F, 3). coverage: of these.
        view: unit vector towards the camera, (3,).
    """
    towards = np.flatnonzero((vertex_normals(vertices, faces) @ view > 0.0) & (coverage.away > FAR))
    exposed = np.zeros(len(vertices))
    if len(towards):
        room = ROOM * float(np.median(coverage.length))
        exposed[towards[Picture.of(points, view).contradicts(vertices[towards], room)[0]]] = 1.0
    return coverage.share(exposed[faces].mean(axis=1))
