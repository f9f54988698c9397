"""The bench's report as a picture: a roofline of the kernels, and growth with size."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from warpdef.errors import InputError, MissingPackageError


def require_plotting(path: Path) -> None:
    """Fail now rather than after minutes of measuring.

    Raises:
        MissingPackageError: matplotlib cannot be imported. InputError: not a .png, or no folder to put it in.
    """
    if path.suffix.lower() != ".png":
        raise InputError(f"--plot: expected a file ending in .png, got {path}")
    if not path.absolute().parent.is_dir():
        raise InputError(f"--plot: {path.parent} is not a folder; make it first")
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise MissingPackageError("--plot needs matplotlib; install it with: pip install 'warpdef[bench]'") from None


def plot_report(report: dict[str, Any], path: Path) -> None:
    """Write the picture; a panel without data is left out.

    Raises:
        InputError: the report has neither kernels nor sweeps. MissingPackageError: no matplotlib.
    """
    require_plotting(path)
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    kernels = [row for row in report["rows"] if row.get("flops_per_byte")]
    sweeps = [s for s in report["scaling"] if len(s["points"]) > 1]
    panels = ([_roofline] if kernels else []) + ([_growth] if sweeps else [])
    if not panels:
        raise InputError("--plot: nothing to draw: measure kernels, or sweep with --scaling")
    figure = Figure(figsize=(7.5 * len(panels), 5.5), layout="constrained")
    FigureCanvasAgg(figure)
    for draw, axes in zip(panels, np.atleast_1d(figure.subplots(1, len(panels))), strict=True):
        draw(axes, report, kernels, sweeps)
    e = report["environment"]
    figure.suptitle(f"{e['device_name']}, {e['threads']} threads, warpdef {e['warpdef']}")
    figure.savefig(path, dpi=130)


def _roofline(axes: Any, report: dict, kernels: list[dict], sweeps: list[dict]) -> None:
    size = "work" if any(row["size"] == "work" for row in kernels) else kernels[0]["size"]
    x = np.logspace(-1.5, 3, 100)
    counts = sorted(report["machine"]["copy_gb_per_s"], key=int, reverse=True)
    for style, threads in zip(("-", "--"), counts, strict=False):
        copy, peak = (report["machine"][key][threads] for key in ("copy_gb_per_s", "peak_gflop_per_s"))
        (line,) = axes.loglog(x, np.minimum(x * copy, peak), style, label=f"copy and multiply-add, {threads} threads")
        shown = [row for row in kernels if row["size"] == size and row["threads"] == int(threads)]
        points = np.array([[row["flops_per_byte"], row["gflop_per_s"]] for row in shown])
        axes.loglog(*points.T, "o", color=line.get_color(), markersize=4)
        if style == "-":
            for row in shown:
                at = (row["flops_per_byte"], row["gflop_per_s"])
                axes.annotate(row["name"], at, textcoords="offset points", xytext=(4, 3), fontsize=7)
    axes.set(
        xlim=(0.1, 200), xlabel="operations a byte (every array once)", ylabel="Gflop/s", title=f"Roofline, size {size}"
    )
    axes.legend(fontsize=8)


def _growth(axes: Any, report: dict, kernels: list[dict], sweeps: list[dict]) -> None:
    for sweep in sweeps:
        value, ms = np.array([[p["value"], p["ms"]] for p in sweep["points"]]).T
        label = f"{sweep['field']}: exponent {sweep['exponents']['ms']:.2f}"
        axes.loglog(value / value[0], ms, "o-", markersize=4, label=label)
    axes.set(xlabel="times the smallest of the sweep", ylabel="ms an iteration", title="Growth")
    axes.legend(fontsize=8)
