"""From a sequence of point clouds to one mesh that moves: the method in order. The page to read first.

    clouds -> cube -> keyframe and template -> grids, objective, optimiser -> vertices, refined -> input units

Section names are those of *Preconditioned Deformation Grids* (Pacific Graphics 2025).
"""

from __future__ import annotations

import platform
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp

import warpdef
from warpdef.appearance import Appearance
from warpdef.cleaning.wide_noise import without_wide_noise
from warpdef.config import Config
from warpdef.device import device_warnings, load_kernels, team_size, usable_cores
from warpdef.errors import MissingPackageError
from warpdef.fit.growing import template_of_all
from warpdef.fit.landmarks import PlacedLandmarks
from warpdef.fit.objective import Objective
from warpdef.fit.optimise import Optimiser
from warpdef.fit.problem import Problem
from warpdef.fit.refine import Refinement
from warpdef.fit.run import FitRun
from warpdef.fit.saving import Saved, Saver, lasting_facts
from warpdef.fit.workers import Team
from warpdef.geometry.cloud_normals import pca_normals
from warpdef.geometry.surface_colors import surface_colors
from warpdef.geometry.viewpoint import camera_place, seen_normals, viewing_direction
from warpdef.kernel_cache import cache_warnings
from warpdef.memory import MemoryEstimate
from warpdef.mesh import MeshSequence, TriMesh, float32_where_exact
from warpdef.motion.gaps import fill_gaps
from warpdef.motion.grid_motion import GridMotion
from warpdef.prepare import Safeguards, prepare
from warpdef.progress import Callback, Clock, Limits, Progress, held_interrupts, peak_memory_mb
from warpdef.quality.assess import assess
from warpdef.result import Reconstruction
from warpdef.sequence import PointSequence, Similarity
from warpdef.shortage import device_memory, explained_shortage, retried
from warpdef.template.build import sheet_note
from warpdef.template.choose import ChosenTemplate, accept_user_template, choose_template

_UNSEEN_TOLD = 0.01
_TORN = 0.25  # share beyond the points: noise of 2 % leaves 0.1 over a body; of an open sheet half and more


def reconstruct(
    sequence: PointSequence | np.ndarray | Sequence[np.ndarray],
    config: Config | None = None,
    *,
    device: str = "auto",
    threads: int | None = None,
    template: TriMesh | None = None,
    callback: Callback | None = None,
    safeguards: Safeguards | None = None,
) -> Reconstruction:
    """Fit one template mesh to every frame.

    Args:
        sequence: the clouds; arrays of shape (T, N, 3) or a list of (N_t, 3) are taken as points without normals.
        config: every number of the method; the default preset if not given.
        device: ``auto``, ``cpu`` or ``cuda:N``.
        threads: CPU threads; all cores of this process if not given. The result does not depend on it.
        template: a mesh of your own for the keyframe, input units, its vertex order kept; if not given, the file
            ``config.template.mesh``; if that is empty, a mesh is reconstructed.
        callback: called with a ``Progress`` now and then. Ctrl-C during the optimisation ends it early: the best
            state so far is returned, with ``report["interrupted"]`` true and ``report["stopped"]`` saying why. So
            do SIGTERM and SIGHUP where the program handles them; ``report["signal"]`` is the signal's name.
        safeguards: checkpoints, a run to go on from, limits of time and memory; if not given, only what is free of
            memory is looked at.

    Raises:
        InputError: clouds, template or checkpoint are not usable, or the run does not fit into memory.
        DeviceError: no such device, or its memory ran out.
        WarpdefError: the optimisation left the finite numbers at any rate.
    """
    safeguards = safeguards or Safeguards()
    ready = prepare(sequence=sequence, config=config, template=template, device=device, safeguards=safeguards)
    sequence, template, config = ready.sequence, ready.template, ready.config
    saved, target, estimate, clock = ready.saved, ready.device, ready.estimate, ready.clock
    tell = callback or (lambda progress: None)

    # Implementation Details: the whole sequence is normalised into the cube by one similarity.
    into = Similarity.into_cube(sequence.points, config.fill)

    def in_cube() -> list[np.ndarray]:  # made anew where it is asked for: it need not stay
        return [into.to_cube(p) for p in sequence.points]

    # Keyframe Selection: the frame with most surface near the middle, and screened Poisson on it.
    tell(Progress("template"))
    with clock.phase("template"), explained_shortage(estimate, target):
        view = viewing_direction(in_cube()) if any(n is None for n in sequence.normals) else None
        eye = None if view is None else camera_place(in_cube(), view)
        scattered, calm = None, sequence
        if view is None and not config.optimiser.chain:
            scattered, calm = without_wide_noise(sequence, into, config.template.neighbours)
        judged = config if scattered is None else _torn_by_noise(config)
        chosen = _template(calm, template, into, judged, saved, view)
    for warning in (*sequence.warnings, *chosen.warnings):
        tell(Progress("template", message=warning))

    landmarks = None
    if ready.landmarks is not None:
        shape, mine = chosen.mesh, template is not None or bool(config.template.mesh)
        landmarks = PlacedLandmarks(
            ready.landmarks, shape.vertices, shape.faces, sequence, into, mine, keyframe=chosen.keyframe
        )

    # Optimization: one descent for all steps, both directions, and the template.
    def fit(config: Config, told: list[str]) -> Reconstruction:
        tell(Progress("compile", message=told[-1] if told else ""))
        with closing(Team(team_size(target, threads))) as team, explained_shortage(estimate, target):
            with clock.phase("compile"):
                clouds, mesh = [into.to_cube(p) for p in calm.points], chosen.mesh
                normals = _surface_normals(clouds, calm.normals, config, view, target)
                given = [n is not None or view is not None for n in calm.normals]
                keyframe = sequence.numbers.index(chosen.keyframe)
                steady = replace(config, optimiser=config.optimiser.for_length(len(clouds)))
                if sequence.order:  # no film
                    steady = replace(steady, refine=replace(steady.refine, time=0.0))
                ends = mesh.vertices, mesh.faces, keyframe
                times = sequence.times or range(sequence.frame_count)
                times = None if sequence.order else [times[number] for number in sequence.numbers]
                problem = Problem(clouds, normals, *ends, steady, target, given, eye, times, scattered)
                optimiser = Optimiser(problem, config.optimiser.total(len(clouds)), team)
                del clouds, normals
                refinement = (
                    Refinement(optimiser.objective, team, landmarks=landmarks) if config.refine.iterations else None
                )
                stages = [stage for stage in (optimiser, refinement) if stage is not None]
                load_kernels([kernel for stage in stages for kernel in stage.kernels()], target)
                for stage in stages:
                    stage.prepare()
            with held_interrupts() as interruption:
                resumed = [*saved.facts["resumed"], saved.iteration] if saved is not None else []
                facts = lasting_facts(sequence, config, chosen, safeguards.notes, resumed, ready.landmarks)
                saver = Saver(safeguards.checkpoint, safeguards.checkpoint_seconds, facts, chosen, clock)
                show = _with_meshes(tell, optimiser.objective, mesh.faces, into, sequence)
                limits = Limits(interruption, clock, safeguards.seconds_max)
                starts = None if chosen.placed is None else chosen.placed[list(sequence.numbers)]
                run = FitRun(optimiser, refinement, team.size, limits, saver, show, starts)
                run.warnings += told
                if saved is not None:
                    run.restore(saved)
                with clock.phase("optimise"):
                    run.descend()
                # Beyond the paper: every vertex of every frame on its own, and one shape for all frames.
                with clock.phase("refine"):
                    run.refine()
                vertices = optimiser.objective.placed_vertices()
                led = None if landmarks is None else landmarks.as_dict(vertices, into.scale)
                run.warnings += [] if landmarks is None else landmarks.warnings(vertices)
                vertices = fill_gaps(vertices, sequence.numbers, sequence.frame_count, mesh.faces, sequence.times)
                vertices = float32_where_exact(into.from_cube(vertices))

                levels = (config.grid.coarsest, config.grid.levels)
                nodes = optimiser.nodes.numpy()
                motion = GridMotion.from_nodes(
                    nodes, levels, chosen.keyframe, into, sequence.numbers, sequence.frame_count
                )

                result = Reconstruction(vertices, mesh.faces, chosen.keyframe, config, steps=run.steps, motion=motion)
                with clock.phase("assess"):
                    result.appearance, colored, left = _look(result, sequence, template)
                    judged = _assess(
                        result, sequence, threads or usable_cores(), None if eye is None else into.from_cube(eye)
                    )
                result.report = _report(sequence, chosen, run, team.size, clock, estimate)
                result.report["warnings"] += left + judged.pop("warnings")
                result.report |= {"colours": colored, "landmarks": led}
                ended = interruption.signal if run.stopped and interruption.asked else None
                result.report |= {"interrupted": ended is not None, "signal": ended, "resumed": resumed, **judged}
                result.report["input"] = {"path": safeguards.notes.get("input", ""), "digests": facts["digests"]}
        return result

    sizes = [len(p) for p in sequence.points]
    return fit(config, []) if saved is not None else retried(fit, config, sizes, estimate, target)


def _torn_by_noise(config: Config) -> Config:
    """For templates of noisy clouds: these leave holes over a closed body, which are no borders."""
    far = max(config.template.far_share_max, _TORN)
    return replace(config, template=replace(config.template, far_share_max=far))


def _template(
    sequence: PointSequence,
    template: TriMesh | None,
    into: Similarity,
    config: Config,
    saved: Saved | None,
    view: np.ndarray | None,
) -> ChosenTemplate:
    mine, notes = None, ()
    if template is not None:
        mine = TriMesh(into.to_cube(template.vertices), template.faces)
        notes = template.appearance.notes if template.appearance else ()
    if saved is not None:
        return saved.template(None if config.template.align else mine, sequence.numbers)  # that is where it was put
    # Frames are numbered as in the input: one without usable points is an empty cloud.
    clouds = [into.to_cube(p) for p in sequence.all_frames()]
    if mine is None:
        return _own_template(clouds, sequence, config, view)
    chosen = accept_user_template(mine, clouds, config)
    return replace(chosen, warnings=[*notes, *chosen.warnings])


def _own_template(
    clouds: list[np.ndarray], sequence: PointSequence, config: Config, view: np.ndarray | None
) -> ChosenTemplate:
    """Of all frames, where one camera saw a body that turns; else of the best keyframe."""
    normals, note = sequence.all_normals(), ""
    if view is not None and config.template.grow and not sequence.order:
        neighbours = config.template.neighbours
        sides = [
            n if n is not None else seen_normals(p, view, neighbours) if len(p) else p
            for p, n in zip(clouds, normals, strict=True)
        ]
        chosen, note = template_of_all(clouds, sides, config, view)
        if chosen is not None:
            return chosen
    chosen = choose_template(clouds, normals, config, view, sequence.places)
    if not note:
        return replace(chosen, why=f"{chosen.why}{sheet_note(chosen.report)}")
    ends = "the mesh is a sheet of what is seen" if chosen.report.surface == "open" else "its far side is a guess"
    return replace(chosen, warnings=[f"{note}; {ends}", *chosen.warnings])


def _with_meshes(
    tell: Callback, objective: Objective, faces: np.ndarray, into: Similarity, sequence: PointSequence
) -> Callback:
    """Messages that can hand out the mesh as the last iteration had it."""

    def meshes() -> MeshSequence:
        vertices = fill_gaps(objective.placed_vertices(), sequence.numbers, sequence.frame_count)
        # In single precision throughout: the optimiser waits.
        return MeshSequence(vertices / np.float32(into.scale) + into.centre.astype(np.float32), faces)

    return lambda progress: tell(replace(progress, meshes=meshes))


def _surface_normals(
    clouds: list[np.ndarray],
    given: Sequence[np.ndarray | None],
    config: Config,
    view: np.ndarray | None,
    device: wp.Device,
) -> list[np.ndarray] | None:
    """Normals of all points: given ones, else of local planes, whose side is open but where all were seen from one
    direction; None where nothing asks for them."""
    if config.loss.tangential == 1.0 and not config.refine.iterations:
        return None
    neighbours = config.template.neighbours
    if view is not None:
        return [
            seen_normals(p, view, neighbours, device) if n is None else n for p, n in zip(clouds, given, strict=True)
        ]
    return [pca_normals(p, neighbours, device) if n is None else n for p, n in zip(clouds, given, strict=True)]


def _look(
    result: Reconstruction, sequence: PointSequence, template: TriMesh | None
) -> tuple[Appearance | None, dict[str, Any] | None, list[str]]:
    """The template's own colours and image, else those of the clouds; what the report says of these; warnings."""
    own, mode = Appearance() if template is None else template.appearance or Appearance(), result.config.colours
    bare = own if own.arrays() else None
    if mode == "off" or not sequence.colors:
        return bare, None, []
    if own.colors is not None or own.texture is not None:
        return bare, None, ["the colours of the clouds are left behind: the template has its own look"]
    clouds = sequence.all_frames(), sequence.all_normals(), sequence.all_colors()
    found = surface_colors(result.vertices, result.faces, *clouds, moving=mode == "moving")
    if found is None:
        return bare, None, ["the clouds have colours, but none of their points is near the mesh: it has none"]
    left = f"{found.unseen:.1%} of the vertices are shown by no frame: their colours are those of their neighbours"
    told = {"mode": mode, "frames": sum(c is not None for c in sequence.colors), "unseen": round(found.unseen, 4)}
    look = own.over(Appearance(colors=found.still, frame_colors=found.moving))
    return look, told, [left] if found.unseen >= _UNSEEN_TOLD else []


def _assess(result: Reconstruction, sequence: PointSequence, threads: int, eye: np.ndarray | None) -> dict:
    """What the clouds alone say of the result, for its report; the confidence goes into the result."""
    try:
        placed = result.vertices, result.faces, result.keyframe
        found = assess(sequence.judged_frames(), *placed, threads=threads, eye=eye)
    except MissingPackageError as error:  # no reason to lose a finished fit
        return {"warnings": [f"the frames are not judged: {error}"]}
    result.confidence = found.confidence
    return {**found.as_dict(), "warnings": found.warnings()}


def _report(
    sequence: PointSequence, chosen: ChosenTemplate, run: FitRun, threads: int, clock: Clock, estimate: MemoryEstimate
) -> dict:
    optimiser, refinement = run.optimiser, run.refinement
    device = optimiser.problem.device
    stages, vertex_stage = {"sobolev": optimiser.solves}, None
    warnings = [*cache_warnings(), *device_warnings(), *sequence.warnings, *chosen.warnings, *run.warnings]
    warnings += optimiser.solves.warning("sobolev.iterations_max")
    if refinement is not None:
        stages["refine"] = refinement.solves
        warnings += refinement.solves.warning("refine.iterations_max")
        recovered, followed = (
            [sequence.numbers[t] for t in found]
            for found in (sorted({*refinement.frames_recovered, *run.bent}), run.followed)
        )
        vertex_stage = {**refinement.as_dict(), "frames_recovered": recovered, "frames_followed": followed}
    return {
        "versions": {"warpdef": warpdef.__version__, "warp": wp.__version__, "python": platform.python_version()},
        "device": {"name": device.name, "alias": device.alias},
        "threads": threads,
        "frames": sequence.frame_count,
        "frames_missing": [gap.number for gap in sequence.gaps],
        "points": [len(p) for p in sequence.all_frames()],
        "columns": sequence.columns or None,
        "duplicates_merged": int(sum(sequence.merged)),
        "points_dropped": int(sum(sequence.dropped)),
        "keyframe": chosen.keyframe,
        "keyframe_why": chosen.why,
        "template": {
            "vertices": optimiser.problem.vertex_count,
            **chosen.report.as_dict(),
            "gate": chosen.gate.as_dict(),
        },
        "iterations": optimiser.done,
        "stopped": run.stopped or None,
        "losses": {key: value for key, value in (run.steps[-1] if run.steps else {}).items() if key != "iteration"},
        "refine": vertex_stage,
        "solver": {stage: solves.as_dict() for stage, solves in stages.items()},
        "seconds": dict(clock.seconds),
        "cpu_seconds": dict(clock.cpu_seconds),
        "memory_estimate_mb": round(estimate.total / 2**20, 1),
        "peak_memory_mb": round(peak_memory_mb(), 1),
        "device_memory": device_memory(device),
        "warnings": warnings,
    }
