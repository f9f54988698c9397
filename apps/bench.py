"""``warpdef bench``: what each kernel and the whole iteration cost, beside the machine's limits and other libraries."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from warpdef.apps.console import clean_stdout, print_json, say
from warpdef.apps.exit_codes import EXIT_ERROR, EXIT_OK
from warpdef.errors import InputError


def bench(
    *,
    only: str = "",
    size: str = "",
    quick: Annotated[bool, Parameter(negative="")] = False,
    scaling: Annotated[bool, Parameter(negative="")] = False,
    threads: Annotated[int | None, Parameter(validator=Number(gte=1))] = None,
    device: str = "auto",
    data: Path | None = None,
    frames: Annotated[str, Parameter(allow_leading_hyphen=True)] = "",
    json: Annotated[Path | None, Parameter(allow_leading_hyphen=True)] = None,
    compare: Path | None = None,
    plot: Path | None = None,
    show: Path | None = None,
) -> int:
    """Measure the kernels and the whole iteration on this machine.

    Every answer is compared with another library's before it is timed, and the clock itself is tested first. On a busy
    machine the figures mean little.

    Args:
        only: Rows and parts whose name contains this: motion, neighbours, losses, solves, refine, iteration, whole run,
            start, scaling, or a row's own name.
        size: One size: small, work or large; all if not given.
        quick: Small sizes and few launches, to see that everything runs.
        scaling: Also sweep threads, points, vertices, frames and levels, and fit how time and memory grow.
        threads: CPU threads, measured beside one; all if not given.
        device: auto, cpu, or cuda:N.
        data: An npz with vertices (T, V, 3) and faces, to be sampled; or clouds; the built-in figure if not given.
        frames: Frames of DATA used, start:stop:step.
        json: Write everything measured to this file; - prints it on standard output instead of the tables.
        compare: Report of an earlier --json to put the figures beside.
        plot: Draw a roofline, and growth, to this .png.
        show: Show a report of an earlier --json instead of measuring.
    """
    from warpdef.apps.benchmark.compare import compare_reports, read_report
    from warpdef.apps.benchmark.plot import plot_report, require_plotting

    earlier = read_report(compare) if compare else None
    if plot is not None:
        require_plotting(plot)
    to_stdout = json == Path("-")
    if json is not None and not to_stdout and not json.absolute().parent.is_dir():
        raise InputError(f"--json: {json.parent} is not a folder; make it first")
    if show is not None:
        report = read_report(show)
    else:
        from warpdef.apps.benchmark.session import Options, run_bench

        options = Options(only, size, quick, scaling, threads, device, data, frames)
        with clean_stdout():
            report = run_bench(options, say)
    if earlier is not None:
        report["comparison"] = compare_reports(report, earlier)
    if to_stdout:
        print_json(report)
    else:
        _write_and_print(report, json, compare)
    if plot is not None:
        plot_report(report, plot)
    wrong = [error for error in report["errors"] if not error.startswith("null test")]
    for error in wrong:
        say(f"warpdef: error: {error}")
    return EXIT_ERROR if wrong else EXIT_OK


def _write_and_print(report: dict, json: Path | None, compare: Path | None) -> None:
    from warpdef.apps.benchmark.tables import print_comparison, print_report
    from warpdef.files.json_text import json_text

    if json is not None:
        json.write_text(json_text(report) + "\n", encoding="utf-8")
    print_report(report)
    if compare is not None:
        print_comparison(report["comparison"], compare.name)
