"""A result as one web page: the numbers inside it, drawn by WebGL, without a server, a network or a library.

Positions are stored as 16 bits along each axis of the motion's bounding box, so within 1/131,070 of its sides, and
packed as ``viewer/page_data.py`` says.
"""

from __future__ import annotations

import html
import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpdef.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from warpdef.apps.viewer.actors import Look
    from warpdef.apps.viewer.camera import Stand
    from warpdef.apps.viewer.content import Content, Pane


def write_html(
    content: Content,
    look: Look,
    path: Path,
    fps: float,
    frame: int = 0,
    stand: Stand | None = None,
    name: str = "result",
) -> None:
    """Write the page; it appears at once or not at all.

    Args:
        name: what is shown, for the title.

    Raises:
        InputError: a pane whose triangles change, or the file cannot be written.
    """
    from warpdef.apps.viewer.actors import point_spacing
    from warpdef.apps.viewer.camera import VIEW_ANGLE, Stand
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
        "azimuth": stand.azimuth,
        "elevation": stand.elevation,
        "angle": VIEW_ANGLE,
        "zoom": stand.zoom,
        "spacing": next((point_spacing(pane.clouds[0]) for pane in content.panes if pane.clouds is not None), 0.0),
        "cloud": look.cloud,
        "wireframe": look.wireframe,
        "smooth": look.smooth,
        "panes": [_pane(pane, content, look, low, high) for pane in content.panes],
    }
    # No frame's name may end the script, or begin a comment in it.
    text = json.dumps(scene, separators=(",", ":")).replace("<", "\\u003c")
    filled = {"NAME": html.escape(name), "ABOUT": _about(content), "SCRIPT": SCRIPT, "SCENE": text}
    with replacing(path) as stream:
        # All at once: what is filled in may itself look like a mark.
        stream.write(re.sub("@([A-Z]+)@", lambda mark: filled[mark[1]], PAGE).encode("utf-8"))


def _about(content: Content) -> str:
    """What the page shows, in a few words."""
    moving = next((pane.moving for pane in content.panes if pane.moving is not None), None)
    frames = f"{len(content)} frame" + ("s" if len(content) != 1 else "")
    if moving is None:
        return f"clouds, {frames}"
    return f"one moving mesh, {frames}, {moving.vertices.shape[1]:,} vertices, {len(moving.faces):,} triangles"


def _pane(pane: Pane, content: Content, look: Look, low: np.ndarray, high: np.ndarray) -> dict[str, Any]:
    from warpdef.apps.viewer.page_data import (
        lower_neighbours,
        pack_clouds,
        pack_indices,
        pack_moving,
        position_steps,
    )

    packed: dict[str, Any] = {"title": pane.title}
    moving = pane.moving
    if pane.meshes is not None and moving is None:
        raise InputError(
            f"--html: the pane '{pane.title}': expected the same triangles in all frames, got others; leave it out"
        )
    if moving is not None:
        count = moving.vertices.shape[1]
        parents = lower_neighbours(moving.faces, count)
        packed |= {"faces": pack_indices(moving.faces), "count": count}
        packed["positions"] = pack_moving(position_steps(moving.vertices, low, high), parents)
        packed |= _colors(pane, content, look, parents)
    if pane.clouds is not None:
        packed["cloudCounts"] = [len(points) for points in pane.clouds]
        steps = [position_steps(points, low, high) for points in pane.clouds]
        packed["cloud"] = pack_clouds(steps)
    return packed


def _colors(pane: Pane, content: Content, look: Look, parents: np.ndarray) -> dict[str, Any]:
    """Material colours, or a measure as bytes with the table that turns them into colours."""
    import numpy as np

    from warpdef.apps.viewer.actors import MATERIAL
    from warpdef.apps.viewer.checker import SHADE, checker_scale
    from warpdef.apps.viewer.colouring import material_hues
    from warpdef.apps.viewer.page_data import deflated, pack_moving
    from warpdef.apps.viewer.scales import MISSING, Scales, color_map
    from warpdef.vertex_measures import MEASURES

    packed: dict[str, Any] = {}
    colors = pane.colors
    if colors is None:
        assert pane.moving is not None  # pages are made of meshes that move
        rest = pane.moving.vertices[pane.keyframe]
        colors = material_hues(rest)
        if look.color == MATERIAL:
            corner, scale = checker_scale(rest)
            packed["checker"] = {"frame": pane.keyframe, "low": corner.tolist(), "scale": scale, "dark": 1.0 - SHADE}
    if look.color != "plain":
        # Four bytes a vertex, as graphics cards read them.
        rows = np.full((*colors.shape[:-1], 4), 255, dtype=np.uint8)
        rows[..., :3] = colors[..., :3]
        packed["colors"] = deflated(rows)
        packed["colorful"] = colors.ndim == 3  # each frame has its own
    if pane.colouring is not None and look.color in pane.colouring.measures:
        from matplotlib import colormaps

        measure, scales = MEASURES[look.color], Scales(content, look.color, look.clim, look.cmap)
        low, high = scales.limits(look.color)
        values = np.stack([pane.colouring.values(look.color, t) for t in range(len(content))])
        known = np.isfinite(values)
        share = np.clip((np.where(known, values, low) - low) / (high - low), 0.0, 1.0)
        # 255 stands for unknown.
        steps = np.where(known, np.rint(share * 254), 255).astype(np.uint8)
        packed["values"] = pack_moving(steps[:, :, None], parents)
        table = colormaps[color_map(look.color, look.cmap)](np.linspace(0.0, 1.0, 255))
        table = np.concatenate([np.rint(table[:, :3] * 255), [MISSING]])
        packed |= {"table": deflated(table.astype(np.uint8)), "limits": [low, high]}
        packed["label"] = measure.label.format(content.unit)
        most = float(np.abs(values[known]).max(initial=0.0))
        packed["ends"] = "" if look.color == "confidence" else f"{scales.ends(look.color)}; largest {most:.3g}"
    elif look.color not in ("plain", MATERIAL):
        packed.pop("colors")
    return packed
