"""A contact sheet: frames evenly spread in tiles that are as narrow as the motion, and one colour bar below them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np

    from warpdef.apps.viewer.scene import Scene

ASPECT = 1.6
"""Width over height that a sheet comes near to."""
_NARROWEST, _WIDEST = 0.25, 4.0


def contact_sheet(scene: Scene, count: int, size: tuple[int, int]) -> np.ndarray:
    """``count`` frames in rows, each tile as large as ``size`` (width, height) holds; (height, width, 3 or 4) uint8."""
    import numpy as np

    content, before = scene.content, list(scene.plotter.window_size)
    frames = sheet_frames(len(content), count)
    scene.tile = True
    scene.plotter.window_size = list(tile_size(scene.seen_aspect(size) * len(content.panes), size))
    scene.place_camera()
    pictures = []
    for frame in frames:
        scene.show(frame)
        pictures.append(scene.picture())
    height, width, _ = pictures[0].shape
    columns = sheet_columns(len(pictures), width / height)
    blank = np.full_like(pictures[0], 0 if scene.look.transparent else 255)
    rows = [pictures[k : k + columns] for k in range(0, len(pictures), columns)]
    rows[-1] = rows[-1] + [blank] * (columns - len(rows[-1]))
    sheet = np.concatenate([np.concatenate(row, axis=1) for row in rows])
    foot = scene.foot(frames, sheet.shape[1], height)
    # What comes after it may be a movie of the same scene.
    scene.tile, scene.plotter.window_size = False, before
    scene.place_camera()
    scene.refresh()
    return sheet if foot is None else np.concatenate([sheet, foot])


def sheet_frames(total: int, count: int) -> list[int]:
    """At most ``count`` of ``total`` frames, first and last among them, each once."""
    count = min(count, total)
    return [round(k * (total - 1) / (count - 1)) for k in range(count)] if count > 1 else [0]


def tile_size(aspect: float, size: tuple[int, int]) -> tuple[int, int]:
    """Pixels of the largest tile within ``size`` whose width over height is ``aspect``, where that is no strip."""
    aspect = min(max(aspect, _NARROWEST), max(_WIDEST, size[0] / size[1]))
    width, height = min(size[0], size[1] * aspect), min(size[1], size[0] / aspect)
    return max(round(width), 32), max(round(height), 32)


def sheet_columns(count: int, aspect: float) -> int:
    """How many of ``count`` tiles stand in a row: few blanks at the end, and a sheet that is neither tower nor strip.

    Args: aspect: a tile's width over its height.
    """

    def badness(columns: int) -> float:
        rows = math.ceil(count / columns)
        return abs(math.log(columns * aspect / rows / ASPECT)) + 2.0 * (rows * columns - count) / count

    return min(range(1, count + 1), key=badness)
