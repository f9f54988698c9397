"""What is written over a scene: a title above each pane, one colour bar below all of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from warpdef.apps.viewer.camera import Room
from warpdef.apps.viewer.flat import Boxes, Text, letter_size, shortened

if TYPE_CHECKING:
    from warpdef.apps.viewer.content import Content, Pane
    from warpdef.apps.viewer.scales import Scales

LINE = 1.3
"""Height of a line, in letters' sizes, as all heights here."""
TITLE_LINES = 2
BAR = 5.6
"""Height of the bar with what is written about it."""
SLIDER = 5.0
"""Height below the bar that a window's slider takes."""
_EDGE = 0.5
_LABELS = 5


def room_for(height: int, *, tile: bool = False, bar: bool = False, slider: bool = False) -> Room:
    """What titles, bar and slider leave of a picture of that height in pixels."""
    size = tile_letter_size(height) if tile else letter_size(height)
    above = _EDGE + (LINE if tile else LINE * TITLE_LINES)
    below = _EDGE + (BAR if bar else 0.0) + (SLIDER if slider else 0.0)
    # Small pictures would be nothing but text.
    top, bottom = (min(part * size / height, 0.3) for part in (above, below))
    return Room(top=top, bottom=bottom)


def tile_letter_size(height: int) -> float:
    """Pixels of the letters in a tile of a contact sheet, which is shown smaller than it is."""
    return min(max(height / 20.0, 11.0), 60.0)


def frame_title(frame: int, count: int, name: str) -> str:
    """Which frame it is, of how many, and what it is called."""
    return f"frame {frame} of {count} (0 to {count - 1}): {name}"


def overlay(plotter: Any) -> Any:
    """A renderer over the whole window, above all panes."""
    from vtkmodules.vtkRenderingCore import vtkRenderer

    window, renderer = plotter.render_window, vtkRenderer()
    layers = window.GetNumberOfLayers()
    window.SetNumberOfLayers(layers + 1)
    renderer.SetLayer(layers)
    renderer.InteractiveOff()
    window.AddRenderer(renderer)
    return renderer


class Captions:
    """Titles of all panes, and the bar."""

    def __init__(self, plotter: Any) -> None:
        self._titles = [Text(renderer) for renderer in plotter.renderers]
        self.bar = ColorBar(overlay(plotter))

    def put(
        self, content: Content, scales: Scales, color: str, frame: int, size: tuple[int, int], *, slider: bool = False
    ) -> None:
        """What belongs to a frame, for a window or a picture of ``size`` pixels."""
        width, height = size
        letters = letter_size(height)
        pane_width = width / len(content.panes)
        frame_line = frame_title(frame, len(content), content.names[frame])
        for index, (pane, text) in enumerate(zip(content.panes, self._titles, strict=True)):
            lines = [pane_title(pane, color), "" if index else frame_line]
            words = "\n".join(shortened(line, pane_width - letters, letters) for line in lines)
            text.put(words, (0.5 * letters / pane_width, 1.0 - 0.4 * letters / height), letters)
        if color in content.measures:
            below = letters * (_EDGE + (SLIDER if slider else 0.0))
            self.bar.put(scales, color, content.unit, [frame], size, letters, below)
        else:
            self.bar.hide()

    def put_on_tile(self, content: Content, frame: int, size: tuple[int, int]) -> None:
        """The frame's number, and the panes' titles where there are several."""
        width, height = size
        pane_width, letters = width / len(content.panes), tile_letter_size(height)
        for index, (pane, text) in enumerate(zip(content.panes, self._titles, strict=True)):
            words = "" if index else f"frame {frame}"
            if len(content.panes) > 1:
                words += f"{', ' if words else ''}{pane.title}"
            place = (0.4 * letters / pane_width, 1.0 - 0.3 * letters / height)
            text.put(shortened(words, pane_width - 0.5 * letters, letters), place, letters)
        self.bar.hide()

    @property
    def titles(self) -> list[str]:
        """What is written above the panes."""
        return [text.text for text in self._titles]


def pane_title(pane: Pane, color: str) -> str:
    """A pane's title, with what its error is the distance to."""
    measured = pane.colouring is not None and color == "error" and pane.against
    return f"{pane.title}: distance to {pane.against}" if measured else pane.title


class ColorBar:
    """Five labels under a band of colours, what they measure above it, what its ends are below."""

    def __init__(self, renderer: Any) -> None:
        self._band = Boxes(renderer)
        self._title, self._note = Text(renderer, "center", "bottom"), Text(renderer, "center")
        self._labels = [Text(renderer, "center") for _ in range(_LABELS)]
        self.hide()

    def hide(self) -> None:
        """Draw nothing."""
        self._band.show(False)
        for text in (self._title, self._note, *self._labels):
            text.put("", (0.0, 0.0), 10.0)

    def put(
        self,
        scales: Scales,
        measure: str,
        unit: str,
        frames: list[int],
        size: tuple[int, int],
        letters: float,
        bottom: float,
    ) -> None:
        """Draw it.

        Args:
            unit: of a length. frames: those that are seen.
            size: width and height of the picture in pixels. letters: their size in pixels.
            bottom: pixels below it.
        """
        import numpy as np

        from warpdef.vertex_measures import MEASURES

        colors, limits = scales.colors(measure), scales.limits(measure)
        title, note = MEASURES[measure].label.format(unit), scales.note(measure, frames)
        width, height = size
        half = min(0.3 * width, 22.0 * letters) / width
        line = letters / height
        low = bottom / height + 3.0 * line
        x = np.linspace(0.5 - half, 0.5 + half, len(colors) + 1)
        edge = np.full(len(colors), low)
        self._band.put(np.column_stack([x[:-1], edge, x[1:], edge + 0.8 * line]), colors)
        self._band.show(True)
        self._title.put(shortened(title, 0.98 * width, letters), (0.5, low + 1.1 * line), letters)
        self._note.put(shortened(note, 0.98 * width, letters), (0.5, low - 1.8 * line), letters)
        places = np.linspace(0.5 - half, 0.5 + half, _LABELS)
        for text, place, value in zip(self._labels, places, np.linspace(*limits, _LABELS), strict=True):
            text.put(f"{value:.3g}", (float(place), low - 0.35 * line), letters)

    @property
    def labels(self) -> list[str]:
        """The numbers that it shows."""
        return [text.text for text in self._labels]

    @property
    def words(self) -> tuple[str, str]:
        """What is written above and below."""
        return self._title.text, self._note.text
