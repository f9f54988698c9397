"""A run from its input to its folder: locks, progress, checkpoints, and how it ended."""

from __future__ import annotations

import contextlib
import dataclasses
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpdef.apps.console import ProgressDisplay, Stopwatch, clean_stdout, say
from warpdef.apps.exit_codes import EXIT_LOST, EXIT_OK
from warpdef.apps.imports import uncollected
from warpdef.apps.signals import exit_code, interruption
from warpdef.config import Config
from warpdef.config_values import parse_slice
from warpdef.errors import InputError, WarpdefError
from warpdef.progress import held_interrupts
from warpdef.quality.verdict import LOST

if TYPE_CHECKING:
    from warpdef.appearance import Appearance
    from warpdef.fit.saving import Saved
    from warpdef.progress import Callback, Progress
    from warpdef.result import Reconstruction
    from warpdef.sequence import PointSequence


@dataclasses.dataclass(frozen=True)
class RunOptions:
    """How a run is made, whatever it computes; as the flags of the command. ``checkpoint_seconds`` None: never."""

    device: str = "auto"
    threads: int | None = None
    overwrite: bool = False
    strict: bool = False
    checkpoint_seconds: float | None = None
    max_seconds: float | None = None
    memory_limit: float | None = None
    live: bool = False
    quiet: bool = False


@dataclasses.dataclass(frozen=True)
class FinishedRun:
    """A result and the folder where it lies; ``resumable`` if it was stopped and can go on."""

    result: Reconstruction
    path: Path
    resumable: bool = False


def resume_to_folder(resumed: Path, source: Path | None, output: Path | None, how: RunOptions) -> FinishedRun:
    """Go on with the run whose output was to be ``resumed``.

    Args:
        source: where its input lies now; None: where it lay.
        output: where the result goes; None: where it was to go.

    Raises:
        WarpdefError: there is no checkpoint, it is damaged, or the input is not the same.
    """
    from warpdef.files.place_lock import claimed
    from warpdef.files.run_folder import RunFolder
    from warpdef.fit.saving import Saved

    with claimed(resumed):
        # Of a run that is through this is told, whatever else was laid into its folder.
        if resumed.is_dir() and not RunFolder(resumed.resolve(), True).checkpoint.exists():
            raise InputError(_nothing_to_resume(resumed))
        unfinished = RunFolder.prepare(resumed, resume=True)
        if not unfinished.checkpoint.exists():
            raise InputError(_nothing_to_resume(resumed))
        saved = Saved(unfinished.checkpoint)
        notes = saved.facts["notes"]
        if source is None:
            source = Path(notes.get("input", ""))
            if not notes.get("input") or not source.exists():
                raise InputError(
                    f"{source}: the input of the run to resume is gone; give its new place before --resume"
                )
        config = dataclasses.replace(saved.config, frames=notes.get("frames", ""))
        run = run_to_folder(source, output or resumed, config, how, saved)
        if not run.resumable:
            _drop(unfinished.checkpoint)
    return run


def _nothing_to_resume(place: Path) -> str:
    """Why there is nothing to go on with: the run is through, or there was none."""
    from warpdef.files.saved_run import load_run

    try:
        report = load_run(place).report
    except WarpdefError:
        return f"{place}: no checkpoint of an unfinished run is kept there; start it without --resume"
    if report.get("stopped"):
        return (
            f"{place}: the run was {report['stopped']} and its checkpoint is gone; begin it anew with --overwrite and "
            f"--config {place / 'config.toml'}"
        )
    return (
        f"{place}: this run is finished ({report.get('iterations')} iterations), there is nothing to go on with; for "
        "another one choose another place, or --overwrite"
    )


def run_to_folder(
    source: Path | PointSequence, output: Path, config: Config, how: RunOptions, saved: Saved | None = None
) -> FinishedRun:
    """Load, reconstruct with progress on standard error, and write the run folder.

    Args:
        source: where the clouds are, or the clouds themselves, of which ``config.frames`` are used.
        output: the run folder to make.
        config: the whole configuration, stored beside the result.
        how: threads, limits and the like.
        saved: the checkpoint to go on from.

    Raises:
        WarpdefError: input, configuration, device or output place is not usable; then nothing is written.
    """
    with uncollected():
        from warpdef.device import find_device
        from warpdef.files import read_mesh
        from warpdef.files.place_lock import claimed
        from warpdef.files.run_folder import RunFolder
        from warpdef.prepare import Safeguards, read_input

    total, watch = Stopwatch(), Stopwatch()
    same_place = saved is not None and RunFolder(Path(os.path.realpath(output)), True).checkpoint == saved.path
    with contextlib.ExitStack() as shown:
        if not same_place:  # else held already
            shown.enter_context(claimed(output))
        folder = RunFolder.prepare(output, how.overwrite, resume=same_place)
        if how.device != "auto":
            find_device(how.device)  # refused before anything is read
        shown.enter_context(clean_stdout())
        display = shown.enter_context(ProgressDisplay(how.quiet))
        display.start("load")
        if isinstance(source, Path):
            sequence = read_input(source, config, how.strict)
        else:
            sequence = source.select(parse_slice(config.frames))
        # A run that goes on has its template's shape in the checkpoint.
        template = read_mesh(config.template.mesh) if config.template.mesh and saved is None else None
        loading = watch.lap()
        before, loaded = _seconds_before(saved)

        tell = shown.enter_context(_shown_live(sequence, display, output)) if how.live else display

        with uncollected():
            from warpdef.pipeline import reconstruct as reconstruct_sequence

        where = str(source.resolve()) if isinstance(source, Path) else ""
        try:
            result = reconstruct_sequence(
                sequence,
                # The frames are chosen already: files outside the range are never opened.
                None if saved is not None else dataclasses.replace(config, frames=""),
                device=how.device,
                threads=how.threads,
                template=template,
                callback=tell,
                safeguards=Safeguards(
                    checkpoint=None if how.checkpoint_seconds is None else folder.checkpoint,
                    checkpoint_seconds=how.checkpoint_seconds or 0.0,
                    resume=saved,
                    notes={"input": where, "frames": config.frames, "load": repr(loaded + loading)},
                    seconds_max=None if how.max_seconds is None else max(how.max_seconds - loading, 0.0),
                    memory_limit=how.memory_limit,
                ),
            )
            watch.lap()
            display.start("write")

            def report() -> dict[str, Any]:
                inner = {"load": loaded + loading, **result.report["seconds"], "write": watch.lap()}
                result.report["seconds"] = {**inner, "total": before + total.lap()}
                return result.report

            with held_interrupts():  # a result that is there is written
                path = folder.save(
                    vertices=result.vertices,
                    faces=result.faces,
                    keyframe=result.keyframe,
                    config=dataclasses.replace(result.config, frames=config.frames),
                    report=report,
                    steps=result.steps,
                    names=sequence.frame_names,
                    motion=result.motion,
                    appearance=result.appearance if saved is None else _look_after_resuming(result),
                    confidence=result.confidence,
                )
        except BaseException:
            if folder.checkpoint.exists():
                say(f"warpdef: the last checkpoint is kept; go on with: warpdef reconstruct --resume {output}")
            raise
        stopped = bool(result.report.get("stopped"))
        if not stopped:
            _drop(folder.checkpoint)
        return FinishedRun(result, path, stopped and folder.checkpoint.exists())


def _seconds_before(saved: Saved | None) -> tuple[float, float]:
    """What a run that goes on had taken until its checkpoint, and how much of that was reading."""
    if saved is None:
        return 0.0, 0.0
    from warpdef.files.checkpoint import understood

    with understood(saved.path):
        loaded = float(saved.facts["notes"].get("load", "0"))
    return loaded + sum(saved.facts["seconds"].values()), loaded


def _drop(checkpoint: Path) -> None:
    """Remove what is no longer needed; a folder that allows it no more does not spoil a written result."""
    try:
        checkpoint.unlink(missing_ok=True)
    except OSError as error:
        say(f"warpdef: {checkpoint} is no longer needed but cannot be removed ({error.strerror}); delete it by hand")


def _look_after_resuming(result: Reconstruction) -> Appearance | None:
    """Colours and texture of the template given, for a run that went on from a checkpoint, which has only its shape;
    else the colours of the clouds."""
    own = _look_of_template(result)
    return result.appearance if own is None else own.over(result.appearance)


def _look_of_template(result: Reconstruction) -> Appearance | None:
    from warpdef.files import read_mesh

    file = result.config.template.mesh
    if not file:
        return None
    try:
        mesh = read_mesh(file)
    except WarpdefError as error:
        say(f"warpdef: warning: the result has no colours of the template: {error}")
        return None
    shapes = [(m.vertices.shape[-2:], m.faces.shape) for m in (mesh, result)]
    return mesh.appearance if shapes[0] == shapes[1] and (mesh.faces == result.faces).all() else None


@contextlib.contextmanager
def _shown_live(sequence: PointSequence, display: ProgressDisplay, output: Path) -> Iterator[Callback]:
    """A callback that shows progress on standard error and the mesh in a window, which closes at the end."""
    from warpdef.apps.viewer.live import LiveView

    with contextlib.closing(LiveView(sequence, str(output), say)) as view:

        def tell(progress: Progress) -> None:
            display(progress)
            view(progress)

        yield tell


def finish(run: FinishedRun, strict: bool = False) -> int:
    """The exit code of a finished run; one that ended early says so on standard error. ``strict``: no frame is lost."""
    report = run.result.report
    code = EXIT_LOST if strict and LOST in report.get("verdicts", ()) else EXIT_OK
    if not report.get("stopped") and not report["interrupted"]:
        return code
    signal = report.get("signal") or "SIGINT"
    by = "" if signal == "SIGINT" else f" by {signal}"
    why = f"interrupted{by}" if report["interrupted"] else f"stopped ({report['stopped']})"
    more = f"; go on with: warpdef reconstruct --resume {run.path}" if run.resumable else ""
    say(f"warpdef: {why} after {report['iterations']} iterations: the best state is in {run.path}{more}")
    return exit_code(interruption(report)) if report["interrupted"] else code
