"""What is written over a scene: a title above each pane, one colour bar below all of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from warpdef.apps.viewer.bars import BAR, SCALE_BAR, ColorBar, ScaleBar
from warpdef.apps.viewer.camera import Room
from warpdef.apps.viewer.flat import CHARACTER, TEXT_COLOR, Text, letter_size, shortened
from warpdef.apps.viewer.judged import COLORS
from warpdef.apps.viewer.timeline import Timeline
from warpdef.quality.verdict import GOOD

if TYPE_CHECKING:
    from warpdef.apps.viewer.content import Content, Pane
    from warpdef.apps.viewer.scales import Scales

LINE = 1.3
"""Height of a line, in letters' sizes, as all heights here."""
TITLE_LINES = 2
SLIDER = 4.8
"""Height below the bar that a window's slider takes, and the strip under it."""
_EDGE = 0.5
_TILE_WORDS = 9.5
"""Width of the longest that is written on a tile, a frame's number and its verdict, in letters' sizes."""


def room_for(
    size: tuple[int, int], *, tile: bool = False, bar: bool = False, scale_bar: bool = False, slider: bool = False
) -> Room:
    """What titles, bars and slider leave of a picture of that width and height in pixels."""
    height, letters = size[1], tile_letter_size(size[1]) if tile else letter_size(size)
    above = _EDGE + (LINE if tile else LINE * TITLE_LINES)
    below = _EDGE + (BAR if bar else 0.0) + (SCALE_BAR if scale_bar else 0.0) + (SLIDER if slider else 0.0)
    # Small pictures would be nothing but text.
    top, bottom = (min(part * letters / height, 0.3) for part in (above, below))
    return Room(top=top, bottom=bottom)


def tile_letter_size(height: int) -> float:
    """Pixels of the letters in a tile of a contact sheet, which is shown smaller than it is."""
    return min(max(height / 20.0, 11.0), 60.0)


def frame_title(content: Content, frame: int) -> str:
    """Which frame it is, of how many, what it is called, and the verdict on it."""
    count = len(content)
    verdict = "" if content.judged is None else f" ({content.judged[frame].words})"
    return f"frame {frame} of {count} (0 to {count - 1}): {content.names[frame]}{verdict}"


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
    """Titles of all panes, the bars, and what is under the mouse."""

    def __init__(self, plotter: Any) -> None:
        self._titles = [Text(renderer) for renderer in plotter.renderers]
        self.over = over = overlay(plotter)
        """What is drawn over all panes."""
        self.bar, self.scale_bar = ColorBar(over), ScaleBar(over)
        self.timeline, self._frame, self._reading = Timeline(over), Text(over), Text(over, "right")

    def put(
        self, content: Content, scales: Scales, color: str, frame: int, size: tuple[int, int], *, slider: bool = False
    ) -> None:
        """What belongs to a frame, for a window or a picture of ``size`` pixels."""
        width, height = size
        letters = letter_size(size)
        pane_width = width / len(content.panes)
        for pane, text in zip(content.panes, self._titles, strict=True):
            text.set_color(TEXT_COLOR)
            words = shortened(pane_title(pane, color), pane_width - letters, letters)
            text.put(words, (0.5 * letters / pane_width, 1.0 - 0.4 * letters / height), letters)
        line = shortened(frame_title(content, frame), width - letters, letters)
        self._frame.put(line, (0.5 * letters / width, 1.0 - (0.4 + LINE) * letters / height), letters)
        self.put_reading(self.reading, size)
        if color in content.measures:
            below = letters * (_EDGE + (SLIDER if slider else 0.0))
            self.bar.put(scales, color, content.unit, [frame], size, letters, below)
        else:
            self.bar.hide()
        if slider and len(content) > 1:
            self.timeline.put(content.judged, frame, len(content), size, letters)

    def put_on_tile(self, content: Content, frame: int, size: tuple[int, int]) -> None:
        """The frame's number, and the panes' titles where there are several."""
        width, height = size
        pane_width = width / len(content.panes)
        letters = min(tile_letter_size(height), pane_width / _TILE_WORDS)
        for index, (pane, text) in enumerate(zip(content.panes, self._titles, strict=True)):
            words = "" if index else f"frame {frame}"
            if not index and content.judged is not None and (verdict := content.judged[frame].verdict) != GOOD:
                words += f", {verdict}"
                text.set_color(COLORS[verdict])
            else:
                text.set_color(TEXT_COLOR)
            if len(content.panes) > 1:
                words += f"{', ' if words else ''}{pane.title}"
            place = (0.4 * letters / pane_width, 1.0 - 0.3 * letters / height)
            text.put(shortened(words, pane_width - 0.5 * letters, letters), place, letters)
        self._frame.put("", (0.0, 0.0), letters)
        self.bar.hide()

    def put_scale(
        self, content: Content, color: str, pixels: float, size: tuple[int, int], *, slider: bool = False
    ) -> None:
        """The scale bar, above the colour bar, where a length of 1 takes so many pixels."""
        letters = letter_size(size)
        bar = BAR if color in content.measures else 0.0
        below, pane_width = letters * (2.0 * _EDGE + bar + (SLIDER if slider else 0.0)), size[0] / len(content.panes)
        self.scale_bar.put(pixels, content.unit, size, letters, below, min(0.14 * size[0], 0.4 * pane_width))

    def put_reading(self, words: str, size: tuple[int, int]) -> None:
        """What is under the mouse, in the right corner: in the first line that has room for it."""
        letters = letter_size(size)
        words = shortened(words, 0.96 * size[0], letters)
        # Of several titles the last one stands in that corner.
        taken = [self._titles[0].text if len(self._titles) == 1 else None, self._frame.text]
        most = size[0] / (CHARACTER * letters) - len(words) - 2.0
        free = [k for k, text in enumerate(taken) if text is not None and len(text) < most]
        line = free[0] if free else len(taken)
        above = 0.4 + LINE * line
        self._reading.put(words, (1.0 - 0.5 * letters / size[0], 1.0 - above * letters / size[1]), letters)

    @property
    def reading(self) -> str:
        """What is said to be under the mouse."""
        return self._reading.text

    @property
    def titles(self) -> list[str]:
        """What is written above the panes, and of the frame."""
        return [*(text.text for text in self._titles), self._frame.text]


def pane_title(pane: Pane, color: str) -> str:
    """A pane's title, with what its error is the distance to."""
    measured = pane.colouring is not None and color == "error" and pane.against
    return f"{pane.title}: distance to {pane.against}" if measured else pane.title
