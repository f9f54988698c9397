"""A texture as colours of the vertices: what the window and the page, which draw colours of vertices, show of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np

    from warpdef.appearance import Appearance


def shown_colors(look: Appearance, faces: np.ndarray, vertex_count: int) -> np.ndarray | None:
    """Colours of the vertices, (V, 3) uint8: their own, else the image's at their place in it, else None.

    Where a vertex of a seam has several places one of them counts. None, too, without Pillow, or where it cannot read
    the image: a view is then in the template's usual colours.
    """
    from warpdef.files.texture_colors import colors_at, pixels_of, uv_of_vertices

    if look.colors is not None:
        return look.colors[:, :3]
    pixels = None if look.texture is None else pixels_of(look.texture)
    uv = uv_of_vertices(look.uv, look.corner_uv, faces, vertex_count)
    return None if pixels is None or uv is None else colors_at(pixels, uv)
