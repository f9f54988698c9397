"""A checker that stays with the material: made at every pixel from the rest place, so that its edges are straight.

A pixel's rest place is between those of its triangle's corners; a cell of the checker is a cube of the space there.
Colours of vertices are darkened in every other cell.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

CELLS = 20
"""Cells along the longest side of the rest shape."""
SHADE = 0.78
"""How bright the darker cells are."""
REST = "restPlace"
"""The points' array that holds ``checker_places``."""

_VERTEX_DECLARED = "in vec3 restPlace;\nout vec3 restPlaceVSOutput;\n"
_VERTEX = "restPlaceVSOutput = restPlace;\n"
# Edges are drawn by a geometry shader between the two; VTK then renames what the fragments read.
_EDGES_DECLARED = "in vec3 restPlaceVSOutput[];\nout vec3 restPlaceGSOutput;\n"
_EDGES = "restPlaceGSOutput = restPlaceVSOutput[i];\n"
_FRAGMENT_DECLARED = "in vec3 restPlaceVSOutput;\n"
# The product of three square waves is the parity of the cell. Each wave is as steep as a pixel is wide: edges are
# smooth, a surface that lies along a wall of cells does not flicker, and cells too small to be seen are grey.
_FRAGMENT = f"""
  vec3 away = abs(2.0 * fract(0.5 * restPlaceVSOutput + 0.25) - 1.0) - 0.5;
  vec3 waves = clamp(away / max(fwidth(restPlaceVSOutput), vec3(1e-6)), -0.5, 0.5) * 2.0;
  float shade = 1.0 - checkered * {1.0 - SHADE:.3f} * (0.5 - 0.5 * waves.x * waves.y * waves.z);
  diffuseColor *= shade;
  ambientColor *= shade;
"""


def checker_places(rest: np.ndarray, cells: int = CELLS) -> np.ndarray:
    """Places of the vertices in cells of the checker, shape (V, 3) float32.

    Half a cell off the lowest corner: what is flat there, a sole or a floor, does not lie in a wall of cells.

    Args: rest: the vertices at rest, shape (V, 3).
    """
    low, scale = checker_scale(rest, cells)
    return ((rest - low) * scale + 0.5).astype("f4")


def checker_scale(rest: np.ndarray, cells: int = CELLS) -> tuple[np.ndarray, float]:
    """The lowest corner of a shape (V, 3), (3,), and how many cells a length of 1 has."""
    low = rest.min(axis=0)
    side = float((rest.max(axis=0) - low).max()) or 1.0
    return low, cells / side


class Checker:
    """The checker of one actor, whose points carry ``REST``: from VTK's shaders, with a few lines put into them."""

    def __init__(self, actor: Any, mapper: Any) -> None:
        """Args: actor: VTK's. mapper: its ``vtkPolyDataMapper``."""
        from vtkmodules.vtkCommonDataModel import vtkDataObject

        mapper.MapDataArrayToVertexAttribute(REST, REST, vtkDataObject.FIELD_ASSOCIATION_POINTS, -1)
        shaders = actor.GetShaderProperty()
        for add, tag, lines in (
            (shaders.AddVertexShaderReplacement, "PositionVC::Dec", _VERTEX_DECLARED),
            (shaders.AddVertexShaderReplacement, "PositionVC::Impl", _VERTEX),
            (shaders.AddGeometryShaderReplacement, "PositionVC::Dec", _EDGES_DECLARED),
            (shaders.AddGeometryShaderReplacement, "PositionVC::Impl", _EDGES),
            (shaders.AddFragmentShaderReplacement, "PositionVC::Dec", _FRAGMENT_DECLARED),
            (shaders.AddFragmentShaderReplacement, "Color::Impl", _FRAGMENT),
        ):
            # VTK puts its own lines where its tag stands.
            add(f"//VTK::{tag}", True, f"//VTK::{tag}\n{lines}", False)
        self._uniforms = shaders.GetFragmentCustomUniforms()
        self.show(False)

    def show(self, on: bool) -> None:
        """Whether it is drawn."""
        self._uniforms.SetUniformf("checkered", float(on))
