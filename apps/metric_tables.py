"""Measures of an evaluation as tables on standard output."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rich.table import Table

from warpdef.apps.console import print_table


@dataclass(frozen=True)
class MetricColumn:
    """How one measure is shown: ``value * factor`` with ``digits`` decimals."""

    key: str
    title: str
    short: str
    factor: float
    digits: int
    better: str

    def show(self, value: float | None) -> str:
        """The value as text; a dash where there is none."""
        return "-" if value is None else f"{value * self.factor:.{self.digits}f}"


MEASURES = (
    MetricColumn("chamfer_l2", "Chamfer distance, 1e-5", "CD", 1e5, 3, "lower"),
    MetricColumn("chamfer_floor", "  of the truth against itself", "floor", 1e5, 3, ""),
    MetricColumn("normal_consistency", "normal consistency", "NC", 1.0, 4, "higher"),
    MetricColumn("f_score_0.5", "F-score at 0.5 %", "F-0.5%", 1.0, 4, "higher"),
    MetricColumn("f_score_1", "F-score at 1 %", "F-1%", 1.0, 4, "higher"),
    MetricColumn("point_to_surface", "point to surface, 1e-3", "P2S", 1e3, 3, "lower"),
    MetricColumn("edge_distortion", "edge-length distortion", "edges", 1.0, 4, "lower"),
    MetricColumn("tracking", "tracking", "track", 1.0, 4, "lower"),
    MetricColumn("flicker", "flicker, degrees", "flick", 1.0, 2, "lower"),
    MetricColumn("flicker_truth", "  the truth's own", "true", 1.0, 2, ""),
    MetricColumn("acceleration", "acceleration, 1e-3 a frame squared", "accel", 1e3, 2, ""),
    MetricColumn("acceleration_truth", "  the truth's own", "true", 1e3, 2, ""),
)


def print_means(metrics: Mapping[str, Any], title: str, keyframe: int | None = None) -> None:
    """One line a measure, mean over the frames; with the keyframe one more, that shows whether tracking drifts."""
    table = Table(title=title, title_justify="left")
    table.add_column("measure")
    table.add_column(f"mean of {len(metrics['frames'])} frames", justify="right")
    table.add_column("better is")
    for measure in MEASURES:
        table.add_row(measure.title, measure.show(metrics["mean"][measure.key]), measure.better)
        if measure.key == "tracking" and keyframe is not None and metrics["mean"]["tracking"] is not None:
            near, far = map(measure.show, tracking_drift(metrics["frames"], keyframe))
            table.add_row("  quarter of the frames nearest to the keyframe", near, "")
            table.add_row("  quarter farthest from it", far, "")
    print_table(table)


def tracking_drift(frames: Sequence[Mapping[str, Any]], keyframe: int) -> tuple[float, float]:
    """Mean tracking of the quarter of the frames nearest to the keyframe, itself left out, and of the farthest."""
    others = [f["tracking"] for f in sorted(frames, key=lambda f: abs(f["frame"] - keyframe)) if f["frame"] != keyframe]
    count = max(len(others) // 4, 1)
    return sum(others[:count]) / count, sum(others[-count:]) / count


def print_frames(metrics: Mapping[str, Any]) -> None:
    """One line a frame."""
    table = Table()
    table.add_column("frame", justify="right")
    for measure in MEASURES:
        table.add_column(measure.short, justify="right")
    for values in metrics["frames"]:
        table.add_row(str(values["frame"]), *(measure.show(values[measure.key]) for measure in MEASURES))
    print_table(table)
