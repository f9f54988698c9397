"""Colours of clouds on the mesh that follows them.

A frame shows a vertex where one of the points nearest to it is near, in spacings of that cloud, and, where normals are
known, faces its way. Its colour there is the mean of the eight nearest such points with weights

    exp(-(a^2 + 4 h^2) / (s / 2)^2),   a, h: distance along and across the surface,   s: spacing of the cloud

by which the other side of a thin part counts next to nothing. The colour that stays with the vertex is the median over
the frames that show it: what one frame has wrong (a highlight, a mixed pixel, a limb in front) is outvoted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from warpdef.geometry.edges import spread_over_edges
from warpdef.geometry.triangles import unique_edges, vertex_normals

NEAREST = 8
SHOWN_WITHIN = 2.0  # spacings from a vertex to the nearest point of a frame that shows it
ACROSS = 4.0  # weight of the distance across the surface, squared
_BLOCK = 1 << 22  # numbers of a median at a time


@dataclass(frozen=True)
class SurfaceColors:
    """Colours of a mesh of V vertices in T frames, sRGB.

    still:  median over the frames that show a vertex                        (V, 3) uint8
    moving: of every frame, between those that show a vertex linear in time  (T, V, 3) uint8, or None
    unseen: share of the vertices that no frame shows: they have the colour of their neighbours over the mesh
    """

    still: np.ndarray
    moving: np.ndarray | None
    unseen: float


def surface_colors(
    vertices: np.ndarray,
    faces: np.ndarray,
    points: Sequence[np.ndarray],
    normals: Sequence[np.ndarray | None],
    colors: Sequence[np.ndarray | None],
    moving: bool = False,
) -> SurfaceColors | None:
    """Take the colours of clouds over to the mesh; None where no frame shows any of it.

    Args:
        vertices: shape (T, V, 3). faces: shape (F, 3).
        points: T clouds, (N_t, 3). normals: (N_t, 3), None where unknown. colors: (N_t, 3) uint8, None where unknown.
        moving: also the colours of every frame.
    """
    shades = np.zeros((*vertices.shape[:2], 3), dtype=np.uint8)
    shown = np.zeros(vertices.shape[:2], dtype=bool)
    for t, (p, n, c) in enumerate(zip(points, normals, colors, strict=True)):
        if c is not None and len(p) > NEAREST:
            shades[t], shown[t] = _frame_colors(np.asarray(vertices[t], dtype=np.float64), faces, p, n, c)
    known = np.asarray(shown.any(axis=0))
    if not known.any():
        return None
    still = _spread(_median(shades, shown), known, faces)
    return SurfaceColors(still, _through_time(shades, shown, still) if moving else None, 1.0 - float(known.mean()))


def _frame_colors(
    vertices: np.ndarray, faces: np.ndarray, points: np.ndarray, normals: np.ndarray | None, colors: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Colours of one frame, (V, 3) uint8, and which vertices it shows, (V,) bool."""
    from scipy.spatial import cKDTree

    tree = cKDTree(points)
    sample = points[:: max(len(points) // 1000, 1)]
    spacing = float(np.median(tree.query(sample, k=NEAREST + 1)[0][:, -1]))
    outward = vertex_normals(vertices, faces)
    _, index = tree.query(vertices, k=NEAREST)
    away = points[index] - vertices[:, None]
    across = np.einsum("vki,vi->vk", away, outward)
    size = np.einsum("vki,vki->vk", away, away) + (ACROSS - 1.0) * across**2
    if normals is not None:
        facing = np.einsum("vki,vi->vk", normals[index], outward)
        # Given normals may point inwards, all of a frame.
        size = np.where(facing * (1.0 if np.median(facing) >= 0 else -1.0) > 0, size, np.inf)
    least = size.min(axis=1)
    shown = least <= (SHOWN_WITHIN * spacing) ** 2
    scale = (spacing / 2.0) ** 2 or 1.0
    weight = np.exp(-(size - np.where(shown, least, 0.0)[:, None]) / scale)
    weight[~shown] = 1.0
    mean = np.einsum("vk,vkc->vc", weight / weight.sum(axis=1, keepdims=True), colors[index].astype(np.float64))
    return np.rint(mean).astype(np.uint8), shown


def _median(shades: np.ndarray, shown: np.ndarray) -> np.ndarray:
    """Median of (T, V, 3) over the frames that show a vertex, (V, 3) float64; anything where none does."""
    count = shown.sum(axis=0)
    low, high = np.maximum(count - 1, 0) // 2, np.minimum(count // 2, len(shown) - 1)
    middle = np.empty(shades.shape[1:])
    step = max(_BLOCK // (3 * len(shown)), 1)
    for first in range(0, len(count), step):
        part = slice(first, first + step)
        values = np.where(shown[:, part, None], shades[:, part], np.int16(256))
        values.sort(axis=0)
        rows = np.arange(values.shape[1])
        middle[part] = (values[low[part], rows] + values[high[part], rows]) / 2.0
    return middle


def _spread(colors: np.ndarray, known: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Colours (V, 3) of the vertices known, and from there outwards over the mesh, as uint8."""
    average = colors[known].mean(axis=0)
    colors, known = spread_over_edges(colors, known, unique_edges(faces))
    colors[~known] = average  # parts of the mesh that no frame shows at all
    return np.rint(colors).astype(np.uint8)


def _through_time(shades: np.ndarray, shown: np.ndarray, still: np.ndarray) -> np.ndarray:
    """Colours of every frame, (T, V, 3) uint8: where one does not show a vertex, from those before and after it."""
    frames, vertex = np.arange(len(shown))[:, None], np.arange(shown.shape[1])
    before = np.maximum.accumulate(np.where(shown, frames, -1), axis=0)
    after = np.minimum.accumulate(np.where(shown, frames, len(shown))[::-1], axis=0)[::-1]
    moving = np.empty_like(shades)
    for t in range(len(shown)):
        a, b = before[t], after[t]
        a, b = np.where(a < 0, b, a), np.where(b == len(shown), a, b)
        seen = a < len(shown)
        a, b = np.where(seen, a, 0), np.where(seen, b, 0)
        share = ((t - a) / np.maximum(b - a, 1))[:, None]
        mixed = (1.0 - share) * shades[a, vertex] + share * shades[b, vertex]
        moving[t] = np.rint(np.where(seen[:, None], mixed, still))
    return moving
