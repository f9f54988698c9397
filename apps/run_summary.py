"""The short table at the end of a reconstruction."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpdef.apps.console import key_value_table, print_table
from warpdef.quality.verdict import summary

if TYPE_CHECKING:
    from warpdef.result import Reconstruction


def print_summary(result: Reconstruction, path: Path) -> None:
    """What was made, how long each phase took, what to be wary of, where it lies, and a verdict; on standard output."""
    print_table(key_value_table("Reconstruction", summary_rows(result, path)))
    if "verdicts" in result.report:
        print(summary(result.report["verdicts"]))


def summary_rows(result: Reconstruction, path: Path) -> dict[str, str]:
    """Names and values of the table, in order."""
    frames, vertices = result.vertices.shape[:2]
    report = result.report
    rows = {
        "mesh": f"{frames} frames, {vertices} vertices, {len(result.faces)} faces",
        "keyframe": f"{result.keyframe}: {report['keyframe_why']}",
        "iterations": str(report["iterations"]),
        "seconds": _pairs(report["seconds"], "{:.1f}"),
        "losses": _pairs(report["losses"], "{:.4g}"),
    }
    for number, warning in enumerate(report["warnings"]):
        rows[f"warning {number + 1}"] = str(warning)
    if note := told_motions(report):
        rows["note"] = note
    return {**rows, "result": str(path)}


def _pairs(values: Mapping[str, float], form: str) -> str:
    return ", ".join(f"{name} {form.format(value)}" for name, value in values.items())


def told_motions(report: Mapping[str, Any]) -> str:
    """One line on motions of the body that its points do not show; empty if there are none."""
    from warpdef.quality.slippage import Slippable, slip_note  # not before a command runs

    return slip_note([Slippable(**motion) for motion in report.get("slippable", ())])
