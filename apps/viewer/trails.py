"""The ways of some vertices through all frames, as lines in the colours of the material."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from warpdef.apps.viewer.content import Pane

TRAJECTORIES = 150
"""Vertices whose way is drawn."""


def add_trails(plotter: Any, pane: Pane) -> Any:
    """The actor of a pane's lines, in the plotter's present pane; None where nothing moves."""
    import numpy as np
    import pyvista

    from warpdef.apps.viewer.colouring import material_hues, spread_out_vertices

    if pane.moving is None or len(pane.moving.vertices) < 2:
        return None
    vertices = pane.moving.vertices
    at_keyframe = vertices[pane.keyframe]
    chosen = spread_out_vertices(at_keyframe, TRAJECTORIES)
    count, length = len(chosen), len(vertices)
    points = vertices[:, chosen].transpose(1, 0, 2).reshape(-1, 3).astype("f4")
    ways = np.column_stack([np.full(count, length), np.arange(count * length).reshape(count, length)])
    lines = pyvista.PolyData(points, lines=ways.ravel())
    colors = material_hues(at_keyframe) if pane.colors is None else pane.colors
    colors = colors if colors.ndim == 2 else colors[pane.keyframe]
    lines.point_data["rgb"] = np.repeat(colors[chosen], length, axis=0)
    return plotter.add_mesh(lines, scalars="rgb", rgb=True, line_width=2.0, lighting=False, reset_camera=False)
