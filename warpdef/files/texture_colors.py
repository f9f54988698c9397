"""Colours of an image at texture coordinates: what clouds, windows and pages take of a texture.

Coordinates are those of OBJ: (0, 0) is the lower left corner; beyond its edges an image is repeated.
"""

from __future__ import annotations

import io
import warnings

import numpy as np

from warpdef.files.surface import Surface
from warpdef.texture import Texture


def pixels_of(texture: Texture) -> np.ndarray | None:
    """The image, shape (H, W, 3) uint8; None without Pillow, or where it cannot read it."""
    try:
        from PIL import Image
    except ImportError:
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            return np.asarray(Image.open(io.BytesIO(texture.data)).convert("RGB"))
    except (OSError, ValueError, SyntaxError, MemoryError, Image.DecompressionBombError):
        return None


def colors_at(pixels: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Colours of the pixels at texture coordinates (N, 2); shape (N, 3) uint8."""
    uv = np.nan_to_num(uv, posinf=0.0, neginf=0.0)
    inside = (uv >= 0.0) & (uv <= 1.0)
    u, v = np.where(inside, uv, uv - np.floor(uv)).T
    height, width, _ = pixels.shape
    column, row = (u * width).astype(int), ((1.0 - v) * height).astype(int)
    return np.ascontiguousarray(pixels[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)])


def uv_of_vertices(
    uv: np.ndarray | None, corner_uv: np.ndarray | None, faces: np.ndarray, vertex_count: int
) -> np.ndarray | None:
    """Coordinates of the vertices (V, 2), where there are any; of several places of one at a seam one counts."""
    if uv is None and corner_uv is not None:
        uv = np.zeros((vertex_count, 2), dtype=corner_uv.dtype)
        uv[faces] = corner_uv
    return uv


def uv_of_places(surface: Surface, face: np.ndarray, weights: np.ndarray) -> np.ndarray | None:
    """Coordinates (N, 2) of places on faces (N,) with barycentric coordinates (N, 3)."""
    if surface.corner_uv is not None:
        corners = surface.corner_uv[face]
    elif surface.uv is not None and surface.faces is not None:
        corners = surface.uv[surface.faces[face]]
    else:
        return None
    return np.einsum("nk,nkc->nc", weights, corners)
