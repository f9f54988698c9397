"""Surface that the one camera that saw all clouds would have seen, and did not.

What a camera does not see may be anywhere out of its sight: behind what it saw, or turned away. Surface that faces it,
beside or before all that it saw, is wrong even if no point is left uncovered: a hidden arm held up where nothing is.
"""

from __future__ import annotations

import numpy as np

from warpdef.geometry.triangles import vertex_normals
from warpdef.geometry.viewpoint import Picture
from warpdef.quality.coverage import FAR, Coverage

ROOM = 12.0
"""Lengths beside or before the points from which surface is in sight: where the camera stands is known roughly."""


def exposed_share(
    points: np.ndarray, vertices: np.ndarray, faces: np.ndarray, coverage: Coverage, eye: np.ndarray
) -> float:
    """Share of the surface that stands where the camera saw nothing, or through it to what is behind.

    Args:
        points: shape (N, 3). vertices: shape (V, 3). faces: shape (F, 3). coverage: of these.
        eye: place of the camera, (3,), the same units.
    """
    facing = (vertex_normals(vertices, faces) * (eye - vertices)).sum(axis=1) > 0.0
    towards = np.flatnonzero(facing & (coverage.away > FAR))
    exposed = np.zeros(len(vertices))
    if len(towards):
        room = ROOM * float(np.median(coverage.length))
        exposed[towards[Picture.of(points, eye).contradicts(vertices[towards], room)[0]]] = 1.0
    return coverage.share(exposed[faces].mean(axis=1))
