"""Surface where the points say that there is none: a mesh that hangs over their end, or is larger than what they show.

What a scanner did not see looks alike at first, and is no fault of the mesh: surface far from every point. Two things
tell it from a mesh that slid along its body, or has put a foot where there is none:

1. Where a scan ends its points see a border (``geometry.borders``). A patch far from all points, of whose
   nearest ones none does, hangs over where the surface closes.
2. A frame whose points show as much area as those of the keyframe lacks nothing. By as much as it shows less, as much
   of the surface may be far from them.
3. What was not seen keeps its size. A sheet that hangs over the border of its points, and is by as much larger than in
   any frame that shows all of it, was drawn out by the fit.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from warpdef.geometry.borders import border_points
from warpdef.geometry.cloud_planes import pca_normals
from warpdef.geometry.coverage import JUDGED
from warpdef.geometry.triangles import boundary_edges, face_normals, vertex_areas, vertex_components
from warpdef.quality.coverage import FAR, OTHER_SIDE, Coverage

CLOSED = 0.9
"""Share of a patch's contour whose nearest points see no border, from which the surface closes there: 1.00 at the end
of a limb that the mesh has left, below 0.5 where a camera saw no further."""
BEYOND = 3.0
"""Lengths from every point from which surface at a border counts as beyond them: of points thrown at random, one place
in a thousand is as far from all."""
SHOWN = 0.003
"""Share of the surface there up to which points show all of it."""
_ASKED = 5  # points from which they say something
_LEAST = 0.001  # share of the surface that is worth asking for
_TRUSTED = 1.1  # times the surface that is not far, up to which a cloud's area is believed


def overhang_share(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray, coverage: Coverage) -> float:
    """Share of the surface that lies far beyond points whose own surface closes.

    Args:
        points: shape (N, 3). vertices: shape (V, 3). faces: shape (F, 3). coverage: of these.
    """
    far = coverage.away > FAR
    if coverage.far < _LEAST or not far.any():
        return 0.0
    patch, area = vertex_components(faces, far), vertex_areas(vertices, faces)
    edge = faces[far[faces].any(axis=1) & ~far[faces].all(axis=1)]
    contour = np.unique(edge[far[edge]])
    point = coverage.nearest[contour]
    # Across a flat body the points of the other side are near, which say nothing of this one.
    facing = (coverage.normals[contour] * face_normals(vertices, faces[coverage.face[point]])[0]).sum(axis=1)
    asked, which = np.unique(point, return_inverse=True)
    closing = ~border_points(points, pca_normals(points, asked=asked), asked)[which] & (facing > OTHER_SIDE)
    hanging = 0.0
    for number in np.unique(patch[contour]):
        around = patch[contour] == number
        if len(np.unique(point[around])) >= _ASKED and closing[around].mean() >= CLOSED:
            hanging += float(area[patch == number].sum())
    return hanging / max(float(area.sum()), np.finfo(float).tiny)


def surplus_share(coverage: Coverage, keyframe: Coverage) -> float | None:
    """Share of the keyframe's surface that is far from this frame's points, and that these do not show less.

    None where one of the clouds cannot tell its area.
    """
    area, most = _shown_area(coverage), _shown_area(keyframe)
    surface = float(keyframe.areas.sum())
    if area is None or not most:
        return None
    # What the keyframe's points did not see of its mesh need not be seen here.
    lacking = max(1.0 - min(area / most, area / surface), 0.0)
    return max(coverage.far * float(coverage.areas.sum()) / surface - lacking, 0.0)


def outgrown_shares(
    coverages: Sequence[Coverage | None], vertices: Iterable[np.ndarray], faces: np.ndarray, keyframe: int
) -> list[float | None]:
    """Of each frame, the surface beyond the border of its points by which it has outgrown the keyframe, as a share of
    the keyframe's; and all frames whose points show the whole of it, as what is stretchy stretches there as well.

    None where there are no points. All of them are, where the mesh is closed, or the keyframe's points do not show the
    whole of it themselves.

    Args:
        coverages: T of them. vertices: T arrays (V, 3). faces: shape (F, 3).
    """
    border, key = np.unique(boundary_edges(faces)), coverages[keyframe]
    surface = 0.0 if key is None else float(key.areas.sum())
    none: list[float | None] = [None] * len(coverages)
    if not len(border) or not surface:
        return none
    growth = [-np.inf if c is None else float(c.areas.sum()) / surface - 1.0 for c in coverages]
    beyond = [np.inf if c is None else _beyond(c, v, faces, border) for c, v in zip(coverages, vertices, strict=True)]
    if beyond[keyframe] > SHOWN * surface:
        return none
    most = max(g for g, b in zip(growth, beyond, strict=True) if b <= SHOWN * surface)
    pairs = zip(growth, beyond, coverages, strict=True)
    return [None if c is None else max(min(b / surface, g - most), 0.0) for g, b, c in pairs]


def _beyond(coverage: Coverage, vertices: np.ndarray, faces: np.ndarray, border: np.ndarray) -> float:
    """Area of what lies beyond the points at the mesh's own border, vertices (B,); input units squared."""
    patch = vertex_components(faces, coverage.away > BEYOND)
    at_border = np.isin(patch, patch[border]) & (patch >= 0)
    return float(vertex_areas(vertices, faces)[at_border].sum())


def _shown_area(coverage: Coverage) -> float | None:
    """Area that the points show, input units squared; None for few points, and where noise or strays make much of it.

    A point stands for four squared spacings.
    """
    area, near = 4.0 * float((coverage.spacing**2).sum()), float(coverage.areas.sum()) * (1.0 - coverage.far)
    return area if len(coverage.spacing) >= JUDGED and area <= _TRUSTED * near else None
