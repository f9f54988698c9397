"""Parts of an hour on a device that look at the machine: driver, compilation, adds, tests, tools of the toolkit."""

from __future__ import annotations

import csv
import io
import os
import shutil
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
from collections import defaultdict
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp
from hour_book import Row, Skip, row
from hour_job import Job, sized

ADDS, ADDRESSES, NODES = 170_000, 17, 1_000
WITHOUT_PROGRAM = ("test_gpu_hour.py",)  # parts that start this program anew
PROCESSES, TESTS_LIMIT_S = 8, 500.0
QUICK_TESTS = ("test_cayley.py", "test_chamfer.py", "test_adam.py")
TOOLS = ("/usr/local/cuda/bin", "/opt/nvidia/nsight-compute")


def part_a(job: Job) -> list[Row]:
    """Driver and device; the first iteration of a process without compiled kernels, then with them."""
    from warpdef.apps.benchmark.data import Source, make_work
    from warpdef.apps.benchmark.point import run_point
    from warpdef.device import usable_cores

    rows = [*_driver(job), row("cores", usable_cores())]
    with tempfile.TemporaryDirectory() as scratch:
        work = Path(scratch) / "work.npz"
        make_work(Source("", job.truth(job.size.frames)), job.size).save(work)
        for name, most in (("cold", 20.0), ("warm", 3.0)):
            found = run_point(work, job.size, job.device, 1, 2, cache=Path(scratch) / "cache")
            rows.append(row(f"first iteration, {name}", found["first_s"], "s", most))
            rows += [
                row(f"... of it {part}, {name}", found[f"{part}_s"], "s") for part in ("import", "build", "compile")
            ]
            slowest = sorted(found["modules"].items(), key=lambda item: -item[1])[:5]
            rows += [row(f"... module {module}, {name}", seconds, "s") for module, seconds in slowest]
    return rows


def _driver(job: Job) -> list[Row]:
    def version(pair: Any) -> str:
        return ".".join(map(str, pair)) if pair else "none"

    device = job.target
    rows = [
        row("device", device.name),
        row("Warp", wp.__version__),
        row("CUDA of the driver", version(wp.get_cuda_driver_version())),
        row("CUDA of Warp", version(wp.get_cuda_toolkit_version())),
    ]
    if job.cuda:
        rows += [
            row("compute capability", device.arch),
            row("multiprocessors", device.sm_count),
            row("memory", device.total_memory / 2**30, "GiB"),
            row("memory free", device.free_memory / 2**30, "GiB"),
            row("memory pools", str(device.is_mempool_enabled)),
        ]
    return rows


def part_b(job: Job) -> list[Row]:
    """What decides between the two ends of every estimate: adds to one address, and the cost of a node."""
    import hour_kernels as kernels

    device, count = job.target, ADDS // (100 if job.quick else 1)
    rows = []
    for name, kernel, dtype, first in (
        ("double", kernels.add_doubles, wp.float64, ()),
        ("double, neighbours alike", kernels.add_runs, wp.float64, (count // ADDRESSES,)),
        ("three floats", kernels.add_vectors, wp.vec3, ()),
    ):
        for addresses in (ADDRESSES, count):
            out = wp.zeros(addresses, dtype=dtype, device=device)
            run = first if addresses == ADDRESSES else tuple(1 for _ in first)
            seconds = _replayed(job, lambda k=kernel, o=out, r=run: wp.launch(k, count, [*r, o], device=device), 10)
            rows.append(row(f"{count} adds of a {name} on {addresses} addresses", 1e6 * seconds, "us"))
            got = float(out.numpy().sum()) / (3 if dtype is wp.vec3 else 1)
            if got % count:
                raise AssertionError(f"{name}: {got} is no multiple of {count} adds")
    out = wp.zeros(1, dtype=wp.float32, device=device)
    for threads in (1, 10_240):
        launch = wp.launch(kernels.do_nothing, threads, [out], device=device, record_cmd=True)
        assert launch is not None
        seconds = _replayed(job, launch.launch, NODES // (10 if job.quick else 1))
        rows.append(row(f"a node of {threads} threads that do nothing, in a chain", 1e6 * seconds, "us"))
    return rows


def _replayed(job: Job, launch: Callable[[], object], times: int) -> float:
    """Seconds of one launch among ``times`` in one graph; median of ten replays, after a warm one."""
    from warpdef.apps.benchmark.timing import DeviceTimer

    launch()

    def all_of_them() -> None:
        for _ in range(times):
            launch()

    replay: Callable[[], object] = all_of_them
    if job.cuda:
        with wp.ScopedCapture(device=job.target) as captured:
            all_of_them()
        graph = captured.graph
        assert graph is not None
        replay = partial(wp.capture_launch, graph)
    clock = DeviceTimer(job.target)
    clock.seconds(replay)
    return float(np.median([clock.seconds(replay) for _ in range(10)])) / times


def part_c(job: Job) -> list[Row]:
    """Every test that has a device, on this one, files shared among processes; failures by name."""
    from warpdef.device import usable_cores

    tests = Path(__file__).resolve().parent
    names = QUICK_TESTS if job.quick else sorted(path.name for path in tests.glob("test_*.py"))
    names = [name for name in names if name not in WITHOUT_PROGRAM]
    count = min(PROCESSES, usable_cores(), len(names))
    with ThreadPoolExecutor(count) as pool:
        reports = list(pool.map(partial(_run_tests, job), range(count), [names[k::count] for k in range(count)]))
    late = [name for k, report in enumerate(reports) if report is None for name in names[k::count]]
    rows = told_of_tests([report for report in reports if report is not None])
    return rows + [row("not done in time, one of", ", ".join(late), most=0)] * bool(late)


def _run_tests(job: Job, number: int, names: list[str]) -> str | None:
    """The JUnit report of these files, each in the folder of this one; None where they were not done in time."""
    tests, answer = Path(__file__).resolve().parent, job.folder / f"tests-{number}.xml"
    answer.unlink(missing_ok=True)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--continue-on-collection-errors"]
    command += ["-k", "cuda" if job.cuda else "cpu", f"--junitxml={answer}"]
    command += ["-n0"] if _importable("xdist") else []
    command += [str(tests / name) for name in names]
    try:
        subprocess.run(command, cwd=tests.parent, check=False, timeout=TESTS_LIMIT_S)
    except subprocess.TimeoutExpired:
        return None
    return answer.read_text(encoding="utf-8") if answer.exists() else None


def _importable(name: str) -> bool:
    from importlib.util import find_spec

    return find_spec(name) is not None


def told_of_tests(reports: Sequence[str]) -> list[Row]:
    """Rows of JUnit reports: counts, and every test that failed by name.

    Raises:
        RuntimeError: no test ran.
    """
    counts: dict[str, int] = defaultdict(int)
    failed = []
    for case in (case for report in reports for case in ElementTree.fromstring(report).iter("testcase")):
        kinds = {child.tag for child in case}
        name = f"{case.get('classname', '')}::{case.get('name', '')}"
        trouble = case.find("failure")
        if "error" in kinds:
            # A file that could not be collected has no test of its own in it.
            counts["files not collected" if not case.get("classname") else "errors"] += 1
            failed += [(name, case.find("error"))] if case.get("classname") else []
        elif trouble is not None:
            counts["failed"] += 1
            failed.append((name, trouble))
        else:
            counts["skipped" if "skipped" in kinds else "passed"] += 1
    if not counts["passed"] + counts["failed"] + counts["errors"]:
        raise RuntimeError("no test ran")
    rows = [row("passed", counts["passed"]), row("failed", counts["failed"] + counts["errors"], most=0)]
    rows += [row(name, counts[name]) for name in ("skipped", "files not collected") if counts[name]]
    return rows + [row(name, _first_line(trouble), most=0) for name, trouble in failed]


def _first_line(trouble: ElementTree.Element | None) -> str:
    text = "" if trouble is None else trouble.get("message") or trouble.text or ""
    return (text.strip().splitlines() or ["it said nothing"])[0][:200]


def _tool(name: str) -> str:
    """Where a program of the toolkit is.

    Raises:
        Skip: nowhere.
    """
    places = os.pathsep.join([os.environ.get("PATH", ""), *TOOLS])
    found = shutil.which(name, path=places)
    if found is None:
        raise Skip(f"{name} is not installed here")
    return found


def _fit_command(job: Job) -> list[str]:
    here = Path(__file__).resolve().parent
    folders = [str(here.parent), str(here)]
    code = f"import sys; sys.path[:0] = {folders!r}; import hour_fits; hour_fits.fit_four({job.device!r})"
    return [sys.executable, "-c", code]


def part_d(job: Job) -> list[Row]:
    """A fit of four frames, both stages, under the checker of memory accesses; compiled before."""
    checker = _tool("compute-sanitizer") if job.cuda else ""
    subprocess.run(_fit_command(job), check=True)
    if not checker:
        raise Skip("the checker is for CUDA; the fit it would watch ran")
    command = [checker, "--tool", "memcheck", "--error-exitcode", "9", *_fit_command(job)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    print(done.stdout, done.stderr)
    complaints = [line for line in done.stdout.splitlines() if "Invalid" in line or "Error" in line]
    if done.returncode not in (0, 9):
        raise RuntimeError(f"compute-sanitizer ended with code {done.returncode}: {done.stderr[-200:]}")
    return [row("complaints", len(complaints), most=0), *(row(line.strip("= "), 1, most=0) for line in complaints[:10])]


def part_g(job: Job) -> list[Row]:
    """Milliseconds of an iteration by kernel; counters of the four that matter most, where the profiler is."""
    from warpdef.apps.benchmark.data import Source, make_work
    from warpdef.apps.benchmark.iteration import descend, kernel_milliseconds_cuda

    work, size = make_work(Source("", job.truth(job.size.frames)), job.size), sized(job.size, iterations=48)
    if job.cuda:
        found = kernel_milliseconds_cuda(work, size, job.target)
    else:
        found = descend(work, size, job.target, 1, 1)["kernels"]
    largest = sorted(found.items(), key=lambda item: -item[1])[:15]
    rows = [
        row("all kernels of an iteration", sum(found.values()), "ms"),
        *(row(name, ms, "ms") for name, ms in largest),
    ]
    try:
        return rows + (_counters(job, _tool("ncu")) if job.cuda else [])
    except Skip as why:
        return [*rows, row("counters", str(why))]


def _counters(job: Job, profiler: str) -> list[Row]:
    names = "regex:scatter|cosine|isometry|block|frames"
    metrics = "gpu__time_duration.sum,dram__throughput.avg.pct_of_peak_sustained_elapsed," + (
        "sm__throughput.avg.pct_of_peak_sustained_elapsed,launch__registers_per_thread,sm__warps_active.avg.pct_of_peak_sustained_active"
    )
    command = [
        profiler,
        "--csv",
        "--metrics",
        metrics,
        "--kernel-name",
        names,
        "--launch-count",
        "60",
        *_fit_command(job),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    rows = told_of_counters(done.stdout)
    return rows or [row("counters", (done.stdout + done.stderr).strip()[-200:] or f"code {done.returncode}")]


def told_of_counters(text: str) -> list[Row]:
    """Means by kernel and counter, from the profiler's table."""
    lines = text.splitlines()
    start = next((k for k, line in enumerate(lines) if line.startswith('"ID"')), len(lines))
    sums: dict[tuple[str, str, str], list[float]] = defaultdict(list)
    for entry in csv.DictReader(io.StringIO("\n".join(lines[start:]))):
        value = (entry.get("Metric Value") or "").replace(",", "")
        if value.replace(".", "", 1).isdigit():
            key = (entry["Kernel Name"].split("(")[0], entry["Metric Name"], entry.get("Metric Unit") or "")
            sums[key].append(float(value))
    return [row(f"{kernel}: {name}", float(np.mean(values)), unit) for (kernel, name, unit), values in sums.items()]
