"""A texture as colours of the vertices: what the window and the page, which draw colours of vertices, show of it."""

from __future__ import annotations

import io
import warnings
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np

    from warpdef.appearance import Appearance


def shown_colors(look: Appearance, faces: np.ndarray, vertex_count: int) -> np.ndarray | None:
    """Colours of the vertices, (V, 3) uint8: their own, else the image's at their place in it, else None.

    Where a vertex of a seam has several places one of them counts. None, too, without Pillow, or where it cannot read
    the image: a view is then in the template's usual colours.
    """
    import numpy as np

    if look.colors is not None:
        return look.colors[:, :3]
    if look.texture is None:
        return None
    try:
        from PIL import Image
    except ImportError:
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            pixels = np.asarray(Image.open(io.BytesIO(look.texture.data)).convert("RGB"))
    except (OSError, ValueError, SyntaxError, MemoryError, Image.DecompressionBombError):
        return None
    uv = look.uv
    if uv is None:
        uv = np.zeros((vertex_count, 2), dtype=np.float32)
        uv[faces] = look.corner_uv
    inside = (uv >= 0.0) & (uv <= 1.0)
    u, v = np.where(inside, uv, uv - np.floor(uv)).T  # beyond its edges an image is repeated
    height, width, _ = pixels.shape
    column, row = (u * width).astype(int), ((1.0 - v) * height).astype(int)
    return np.ascontiguousarray(pixels[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)])
