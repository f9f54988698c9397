"""``warpdef datasets``: what a folder of true sequences holds."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from warpdef.apps.console import ProgressDisplay, clean_stdout, print_json, print_table, say
from warpdef.apps.exit_codes import EXIT_ERROR, EXIT_OK
from warpdef.errors import InputError, WarpdefError

if TYPE_CHECKING:
    from warpdef.datasets.check import SequenceReport
    from warpdef.datasets.find import Survey


def datasets(
    action: Literal["check"],
    folder: Path,
    /,
    *,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Say which true mesh sequences a folder holds: frames, topology, and what is wrong with them.

    Found are .npz files with vertices (T, V, 3) and faces; folders of numbered .obj, .ply or .off; folders with gt/
    (DynoSurf's layout); .anime files (DeformingThings4D); sequences in .hdf5 files (DFAUST; needs h5py). Everything
    is read. The exit code is 2 where anything cannot be.

    Args:
        action: check.
        folder: A set as it was distributed, one of its sequences, or one file.
        json: Print all that was found as JSON on standard output, and nothing else there.
    """
    from warpdef.datasets.check import check_sequence
    from warpdef.datasets.find import survey
    from warpdef.progress import Progress

    reports: list[SequenceReport] = []
    with clean_stdout(), ProgressDisplay() as display:
        found = survey(folder)
        if not found.sequences and not found.problems:
            raise InputError(f"{folder}: expected true mesh sequences, got none{_passed(found)}; check the path")
        display.start("check", len(found.sequences), "sequences")
        for number, sequence in enumerate(found.sequences):
            try:
                reports.append(check_sequence(sequence))
            except WarpdefError as error:
                found.problems.append(error)
            display(Progress("check", number + 1, len(found.sequences)))
    if json:
        sequences = [report.as_dict() for report in reports]
        problems = [str(problem) for problem in found.problems]
        print_json({"folder": str(folder), "sequences": sequences, "problems": problems, "passed_over": found.passed})
    else:
        _print(folder, reports, found)
    return EXIT_ERROR if found.problems else EXIT_OK


def _passed(found: Survey) -> str:
    return f" ({found.passed[0]})" if found.passed else ""


def _print(folder: Path, reports: list[SequenceReport], found: Survey) -> None:
    from rich.table import Table

    table = Table(title=f"{folder}: {len(reports)} sequence{'s' if len(reports) != 1 else ''}", title_justify="left")
    for title in ("sequence", "kind", "frames", "vertices", "faces", "surface", "pieces", "triangles", "clouds"):
        table.add_column(title, justify="right" if title in ("frames", "vertices", "faces", "pieces") else "left")
    for report in reports:
        counts = (str(n) for n in (report.frames, report.vertices, report.faces))
        same = "the same" if report.same_triangles else "differ"
        clouds = "-" if report.clouds is None else Path(report.clouds).name
        table.add_row(report.name, report.kind, *counts, report.surface, str(report.components), same, clouds)
    if reports:
        print_table(table)
    for report in reports:
        unused = [f"{report.unused} vertices belong to no face"] if report.unused else []
        for problem in (*report.problems, *unused):
            print(f"{report.name}: {problem}")
    for passed in found.passed:
        print(f"passed over: {passed}")
    for problem in found.problems:
        say(f"cannot be read: {problem}")
