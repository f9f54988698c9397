"""Surface that the one camera that saw all clouds would have seen, and did not.

What a camera does not see may be anywhere out of its sight: behind what it saw, or turned away. Surface that faces it,
beside or before all that it saw, is wrong even if no point is left uncovered: a hidden arm held up where nothing is.

Where the camera stands is known roughly, so that what lies deeper than the points beside it moves in the picture, and
is given room. What spans a gap between points, at their own depth, does not: a web between two limbs needs less.
"""

from __future__ import annotations

import numpy as np

from warpdef.geometry.viewpoint import Picture
from warpdef.quality.coverage import FAR, Coverage

ROOM = 12.0
"""Lengths beside or before the points from which surface is in sight: where the camera stands is known roughly."""
GAP_FREE = 2.6
"""Widest angle in which no points are, seen in the picture from surface that spans a gap; 150 degrees. Beyond an
outline it is a half turn."""
_TOWARDS = 0.5  # least cosine of surface that faces the camera: what is steeper loses its points


def exposed_share(
    points: np.ndarray, vertices: np.ndarray, faces: np.ndarray, coverage: Coverage, eye: np.ndarray
) -> float:
    """Share of the surface that stands where the camera saw nothing, or through it to what is behind.

    Args:
        points: shape (N, 3). vertices: shape (V, 3). faces: shape (F, 3). coverage: of these.
        eye: place of the camera, (3,), the same units.
    """
    facing = (coverage.normals * (eye - vertices)).sum(axis=1) > 0.0
    towards = np.flatnonzero(facing & (coverage.away > FAR))
    exposed = np.zeros(len(vertices))
    if len(towards):
        room = ROOM * float(np.median(coverage.length))
        exposed[towards[Picture.of(points, eye).contradicts(vertices[towards], room)[0]]] = 1.0
    return coverage.share(exposed[faces].mean(axis=1))


def spanning_share(
    points: np.ndarray, vertices: np.ndarray, faces: np.ndarray, coverage: Coverage, eye: np.ndarray
) -> float:
    """Share of the surface that spans gaps through which the camera saw: it faces the camera, far from every point,
    as deep as the points beside it, and these lie around it in the picture.

    Args:
        points: shape (N, 3). vertices: shape (V, 3). faces: shape (F, 3). coverage: of these.
        eye: place of the camera, (3,), the same units.
    """
    towards = eye - vertices
    steep = (coverage.normals * towards).sum(axis=1) < _TOWARDS * np.linalg.norm(towards, axis=1)
    asked = np.flatnonzero((coverage.away > FAR) & ~steep)
    spanning = np.zeros(len(vertices))
    if len(asked):
        length = float(np.median(coverage.length))
        found = Picture.of(points, eye).in_gaps(vertices[asked], FAR * length, ROOM * length, GAP_FREE)
        spanning[asked[found]] = 1.0
    return coverage.share(spanning[faces].mean(axis=1))
