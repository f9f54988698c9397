"""What one file of points or of a mesh holds, before anything is decided about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from warpdef.errors import InputError
from warpdef.texture import Texture


@dataclass(frozen=True)
class NamedImages:
    """What a mesh file says of its texture's image; names are as they stand there.

    images:    image files                                    (PLY)
    libraries: of materials: lines of one or more file names  (OBJ)
    materials: those that faces use                           (OBJ)
    """

    images: tuple[str, ...] = ()
    libraries: tuple[str, ...] = ()
    materials: tuple[str, ...] = ()


@dataclass(frozen=True)
class Surface:
    """Contents of one cloud or mesh file, vertex order as in the file, nothing merged.

    points:    positions, input units                                (N, 3) float64
    normals:   as stored, any length, or None                        (N, 3) float64
    faces:     polygons cut into fans, or None                       (F, 3) int64
    colors:    of the points, or None                                (N, 3) or (N, 4) uint8
    uv:        texture coordinates of the points, or None            (N, 2) float64
    corner_uv: those of the faces' corners, where they differ        (F, 3, 2) float64
    named:     images that the file names, not opened
    texture:   the image, once it is read
    notes:     why it is missing, a line each
    columns:   what was taken and what was passed over, where columns have names or had to be told apart
    passed:    names of what the points carry beyond all this, which has no place on a mesh
    """

    points: np.ndarray
    normals: np.ndarray | None = None
    faces: np.ndarray | None = None
    colors: np.ndarray | None = None
    uv: np.ndarray | None = None
    corner_uv: np.ndarray | None = None
    named: NamedImages = NamedImages()
    texture: Texture | None = None
    notes: tuple[str, ...] = ()
    columns: str = ""
    passed: tuple[str, ...] = ()


def fan_triangles(indices: np.ndarray, counts: Sequence[int] | np.ndarray, where: str) -> np.ndarray:
    """Polygons to triangles, each polygon a fan around its first vertex, in the order given.

    Args:
        indices: the polygons' vertex indices one after the other, shape (sum of counts,).
        counts: vertices of each polygon, shape (P,).
        where: file name for errors.

    Returns:
        Triangles, shape (F, 3) int64.

    Raises:
        InputError: a polygon of fewer than three vertices.
    """
    counts = np.asarray(counts, dtype=np.int64)
    if len(counts) and counts.min() < 3:
        face = int(counts.argmin())
        raise InputError(f"{where}: face {face}: expected at least 3 vertices, got {counts[face]}; remove it")
    triangles = counts - 2
    start = np.cumsum(counts) - counts
    first = np.repeat(start, triangles)
    step = np.arange(len(first)) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    indices, faces = np.asarray(indices, dtype=np.int64), np.empty((len(first), 3), dtype=np.int64)
    # A column at a time takes half the memory.
    for corner, place in enumerate((first, first + step + 1, first + step + 2)):
        faces[:, corner] = indices[place]
    return faces


def vertex_or_corner_uv(
    corner_uv: np.ndarray, faces: np.ndarray, vertex_count: int
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Texture coordinates by vertex (V, 2) where each vertex has only one place, else by corner (F, 3, 2)."""
    uv = np.zeros((vertex_count, 2))
    uv[faces] = corner_uv
    return (uv, None) if np.array_equal(uv[faces], corner_uv) else (None, corner_uv)
