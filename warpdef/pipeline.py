"""From a sequence of point clouds to one mesh that moves: the method in order. The page to read first.

    clouds -> cube -> keyframe and template -> grids, objective, optimiser -> vertices, refined -> input units

Section names are those of *Preconditioned Deformation Grids* (Pacific Graphics 2025).
"""

from __future__ import annotations

import gc
import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from warpdef.cleaning.wide_noise import noise_note
from warpdef.config import Config
from warpdef.cube_clouds import CubeClouds
from warpdef.device import load_kernels, team_size
from warpdef.errors import OutOfMemory
from warpdef.fit.gathering import gathered_template, gathers, keep_doubts, may_gather, told_of_few_points, why_worse
from warpdef.fit.landmarks import PlacedLandmarks
from warpdef.fit.objective import Objective
from warpdef.fit.optimise import Optimiser
from warpdef.fit.problem import Problem
from warpdef.fit.refine import Refinement
from warpdef.fit.run import FitRun, Fitted
from warpdef.fit.saving import Saver, lasting_facts
from warpdef.fit.workers import Team
from warpdef.geometry.closest import closest_kernels
from warpdef.mesh import MeshSequence, TriMesh, float32_where_exact
from warpdef.motion.gaps import fill_gaps
from warpdef.motion.grid_motion import GridMotion
from warpdef.prepare import Prepared, Safeguards, prepare
from warpdef.progress import Callback, Interruption, Limits, Progress, held_interrupts
from warpdef.reports import find_look, find_verdicts, run_costs, run_report
from warpdef.result import Reconstruction
from warpdef.sequence import PointSequence
from warpdef.shortage import explained_shortage, retried
from warpdef.starting_template import find_template
from warpdef.template.choose import ChosenTemplate

FIRST_WITHIN = 0.45  # of a time limit, for the first of two fits: the second takes as long


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
        threads: CPU threads; all cores of this process if not given. The result does not depend on it. BLAS has its
            own, of no use here: ``OPENBLAS_NUM_THREADS=1`` before NumPy is imported, as the command does, saves them.
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
    tell = callback or (lambda progress: None)

    # Keyframe Selection: the frame with most surface near the middle, and screened Poisson on it.
    tell(Progress("template"))
    with ready.clock.phase("template"), explained_shortage(ready.estimate, ready.device):
        clouds = CubeClouds.of(ready.sequence, ready.config)
        chosen = find_template(clouds, ready.template, ready.config, ready.saved)
    noisy = () if clouds.noise is None else (noise_note(clouds.noise),)
    for warning in (*ready.sequence.warnings, *noisy, *chosen.warnings):
        tell(Progress("template", message=warning))

    # Optimization: one descent for all transitions and the template; begun again where memory runs out.
    run = _Run(ready, safeguards, clouds, chosen, _landmarks(ready, clouds, chosen), threads, tell)
    sizes = [len(p) for p in ready.sequence.points]
    if ready.saved is not None:
        result = run.fit(ready.config, [])
    else:
        result = retried(run.fit, ready.config, sizes, ready.estimate, ready.device)
    return _made_again(run, result) if run.gathers else result


def _landmarks(ready: Prepared, clouds: CubeClouds, chosen: ChosenTemplate) -> PlacedLandmarks | None:
    """Correspondences that the user knows, on the template."""
    if ready.landmarks is None:
        return None
    shape, mine = chosen.mesh, ready.template is not None or bool(ready.config.template.mesh)
    placed = shape.vertices, shape.faces, ready.sequence, clouds.into
    return PlacedLandmarks(ready.landmarks, *placed, mine, keyframe=chosen.keyframe)


@dataclass(frozen=True)
class _Run:
    """What a fit begins with, whatever its configuration; ``again``: of the points of all frames, a second time."""

    ready: Prepared
    safeguards: Safeguards
    clouds: CubeClouds
    chosen: ChosenTemplate
    landmarks: PlacedLandmarks | None
    threads: int | None
    tell: Callback
    again: bool = False

    @property
    def gathers(self) -> bool:
        """Whether a template of all frames may be made of what comes out (``fit.gathering``)."""
        ready, sizes = self.ready, [len(p) for p in self.ready.sequence.points]
        fit_for_it = self.clouds.view is None and self.clouds.scattered is None and not self.again
        return fit_for_it and may_gather(sizes, ready.config) and gathers(self.chosen, ready.config)

    def fit(self, config: Config, told: list[str]) -> Reconstruction:
        """The fit, and its result in input units; ``told``: what was changed since it was tried before."""
        ready, clock = self.ready, self.ready.clock
        self.tell(Progress("compile", message=told[-1] if told else ""))
        with (
            closing(Team(team_size(ready.device, self.threads))) as team,
            explained_shortage(ready.estimate, ready.device),
        ):
            with clock.phase("compile"):
                optimiser = Optimiser(self._problem(config), config.optimiser.total(len(ready.sequence.points)), team)
                refinement = None
                if config.refine.iterations:
                    refinement = Refinement(optimiser.objective, team, landmarks=self.landmarks)
                _compile(optimiser, refinement)
            with held_interrupts() as interruption:
                run = self._fit_run(optimiser, refinement, config, team, interruption)
                run.warnings += told
                if ready.saved is not None:
                    run.restore(ready.saved)
                with clock.phase("optimise"):
                    run.descend()
                # Beyond the paper: every vertex of every frame on its own, and one shape for all frames.
                with clock.phase("refine"):
                    run.refine()
                if self.gathers and not run.stopped:
                    run.keep()  # what it goes on from if it is cut short in the second
                fitted, report = run.fitted(), run_report(ready, self.chosen, run, team.size)
                # Judging takes as much again a frame; the fit's arrays hold on to one another.
                del run, optimiser, refinement
                gc.collect()
                result = self._result(fitted, report, config)
                ended = interruption.signal if fitted.stopped and interruption.asked else None
                result.report |= {"interrupted": ended is not None, "signal": ended}
        return result

    def _problem(self, config: Config) -> Problem:
        """Clouds, template and configuration laid out on the device."""
        ready, clouds, chosen, sequence = self.ready, self.clouds, self.chosen, self.ready.sequence
        points = clouds.points()
        steady = replace(config, optimiser=config.optimiser.for_length(len(points)))
        times = None
        if sequence.order:  # no film
            steady = replace(steady, refine=replace(steady.refine, time=0.0))
        else:
            times = sequence.times or range(sequence.frame_count)
            times = [times[number] for number in sequence.numbers]
        return Problem(
            points,
            clouds.normals(points, config, ready.device),
            chosen.mesh.vertices,
            chosen.mesh.faces,
            keyframe=sequence.numbers.index(chosen.keyframe),
            config=steady,
            device=ready.device,
            oriented=clouds.oriented(),
            eye=clouds.eye,
            times=times,
            scattered=clouds.scattered,
        )

    @property
    def _resumed(self) -> list[int]:
        """Iterations at which this run was taken up again."""
        saved = self.ready.saved
        return [] if saved is None else [*saved.facts["resumed"], saved.iteration]

    def _fit_run(
        self,
        optimiser: Optimiser,
        refinement: Refinement | None,
        config: Config,
        team: Team,
        interruption: Interruption,
    ) -> FitRun:
        ready, safe, sequence = self.ready, self.safeguards, self.ready.sequence
        facts = lasting_facts(sequence, config, self.chosen, safe.notes, self._resumed, ready.landmarks)
        saver = Saver(safe.checkpoint, safe.checkpoint_seconds, facts, self.chosen, ready.clock)
        limits = Limits(interruption, ready.clock, safe.seconds_max)
        starts = None if self.chosen.placed is None else self.chosen.placed[list(sequence.numbers)]
        meshes = partial(self._meshes_now, optimiser.objective)
        return FitRun(
            optimiser,
            refinement,
            team.size,
            limits,
            saver,
            tell=lambda progress: self.tell(replace(progress, meshes=meshes)),
            starts=starts,
        )

    def _meshes_now(self, objective: Objective) -> MeshSequence:
        """The meshes as the last iteration had them, in single precision throughout: the optimiser waits."""
        sequence, into = self.ready.sequence, self.clouds.into
        vertices = fill_gaps(objective.placed_vertices(), sequence.numbers, sequence.frame_count)
        return MeshSequence(vertices / np.float32(into.scale) + into.centre.astype(np.float32), self.chosen.mesh.faces)

    def _result(self, fitted: Fitted, report: dict[str, Any], config: Config) -> Reconstruction:
        """Meshes and motion in input units, with missing frames filled in, judged; and the report of the run."""
        ready, into, sequence, chosen = self.ready, self.clouds.into, self.ready.sequence, self.chosen
        vertices, faces = fitted.vertices, chosen.mesh.faces
        led = None
        if self.landmarks is not None:
            led = self.landmarks.as_dict(vertices, into.scale)
            report["warnings"] += self.landmarks.warnings(vertices)
        vertices = fill_gaps(vertices, sequence.numbers, sequence.frame_count, faces, sequence.times)
        vertices = float32_where_exact(into.from_cube(vertices))
        levels = (config.grid.coarsest, config.grid.levels)
        placed = into, sequence.numbers, sequence.frame_count
        motion = GridMotion.from_nodes(fitted.nodes, levels, chosen.keyframe, *placed)

        result = Reconstruction(vertices, faces, chosen.keyframe, config, report, fitted.steps, motion)
        with ready.clock.phase("assess"):
            result.appearance, colored, left = find_look(result, sequence, ready.template)
            verdicts = find_verdicts(result, self.clouds, ready.device, self.threads)
        noise = self.clouds.noise
        report["warnings"] += left + verdicts.pop("warnings") + ([] if noise is None else [noise_note(noise)])
        report["noise"] = noise
        report |= {"colours": colored, "landmarks": led, "resumed": self._resumed, **verdicts, **run_costs(ready)}
        report["input"] = {"path": self.safeguards.notes.get("input", ""), "digests": fitted.digests}
        return result


def _made_again(run: _Run, first: Reconstruction) -> Reconstruction:
    """What comes of a template of all frames' points, gathered by the first fit, where that is the better result."""
    ready, clock, limit = run.ready, run.ready.clock, run.safeguards.seconds_max
    if first.report["stopped"]:
        return told_of_few_points(first, "the run was ended before")
    if limit is not None and time.perf_counter() - clock.begun > FIRST_WITHIN * limit:
        return told_of_few_points(first, "no time was left to try")
    run.tell(Progress("template", message="sparse frames: made again of the points of all, by the motion found"))
    with clock.phase("template"), explained_shortage(ready.estimate, ready.device):
        clouds = run.clouds.calm.all_frames()
        again, why = gathered_template(run.chosen, first, clouds, run.clouds.into, first.config)
    if again is None:
        return told_of_few_points(first, why, clock)
    # The checkpoint stays where the first fit ended: cut short, a run goes on from there.
    anew = replace(
        run,
        ready=replace(ready, saved=None),
        safeguards=replace(run.safeguards, checkpoint=None),
        chosen=again,
        landmarks=_landmarks(ready, run.clouds, again),
        tell=lambda progress: run.tell(replace(progress, meshes=None)),  # who shows them counts on the same faces
        again=True,
    )
    try:
        second = anew.fit(first.config, [])
    except OutOfMemory as error:
        return told_of_few_points(first, str(error), clock)
    if second.report["stopped"]:
        first.report |= {key: second.report[key] for key in ("stopped", "interrupted", "signal")}
        return told_of_few_points(first, "the run was ended before", clock)
    second.report["resumed"] = first.report["resumed"]
    with clock.phase("assess"):
        worse = why_worse(first, second, clouds)
    if worse:
        return told_of_few_points(first, worse, clock)
    keep_doubts(first, second)
    return told_of_few_points(second, "", clock)


def _compile(optimiser: Optimiser, refinement: Refinement | None) -> None:
    """All kernels of both stages and of the verdicts at once, then their commands."""
    stages = [stage for stage in (optimiser, refinement) if stage is not None]
    kernels = [kernel for stage in stages for kernel in stage.kernels()]
    load_kernels([*kernels, *closest_kernels()], optimiser.problem.device)
    for stage in stages:
        stage.prepare()
