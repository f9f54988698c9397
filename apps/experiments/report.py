"""A table of an experiment as CSV, JSON and Markdown: our rows beside published ones, by sequence and in the mean."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from warpdef.apps.experiments.plan import Experiment, Setting
from warpdef.apps.experiments.published import Published, published
from warpdef.apps.experiments.run import ExperimentRun, frame_text
from warpdef.apps.experiments.session import Outcome, Results
from warpdef.apps.experiments.store import write_text
from warpdef.apps.experiments.verdicts import verdicts
from warpdef.apps.metric_tables import MEASURES
from warpdef.files.json_text import json_text

OURS = "warpdef"
_SHOWN = tuple(m for m in MEASURES if m.key not in ("point_to_surface", "edge_distortion"))
_NUMBERS = tuple(m.key for m in MEASURES) + ("worst", "seconds", "peak_memory_mb", "iterations", "template_vertices")
COLUMNS = ("setting", "x", "who", "data", "frames", "points", "noise", *_NUMBERS, "source")
"""Of the CSV, in order; measures in plain units, fractions of the true frame's longest side."""


def table_rows(experiment: Experiment, results: Results) -> list[dict[str, Any]]:
    """All rows: for every setting each sequence, their mean, then what others report. A missing value is None."""
    rows = []
    for setting in experiment.settings:
        ours = [_own_row(setting, run, results[run.key]) for run in setting.runs if run.key in results]
        rows += ours
        if ours:
            rows.append(_mean_row(setting, ours))
        rows += [_published_row(setting, row) for row in published(experiment.name, setting.name)]
    return rows


def _own_row(setting: Setting, run: ExperimentRun, result: dict[str, Any]) -> dict[str, Any]:
    return {
        **_blank(setting),
        "who": OURS,
        "data": run.source.name,
        "frames": frame_text(run.frames),
        "points": run.points or None,
        "noise": run.noise,
        **result["mean"],
        "worst": result["worst"],
        "seconds": result["reconstruct_s"],
        "peak_memory_mb": result["peak_memory_mb"],
        "iterations": result["iterations"],
        "template_vertices": result["template"]["vertices"],
        "source": f"keyframe {result['keyframe']}",
    }


def _mean_row(setting: Setting, ours: Sequence[dict[str, Any]]) -> dict[str, Any]:
    missing = len(setting.runs) - len(ours)
    row = {**_blank(setting), "who": OURS, "data": f"mean of {len(ours)}"}
    for key in _NUMBERS:
        values = [r[key] for r in ours if r[key] is not None]
        row[key] = float(np.mean(values)) if len(values) == len(ours) else None
    row["worst"] = max(r["worst"] for r in ours)
    row["source"] = f"{missing} of {len(setting.runs)} not finished" if missing else ""
    return row


def _published_row(setting: Setting, row: Published) -> dict[str, Any]:
    return {**_blank(setting), "who": row.who, "data": row.data, **row.measures(), "source": row.where}


def _blank(setting: Setting) -> dict[str, Any]:
    return {**dict.fromkeys(COLUMNS), "setting": setting.name, "x": setting.x, "source": ""}


def csv_text(rows: Sequence[dict[str, Any]]) -> str:
    """The rows as CSV; a missing value is an empty field."""
    stream = io.StringIO()
    writer = csv.DictWriter(stream, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows({key: "" if value is None else value for key, value in row.items()} for row in rows)
    return stream.getvalue()


def markdown_text(experiment: Experiment, rows: Sequence[dict[str, Any]], outcome: Outcome, command: str) -> str:
    """The table as Markdown, with notes, verdicts, failures and every sequence below."""
    parts = [f"# {experiment.title}", f"`{command}`", *experiment.notes]
    if outcome.failures:
        parts += ["Failed:", _list(outcome.failures.values())]
    single = all(len(setting.runs) == 1 for setting in experiment.settings)
    above = [row for row in rows if row["who"] != OURS or row["data"].startswith("mean of") != single]
    parts.append(_table(above))
    said = verdicts(experiment, outcome.results)
    if said:
        parts += ["What it says:", _list(said)]
    about = [f"{setting.name}: {setting.about}" for setting in experiment.settings if setting.about]
    if about:
        parts += ["Settings:", _list(about)]
    if not single:
        own = [row for row in rows if row["who"] == OURS and not row["data"].startswith("mean of")]
        parts += ["## By sequence", _table(own)]
    parts += [
        "CD and floor in 1e-5, worst: the largest CD of a frame; floor: the truth against a second sampling of itself; "
        "track: tracking error over the frame's longest side; s: seconds of the reconstruction on "
        + "; ".join(sorted({_machine(r) for r in outcome.results.values()}))
        + "."
    ]
    return "\n\n".join(parts) + "\n"


def _machine(result: dict[str, Any]) -> str:
    alias = result["device"]["alias"]
    return f"{result['device']['name']} ({alias}" + (f", {result['threads']} threads)" if alias == "cpu" else ")")


def _list(lines: Any) -> str:
    return "\n".join(f"- {line}" for line in lines)


def _table(rows: Sequence[dict[str, Any]]) -> str:
    head = ["setting", "who", "data", *(m.short for m in _SHOWN), "worst", "iterations", "s", "source"]
    lines = [head, ["---"] * len(head)]
    chamfer = _SHOWN[0]
    for row in rows:
        cells = [row["setting"], row["who"], _data(row)]
        cells += [_plain(m.show(row[m.key]), row[m.key]) for m in _SHOWN]
        cells += [_plain(chamfer.show(row["worst"]), row["worst"]), _whole(row["iterations"]), _whole(row["seconds"])]
        lines.append([*cells, row["source"]])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _data(row: dict[str, Any]) -> str:
    noise = f", noise {100 * row['noise']:g} %" if row["noise"] else ""
    return f"{row['data']} {row['frames'] or ''}".strip() + noise


def _plain(text: str, value: float | None) -> str:
    """Nothing for no value; large distances without false digits."""
    return "" if value is None else text if len(text) < 8 else f"{1e5 * value:.2g}"


def _whole(value: float | None) -> str:
    return "" if value is None else f"{value:.0f}"


def write_report(experiment: Experiment, outcome: Outcome, folder: Path, command: str) -> list[dict[str, Any]]:
    """NAME.csv, NAME.json and NAME.md in ``folder``; returns the rows.

    Raises:
        InputError: a file cannot be written.
    """
    rows = table_rows(experiment, outcome.results)
    report = {
        "experiment": experiment.name,
        "title": experiment.title,
        "command": command,
        "notes": list(experiment.notes),
        "verdicts": verdicts(experiment, outcome.results),
        "failures": list(outcome.failures.values()),
        "rows": rows,
        "runs": {s.name: [run.key for run in s.runs] for s in experiment.settings},
    }
    write_text(folder / f"{experiment.name}.csv", csv_text(rows))
    write_text(folder / f"{experiment.name}.json", json_text(report) + "\n")
    write_text(folder / f"{experiment.name}.md", markdown_text(experiment, rows, outcome, command))
    return rows
