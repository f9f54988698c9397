"""What is at a place of a surface, in words: the number that its colour stands for."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np

    from warpdef.apps.viewer.content import Content, Pane


def reading(content: Content, pane: Pane, frame: int, color: str, face: int, weights: np.ndarray) -> str:
    """The measure where it is shown, interpolated as the picture is, and the vertex that is nearest with its place.

    Args:
        face: index of the triangle. weights: barycentric coordinates in it, shape (3,).
    """
    from warpdef.vertex_measures import MEASURES

    vertices, faces = pane.surface(frame) or ((), ())
    if not 0 <= face < len(faces):
        return ""
    corners = faces[face]
    vertex = int(corners[int(weights.argmax())])
    place = vertices[vertex] + content.origin
    where = f"vertex {vertex} at ({', '.join(f'{x:.4g}' for x in place)})"
    if pane.colouring is None or color not in pane.colouring.measures:
        return where
    value = float(pane.colouring.values(color, frame)[corners] @ weights)
    unit = f" {content.unit}" if "{}" in MEASURES[color].label else ""
    return f"{'unknown' if value != value else f'{value:.4g}{unit}'}, {where}"
