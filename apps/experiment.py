"""``warpdef experiment``: a whole table by one command, the paper's or our own, here or on a cluster."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, get_args

from cyclopts import Parameter
from cyclopts.validators import Number

from warpdef.apps.config_flags import ConfigFlags, resolve_config
from warpdef.apps.console import clean_stdout, print_json, say
from warpdef.apps.exit_codes import EXIT_ERROR, EXIT_OK
from warpdef.apps.signals import exit_code
from warpdef.errors import InputError

if TYPE_CHECKING:
    from warpdef.apps.experiments.plan import Builder, Experiment, Plan
    from warpdef.config import Config

Name = Literal[
    "main", "length", "resolution", "noise", "components", "levels", "initialization", "accuracy", "ideas", "long"
]
NAMES: tuple[str, ...] = get_args(Name)


def experiment(
    name: Name,
    /,
    *,
    data: Path | None = None,
    output: Annotated[Path, Parameter(alias="-o")],
    only: Annotated[tuple[str, ...], Parameter(negative="", consume_multiple=False)] = (),
    rows: Annotated[tuple[str, ...], Parameter(negative="", consume_multiple=False)] = (),
    quick: Annotated[bool, Parameter(negative="")] = False,
    samples: Annotated[int | None, Parameter(validator=Number(gte=1))] = None,
    preset: Literal["default", "paper"] = "default",
    config: Path | None = None,
    meshes: Path | None = None,
    workers: Literal["here", "dask"] = "here",
    cluster: str = "",
    worker_count: Annotated[int | None, Parameter(validator=Number(gte=1))] = None,
    device: str = "auto",
    threads: Annotated[int | None, Parameter(validator=Number(gte=1))] = None,
    keep: Annotated[bool, Parameter(negative="")] = False,
    again: Annotated[bool, Parameter(negative="")] = False,
    plot: bool = True,
    json: Annotated[bool, Parameter(negative="")] = False,
    flags: ConfigFlags | None = None,
) -> int:
    """Run an experiment: a table with published rows beside ours, as NAME.csv, .json, .md and .png.

    Of the paper: main, length, resolution, noise, components, levels, initialization. Our own: accuracy (targets),
    ideas (each idea of the configuration switched off), long (what many frames cost). Every finished run is kept, so
    the same command goes on where it was ended.

    Args:
        name: Which table.
        data: Folder with true sequences, see warpdef datasets; the built-in figure if not given.
        output: Folder for the tables, and for finished runs, which all experiments there share.
        only: Only sequences whose name contains this; may be given again.
        rows: Only the first row, which the others are judged by, and rows whose name contains this; may be given again.
        quick: A few frames, points and iterations, to see that everything runs.
        samples: Samples on each surface in the comparison; the paper's 100000 if not given.
        preset: Values to start from, as for warpdef reconstruct; settings of the experiment win over all others.
        config: TOML file whose values replace the preset's.
        meshes: For initialization: folder with meshes from outside, SEQUENCE_first.ply, _middle, _auto or SEQUENCE.ply.
        workers: here: one run after the other; dask: over a Dask cluster, runs of a worker that dies done again.
        cluster: Address of a running Dask scheduler, as tcp://host:8786; workers on this machine if not given.
        worker_count: Workers on this machine; one a GPU, or one for every two cores (or --threads) if not given.
        device: auto, cpu, cuda or cuda:N; with --workers dask, auto and cuda are all GPUs, a worker each.
        threads: CPU threads of a run; all, or a worker's share, if not given.
        keep: Keep the reconstructions too, as run folders under OUTPUT/meshes.
        again: Do finished runs again.
        plot: Draw NAME.png.
        json: Print NAME.json on standard output, and nothing else there.
    """
    from warpdef.apps.experiments import session
    from warpdef.apps.experiments.plot import plot as draw
    from warpdef.apps.experiments.plot import require_plotting
    from warpdef.apps.experiments.report import write_report
    from warpdef.apps.experiments.store import Store

    if plot:
        require_plotting()
    if workers == "here" and (cluster or worker_count):
        raise InputError("--cluster and --worker-count: expected --workers dask beside them; add it")
    kept = output / "meshes" if keep else None
    with clean_stdout():
        settings = resolve_config(preset, config, flags)
        table = _with_rows(_builder(name)(_plan(data, only, quick, samples, settings, meshes, flags)), rows)
        table = replace(table, notes=(*table.notes, *_about(preset, settings, quick)))
        if workers == "dask" and any(run.fresh for run in table.runs()):
            raise InputError(
                f"--workers dask: {name} measures the memory of single processes; run it without, on a quiet machine"
            )
        store = Store(output)
        if workers == "dask":
            from warpdef.apps.experiments.cluster import on_cluster

            executor = on_cluster(cluster, device, threads, worker_count, kept)
        else:
            executor = session.here(device, threads, kept)
        command = _command()
        try:
            outcome = session.run_experiment(
                table,
                store,
                executor,
                again=again,
                say=say,
                after_each=lambda outcome: write_report(table, outcome, output, command),
            )
        except KeyboardInterrupt as ended:
            say(f"warpdef: interrupted: finished runs are kept in {output}; the same command goes on from there")
            return exit_code(ended)
        written = write_report(table, outcome, output, command)
        if plot and written:
            draw(table, written, output / f"{name}.png")
    _show(output, name, json)
    for failure in outcome.failures.values():
        say(f"warpdef: error: {failure}")
    return EXIT_ERROR if outcome.failures else EXIT_OK


def _builder(name: str) -> Builder:
    from warpdef.apps.experiments import own_experiments, paper_experiments

    return getattr(own_experiments if hasattr(own_experiments, name) else paper_experiments, name)


def _plan(
    data: Path | None,
    only: tuple[str, ...],
    quick: bool,
    samples: int | None,
    config: Config,
    meshes: Path | None,
    flags: ConfigFlags | None,
) -> Plan:
    from warpdef.apps.experiments.plan import FULL, QUICK, QUICK_ITERATIONS, QUICK_ROUNDS, Plan
    from warpdef.apps.experiments.run import Figure, with_values

    size = QUICK if quick else FULL
    # Points and frames are those of the clouds to be sampled; nothing is left for the reconstruction to choose.
    size = replace(size, points=config.points or size.points, samples=samples or size.samples)
    frames = config.frames
    config = replace(config, points=0, frames="")
    if quick:
        given = getattr(flags, "optimiser__iterations", None)
        few = {"optimiser.iterations": given or QUICK_ITERATIONS, "optimiser.warmup": min(2, config.optimiser.warmup)}
        few |= {"optimiser.iterations_per_frame": 0.0}
        few |= {"refine.iterations": min(QUICK_ROUNDS, config.refine.iterations)}
        config = with_values(config, few)
    if data is None:
        sequences = [Figure(max(size.frames, *size.lengths))]
    else:
        from warpdef.datasets import find_sequences

        sequences = find_sequences(data)
    chosen = tuple(s for s in sequences if not only or any(part in s.name for part in only))
    if not chosen:
        names = ", ".join(s.name for s in sequences)
        raise InputError(f"--only: expected part of a sequence's name ({names:.200}), got {', '.join(only)}")
    return Plan(chosen, config, size, frames, meshes, data if data is not None and data.is_dir() else None)


def _with_rows(table: Experiment, parts: tuple[str, ...]) -> Experiment:
    """The table with its first row and those whose name contains one of ``parts``; all of it where none is given."""
    if not parts:
        return table
    for part in parts:
        if not any(part in setting.name for setting in table.settings):
            names = ", ".join(setting.name for setting in table.settings)
            raise InputError(f"--rows: expected part of a row's name ({names:.400}), got {part}")
    first, *others = table.settings
    kept = (first, *(s for s in others if any(part in s.name for part in parts)))
    return replace(table, settings=kept, notes=(*table.notes, f"{len(kept)} of {1 + len(others)} rows."))


def _about(preset_name: str, config: Config, quick: bool) -> list[str]:
    """What a reader must know to judge the figures: the configuration, and that a quick run shows nothing."""
    from warpdef.apps.config_flags import entries
    from warpdef.apps.experiments.run import value_of
    from warpdef.presets import preset

    base = preset(preset_name)
    pairs = [(e.key, value_of(config, e.key), value_of(base, e.key)) for e in entries()]
    changed = [f"{key} = {now} (preset: {usual})" for key, now, usual in pairs if now != usual]
    notes = [f"Preset {preset_name}" + (f", but {', '.join(changed)}." if changed else ".")]
    if quick:
        notes.append("A quick run: it shows that everything works; its figures say nothing about quality.")
    return notes


def _command() -> str:
    import shlex

    return shlex.join(["warpdef", *sys.argv[1:]])


def _show(output: Path, name: str, json: bool) -> None:
    import json as parser

    if json:
        print_json(parser.loads((output / f"{name}.json").read_text(encoding="utf-8")))
    else:
        print((output / f"{name}.md").read_text(encoding="utf-8"), end="")
        print(f"\nTables: {output / name}.csv, .json, .md")
