"""A result as one web page: the numbers inside it, drawn by WebGL, without a server, a network or a library.

Positions are stored as 16 bits along each axis of the motion's bounding box, so within 1/131,070 of its sides.
"""

from __future__ import annotations

import base64
import html
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpdef.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from warpdef.apps.viewer.actors import Look
    from warpdef.apps.viewer.camera import Stand
    from warpdef.apps.viewer.content import Content, Pane

_STEPS = 65535


def write_html(
    content: Content, look: Look, path: Path, fps: float, frame: int = 0, stand: Stand | None = None
) -> None:
    """Write the page; it appears at once or not at all.

    Raises:
        InputError: a pane whose triangles change, or the file cannot be written.
    """
    from warpdef.apps.viewer.camera import MARGIN, VIEW_ANGLE, Stand, box_extent
    from warpdef.apps.viewer.page import PAGE
    from warpdef.apps.viewer.script import SCRIPT
    from warpdef.files.disk import replacing

    stand = stand or Stand()
    low, high = content.bounds
    for pane in content.panes:
        # Clouds' strays are outside the bounds that the camera looks at, but are drawn all the same.
        for points in pane.clouds or ():
            low, high = low.clip(max=points.min(axis=0)), high.clip(min=points.max(axis=0))
    scene: dict[str, Any] = {
        "low": low.tolist(),
        "size": (high - low).tolist(),
        "frames": len(content),
        "names": list(content.names),
        "fps": fps,
        "frame": frame,
        "up": content.up,
        "focus": ((content.bounds[0] + content.bounds[1]) / 2.0).tolist(),
        "extent": box_extent(content.bounds, content.up, stand.azimuth, stand.elevation),
        "azimuth": stand.azimuth,
        "elevation": stand.elevation,
        "angle": VIEW_ANGLE,
        "margin": MARGIN / stand.zoom,
        "cloud": look.cloud,
        "wireframe": look.wireframe,
        "smooth": look.smooth,
        "panes": [_pane(pane, content, look, low, high) for pane in content.panes],
    }
    # No frame's name may end the script, or begin a comment in it.
    text = json.dumps(scene, separators=(",", ":")).replace("<", "\\u003c")
    title = html.escape(content.panes[0].title)
    with replacing(path) as stream:
        page = PAGE.replace("@TITLE@", title).replace("@SCRIPT@", SCRIPT).replace("@SCENE@", text)
        stream.write(page.encode("utf-8"))


def _pane(pane: Pane, content: Content, look: Look, low: np.ndarray, high: np.ndarray) -> dict[str, Any]:
    import numpy as np

    packed: dict[str, Any] = {"title": pane.title}
    moving = pane.moving
    if pane.meshes is not None and moving is None:
        raise InputError(
            f"--html: the pane '{pane.title}': expected the same triangles in all frames, got others; leave it out"
        )
    if moving is not None:
        packed["faces"] = _base64(moving.faces.astype("<u4"))
        packed["count"] = moving.vertices.shape[1]
        packed["positions"] = _base64(_steps(moving.vertices, low, high))
        packed |= _colors(pane, content, look)
    if pane.clouds is not None:
        counts = [len(points) for points in pane.clouds]
        packed["cloudCounts"] = counts
        packed["cloud"] = _base64(_steps(np.concatenate(pane.clouds), low, high))
    return packed


def _colors(pane: Pane, content: Content, look: Look) -> dict[str, Any]:
    """Material colours, or a measure as bytes with the table that turns them into colours."""
    import numpy as np

    from warpdef.apps.viewer.actors import MATERIAL
    from warpdef.apps.viewer.colouring import material_colors
    from warpdef.vertex_measures import MEASURES

    packed: dict[str, Any] = {}
    colors = pane.colors
    if colors is None:
        assert pane.moving is not None  # pages are made of meshes that move
        colors = material_colors(pane.moving.vertices[pane.keyframe])
    if look.color != "plain":
        packed["colors"] = _base64(np.ascontiguousarray(colors))
    if pane.colouring is not None and look.color in pane.colouring.measures:
        from matplotlib import colormaps

        measure = MEASURES[look.color]
        low, high = pane.colouring.limits(look.color)
        values = np.stack([pane.colouring.values(look.color, t) for t in range(len(content))])
        known = np.isfinite(values)
        share = np.clip((np.where(known, values, low) - low) / (high - low), 0.0, 1.0)
        # 255 stands for unknown.
        packed["values"] = _base64(np.where(known, np.rint(share * 254), 255).astype("u1"))
        table = colormaps["coolwarm" if measure.diverging else "viridis"](np.linspace(0.0, 1.0, 255))
        table = np.concatenate([np.rint(table[:, :3] * 255), [[154, 154, 154]]])
        packed |= {"table": _base64(table.astype("u1")), "limits": [low, high]}
        packed["label"] = measure.label.format(content.unit)
    elif look.color not in ("plain", MATERIAL):
        packed.pop("colors")
    return packed


def _steps(points: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    import numpy as np

    size = np.where(high > low, high - low, 1.0)
    return np.rint((points - low) / size * _STEPS).clip(0, _STEPS).astype("<u2")


def _base64(array: np.ndarray) -> str:
    return base64.b64encode(array.tobytes()).decode("ascii")
