"""Where the points of a cloud end, its surface ends too: an open template instead of a balloon.

Screened Poisson closes everything. An unsupported patch of its surface (``support`` below 1/2) is an opening of the
body if it is larger than a gap between random points, reaches away from them, and the points around it see a border as
well; all others are closed over: sampling gaps, cavities too fine for the cloud, and surface that went astray for want
of good normals, which the quality gate then finds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warpdef.geometry import triangles
from warpdef.geometry.borders import border_points
from warpdef.template.support import Support

OPENING_POINTS = 12.0  # least size of an opening, in areas of a point
OPENING_DEPTH = 1.9  # least distance of its deepest place from all points, in sqrt(area of a point)
CONFIRMED = 0.25  # least share of its border that the points must see
BORDER_STRIP = 0.8  # width of the strip in which ``border_points`` finds a point, in sqrt(area of a point)
BORDER_REACH = 1.5  # how far from the contour that strip is looked for, in the same unit
ISLAND_SHARE = 0.02  # a supported piece with less than this share of the whole is dropped
MARGIN = 4.0  # kept around the supported part before it is remeshed, in sqrt(area of a point)
_STAYS, _GOES = 0.25, -0.25  # levels given to patches as a whole


@dataclass(frozen=True)
class Trimming:
    """Which part of a surface stays.

    level:    above 0 where it stays, its contour 0 the new border  (V,)
    share:    area that goes over area that stays
    openings: patches that go
    opening:  the number of each vertex's opening, -1 in none  (V,)
    """

    level: np.ndarray
    share: float
    openings: int
    opening: np.ndarray


def find_trimming(vertices: np.ndarray, faces: np.ndarray, support: Support) -> Trimming:
    """Judge every unsupported patch of a surface (V, 3), (F, 3) whose faces have the side of the support's normals."""
    level = support.at(vertices, triangles.vertex_normals(vertices, faces)) - 0.5
    area = triangles.vertex_areas(vertices, faces)
    # Patches are measured in points, so that sparse places may have larger gaps.
    points = area / support.local_area(vertices)
    patch = triangles.vertex_components(faces, level <= 0)
    opening = _openings(vertices, faces, level, patch, points, support)
    numbers = np.where(np.append(opening, False)[patch], patch, -1)
    level[(patch >= 0) & (numbers < 0)] = _STAYS
    piece = triangles.vertex_components(faces, level > 0)
    if piece.max() > 0:
        size = np.bincount(piece[piece >= 0], points[piece >= 0])
        level[(piece >= 0) & np.append(size < ISLAND_SHARE * size.sum(), False)[piece]] = _GOES
    stays = level > 0
    share = float(area[~stays].sum() / max(area[stays].sum(), 1e-300))
    return Trimming(level, share, int(opening.sum()), numbers)


def _openings(
    vertices: np.ndarray,
    faces: np.ndarray,
    level: np.ndarray,
    patch: np.ndarray,
    points: np.ndarray,
    support: Support,
) -> np.ndarray:
    """Which of the patches, numbered by ``patch`` (V,), are openings of the body."""
    from scipy.spatial import cKDTree

    count = int(patch.max()) + 1
    inside = patch >= 0
    size = np.bincount(patch[inside], points[inside], minlength=count)
    depth = np.zeros(count)
    np.maximum.at(depth, patch[inside], support.distance(vertices[inside]))
    middle, length, owner = _contour(vertices, faces, level, patch)
    if not len(middle):
        # All of the surface is supported, or none: then it went astray as a whole.
        return np.zeros(count, dtype=bool)
    length = np.bincount(owner, length / np.sqrt(support.local_area(middle)), minlength=count)
    border = border_points(support.points, support.normals)
    distance, nearest = cKDTree(middle).query(support.points[border])
    near = distance < BORDER_REACH * np.sqrt(support.area[border])
    seen = np.bincount(owner[nearest[near]], minlength=count)
    return (size >= OPENING_POINTS) & (depth >= OPENING_DEPTH) & (seen >= CONFIRMED * BORDER_STRIP * length)


def _contour(
    vertices: np.ndarray, faces: np.ndarray, level: np.ndarray, patch: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The segments in which the contour crosses faces: their middles (S, 3), lengths (S,) and patches (S,)."""
    inside = level[faces] <= 0
    crossed = faces[inside.any(axis=1) & ~inside.all(axis=1)]
    ends = []
    for i, j in ((0, 1), (1, 2), (2, 0)):
        a, b = crossed[:, i], crossed[:, j]
        cut = (level[a] <= 0) != (level[b] <= 0)
        share = np.where(cut, level[a] / np.where(cut, level[a] - level[b], 1.0), np.nan)[:, None]
        ends.append((1.0 - share) * vertices[a] + share * vertices[b])
    ends = np.stack(ends, axis=1)
    # Exactly two of the three edges are cut.
    ends = ends[~np.isnan(ends[:, :, 0])].reshape(-1, 2, 3)
    return ends.mean(axis=1), np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1), patch[crossed].max(axis=1)


def crop(vertices: np.ndarray, faces: np.ndarray, level: np.ndarray, support: Support):
    """The part that stays with a margin around it, roughly cut: what is worth remeshing; vertices and faces."""
    wide = (level > 0) | (support.distance(vertices) < MARGIN)
    return triangles.compact(*triangles.separate_touching(vertices, faces[wide[faces].all(axis=1)]))
