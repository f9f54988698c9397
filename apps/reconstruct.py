"""``warpdef reconstruct``: clouds in, a run folder out."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter
from cyclopts.validators import Number

from warpdef.apps.config_flags import ConfigFlags, resolve_config
from warpdef.apps.console import print_json
from warpdef.apps.run_summary import print_summary
from warpdef.apps.run_to_folder import RunOptions, finish, resume_to_folder, run_to_folder
from warpdef.errors import InputError
from warpdef.progress import held_interrupts

CHECKPOINT_SECONDS = 60.0


def reconstruct(
    input: Path | None = None,
    /,
    *,
    output: Annotated[Path | None, Parameter(alias="-o")] = None,
    resume: Path | None = None,
    preset: Literal["default", "paper"] = "default",
    config: Path | None = None,
    device: str = "auto",
    threads: Annotated[int | None, Parameter(validator=Number(gte=1))] = None,
    json: Annotated[bool, Parameter(negative="")] = False,
    quiet: Annotated[bool, Parameter(alias="-q", negative="")] = False,
    live: Annotated[bool, Parameter(negative="")] = False,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
    strict: Annotated[bool, Parameter(negative="")] = False,
    max_seconds: Annotated[float | None, Parameter(validator=Number(gt=0))] = None,
    checkpoint_seconds: Annotated[float, Parameter(validator=Number(gte=0))] = CHECKPOINT_SECONDS,
    memory_limit: Annotated[float | None, Parameter(validator=Number(gte=0))] = None,
    flags: ConfigFlags | None = None,
) -> int:
    """Reconstruct one moving mesh from a sequence of point clouds.

    Args:
        input: Folder of numbered clouds or meshes (ply, obj, npy, pcd, las, e57, glb, xyz, csv and others), or an npz
            with points and, if known, normals.
        output: Folder for the result.
        resume: OUTPUT of a run that was cut short, to go on from its last checkpoint with the same input (INPUT only
            if it lies elsewhere now), to the same result.
        preset: Values to start from: default is what was measured to be better, paper the published ones.
        config: TOML file whose values replace the preset's; flags win over both. An older result's config.toml
            repeats its run.
        device: auto, cpu, or cuda:N.
        threads: CPU threads; all if not given.
        json: Print report.json on standard output, and nothing else there.
        quiet: Say nothing but warnings and errors; the result is in OUTPUT.
        live: Show the mesh in a window while it is optimised; closing it does not end the run.
        overwrite: Replace an older result at OUTPUT, or begin an unfinished run anew.
        strict: Refuse input with a frame that cannot be used (empty, damaged); else its mesh is interpolated, with a
            warning. And end with exit code 3 if the mesh is lost in a frame; the result is written all the same.
        max_seconds: Time limit: end with the best state so far. Writing the result comes on top.
        checkpoint_seconds: Least time between two checkpoints, kept beside OUTPUT until the result is written.
        memory_limit: GiB that the run may be estimated to need, else it is refused; what is free if not given;
            0 for no limit.
    """
    how = RunOptions(device, threads, overwrite, strict, checkpoint_seconds, max_seconds, memory_limit, live, quiet)
    if resume is None:
        if input is None or output is None:
            missing = "INPUT" if input is None else "--output"
            raise InputError(f"reconstruct: expected {missing}, got none; see warpdef reconstruct --help")
        if output.suffix:
            _require_folder_name(output)
        run = run_to_folder(input, output, resolve_config(preset, config, flags), how)
    else:
        if preset != "default" or config is not None or flags is not None:
            raise InputError("--resume goes on with the configuration of that run; leave out all flags that change it")
        run = resume_to_folder(resume, input, output, how)
    with held_interrupts():  # the result is whole: what ends the program now must not say that nothing was written
        if json:
            print_json(run.result.report)
        elif not quiet:
            print_summary(run.result, run.path)
        return finish(run, strict)


def _require_folder_name(output: Path) -> None:
    from warpdef.export import FORMATS

    if output.suffix[1:].lower() in FORMATS:
        raise InputError(
            f"--output: expected a folder for the result, got the name of a file, {output.name}; leave {output.suffix} "
            f"out, and then: warpdef export {output.with_suffix('')} {output}"
        )
