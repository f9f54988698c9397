"""A measure at the vertices of an animation, as numbers and as colours."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from warpdef.errors import InputError
from warpdef.vertex_measures import MEASURES, VertexMeasures

UNKNOWN = (154, 154, 154)
"""Colour of a vertex whose number is not known, sRGB."""


@dataclass(frozen=True)
class VertexValues:
    """A number at every vertex and frame.

    name:      a key of ``MEASURES``
    what:      what it is, with its unit, for people
    unit:      of the numbers; empty where they have none
    values:    NaN where unknown                              (T, V) float32
    limits:    what the ends of the colours stand for
    diverging: 0 is in the colours' middle
    """

    name: str
    what: str
    unit: str
    values: np.ndarray
    limits: tuple[float, float]
    diverging: bool = False

    @property
    def title(self) -> str:
        """Name and unit: ``error (mm)``."""
        return f"{self.name} ({self.unit})" if self.unit else self.name

    def over_time(self) -> VertexValues:
        """The mean over all frames that know a number, as one frame."""
        known = np.isfinite(self.values)
        count = known.sum(axis=0, keepdims=True)
        total = np.where(known, self.values, 0.0).sum(axis=0, keepdims=True)
        mean = np.where(count > 0, total / np.maximum(count, 1), np.nan).astype(np.float32)
        return replace(self, values=mean)

    def colors(self) -> np.ndarray:
        """sRGB colours, shape (T, V, 3) uint8: from violet to yellow, or blue to red; grey where unknown."""
        from matplotlib import colormaps

        table = np.rint(colormaps["coolwarm" if self.diverging else "viridis"](np.arange(256))[:, :3] * 255)
        table = np.concatenate([table, [UNKNOWN]]).astype(np.uint8)
        low, high = self.limits
        known = np.isfinite(self.values)
        place = np.rint(255 * np.clip((np.where(known, self.values, low) - low) / (high - low), 0.0, 1.0))
        return table[np.where(known, place, 256).astype(np.int64)]


def measure_vertices(measures: VertexMeasures, name: str, times: np.ndarray, unit: str = "input units") -> VertexValues:
    """A measure of a moving mesh at some times of it; between two frames linearly from one to the other.

    Args:
        measures: of all frames. name: a key of ``MEASURES``. times: counted in frames, shape (n,). unit: of a length.

    Raises:
        InputError: what the measure compares with is not known.
    """
    if name not in measures.measures:
        raise InputError(f"--color {name}: expected {MEASURES[name].needs}, got none; choose another measure")
    before = np.floor(times).astype(int)
    after = np.minimum(before + 1, len(measures.meshes) - 1)
    share = times - before
    known = {int(t): measures.values(name, int(t)) for t in np.unique([*before, *after[share > 0.0]])}
    rows = [
        known[int(a)] if s == 0.0 else (1.0 - s) * known[int(a)] + s * known[int(b)]
        for a, b, s in zip(before, after, share, strict=True)
    ]
    kind = MEASURES[name]
    what = kind.label.format(unit)
    own = unit if "{}" in kind.label else ""
    values = np.stack(rows).astype(np.float32)
    return VertexValues(name, what, own, values, measures.limits(name), kind.diverging)
