"""``warpdef demo``: the whole way, from a figure whose truth is known to measured quality."""

from __future__ import annotations

import filecmp
import shlex
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from warpdef.apps.config_flags import resolve_config
from warpdef.apps.console import ProgressDisplay, clean_stdout, print_json, say
from warpdef.apps.evaluate import evaluate_run
from warpdef.apps.exit_codes import EXIT_OK
from warpdef.apps.metric_tables import print_means
from warpdef.apps.run_summary import print_summary
from warpdef.apps.run_to_folder import RunOptions, finish, run_to_folder
from warpdef.apps.signals import exit_code
from warpdef.progress import held_interrupts

if TYPE_CHECKING:
    from warpdef.mesh import MeshSequence
    from warpdef.sequence import PointSequence

TRUTH, CLOUDS = "truth.npz", "clouds.npz"


def demo(
    *,
    output: Annotated[Path, Parameter(alias="-o")] = Path("warpdef-demo"),
    frames: Annotated[int, Parameter(validator=Number(gte=2))] = 17,
    points: Annotated[int, Parameter(validator=Number(gte=10))] = 5000,
    iterations: Annotated[int | None, Parameter(validator=Number(gte=1))] = None,
    device: str = "auto",
    threads: Annotated[int | None, Parameter(validator=Number(gte=1))] = None,
    json: Annotated[bool, Parameter(negative="")] = False,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Make a walking figure, reconstruct it from sampled points, and compare with the truth.

    Args:
        output: Folder for the result, and for truth.npz and clouds.npz, from which it was made.
        frames: Frames of the figure's walk.
        points: Points sampled a frame.
        iterations: Iterations of the reconstruction; the default preset's if not given.
        device: auto, cpu, or cuda:N.
        threads: CPU threads; all if not given.
        json: Print report and measures as JSON on standard output, and nothing else there.
        overwrite: Replace an older result at OUTPUT.
    """
    from warpdef.files.run_folder import RunFolder
    from warpdef.files.saved_run import load_run

    if not overwrite:
        RunFolder.prepare(output)  # refuse at once, before the figure is made
    config = resolve_config("default", None, None)
    if iterations is not None:
        config = replace(config, optimiser=replace(config.optimiser, iterations=iterations))
    with clean_stdout(), ProgressDisplay() as display:
        display.start("figure")
        truth, clouds = make_input(frames, points)
    if overwrite:
        remove_own_input(output, truth, clouds)
    run = run_to_folder(clouds, output, config, RunOptions(device, threads, overwrite))
    with held_interrupts():  # as for ``reconstruct``
        write_input(run.path, truth, clouds)
        if not json:
            print_summary(run.result, run.path)
        code = finish(run)
    if code != EXIT_OK:
        return code
    try:
        metrics = evaluate_run(load_run(run.path), truth)
    except KeyboardInterrupt as ended:
        say(f"warpdef: interrupted while evaluating: the result is in {run.path}")
        return exit_code(ended)
    if json:
        print_json({"report": run.result.report, "metrics": metrics})
    else:
        print_means(metrics, "Against the figure's true surface")
        print(f"look at it: warpdef view {shlex.quote(str(output))} --html {shlex.quote(str(output))}.html")
    return EXIT_OK


def make_input(frames: int, points: int) -> tuple[MeshSequence, PointSequence]:
    """The figure, exact, and clouds sampled from it with seed 0."""
    from warpdef.truth.figure import walking_figure
    from warpdef.truth.sample import sample_sequence

    truth = walking_figure(frames)
    return truth, sample_sequence(truth, points, seed=0)


def write_input(folder: Path, truth: MeshSequence, clouds: PointSequence) -> None:
    """Put what a demo was made from into ``folder``."""
    from warpdef.files import write_clouds_npz
    from warpdef.files.numpy_files import write_npz

    write_npz(folder / TRUTH, {"vertices": truth.vertices, "faces": truth.faces})
    write_clouds_npz(folder / CLOUDS, clouds)


def remove_own_input(folder: Path, truth: MeshSequence, clouds: PointSequence) -> None:
    """Remove an older demo's input from its folder, so that nothing but a result stands there to be replaced.

    Only files equal to what this demo would write go; anyone else's of the same name stay, and stop the overwriting.
    """
    with tempfile.TemporaryDirectory() as scratch:
        write_input(Path(scratch), truth, clouds)
        for name in (TRUTH, CLOUDS):
            if (folder / name).is_file() and filecmp.cmp(folder / name, Path(scratch) / name, shallow=False):
                (folder / name).unlink()
