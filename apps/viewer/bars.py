"""Bars below a scene: one that says what its colours are, one that says how long a length is."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from warpdef.apps.viewer.flat import CHARACTER, Boxes, Text, shortened

if TYPE_CHECKING:
    from warpdef.apps.viewer.scales import Scales

BAR = 5.6
"""Height of the colour bar with what is written about it, in letters' sizes."""
SCALE_BAR = 2.2
"""The same of the scale bar."""
_LABELS = 5
_DARK = (32, 36, 44)


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


class ScaleBar:
    """A round length in the lower left corner, as long as it is where the camera looks at."""

    def __init__(self, renderer: Any) -> None:
        self._band, self._label = Boxes(renderer), Text(renderer, "center", "bottom")
        self.hide()

    def hide(self) -> None:
        """Draw nothing."""
        self._band.show(False)
        self._label.put("", (0.0, 0.0), 10.0)

    def put(self, pixels: float, unit: str, size: tuple[int, int], letters: float, bottom: float, most: float) -> None:
        """Draw it.

        Args:
            pixels: that a length of 1 takes. unit: what a length of 1 is called.
            size: width and height of the picture in pixels. letters: their size in pixels.
            bottom: pixels below it. most: pixels that it may take at most.
        """
        import numpy as np

        width, height = size
        length = round_length(most / pixels)
        words = f"{length:g} {unit}"
        # The bar, or the longer label over it, begins at the edge.
        middle = max(length * pixels, CHARACTER * letters * len(words)) / 2.0 + letters
        left, right = ((middle + side * length * pixels / 2.0) / width for side in (-1.0, 1.0))
        low, line, stroke = bottom / height, letters / height, letters / width
        boxes = [
            (left, low + 0.3 * line, right, low + 0.45 * line),
            (left, low, left + 0.15 * stroke, low + 0.75 * line),
            (right - 0.15 * stroke, low, right, low + 0.75 * line),
        ]
        self._band.put(np.array(boxes), np.array([_DARK] * len(boxes)))
        self._band.show(True)
        self._label.put(words, (middle / width, low + 0.9 * line), letters)

    @property
    def label(self) -> str:
        """The length that it shows."""
        return self._label.text


def round_length(most: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that is not above ``most``."""
    power = 10.0 ** math.floor(math.log10(most) + 1e-9)
    return power * max(step for step in (1, 2, 5) if step * power <= most * (1.0 + 1e-9))
