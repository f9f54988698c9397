"""From a sequence of point clouds to one mesh that moves: the method in order. The page to read first.

    clouds -> cube -> keyframe and template -> grids, objective, optimiser -> vertices, refined -> input units

Section names are those of *Preconditioned Deformation Grids* (Pacific Graphics 2025).
"""

from __future__ import annotations

import math
import platform
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
import warp as wp

import warpdef
from warpdef.config import Config, parse_slice
from warpdef.errors import WarpdefError
from warpdef.files import read_mesh
from warpdef.fit.optimise import Optimiser
from warpdef.fit.problem import Problem
from warpdef.fit.refine import Refinement
from warpdef.fit.workers import Team, find_device, usable_cores
from warpdef.mesh import TriMesh
from warpdef.progress import Callback, Clock, Interruption, Progress, held_interrupts, peak_memory_mb
from warpdef.result import Reconstruction
from warpdef.sequence import PointSequence, Similarity
from warpdef.template.choose import ChosenTemplate, accept_user_template, choose_template
from warpdef.template.normals import pca_normals

_LOOK_EVERY = 10  # iterations between two looks at the losses: a look waits for the device


def reconstruct(
    sequence: PointSequence | np.ndarray | Sequence[np.ndarray],
    config: Config | None = None,
    *,
    device: str = "auto",
    threads: int | None = None,
    template: TriMesh | None = None,
    callback: Callback | None = None,
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
            state so far is returned, with ``report["interrupted"]`` true.

    Raises:
        InputError: clouds or template are not usable. DeviceError: no such device.
        WarpdefError: the optimisation left the finite numbers.
    """
    config = config or Config()
    tell = callback or (lambda progress: None)
    clock = Clock()
    target = find_device(device)
    if not isinstance(sequence, PointSequence):
        sequence = PointSequence.from_arrays(sequence)
    sequence = sequence.select(parse_slice(config.frames))
    if config.points:
        sequence = sequence.subsample(config.points, config.seed)

    if template is None and config.template.mesh:
        template = read_mesh(Path(config.template.mesh))

    # Implementation Details: the whole sequence is normalised into the cube by one similarity.
    into = Similarity.into_cube(sequence.points, config.fill)
    clouds = [into.to_cube(p) for p in sequence.points]

    # Keyframe Selection: the frame with most surface near the middle, and screened Poisson on it.
    tell(Progress("template"))
    with clock.phase("template"):
        chosen = _template(clouds, sequence, template, into, config)
    for warning in chosen.warnings:
        tell(Progress("template", message=warning))

    # Optimization: one descent for all steps, both directions, and the template.
    tell(Progress("compile"))
    with closing(Team(threads or usable_cores() if target.is_cpu else 1)) as team:
        with clock.phase("compile"):
            normals = _surface_normals(clouds, sequence.normals, config)
            mesh = chosen.mesh
            given = [n is not None for n in sequence.normals]
            problem = Problem(clouds, normals, mesh.vertices, mesh.faces, chosen.keyframe, config, target, given)
            optimiser = Optimiser(problem, config.optimiser.total(len(clouds)), team)
            optimiser.prepare()
            refinement = Refinement(optimiser.objective, team) if config.refine.iterations else None
            if refinement is not None:
                refinement.prepare()
        with held_interrupts() as interruption:
            with clock.phase("optimise"):
                steps = _descend(optimiser, interruption, tell)
                optimiser.finish()
            # Beyond the paper: every vertex of every frame on its own, and one shape for all frames.
            troubles: list[str] = []
            with clock.phase("refine"):
                if refinement is not None and not interruption.asked:
                    troubles = _refine(refinement, interruption, tell)
            interrupted = interruption.asked
        vertices = into.from_cube(optimiser.objective.placed_vertices()).astype(np.float32)

    result = Reconstruction(vertices, mesh.faces, chosen.keyframe, config, steps=steps)
    result.report = _report(sequence, chosen, optimiser, refinement, troubles, steps, interrupted, team.size, clock)
    return result


def _template(
    clouds: list[np.ndarray], sequence: PointSequence, template: TriMesh | None, into: Similarity, config: Config
) -> ChosenTemplate:
    if template is None:
        return choose_template(clouds, sequence.normals, config)
    return accept_user_template(TriMesh(into.to_cube(template.vertices), template.faces), clouds, config)


def _surface_normals(
    clouds: list[np.ndarray], given: Sequence[np.ndarray | None], config: Config
) -> list[np.ndarray] | None:
    """Normals of all points: given ones, else of local planes, whose side is open; None where nothing asks for them."""
    if config.loss.tangential == 1.0 and not config.refine.iterations:
        return None
    neighbours = config.template.neighbours
    return [pca_normals(p, neighbours) if n is None else n for p, n in zip(clouds, given, strict=True)]


def _descend(optimiser: Optimiser, interruption: Interruption, tell: Callback) -> list[dict[str, float]]:
    """All iterations of the grid stage, or those until Ctrl-C; returns the loss curve."""
    steps: list[dict[str, float]] = []
    while optimiser.done < optimiser.iterations and not interruption.asked:
        optimiser.step()
        if optimiser.done % _LOOK_EVERY == 0 or optimiser.done == optimiser.iterations:
            losses = optimiser.look()
            if not math.isfinite(losses["total"]):
                raise WarpdefError(
                    f"the optimisation left the finite numbers by iteration {optimiser.done} (losses {losses}); "
                    "lower optimiser.rate"
                )
            steps.append({"iteration": optimiser.done, **losses})
            tell(Progress("optimise", optimiser.done, optimiser.iterations, losses))
    return steps


def _refine(refinement: Refinement, interruption: Interruption, tell: Callback) -> list[str]:
    """All rounds of the vertex stage, or those until Ctrl-C; what went wrong, in which case the grids' result stays."""
    vertices = refinement.objective.vertices
    before = wp.clone(vertices)
    refinement.start()
    while refinement.done < refinement.config.iterations and not interruption.asked:
        refinement.step()
        refinement.look()
        tell(Progress("refine", refinement.done, refinement.config.iterations))
    if np.isfinite(vertices.numpy()).all():
        return []
    vertices.assign(before)
    return ["the vertex stage left the finite numbers; the result is that of the grids. Raise refine.damping"]


def _report(
    sequence: PointSequence,
    chosen: ChosenTemplate,
    optimiser: Optimiser,
    refinement: Refinement | None,
    troubles: list[str],
    steps: list[dict[str, float]],
    interrupted: bool,
    threads: int,
    clock: Clock,
) -> dict:
    device = optimiser.problem.device
    stages = {"sobolev": optimiser.solves}
    warnings = [*chosen.warnings, *troubles, *optimiser.solves.warning("sobolev.iterations_max")]
    if refinement is not None:
        stages["refine"] = refinement.solves
        warnings += refinement.solves.warning("refine.iterations_max")
    return {
        "versions": {"warpdef": warpdef.__version__, "warp": wp.__version__, "python": platform.python_version()},
        "device": {"name": device.name, "alias": device.alias},
        "threads": threads,
        "frames": len(sequence),
        "points": [len(p) for p in sequence.points],
        "duplicates_merged": int(sum(sequence.merged)),
        "keyframe": chosen.keyframe,
        "keyframe_why": chosen.why,
        "template": {
            "vertices": optimiser.problem.vertex_count,
            **chosen.report.as_dict(),
            "gate": chosen.gate.as_dict(),
        },
        "iterations": optimiser.done,
        "interrupted": interrupted,
        "losses": {key: value for key, value in (steps[-1] if steps else {}).items() if key != "iteration"},
        "refine": None if refinement is None else refinement.as_dict(),
        "solver": {stage: solves.as_dict() for stage, solves in stages.items()},
        "seconds": dict(clock.seconds),
        "peak_memory_mb": round(peak_memory_mb(), 1),
        "warnings": warnings,
    }
