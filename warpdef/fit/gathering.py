"""The template made again of the points of all frames, where those of a frame are too few to tell a body's shape.

Some 600 points a frame are as far apart as limbs are thin: sides of estimated normals are mistaken there, Poisson
balloons, what it balloons is cut off, and a closed body is called open. But how it moves a rough mesh tells well: a
first fit done, the points of all frames are taken back to the keyframe with the surface that they lie on (to 0.2 % of
the extent from the true one), where together they are a dense cloud. The template of that is fitted once more, and
taken only if it then lies nearer to the clouds: what a first fit mistook, as limbs that became one, it may not mend.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from warpdef.config import Config
from warpdef.errors import InputError
from warpdef.geometry.closest import closest_on_surface
from warpdef.geometry.cloud_normals import SPARSE, estimate_normals
from warpdef.geometry.sampling import mean_spacing, sample_surface
from warpdef.motion.attach import attach
from warpdef.motion.rotations import blend, inverse, local_rotations, turn
from warpdef.progress import Clock
from warpdef.quality.verdict import DOUBTFUL, GOOD
from warpdef.result import Moving, Reconstruction
from warpdef.sequence import Similarity, name_frames
from warpdef.template.build import depth_by_spacing, draft
from warpdef.template.choose import ChosenTemplate
from warpdef.template.poisson import load_backend
from warpdef.template.quality import judge

GATHERED = 12_000  # points at most, of the frames nearest to the keyframe: what comes from far has strayed more
LEAST_GAIN = 3.0  # times the points of the keyframe, at least: less would say little more
EXPLAINED = 3.0  # spacings of a point from the first mesh, up to which it goes back with it
INVERTED, ARRIVED = 20, 0.5  # steps of inverting the grids' motion, and spacings from its aim within which it is there
AMONG = 3.0  # spacings from the keyframe's own points, within which one taken back lies among them: its widest gap
OPEN_FROM = 0.1
"""Area beyond the points, over what is kept, from which these make an open surface: they have strayed a little, and
leave up to 0.08 of a closed body bare; the upper half of a person's has 0.10 to 0.14."""
SHEET = 0.5  # and from which it clearly is one; bodies of 600 points that are called open have 0.05 to 0.5
KNOWN_LEAST = 0.9  # share of the points that do: below, the first fit is no guide
TRIED_COARSER = 1  # levels of the octree tried beyond the first
DEPTH_LEAST = 3  # the coarsest that there is
HANDLES_MORE = 3  # than the first had: what limbs that touch there give, and the second fit is to be judged by
SAMPLES = 4_000  # of a mesh in a frame, that are held against its points


def may_gather(points: Sequence[int], config: Config) -> bool:
    """Whether frames of so many points are so sparse, and so many, that a template of all of them may pay."""
    filled = [n for n in points if n]
    if not config.template.gather or config.optimiser.chain or not config.refine.iterations or not filled:
        return False
    usual = float(np.median(filled))
    return usual <= SPARSE and sum(filled) >= LEAST_GAIN * usual


def gathers(chosen: ChosenTemplate, config: Config) -> bool:
    """Whether a template leaves something to gain: its normals are guesses, or it was found to be open."""
    asked = config.template.surface != "open" and chosen.report.backend != "user"
    return asked and chosen.placed is None and (chosen.report.normals == "estimated" or chosen.report.surface == "open")


def gathered_points(result: Moving, clouds: Sequence[np.ndarray]) -> tuple[np.ndarray, float]:
    """Points of the frames around the keyframe, taken back to it; and the share of them that came to lie among its own.

    A point near the mesh goes back with it. Where it has lost a limb the grids, which were fitted to clouds alone, know
    the way: their motion is inverted there, from where the mesh would take the point. What then lies where the keyframe
    has no point has strayed.

    Args:
        result: a fit, input units. clouds: T arrays (N_t, 3), input units; empty where a frame has no points.
    """
    from scipy.spatial import cKDTree

    keyframe, faces, motion = result.keyframe, result.faces, result.motion
    nearest = sorted(range(len(clouds)), key=lambda t: (abs(t - keyframe), t))
    rest, own = result.vertices[keyframe].astype(np.float64), cKDTree(clouds[keyframe])
    spacing = mean_spacing(clouds[keyframe], own)
    back, targets, turns, frames, strange = [np.empty((0, 3))], [], [], [], []
    count = len(clouds[keyframe])
    for t in nearest[1:]:
        if not len(clouds[t]) or count >= GATHERED:
            continue
        moved = result.vertices[t].astype(np.float64)
        held = attach(clouds[t], moved, faces)
        turned = inverse(blend(held.weights, local_rotations(rest, moved[None], faces)[0]))
        back.append(held.weights @ rest + turn(turned, clouds[t] - held.weights @ moved))
        far = held.distance > EXPLAINED * spacing
        strange.append(far)
        targets.append(clouds[t][far])
        turns.append(turned[far])
        frames += [t] * int(far.sum())
        count += len(far)
    points = np.concatenate(back)
    if motion is not None and frames:
        which = np.flatnonzero(np.concatenate(strange))
        target, turned, row = np.concatenate(targets), np.concatenate(turns), np.arange(len(frames))
        found = points[which]
        for _ in range(INVERTED):
            found = found + turn(turned, target - motion.carry(found)[frames, row])
        there = np.linalg.norm(target - motion.carry(found)[frames, row], axis=1) < ARRIVED * spacing
        points[which[there]] = found[there]
    known = own.query(points)[0] <= AMONG * spacing
    return np.concatenate([clouds[keyframe], points[known]]), float(known.mean()) if len(known) else 0.0


def gathered_template(
    first: ChosenTemplate, result: Moving, clouds: Sequence[np.ndarray], into: Similarity, config: Config
) -> tuple[ChosenTemplate | None, str]:
    """The template of the points of all frames, with as many faces as the first; or why there is none.

    It is closed, or open where the first was, and less is left open. The points of many frames make layers, and these
    handles: where there are more than before a coarser surface is tried.

    Args:
        first: what was fitted, cube units. result: what came of it, input units.
        clouds: T arrays (N_t, 3), input units. into: takes these into the cube.

    Raises:
        MissingPackageError: the library for the reconstruction is not there.
    """
    points, known = gathered_points(result, clouds)
    if known < KNOWN_LEAST:
        return None, f"only {known:.0%} of the points can be taken back to the keyframe"
    points, own = into.to_cube(points), into.to_cube(clouds[result.keyframe])
    backend = load_backend(config.template.backend)
    finest = config.template.depth or depth_by_spacing(points)
    normals = estimate_normals(points, config.template.neighbours)
    far = max(config.template.far_share_max, OPEN_FROM)
    asked = replace(config.template, faces_max=first.report.faces_target, far_share_max=far)
    best, least, why = None, first.gate.handles + HANDLES_MORE + 1, ""
    for coarser in range(TRIED_COARSER + 1):
        depth = max(finest - coarser, DEPTH_LEAST)
        try:
            made = draft(points, normals, replace(asked, depth=depth), backend, "trusted")
        except InputError as error:
            why = str(error)
            continue
        is_open, drafted = made.report.surface == "open", made.mesh
        gate = judge(drafted, own, asked, config.seed, is_open)
        if is_open and (first.report.surface != "open" or made.report.trimmed > first.report.trimmed):
            why = f"it is open: closed, it would have {made.report.trimmed:.0%} more surface"
        elif not gate.passed:
            why = " and ".join(gate.failures)
        elif gate.handles >= least:
            why = f"it has {gate.handles} handles, the first {first.gate.handles}"
        else:
            best, least = made, gate.handles
            if least <= first.gate.handles:
                break
    if best is None:
        return None, why
    try:
        built = best.finish()
    except InputError as error:
        return None, str(error)
    report = replace(built.report, normals="estimated")
    gate = judge(built.mesh, own, asked, config.seed, report.surface == "open")
    if not gate.passed:
        return None, " and ".join(gate.failures)
    told = f"{first.why}; the template was made again of {len(points):,} points of all frames"
    return ChosenTemplate(built.mesh, first.keyframe, told, report, gate, built.warnings), ""


def nearness(result: Moving, clouds: Sequence[np.ndarray], seed: int) -> float:
    """Mean squared distance of points to the surface and of that to the points, added; input units.

    Args:
        result: T meshes. clouds: T arrays (N_t, 3); empty ones say nothing. seed: of the samples of the surface.
    """
    from scipy.spatial import cKDTree

    found = []
    for placed, cloud in zip(result.vertices, clouds, strict=True):
        if not len(cloud):
            continue
        placed = placed.astype(np.float64)
        there = closest_on_surface(cloud, placed, result.faces)[0]
        samples = sample_surface(placed, result.faces, SAMPLES, np.random.default_rng(seed))[0]
        back = cKDTree(cloud).query(samples)[0]
        found.append(float((there**2).mean() + (back**2).mean()))
    return float(np.mean(found))


def why_worse(first: Reconstruction, second: Reconstruction, clouds: Sequence[np.ndarray]) -> str:
    """Why the second fit is not the better one; nothing where it is: no more frames in doubt, and nearer to the clouds.

    Args:
        clouds: T arrays (N_t, 3), input units.
    """
    doubted = [sum(v != GOOD for v in result.report.get("verdicts", ())) for result in (first, second)]
    if doubted[1] > doubted[0]:
        return f"{doubted[1]} frames of the mesh that came of it are not good, for {doubted[0]}"
    near = [nearness(result, clouds, first.config.seed) for result in (first, second)]
    return "" if near[1] <= near[0] else "the mesh that came of it lies farther from the points"


def keep_doubts(first: Reconstruction, second: Reconstruction) -> None:
    """Where the second mesh has handles, frames that were in doubt stay in doubt, and the report says why.

    It is nearer to the points, but a handle may be a web between limbs that touch at the keyframe.
    """
    told = second.report
    handles = told["template"]["gate"]["handles"]
    pairs = zip(first.report.get("verdicts", ()), told.get("verdicts", ()), strict=True)
    kept = [t for t, (before, now) in enumerate(pairs) if before != GOOD and now == GOOD]
    if not handles or not kept:
        return
    webs = f"the mesh has handles ({handles}), which may be webs between limbs that touch at the keyframe"
    told["warnings"].append(f"{webs}: look at {name_frames(kept)}, or try another --keyframe")
    _doubt(told, kept, webs)


def told_of_few_points(result: Reconstruction, why: str, clock: Clock | None = None) -> Reconstruction:
    """The result of sparse clouds, its report with what became of a template of all frames.

    Where it still is open, by less than a sheet is, its holes may be want of points: then its frames are doubtful.

    Args:
        result: the one taken; its report is changed. why: it is the first one, of one frame's points; empty: it is not.
        clock: of the run, whose seconds have gone on.
    """
    report = result.report
    report["gathered"] = why or "taken"
    if clock is not None:
        report |= {"seconds": dict(clock.seconds), "cpu_seconds": dict(clock.cpu_seconds)}
    template = report["template"]
    guessed = result.config.template.surface == "auto" and template["normals"] == "estimated"
    if not guessed or template["surface"] != "open" or template["trimmed"] > SHEET:
        return result
    holes = f"the mesh has openings, {template['trimmed']:.0%} of it, that may be want of points"
    advice = "give more points or normals, or say --template.surface closed, or open if they are right"
    report["warnings"].append(f"{holes}: {advice}")
    _doubt(report, [t for t, verdict in enumerate(report.get("verdicts", ())) if verdict == GOOD], holes)
    return result


def _doubt(report: dict[str, Any], frames: Sequence[int], reason: str) -> None:
    """Call good frames of a report doubtful."""
    for t in frames:
        report["verdicts"][t] = DOUBTFUL
        report["quality"][t]["reasons"].append(reason)
