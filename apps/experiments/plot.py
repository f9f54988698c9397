"""An experiment's table as a picture: Chamfer distance and normal consistency, the paper's dashed beside ours."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from warpdef.apps.experiments.plan import Experiment
from warpdef.apps.experiments.published import PAPER
from warpdef.apps.experiments.report import OURS
from warpdef.errors import MissingPackageError
from warpdef.files.disk import replacing

_PANELS = (("chamfer_l2", "CD, 1e-5", 1e5), ("normal_consistency", "normal consistency", 1.0))


def require_plotting() -> None:
    """Fail before hours of runs rather than after them.

    Raises:
        MissingPackageError: matplotlib cannot be imported.
    """
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise MissingPackageError(
            "the plot needs matplotlib; install it with: pip install 'warpdef[bench]', or leave it out with --no-plot"
        ) from None


def plot(experiment: Experiment, rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Write the picture: lines over the axis where settings are numbers, else one place a setting.

    Raises:
        InputError: the file cannot be written. MissingPackageError: no matplotlib.
    """
    require_plotting()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    numbered = all(setting.x is not None for setting in experiment.settings)
    height = 4.5 if numbered else max(3.0, 1.2 + 0.32 * len(experiment.settings))
    figure = Figure(figsize=(11, height), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 2, sharey=not numbered)
    for panel, (key, title, factor) in zip(axes, _PANELS, strict=True):
        for line in _lines(experiment, rows, key, factor):
            places, values, style = line.pop("places"), line.pop("values"), line.pop("style")
            panel.plot(*((places, values) if numbered else (values, places)), style, **line)
        (panel.set_ylabel if numbered else panel.set_xlabel)(title)
        if key == "chamfer_l2":
            (panel.set_yscale if numbered else panel.set_xscale)("log")
            axis = panel.yaxis if numbered else panel.xaxis
            low, high = axis.get_view_interval()
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 1e3 * low else (1.0,), numticks=12))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axis.set_minor_locator(NullLocator())
        if numbered:
            panel.set_xlabel(experiment.axis)
            panel.set_xticks(sorted({setting.x for setting in experiment.settings if setting.x is not None}))
        panel.grid(alpha=0.3)
    if not numbered:
        axes[0].set_yticks(range(len(experiment.settings)), [s.name for s in experiment.settings])
        axes[0].invert_yaxis()
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8)
    figure.suptitle(experiment.title)
    with replacing(path) as stream:
        figure.savefig(stream, format="png", dpi=130)


def _lines(experiment: Experiment, rows: Sequence[dict[str, Any]], key: str, factor: float) -> list[dict[str, Any]]:
    """One line a sequence, the mean, and one a data set of the paper."""
    numbers = [setting.x for setting in experiment.settings if setting.x is not None]
    numbered = len(numbers) == len(experiment.settings)
    places = numbers if numbered else range(len(experiment.settings))
    place = {setting.name: at for setting, at in zip(experiment.settings, places, strict=True)}
    groups: dict[tuple[str, str], list[tuple[float, float]]] = {}
    single = all(len(s.runs) == 1 for s in experiment.settings)
    for row in rows:
        mean = row["who"] == OURS and row["data"].startswith("mean of")
        if row[key] is None or (single and mean):
            continue
        data = (
            "mean" if mean else row["data"] + (f", noise {100 * row['noise']:g} %" if _noisy(experiment, row) else "")
        )
        name = (row["who"], "" if single and row["who"] == OURS else data)
        groups.setdefault(name, []).append((place[row["setting"]], factor * row[key]))
    lines = []
    for (who, data), points in groups.items():
        bold = who == OURS and (data in ("mean", ""))
        marker = "o" if who == OURS else "s" if who == PAPER else "^"
        style = (("-" if who == OURS else "--") if numbered else "") + marker
        places, values = zip(*sorted(points), strict=True)
        label = f"{who}: {data}" if data else who
        lines.append(
            {"places": places, "values": values, "label": label, "style": style, "linewidth": 2.2 if bold else 1.0}
        )
    return lines


def _noisy(experiment: Experiment, row: dict[str, Any]) -> bool:
    return experiment.name == "ideas" and bool(row["noise"])
