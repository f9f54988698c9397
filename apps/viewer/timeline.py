"""Under a window's slider: the frame's number, and a strip of residuals over time in the colours of the verdicts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from warpdef.apps.viewer.flat import CHARACTER, Boxes, Text
from warpdef.apps.viewer.judged import COLORS

if TYPE_CHECKING:
    import numpy as np

    from warpdef.apps.viewer.judged import Judged

LEFT, RIGHT = 0.2, 0.8
"""Where the slider begins and ends, shares of the width."""
SLIDER_AT = 3.7
"""Height of the slider's middle, in letters' sizes."""
_BOTTOM, _TOP = 0.4, 2.3
_LEAST = 0.15
"""Height of the lowest bar: the verdict's colour must be seen."""
_USUAL = 4.0
"""A bar is cut where its residual is so many times the median."""


class Timeline:
    """What belongs to the slider."""

    def __init__(self, renderer: Any) -> None:
        self._strip, self._mark = Boxes(renderer), Boxes(renderer)
        self._number = Text(renderer, "left", "center")
        self._name, self._value = Text(renderer, "right", "bottom"), Text(renderer, "left", "bottom")
        self._strip.show(False)
        self._mark.show(False)

    def put(
        self, judged: Sequence[Judged] | None, frame: int, count: int, size: tuple[int, int], letters: float
    ) -> None:
        """Draw it.

        Args:
            judged: the frames, or nothing is known of them.
            size: width and height of the window in pixels. letters: their size in pixels.
        """
        import numpy as np

        line, gap = letters / size[1], letters / size[0]
        self._number.put(str(frame), (RIGHT + 0.9 * gap, SLIDER_AT * line), letters)
        if judged is None or count < 2:
            return
        boxes = strip_boxes([j.residual for j in judged], _BOTTOM * line, _TOP * line)
        colors = np.array([[int(COLORS[j.verdict][k : k + 2], 16) for k in (1, 3, 5)] for j in judged])
        left, _, right, _ = boxes[frame]
        self._mark.put(np.array([[left, 0.0, right, 0.8 * _BOTTOM * line]]), np.array([[32, 36, 44]]))
        self._strip.put(boxes, colors)
        self._strip.show(True)
        self._mark.show(True)
        residual = judged[frame].residual
        words = "no points" if residual is None else f"{residual:.2g} % of the extent"
        if CHARACTER * letters * len(words) > (1.0 - boxes[-1, 2]) * size[0] - 2.0 * letters:
            words = words.removesuffix(" of the extent")
        self._name.put("residual", (LEFT - gap - (boxes[0, 2] - boxes[0, 0]) / 2.0, _BOTTOM * line), letters)
        self._value.put(words, (RIGHT + gap + (boxes[0, 2] - boxes[0, 0]) / 2.0, _BOTTOM * line), letters)

    @property
    def words(self) -> tuple[str, str]:
        """The frame's number and its residual."""
        return self._number.text, self._value.text


def strip_boxes(residuals: Sequence[float | None], bottom: float, top: float) -> np.ndarray:
    """A bar a frame, each below its place on the slider: left, bottom, right, top, shape (T, 4), shares of the window.

    Heights are by the residual; the few that are ``_USUAL`` times the median are cut, as the others would be nothing.
    """
    import numpy as np

    values = np.array([np.nan if r is None else r for r in residuals], dtype=float)
    known = values[np.isfinite(values)]
    most = min(known.max(), _USUAL * float(np.median(known))) if len(known) else 1.0
    share = np.nan_to_num(values / (most or 1.0), nan=0.0).clip(_LEAST, 1.0)
    step = (RIGHT - LEFT) / (len(values) - 1)
    middle = np.linspace(LEFT, RIGHT, len(values))
    half = 0.5 * step * (0.86 if len(values) < 100 else 1.0)
    low = np.full(len(values), bottom)
    return np.stack([middle - half, low, middle + half, bottom + share * (top - bottom)], axis=1)
