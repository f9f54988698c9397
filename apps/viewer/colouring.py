"""Colours that show the material of a moving mesh, and vertices spread out over it."""

from __future__ import annotations

import numpy as np


def material_colors(vertices: np.ndarray, cells: int = 20) -> np.ndarray:
    """Colours that make sliding visible: a hue by place, and a checker of ``cells`` cells along the longest side.

    Args:
        vertices: the keyframe's, shape (V, 3); the colours then stay with the vertices.

    Returns:
        Shape (V, 3) uint8.
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    sides = high - low
    place = (vertices - low) / np.where(sides > 0.0, sides, 1.0)
    cell = np.floor((vertices - low) * (cells / (float(sides.max()) or 1.0)))
    shade = np.where(cell.sum(axis=1) % 2 == 0, 1.0, 0.78)[:, None]
    return np.rint((0.15 + 0.85 * place) * shade * 255).astype(np.uint8)


def spread_out_vertices(vertices: np.ndarray, count: int) -> np.ndarray:
    """Indices of at most ``count`` vertices far from each other (farthest-point sampling), shape (K,)."""
    vertices = np.asarray(vertices, dtype=np.float64)
    chosen = [0]
    distance_sq = ((vertices - vertices[0]) ** 2).sum(axis=1)
    while len(chosen) < min(count, len(vertices)) and distance_sq.max() > 0.0:
        chosen.append(int(distance_sq.argmax()))
        distance_sq = np.minimum(distance_sq, ((vertices - vertices[chosen[-1]]) ** 2).sum(axis=1))
    return np.array(chosen)
