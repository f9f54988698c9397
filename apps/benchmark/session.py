"""One run of the bench, from the machine's own figures to the targets: all that is measured, as one plain dictionary.

The report, which ``--json`` writes:

    schema         SCHEMA; another number means other keys
    environment    device, threads, versions, load, what data and command
    null_tests     [{name, sizes, seconds, ratio, passed}]
    machine        copy_gb_per_s and peak_gflop_per_s, by thread count
    rows           [{name, size, threads, unit, elements, ms, ms_low, ms_high, ..., peers: [...], error}]
    ratios         the iteration over cKDTree, by size and thread count
    whole          [{size, threads, cpu_s, stages: {stage: {cpu_s, wall_s}}, ckdtree_s, ratio, peak_mb, ...}]
    phases         milliseconds of an iteration by phase, and by kernel on one thread
    start          {cold, warm}: seconds to the first iteration, by part and module, and memory
    scaling        [{field, threads, points: [...], exponents, within}]
    targets        [{title, value, bound, unit, met}]
    errors         every sentence that says a figure is not to be used
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from warpdef.apps.benchmark.bed import Bed, teams
from warpdef.apps.benchmark.compare import SCHEMA
from warpdef.apps.benchmark.data import Source, load_source, make_work
from warpdef.apps.benchmark.iteration import descend, iteration_rows, kernel_milliseconds_cuda, ratio_entry
from warpdef.apps.benchmark.machine import arithmetic_peak, copy_bandwidth, environment, null_tests
from warpdef.apps.benchmark.point import run_point
from warpdef.apps.benchmark.rows import kernel_rows
from warpdef.apps.benchmark.scaling import run_sweeps
from warpdef.apps.benchmark.sizes import (
    LARGEST,
    PARTS,
    SIZES,
    SIZES_QUICK,
    SWEEP_ITERATIONS,
    SWEEP_WARMUP,
    SWEEPS,
    SWEEPS_QUICK,
    TARGETS,
    WHOLE,
    WORK,
    Size,
    selection,
)
from warpdef.apps.benchmark.timing import QUICK, Effort
from warpdef.apps.benchmark.whole import whole_row, whole_run
from warpdef.device import find_device, is_cuda, team_size, usable_cores
from warpdef.errors import InputError


@dataclass(frozen=True)
class Options:
    """What to measure; fields as the options of ``warpdef bench``. data: None for the built-in figure."""

    only: str = ""
    size: str = ""
    quick: bool = False
    scaling: bool = False
    threads: int | None = None
    device: str = "auto"
    data: Path | None = None
    frames: str = ""


def run_bench(options: Options, tell: Callable[[str], None] = lambda text: None) -> dict:
    """Measure; ``tell`` hears what is being done.

    Raises:
        InputError: an unknown row or size, or unusable data. DeviceError: no such device.
        WarpdefError: a process of its own failed.
    """
    wanted = selection(options.only)
    sizes = chosen_sizes(options)
    device = find_device(options.device)
    most = team_size(device, options.threads)
    counts = tuple(sorted({1, most}))
    sweeps, largest = (SWEEPS_QUICK, None) if options.quick else (SWEEPS, LARGEST)
    base = SIZES_QUICK[0] if options.quick else WORK
    scaling = options.scaling and "scaling" in wanted
    report: dict = {
        "schema": SCHEMA,
        "environment": environment(device, most),
        **{key: [] for key in ("null_tests", "rows", "ratios", "whole", "phases", "scaling", "targets", "errors")},
        "machine": {},
        "start": {},
    }
    tell("null test")
    report["null_tests"] = null_tests(device, options.quick)
    for test in report["null_tests"]:
        if not test["passed"]:
            ratio = test["ratio"]
            report["errors"].append(
                f"null test ({test['name']}): four times the work cost {ratio:.2f} times; believe no figure"
            )
    tell("data")
    frames = max(s.frames for s in (*sizes, base))
    source = load_source(options.data, options.frames, frames)
    report["environment"]["data"] = source.name
    effort = QUICK if options.quick else Effort()
    with teams(counts) as made, tempfile.TemporaryDirectory() as folder:
        tell("bandwidth and arithmetic of this machine")
        megabytes = 64 if options.quick else 256
        bandwidth = {n: copy_bandwidth(device, n, megabytes) for n in counts}
        peak = {n: arithmetic_peak(device, made[n], effort) for n in counts}
        report["machine"] = {
            "copy_gb_per_s": {str(n): 1e-9 * b for n, b in bandwidth.items()},
            "peak_gflop_per_s": {str(n): 1e-9 * p for n, p in peak.items()},
        }
        for size in sizes:
            work = make_work(source, size)
            if wanted - {*PARTS, "scaling"}:
                tell(f"kernels, size {size.name}")
                bed = Bed(work, size, device, most)
                report["rows"].extend(kernel_rows(bed, made, bandwidth, effort, wanted))
                del bed
            if "iteration" in wanted:
                for threads in counts:
                    tell(f"iteration, size {size.name}, {threads} threads")
                    # On CUDA one host thread leads; cKDTree then has all cores.
                    workers = usable_cores() if is_cuda(device) else threads
                    results = descend(work, size, device, threads, workers)
                    report["rows"].extend(iteration_rows(results, size, threads))
                    report["ratios"].append(ratio_entry(results, size, threads, workers))
                    kernels = results["kernels"] or kernel_milliseconds_cuda(work, size, device)
                    spent = {"phases": results["phases"], "kernels": kernels}
                    report["phases"].append({"size": size.name, "threads": threads, **spent})
            if WHOLE in wanted:
                for threads in counts:
                    tell(f"whole run, size {size.name}, {threads} threads, in a process of its own")
                    found = whole_run(work, size, device.alias, threads, Path(folder))
                    report["whole"].append(found)
                    report["rows"].append(whole_row(found, work))
        if "start" in wanted:
            tell("start and compile time, in processes of their own")
            report["start"] = starts(source, main_size(sizes), device.alias, most, Path(folder))
        if scaling:
            count, warmup = (6, 3) if options.quick else (SWEEP_ITERATIONS, SWEEP_WARMUP)
            report["scaling"] = run_sweeps(
                source, base, sweeps, largest, device.alias, most, count, warmup, Path(folder), tell
            )
    measured = (*report["rows"], *report["ratios"], *report["scaling"])
    report["errors"] += [entry["error"] for entry in measured if entry.get("error")]
    report["targets"] = targets(report, main_size(sizes).name, "cuda" if is_cuda(device) else "cpu")
    return report


def chosen_sizes(options: Options) -> tuple[Size, ...]:
    """The declared sizes, or the one asked for.

    Raises:
        InputError: no such size.
    """
    sizes = SIZES_QUICK if options.quick else SIZES
    chosen = tuple(s for s in sizes if options.size in ("", s.name))
    if not chosen:
        raise InputError(f"--size: expected one of {', '.join(s.name for s in sizes)}, got {options.size!r}")
    return chosen


def main_size(sizes: tuple[Size, ...]) -> Size:
    """The size that targets are about, or the only one there is."""
    return WORK if WORK in sizes else sizes[0]


def starts(source: Source, size: Size, device: str, threads: int, folder: Path) -> dict:
    """A run with an empty kernel cache, then one with the cache it left."""
    file = folder / "start.npz"
    make_work(source, size).save(file)
    cold, warm = (run_point(file, size, device, threads, 4, cache=folder / "kernels") for _ in range(2))
    return {"size": size.name, "cold": cold, "warm": warm}


def targets(report: dict, size: str, kind: str) -> list[dict]:
    """Each target of this kind of device that was measured, beside its bound; only size ``work`` is judged."""
    values: dict[str, float | None] = {}
    most = report["environment"]["threads"]
    for entry in report["ratios"]:
        if entry["size"] == size and entry["error"] is None:
            if entry["threads"] == most:
                values["iteration_over_ckdtree_all"] = entry["ratio"]
                values["iteration_ms"] = entry["iteration_ms"]
            if entry["threads"] == 1:
                values["iteration_over_ckdtree_one"] = entry["ratio"]
    if report["start"]:
        values["cold_start_s"] = report["start"]["cold"]["first_s"]
        values["warm_start_s"] = report["start"]["warm"]["first_s"]
        values["peak_memory_mb"] = report["start"]["warm"]["peak_mb"]
        values["device_memory_mb"] = report["start"]["warm"]["device_mb"]
    for sweep in report["scaling"]:
        if sweep["field"] == "largest" and sweep["points"]:
            values["largest_peak_mb"] = sweep["points"][0]["peak_mb"]
    judged = size == WORK.name
    return [
        {
            "title": t.title,
            "size": size,
            "value": value,
            "bound": t.bound,
            "unit": t.unit,
            "met": value <= t.bound if judged else None,
        }
        for t in TARGETS
        if t.device == kind and (value := values.get(t.key)) is not None
    ]
