"""Text and boxes over a picture. Places are shares of the viewport: (0, 0) its lower left corner, (1, 1) the other."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

TEXT_COLOR = "#20242c"
CHARACTER = 0.5
"""About how wide a character is, in the size of its text."""


class Text:
    """A few lines of text at one place."""

    def __init__(self, renderer: Any, across: str = "left", upright: str = "top", color: str = TEXT_COLOR) -> None:
        """Args: across: ``left``, ``center`` or ``right``. upright: ``top``, ``center`` or ``bottom``."""
        from vtkmodules.vtkRenderingCore import vtkTextActor

        self.actor = vtkTextActor()
        self.actor.SetTextScaleModeToNone()
        self.actor.GetPositionCoordinate().SetCoordinateSystemToNormalizedViewport()
        self._property = self.actor.GetTextProperty()
        self._property.SetFontFamilyToArial()
        {
            "left": self._property.SetJustificationToLeft,
            "center": self._property.SetJustificationToCentered,
            "right": self._property.SetJustificationToRight,
        }[across]()
        {
            "top": self._property.SetVerticalJustificationToTop,
            "center": self._property.SetVerticalJustificationToCentered,
            "bottom": self._property.SetVerticalJustificationToBottom,
        }[upright]()
        self.set_color(color)
        renderer.AddViewProp(self.actor)

    def set_color(self, color: str) -> None:
        """Its colour, as ``#rrggbb`` or a name."""
        import pyvista

        self._property.SetColor(*pyvista.Color(color).float_rgb)

    def put(self, text: str, place: tuple[float, float], size: float) -> None:
        """Say ``text`` there, in letters of ``size`` pixels; the empty text is not drawn."""
        self.actor.SetInput(text)
        self.actor.SetVisibility(bool(text))
        self.actor.SetPosition(*place)
        self._property.SetFontSize(round(size))

    @property
    def text(self) -> str:
        """What it says."""
        return (self.actor.GetInput() or "") if self.actor.GetVisibility() else ""


class Boxes:
    """Filled rectangles."""

    def __init__(self, renderer: Any) -> None:
        import pyvista
        from vtkmodules.vtkRenderingCore import vtkActor2D, vtkCoordinate, vtkPolyDataMapper2D

        self._data = pyvista.PolyData()
        mapper, places = vtkPolyDataMapper2D(), vtkCoordinate()
        places.SetCoordinateSystemToNormalizedViewport()
        mapper.SetTransformCoordinate(places)
        mapper.TransformCoordinateUseDoubleOn()
        mapper.SetInputData(self._data)
        mapper.SetScalarModeToUseCellData()
        mapper.SetColorModeToDirectScalars()
        self.actor = vtkActor2D()
        self.actor.SetMapper(mapper)
        renderer.AddViewProp(self.actor)

    def put(self, boxes: np.ndarray, colors: np.ndarray) -> None:
        """Args: boxes: left, bottom, right, top of each, shape (N, 4). colors: shape (N, 3) uint8."""
        import numpy as np
        import pyvista

        left, bottom, right, top = np.asarray(boxes, dtype=float).T
        corners = np.stack([left, bottom, right, bottom, right, top, left, top], axis=1).reshape(-1, 2)
        places = np.column_stack([corners, np.zeros(len(corners))])
        faces = np.column_stack([np.full(len(left), 4), np.arange(4 * len(left)).reshape(-1, 4)])
        made = pyvista.PolyData(places, faces=faces.ravel())
        made.cell_data["rgb"] = np.asarray(colors, dtype=np.uint8)
        made.cell_data.active_scalars_name = "rgb"
        self._data.copy_from(made)

    def show(self, on: bool) -> None:
        """Whether they are drawn."""
        self.actor.SetVisibility(on)


def letter_size(size: tuple[int, int]) -> float:
    """Pixels of the letters in a picture of that width and height: legible in small ones, not lost in large ones."""
    return min(max(min(size[1], 0.75 * size[0]) / 48.0, 11.0), 48.0)


def shortened(text: str, width: float, size: float) -> str:
    """``text`` with its middle left out, where it would be wider than ``width`` pixels in letters of ``size``."""
    most = max(int(width / (CHARACTER * size)), 8)
    if len(text) <= most:
        return text
    kept = most - 3
    return f"{text[: kept - kept // 2]}...{text[len(text) - kept // 2 :]}"
