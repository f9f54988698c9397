"""What is known of a result without a truth, as a table on standard output."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.table import Table

from warpdef.apps.console import print_table
from warpdef.apps.metric_tables import MetricColumn
from warpdef.apps.run_summary import told_motions
from warpdef.quality.verdict import summary

MEASURES = (
    MetricColumn("residual_mean_percent", "mean distance of the points, % of the extent", "mean %", 1.0, 3, "lower"),
    MetricColumn("residual_p95_percent", "95th percentile", "p95 %", 1.0, 3, "lower"),
    MetricColumn("uncovered", "points not covered, %", "uncov %", 100.0, 1, "lower"),
    MetricColumn("far", "surface far from every point, %", "far %", 100.0, 1, ""),
    MetricColumn("unseen", "surface unseen, %", "unseen %", 100.0, 1, ""),
    MetricColumn("torn", "surface far and stretched, %", "torn %", 100.0, 2, "lower"),
    MetricColumn("stretch_p95", "edge stretch, 95th percentile of |log ratio|", "stretch", 1.0, 2, "lower"),
    MetricColumn("folded", "neighbouring faces folded, %", "folds %", 100.0, 2, "lower"),
    MetricColumn("thickness", "thickness over the shape's", "thick", 1.0, 2, ""),
    MetricColumn("volume", "volume over the shape's", "volume", 1.0, 2, ""),
    MetricColumn("flicker", "flicker, degrees", "flick", 1.0, 2, "lower"),
)


def print_quality(assessed: Mapping[str, Any], title: str) -> None:
    """One line a frame with its verdict, why the frames are not good, what motions nothing shows, and how many frames
    there are of each verdict.

    Args:
        assessed: ``Assessment.as_dict()``.
    """
    words = "; ".join(f"{measure.short.removesuffix(' %')}: {measure.title}" for measure in MEASURES)
    caption = f"{words}. The extent is the longest side of the shape."
    table = Table(title=title, title_justify="left", caption=caption, caption_justify="left")
    table.add_column("frame", justify="right")
    for measure in MEASURES:
        table.add_column(measure.short, justify="right")
    table.add_column("verdict", no_wrap=True)
    for values, verdict in zip(assessed["quality"], assessed["verdicts"], strict=True):
        table.add_row(str(values["frame"]), *(m.show(values[m.key]) for m in MEASURES), verdict)
    print_table(table)
    for values, verdict in zip(assessed["quality"], assessed["verdicts"], strict=True):
        if values["reasons"]:
            print(f"frame {values['frame']} is {verdict}: {'; '.join(values['reasons'])}")
    if note := told_motions(assessed):
        print(note)
    print(summary(assessed["verdicts"]))
