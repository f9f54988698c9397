"""Numbers to colours: one scale a measure for all panes and frames, so that colours can be compared."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

    from warpdef.apps.viewer.content import Content

UNKNOWN = "#9a9a9a"
"""Where a measure is not known."""
MISSING = (154, 154, 154)
"""The same as bytes."""


def color_map(measure: str, chosen: str = "") -> str:
    """The name of a measure's colour map: the one chosen, or the usual one."""
    from warpdef.vertex_measures import MEASURES

    return chosen or ("coolwarm" if MEASURES[measure].diverging else "viridis")


class Scales:
    """The ends and colours of every measure of a content."""

    def __init__(self, content: Content, measure: str, clim: tuple[float, float] | None = None, cmap: str = "") -> None:
        """Args: measure: what ``clim`` are the ends of. cmap: matplotlib's name of a colour map, for all measures."""
        self._content, self._given, self._clim, self._cmap = content, measure, clim, cmap
        self._tables: dict[str, Any] = {}
        self._limits: dict[str, tuple[float, float]] = {}

    def limits(self, measure: str) -> tuple[float, float]:
        """The ends: those given, else the widest of the panes'."""
        if self._clim is not None and measure == self._given:
            return self._clim
        if measure not in self._limits:
            known = [pane.colouring.limits(measure) for pane in self._measured(measure)]
            self._limits[measure] = min(low for low, _ in known), max(high for _, high in known)
        return self._limits[measure]

    def table(self, measure: str) -> Any:
        """PyVista's lookup table, made once."""
        import pyvista

        if measure not in self._tables:
            table = pyvista.LookupTable(color_map(measure, self._cmap), n_values=256)
            table.scalar_range = self.limits(measure)
            table.nan_color = UNKNOWN
            self._tables[measure] = table
        return self._tables[measure]

    def colors(self, measure: str) -> np.ndarray:
        """The table's colours from the lower to the upper end, shape (256, 3) uint8."""
        return self.table(measure).values[:, :3]

    def note(self, measure: str, frames: list[int]) -> str:
        """What the bar's ends are, and the largest value in the frames that are seen."""
        import numpy as np

        if measure == "confidence" and self._clim is None:
            return ""
        values = [pane.colouring.values(measure, t) for pane in self._measured(measure) for t in frames]
        seen = np.concatenate(values)
        seen = seen[np.isfinite(seen)]
        where = "in this frame" if len(frames) == 1 else "in these frames"
        least, most = (seen.min(), seen.max()) if len(seen) else (0.0, 0.0)
        low = self.limits(measure)[0]
        span = f"{least:.3g} to {most:.3g} {where}" if low < 0.0 else f"maximum {where} {most:.3g}"
        return f"{self.ends(measure)}; {span}"

    def ends(self, measure: str) -> str:
        """What the bar's ends are, in words."""
        if self._clim is not None and measure == self._given:
            return "ends as chosen"
        return f"ends at {'±' if self.limits(measure)[0] < 0.0 else ''}the 99th percentile"

    def forget(self) -> None:
        """The measures are others now."""
        self._tables.clear()
        self._limits.clear()

    def _measured(self, measure: str) -> list[Any]:
        return [p for p in self._content.panes if p.colouring is not None and measure in p.colouring.measures]
