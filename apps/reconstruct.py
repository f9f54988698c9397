"""``warpdef reconstruct``: clouds in, a run folder out."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter
from cyclopts.validators import Number

from warpdef.apps.config_flags import ConfigFlags, resolve_config
from warpdef.apps.console import ProgressDisplay, Stopwatch, clean_stdout, print_json, say
from warpdef.apps.exit_codes import EXIT_INTERRUPTED, EXIT_OK
from warpdef.apps.run_summary import print_summary
from warpdef.config import Config, parse_slice

if TYPE_CHECKING:
    from warpdef.result import Reconstruction
    from warpdef.sequence import PointSequence


def reconstruct(
    input: Path,
    /,
    *,
    output: Annotated[Path, Parameter(alias="-o")],
    preset: Literal["default", "paper"] = "default",
    config: Path | None = None,
    device: str = "auto",
    threads: Annotated[int | None, Parameter(validator=Number(gte=1))] = None,
    json: Annotated[bool, Parameter(negative="")] = False,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
    flags: ConfigFlags | None = None,
) -> int:
    """Reconstruct one moving mesh from a sequence of point clouds.

    Args:
        input: Folder of numbered clouds (ply, obj, off, xyz, npy), or an npz with points and, if known, normals.
        output: Folder for the result.
        preset: Values to start from: default is what was measured to be better, paper the published ones.
        config: TOML file whose values replace the preset's; flags win over both. An older result's config.toml
            repeats its run.
        device: auto, cpu, or cuda:N.
        threads: CPU threads; all if not given.
        json: Print report.json on standard output, and nothing else there.
        overwrite: Replace an older result at OUTPUT.
    """
    settings = resolve_config(preset, config, flags)
    run = run_to_folder(input, output, settings, device=device, threads=threads, overwrite=overwrite)
    if json:
        print_json(run.result.report)
    else:
        print_summary(run.result, run.path)
    return finish(run)


@dataclasses.dataclass(frozen=True)
class FinishedRun:
    """A result and the folder where it lies."""

    result: Reconstruction
    path: Path


def run_to_folder(
    source: Path | PointSequence,
    output: Path,
    config: Config,
    *,
    device: str = "auto",
    threads: int | None = None,
    overwrite: bool = False,
) -> FinishedRun:
    """Load, reconstruct with progress on standard error, and write the run folder.

    Args:
        source: where the clouds are, or the clouds themselves, of which ``config.frames`` are used.
        output: the run folder to make.
        config: the whole configuration, stored beside the result.
        device, threads: as the flags of the command.
        overwrite: replace an older result.

    Raises:
        WarpdefError: input, configuration, device or output place is not usable; then nothing is written.
    """
    from warpdef.files import read_clouds, read_mesh
    from warpdef.files.run_folder import RunFolder

    total, watch = Stopwatch(), Stopwatch()
    folder = RunFolder.prepare(output, overwrite)
    with clean_stdout(), ProgressDisplay() as display:
        frames = parse_slice(config.frames)
        display.start("load")
        sequence = read_clouds(source, frames) if isinstance(source, Path) else source.select(frames)
        template = read_mesh(config.template.mesh) if config.template.mesh else None
        loading = watch.lap()

        from warpdef.pipeline import reconstruct as reconstruct_sequence

        # The frames are chosen already: files outside the range are never opened.
        result = reconstruct_sequence(
            sequence,
            dataclasses.replace(config, frames=""),
            device=device,
            threads=threads,
            template=template,
            callback=display,
        )
        watch.lap()
        display.start("write")

        def report() -> dict[str, Any]:
            inner = result.report["seconds"]
            result.report["seconds"] = {"load": loading, **inner, "write": watch.lap(), "total": total.lap()}
            return result.report

        path = folder.save(
            vertices=result.vertices,
            faces=result.faces,
            keyframe=result.keyframe,
            config=dataclasses.replace(result.config, frames=config.frames),
            report=report,
            steps=result.steps,
            names=sequence.names,
        )
    return FinishedRun(result, path)


def finish(run: FinishedRun) -> int:
    """The exit code of a finished run; an interrupted one says so on standard error."""
    if not run.result.report["interrupted"]:
        return EXIT_OK
    say(f"warpdef: interrupted after {run.result.report['iterations']} iterations: the best state is in {run.path}")
    return EXIT_INTERRUPTED
