"""A run of the bench against an earlier one, row by row."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from warpdef.errors import InputError

SCHEMA = 1
"""Counts changes to the keys of a report."""
SAME = ("device_name", "cores", "data")


def read_report(path: Path) -> dict[str, Any]:
    """A report that ``warpdef bench --json`` wrote.

    Raises:
        InputError: nothing there, or not such a report.
    """
    if not path.is_file():
        raise InputError(f"{path}: expected a report of warpdef bench --json, found no file; give its path")
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, OSError):
        report = None
    if not isinstance(report, dict) or report.get("schema") != SCHEMA or not isinstance(report.get("rows"), list):
        raise InputError(
            f"{path}: expected a report of warpdef bench --json with schema {SCHEMA}, got something else; measure again"
        )
    return report


def compare_reports(new: dict[str, Any], old: dict[str, Any]) -> dict[str, Any]:
    """Rows of the same name, size and thread count: new median over old.

    Returns:
        ``rows``: name, size, threads, old_ms, new_ms, ratio, and ``verdict``: "faster" or "slower" where the quartiles
        do not overlap, else "same". ``missing``: rows only one run has. ``warnings``: why they may not be comparable.
    """
    before, after = ({_key(row): row for row in report["rows"]} for report in (old, new))
    rows = []
    for key in (k for k in after if k in before):
        a, b = before[key], after[key]
        verdict = "same"
        if b["ms_high"] < a["ms_low"]:
            verdict = "faster"
        if b["ms_low"] > a["ms_high"]:
            verdict = "slower"
        name, size, threads = key
        times = {"old_ms": a["ms"], "new_ms": b["ms"], "ratio": b["ms"] / a["ms"]}
        rows.append({"name": name, "size": size, "threads": threads, **times, "verdict": verdict})
    warnings = [
        f"{field}: {old['environment'].get(field)} then, {new['environment'].get(field)} now"
        for field in SAME
        if old["environment"].get(field) != new["environment"].get(field)
    ]
    for when, report in (("then", old), ("now", new)):
        warnings += [f"{when}: {error}" for error in report.get("errors", []) if error.startswith("null test")]
    return {"rows": rows, "missing": [list(key) for key in before.keys() ^ after.keys()], "warnings": warnings}


def _key(row: dict[str, Any]) -> tuple[str, str, int]:
    return row["name"], row["size"], row["threads"]
