"""What a run says of itself: looks and verdicts for its result, and the contents of ``report.json``."""

from __future__ import annotations

import platform
from typing import Any

import warp as wp

import warpdef
from warpdef.appearance import Appearance
from warpdef.cube_clouds import CubeClouds
from warpdef.device import device_warnings, team_size
from warpdef.errors import MissingPackageError
from warpdef.fit.run import FitRun
from warpdef.geometry.surface_colors import surface_colors
from warpdef.kernel_cache import cache_warnings
from warpdef.mesh import TriMesh
from warpdef.prepare import Prepared
from warpdef.progress import peak_memory_mb
from warpdef.quality.assess import assess
from warpdef.result import Reconstruction
from warpdef.sequence import PointSequence
from warpdef.shortage import device_memory
from warpdef.template.choose import ChosenTemplate

_UNSEEN_TOLD = 0.01


def find_look(
    result: Reconstruction, sequence: PointSequence, template: TriMesh | None
) -> tuple[Appearance | None, dict[str, Any] | None, list[str]]:
    """The template's own colours and image, else those of the clouds; what the report says of these; warnings."""
    own, mode = Appearance() if template is None else template.appearance or Appearance(), result.config.colours
    bare = own if own.arrays() else None
    if mode == "off" or not sequence.colors:
        return bare, None, []
    if own.colors is not None or own.texture is not None:
        return bare, None, ["the colours of the clouds are left behind: the template has its own look"]
    if _nothing_painted(sequence):
        return bare, None, ["all colours of the clouds are black, or all are white: they are taken for none"]
    clouds = sequence.all_frames(), sequence.all_normals(), sequence.all_colors()
    found = surface_colors(result.vertices, result.faces, *clouds, moving=mode == "moving")
    if found is None:
        return bare, None, ["the clouds have colours, but none of their points is near the mesh: it has none"]
    left = f"{found.unseen:.1%} of the vertices are shown by no frame: their colours are those of their neighbours"
    told = {"mode": mode, "frames": sum(c is not None for c in sequence.colors), "unseen": round(found.unseen, 4)}
    look = own.over(Appearance(colors=found.still, frame_colors=found.moving))
    return look, told, [left] if found.unseen >= _UNSEEN_TOLD else []


def _nothing_painted(sequence: PointSequence) -> bool:
    """Whether every colour is the one that a field holds which a sensor or a program never filled."""
    shades = [c for c in sequence.colors if c is not None and len(c)]
    return bool(shades) and any(all((c == blank).all() for c in shades) for blank in (0, 255))


def find_verdicts(
    result: Reconstruction, clouds: CubeClouds, device: wp.Device, threads: int | None = None
) -> dict[str, Any]:
    """What the clouds alone say of the result, for its report; the confidence goes into the result."""
    eye = None if clouds.eye is None else clouds.into.from_cube(clouds.eye)
    placed = result.vertices, result.faces, result.keyframe
    try:
        frames = clouds.measured.judged_frames()
        found = assess(frames, *placed, threads=team_size(device, threads), eye=eye, device=device)
    except MissingPackageError as error:  # no reason to lose a finished fit
        return {"warnings": [f"the frames are not judged: {error}"]}
    result.confidence = found.confidence
    return {**found.as_dict(), "warnings": found.warnings()}


def run_report(ready: Prepared, chosen: ChosenTemplate, run: FitRun, threads: int) -> dict[str, Any]:
    """What was used, chosen and done, plain values; looks, verdicts and costs since then are the caller's to add."""
    sequence = ready.sequence
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
        **run_costs(ready),
        "warnings": warnings,
    }


def run_costs(ready: Prepared) -> dict[str, Any]:
    """Time and memory so far, for a report."""
    return {
        "seconds": dict(ready.clock.seconds),
        "cpu_seconds": dict(ready.clock.cpu_seconds),
        "memory_estimate_mb": round(ready.estimate.total / 2**20, 1),
        "peak_memory_mb": round(peak_memory_mb(), 1),
        "device_memory": device_memory(ready.device),
    }
