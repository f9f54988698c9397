"""Colours that show the material of a moving mesh, and vertices spread out over it."""

from __future__ import annotations

import numpy as np

from warpdef.apps.viewer.checker import SHADE, checker_places


def material_hues(rest: np.ndarray) -> np.ndarray:
    """A hue by place for every vertex of a shape, (V, 3): (V, 3) uint8."""
    low, high = rest.min(axis=0), rest.max(axis=0)
    sides = high - low
    place = (rest - low) / np.where(sides > 0.0, sides, 1.0)
    return np.rint((0.15 + 0.85 * place) * 255).astype(np.uint8)


def material_colors(rest: np.ndarray) -> np.ndarray:
    """The hues with the checker at the vertices, for what cannot compute it at every pixel; see ``checker``.

    Args: rest: the keyframe's vertices, shape (V, 3); the colours then stay with the vertices.

    Returns:
        Shape (V, 3) uint8.
    """
    dark = np.floor(checker_places(rest)).sum(axis=1) % 2 != 0
    return np.rint(material_hues(rest) * np.where(dark, SHADE, 1.0)[:, None]).astype(np.uint8)


def spread_out_vertices(vertices: np.ndarray, count: int) -> np.ndarray:
    """Indices of at most ``count`` vertices far from each other (farthest-point sampling), shape (K,)."""
    vertices = np.asarray(vertices, dtype=np.float64)
    chosen = [0]
    distance_sq = ((vertices - vertices[0]) ** 2).sum(axis=1)
    while len(chosen) < min(count, len(vertices)) and distance_sq.max() > 0.0:
        chosen.append(int(distance_sq.argmax()))
        distance_sq = np.minimum(distance_sq, ((vertices - vertices[chosen[-1]]) ** 2).sum(axis=1))
    return np.array(chosen)
