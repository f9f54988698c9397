"""The bench's report as tables on standard output."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.table import Table
from rich.text import Text

from warpdef.apps.benchmark.scaling import GROWING, judged_by
from warpdef.apps.benchmark.sizes import EXPONENT_MAX
from warpdef.apps.console import key_value_table, print_table

_LARGEST_SHARES = 12  # kernels shown of an iteration


def print_report(report: Mapping[str, Any]) -> None:
    """Everything that was measured; warnings first, targets last."""
    print_table(key_value_table("Machine", _machine(report)))
    if report["rows"]:
        print_table(_rows(report["rows"]))
    if report["ratios"]:
        print_table(_ratios(report["ratios"]))
    for whole in report.get("whole", ()):
        print_table(_whole(whole))
    for spent in report["phases"]:
        print_table(_shares(spent))
    if report["start"]:
        print_table(_start(report["start"]))
    for sweep in report["scaling"]:
        print_table(_sweep(sweep))
    if report["targets"]:
        print_table(_targets(report["targets"]))
    for error in report["errors"]:
        print_table(_line(f"ERROR {error}"))


def print_comparison(comparison: Mapping[str, Any], name: str) -> None:
    """Ratios against an earlier run; below 1 is faster now."""
    columns = ("row", "size", ">threads", ">then ms", ">now ms", ">ratio", "verdict")
    table = _table(f"Against {name} (now / then)", *columns)
    for row in comparison["rows"]:
        times = (_number(row["old_ms"]), _number(row["new_ms"]), f"{row['ratio']:.2f}")
        table.add_row(row["name"], row["size"], str(row["threads"]), *times, row["verdict"])
    print_table(table)
    for name, size, threads in sorted(comparison["missing"]):
        print_table(_line(f"only in one run: {name}, {size}, {threads} threads"))
    for warning in comparison["warnings"]:
        print_table(_line(f"WARNING {warning}"))


def _machine(report: Mapping[str, Any]) -> dict[str, str]:
    e, machine = report["environment"], report["machine"]

    def by_threads(values: Mapping[str, float], unit: str) -> str:
        return ", ".join(f"{v:.1f} {unit} with {n}" for n, v in values.items())

    tests = [
        f"{t['name']}: four times the work costs {t['ratio']:.2f} times, {'passed' if t['passed'] else 'FAILED'}"
        for t in report["null_tests"]
    ]
    load = "" if e["load_at_start"] is None else f", load {e['load_at_start']:.1f}"
    return {
        "device": f"{e['device']}: {e['device_name']}, {e['cores']} cores, {e['threads']} threads{load}",
        "versions": ", ".join(f"{name} {e[name]}" for name in ("warpdef", "warp", "numpy", "scipy", "python")),
        "data": e["data"],
        "null test": "; ".join(tests),
        "copy (read and write)": by_threads(machine["copy_gb_per_s"], "GB/s"),
        "multiply-adds": by_threads(machine["peak_gflop_per_s"], "Gflop/s"),
    }


def _rows(rows: Sequence[Mapping[str, Any]]) -> Table:
    columns = ("row", "size", ">thr", ">ms", ">quartiles", ">M/s", ">GB/s", ">of copy", "times as fast as")
    table = _table("Kernels and iterations (bytes: every array once; above 100 % of copy: served by caches)", *columns)
    for row in rows:
        bandwidth = ("-", "-")
        if row.get("gb_per_s") is not None:
            bandwidth = (_number(row["gb_per_s"]), f"{100 * row['share_of_copy']:.0f} %")
        spread = f"{_number(row['ms_low'])} - {_number(row['ms_high'])}"
        beside = row["error"] or ", ".join(map(_peer, row["peers"]))
        cells = [row["name"], row["size"], str(row["threads"]), _number(row["ms"]), spread]
        cells += [_number(row["melements_per_s"]), *bandwidth, f"ERROR {beside}" if row["error"] else beside]
        table.add_row(*map(Text, cells), style="red" if row["error"] else None)
    return table


def _peer(peer: Mapping[str, Any]) -> str:
    workers = "" if peer["workers"] is None else f" ({peer['workers']} thr)"
    return f"{peer['name']}{workers} {peer['speed_up']:.1f}"


def _ratios(ratios: Sequence[Mapping[str, Any]]) -> Table:
    count = ratios[0]["checkpoints"]
    title = f"iteration / cKDTree: mean full iteration of a descent; cKDTree, ms, at {count} places along it"
    columns = ("size", ">threads", ">iteration ms", ">workers", ">build", ">queries", ">ratio")
    columns += (">to its best", "same neighbours")
    table = _table(title, *columns)
    for r in ratios:
        theirs = (str(r["workers"]), _number(r["ckdtree_build_ms"]), _number(r["ckdtree_query_ms"]))
        ratio = (f"{r['ratio']:.3f}", f"{r['ratio_best']:.3f}")
        same = r["error"] or "yes"
        table.add_row(r["size"], str(r["threads"]), _number(r["iteration_ms"]), *theirs, *ratio, same)
    return table


def _whole(whole: Mapping[str, Any]) -> Table:
    threads = f"{whole['threads']} thread{'s' if whole['threads'] > 1 else ''}"
    size = f"{whole['frames']} frames, {whole['points']} points each, {whole['vertices']} vertices"
    table = _table(f"A whole run: {whole['size']}, {threads}; {size}", "stage", ">CPU s", ">s")
    for name, spent in whole["stages"].items():
        table.add_row(name, _number(spent["cpu_s"]), _number(spent["wall_s"]))
    table.add_row("start, reading and writing", *(_number(whole["others"][key]) for key in ("cpu_s", "wall_s")))
    table.add_section()
    table.add_row("in all", _number(whole["cpu_s"]), _number(whole["wall_s"]))
    table.add_row("one pass of neighbours by cKDTree", _number(whole["ckdtree_s"]), "")
    table.add_row("whole run / pass", f"{whole['ratio']:.1f}", "")
    table.add_row("peak of the process, MB", _number(whole["peak_mb"]), "")
    return table


def _shares(spent: Mapping[str, Any]) -> Table:
    threads = f"{spent['threads']} thread{'s' if spent['threads'] > 1 else ''}"
    table = _table(f"Where an iteration goes: {spent['size']}, {threads}", "phase or kernel", ">ms", ">share")
    for part in (spent["phases"], spent["kernels"]):
        total = sum(part.values())
        largest = sorted(part.items(), key=lambda item: -item[1])[:_LARGEST_SHARES]
        for name, ms in largest:
            table.add_row(name, _number(ms), f"{100 * ms / total:.0f} %")
        table.add_section()
    return table


def _start(start: Mapping[str, Any]) -> Table:
    title = f"From process start to the end of the first iteration: {start['size']}"
    table = _table(title, "seconds", ">cold", ">warm")
    cold, warm = start["cold"], start["warm"]
    for title, key in (("import", "import_s"), ("build", "build_s"), ("compile", "compile_s"), ("iteration", "step_s")):
        table.add_row(title, f"{cold[key]:.2f}", f"{warm[key]:.2f}")
    table.add_row("in all", f"{cold['first_s']:.2f}", f"{warm['first_s']:.2f}")
    table.add_section()
    for module in sorted(cold["modules"], key=lambda name: -cold["modules"][name]):
        table.add_row(f"  module {module}", f"{cold['modules'][module]:.2f}", f"{warm['modules'].get(module, 0.0):.3f}")
    table.add_section()
    table.add_row("arrays, MB", f"{cold['arrays_mb']:.0f}", f"{warm['arrays_mb']:.0f}")
    table.add_row("peak of the process, MB", f"{cold['peak_mb']:.0f}", f"{warm['peak_mb']:.0f}")
    if warm["device_mb"] is not None:
        table.add_row("peak of the device, MB", f"{cold['device_mb']:.0f}", f"{warm['device_mb']:.0f}")
    return table


def _sweep(sweep: Mapping[str, Any]) -> Table:
    threads = "" if sweep["threads"] is None else f", {sweep['threads']} threads"
    table = _table(
        f"Growth with {sweep['field']}{threads}", f">{sweep['field']}", ">ms", ">CPU ms", ">arrays MB", ">peak MB"
    )
    for point in sweep["points"]:
        table.add_row(str(point["value"]), *(_number(point.get(key)) for key in GROWING))
    fitted = sweep["exponents"]
    if fitted:
        table.add_section()
        for title, end in (("exponent", ""), ("last two", "_top")):
            table.add_row(title, *(f"{fitted[key + end]:.2f}" if key in fitted else "-" for key in GROWING))
    if sweep["within"] is not None:
        bound, judged = f"at most {EXPONENT_MAX}", judged_by(sweep)
        verdicts = ("" if key not in judged else "yes" if fitted[key] <= EXPONENT_MAX else "NO" for key in GROWING)
        table.add_row(bound, *verdicts)
    return table


def _targets(targets: Sequence[Mapping[str, Any]]) -> Table:
    table = _table(f"Targets, size {targets[0]['size']}", "figure", ">measured", ">at most", "met")
    for t in targets:
        met = {True: "yes", False: "NO", None: "not judged"}[t["met"]]
        table.add_row(t["title"], f"{t['value']:.3g} {t['unit']}", f"{t['bound']:g} {t['unit']}", met)
    return table


def _table(title: str, *columns: str) -> Table:
    """A table without a frame; a column named with > in front is right-aligned."""
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for k, column in enumerate(columns):
        right = column.startswith(">")
        last = k == len(columns) - 1 and not right
        table.add_column(column.lstrip(">"), justify="right" if right else "left", no_wrap=not last)
    return table


def _line(text: str) -> Table:
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(overflow="fold")
    table.add_row(Text(text, style="red" if text.startswith(("ERROR", "WARNING")) else ""))
    return table


def _number(value: float | None) -> str:
    """Three significant digits, without exponents."""
    if value is None:
        return "-"
    digits = 0 if abs(value) >= 100 else 1 if abs(value) >= 10 else 2 if abs(value) >= 1 else 3
    return f"{value:.{digits}f}"
