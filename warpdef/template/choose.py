"""The template: the mesh of the best keyframe (sec. Keyframe Selection), or a mesh of your own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from warpdef.config import Config
from warpdef.errors import InputError
from warpdef.geometry import triangles
from warpdef.geometry.viewpoint import seen_normals
from warpdef.mesh import TriMesh
from warpdef.template.build import FLIPPED_WARN, Draft, TemplateReport, draft
from warpdef.template.keyframe import KeyframeCandidate, doubt_of_asked, rank_keyframes, spread_out
from warpdef.template.place import align, require_place
from warpdef.template.poisson import load_backend
from warpdef.template.quality import GateReport, judge

MIDDLE = 0.3  # of the frames, to either side of the middle: keyframes there are as good as each other
HANDLES_TO_THE_END = 1.5  # handles that a keyframe at either end of the sequence weighs as much as


@dataclass(frozen=True)
class ChosenTemplate:
    """The template of a sequence and the frame that it belongs to.

    mesh:     cube units
    keyframe: frame index from 0
    why:      why that frame, one sentence
    report:   how the mesh was made
    gate:     what the quality gate measured
    warnings: everything that a user should hear of
    placed:   where each of T frames is expected to have the mesh, (T, V, 3) cube units; None where nothing is known
    """

    mesh: TriMesh
    keyframe: int
    why: str
    report: TemplateReport
    gate: GateReport
    warnings: list[str]
    placed: np.ndarray | None = None


def choose_template(
    clouds: Sequence[np.ndarray],
    normals: Sequence[np.ndarray | None],
    config: Config,
    view: np.ndarray | None = None,
    places: np.ndarray | None = None,
    noise: str = "",
) -> ChosenTemplate:
    """Build templates on the best keyframes, in order, until one passes the quality gate and has no handle.

    A handle (a hand on the hip closes the arm to a loop) may be the body's own or come of two parts that touch, and one
    frame alone cannot tell; touching adds handles and never takes one away. So if a template has some, the other
    candidates are tried as well and the one with fewest is taken. Handles, and what the gate asks, are told by drafts,
    whose triangles are not even yet; what is taken is finished, and judged as it then is.

    At most ``config.template.attempts`` frames are tried, and only one where the user named it. If none passes, the
    best by the gate's score is taken, with a warning. A frame that fails with given normals of doubtful side is tried
    once more with normals estimated from its points.

    Args:
        clouds: one array a frame, each (N_t, 3), cube units.
        normals: one array a frame, each (N_t, 3), unit length, or None where unknown.
        config: the whole configuration; ``seed``, ``keyframe`` and ``template`` matter here.
        view: shape (3,), towards the one camera that saw all clouds, which tells the side of normals; None: no such.
        places: as in ``rank_keyframes``.
        noise: of clouds whose wide noise was taken off, whose side ``normals`` have: ``estimated``, or ``kept``.

    Raises:
        InputError: the keyframe asked for does not exist, or no surface came out of any frame tried.
        MissingPackageError: the library for the reconstruction is not there.
    """
    backend, filled = load_backend(config.template.backend), sum(len(cloud) > 0 for cloud in clouds)
    ranked = rank_keyframes(clouds, config.keyframe, places, view, bool(noise))
    candidates, given = spread_out(ranked, config.template.attempts), "calm" if noise == "estimated" else "given"
    attempts = []
    for candidate in candidates:
        if normals[candidate.frame] is not None:
            attempts.append((candidate, "trusted" if config.trust_normals else given))
            if config.trust_normals:
                continue
        attempts.append((candidate, "estimated" if view is None else "seen"))
    # Where one camera saw parts, what the template lacks is told by what the camera saw.
    doubt = "" if view is not None else doubt_of_asked(clouds, config.keyframe, places)
    warnings = [doubt] if doubt else []
    failed: list[ChosenTemplate] = []
    passed: list[ChosenTemplate] = []
    drafts = _Drafts(clouds, config)
    while attempts:
        candidate, source = attempts.pop(0)
        frame = candidate.frame
        least = min((_cost(c.keyframe, c.gate.handles, len(clouds)) for c in passed), default=np.inf)
        if _cost(frame, 0, len(clouds)) >= least:
            continue  # it could not be better
        try:
            sides = normals[frame] if source in (given, "trusted") else None
            if view is not None and source == "seen":
                sides = seen_normals(clouds[frame], view, config.template.neighbours)
            chosen = drafts.begin(draft(clouds[frame], sides, config.template, backend, source, filled), candidate)
            if chosen.gate.passed and chosen.gate.handles == 0:
                chosen = drafts.finish(chosen)
        except InputError as error:
            if passed:
                continue
            warnings.append(f"keyframe {frame} gave no template: {error}{_next(frame, attempts)}")
            continue
        gate = chosen.gate
        if gate.passed:
            passed.append(chosen)
            if gate.handles == 0:
                break
            attempts = [a for a in attempts if a[0].frame != frame]
        if passed:
            continue  # what else is built now only competes for fewer handles
        failed.append(chosen)
        if source == given and chosen.report.flipped <= FLIPPED_WARN * len(clouds[frame]):
            attempts.pop(0)  # the given normals are not to blame
        reasons = " and ".join(gate.failures)
        warnings.append(f"keyframe {frame} failed the template gate: {reasons}{_next(frame, attempts)}")
    passed.sort(key=lambda c: _cost(c.keyframe, c.gate.handles, len(clouds)))
    unsound: list[ChosenTemplate] = []
    if drafts.first_finished(passed, warnings, unsound) is not None:
        return _fewest_handles(passed, warnings, len(clouds))
    failed += unsound
    failed.sort(key=lambda c: c.gate.score)
    best = drafts.first_finished(failed, warnings)
    if best is None:
        raise InputError(f"no template: {warnings[-1]}; give a mesh of your own with --template")
    warnings += best.warnings
    advice = _advice(best, config, len(clouds))
    warnings.append(
        f"no keyframe passed the template gate; using the best, frame {best.keyframe}, though "
        f"{' and '.join(best.gate.failures)}; {advice}"
    )
    return replace(best, warnings=warnings)


class _Drafts:
    """Templates of drafts, and what is left to do for them."""

    def __init__(self, clouds: Sequence[np.ndarray], config: Config) -> None:
        self._clouds, self._config = clouds, config
        self._unfinished: dict[tuple[int, str], Draft] = {}

    def begin(self, made: Draft, candidate: KeyframeCandidate) -> ChosenTemplate:
        """A draft as a template, judged as it is."""
        frame = candidate.frame
        self._unfinished[frame, made.report.normals] = made
        warnings = [f"keyframe {frame}: {w}" for w in made.warnings]
        gate = self._judged(made.mesh, frame, made.report)
        return ChosenTemplate(made.mesh, frame, candidate.why, made.report, gate, warnings)

    def finish(self, chosen: ChosenTemplate) -> ChosenTemplate:
        """With even triangles, and judged anew; what is finished stays as it is. Raises as ``Draft.finish``."""
        made = self._unfinished.get((chosen.keyframe, chosen.report.normals))
        if made is None:
            return chosen
        done = made.finish()
        del self._unfinished[chosen.keyframe, chosen.report.normals]
        gate = self._judged(done.mesh, chosen.keyframe, done.report)
        return replace(chosen, mesh=done.mesh, report=done.report, gate=gate)

    def first_finished(
        self, ordered: list[ChosenTemplate], warnings: list[str], unsound: list[ChosenTemplate] | None = None
    ) -> ChosenTemplate | None:
        """The first that can be finished and passes the gate then; others are removed.

        Args:
            unsound: takes those that can be finished and do not pass; None: the first is taken, passing or not.
        """
        while ordered:
            try:
                done = self.finish(ordered[0])
            except InputError as error:
                warnings.append(f"keyframe {ordered[0].keyframe} gave no template: {error}")
            else:
                if done.gate.passed or unsound is None:
                    ordered[0] = done
                    return done
                failures = " and ".join(done.gate.failures)
                warnings.append(f"keyframe {done.keyframe} failed the template gate: {failures}")
                unsound.append(done)
            ordered.pop(0)
        return None

    def _judged(self, mesh: TriMesh, frame: int, report: TemplateReport) -> GateReport:
        return judge(mesh, self._clouds[frame], self._config.template, self._config.seed, report.surface == "open")


def _advice(best: ChosenTemplate, config: Config, frame_count: int) -> str:
    """What to try, without what is in force already."""
    if best.gate.far_share > config.template.far_share_max:
        is_open = best.report.surface == "open" or config.template.surface == "open"
        tries = "check the template, " + ("" if is_open else "set template.surface to open, ")
        return f"an open or partly seen surface cannot be closed well: {tries}or give your own with --template"
    more = "more points, " if config.points else ""
    more += "a larger template.attempts, " if config.template.attempts < frame_count else ""
    return f"a thin limb may be lost: try {more}or your own mesh with --template".replace("try or ", "try ")


def _cost(frame: int, handles: int, frame_count: int) -> float:
    """Handles, and what a keyframe near either end costs: it makes the chain of steps up to twice as long."""
    off_middle = abs(frame - (frame_count - 1) / 2) / frame_count
    return handles + HANDLES_TO_THE_END * max(0.0, off_middle - MIDDLE) / (0.5 - MIDDLE)


def _fewest_handles(passed: list[ChosenTemplate], warnings: list[str], frame_count: int) -> ChosenTemplate:
    """The template of least cost, of equal ones the first; ``why`` tells of the others."""
    best = min(passed, key=lambda c: _cost(c.keyframe, c.gate.handles, frame_count))
    others = ", ".join(f"{c.gate.handles} in frame {c.keyframe}" for c in passed if c is not best)
    why = f"{best.why}; handles of the template: {best.gate.handles} here, {others}" if others else best.why
    return replace(best, why=why, warnings=warnings + best.warnings)


def _next(frame: int, attempts: list) -> str:
    if not attempts:
        return ""
    candidate, _ = attempts[0]
    return "; trying estimated normals" if candidate.frame == frame else f"; trying frame {candidate.frame}"


def accept_user_template(mesh: TriMesh, clouds: Sequence[np.ndarray], config: Config) -> ChosenTemplate:
    """Take a mesh of the user's own, vertices and faces exactly as they are.

    With ``keyframe.choice`` ``auto`` it belongs to the frame whose cloud is nearest to it (mean nearest distance, both
    ways); else to the frame named. What the quality gate finds is told as warnings: an open template is a user's right.

    Args:
        mesh: the template, cube units.
        clouds: one array a frame, each (N_t, 3), cube units.
        config: the whole configuration; ``seed``, ``keyframe`` and ``template`` matter here.

    Raises:
        InputError: the keyframe asked for does not exist, the mesh has no area, or it lies elsewhere, is far larger or
            smaller or turned (``place``); with ``template.align`` it is placed first, on a keyframe that must be named.
    """
    if config.template.align and config.keyframe.choice == "auto":
        raise InputError("--align-template: name the frame that the template belongs to with --keyframe")
    if not triangles.face_areas(mesh.vertices, mesh.faces).sum() > 0:
        raise InputError("--template: expected a surface with an area above 0, got only degenerate faces")
    warnings = []
    if config.keyframe.choice == "auto":
        distance = [_mean_distance(mesh, cloud, config.seed) if len(cloud) else np.inf for cloud in clouds]
        frame = int(np.argmin(distance))
        why = f"the frame nearest to the template given: mean distance {distance[frame]:.4f} cube units"
        warnings.append(
            f"--template without --keyframe: taking frame {frame}, whose points are nearest to it; "
            "name the frame with --keyframe if that is wrong"
        )
    else:
        candidate = rank_keyframes(clouds, config.keyframe)[0]
        frame, why = candidate.frame, candidate.why
    if config.template.align:
        mesh, done = align(mesh, clouds[frame], config.seed)
        warnings.append(f"the template given was {done}, to lie on keyframe {frame}")
    gate = judge(mesh, clouds[frame], config.template, config.seed)
    require_place(mesh, clouds[frame], gate.missed_share, config.seed)
    warnings += [f"the template given for keyframe {frame}: {failure}" for failure in gate.failures]
    unused = len(mesh.vertices) - len(np.unique(mesh.faces))
    if unused:
        warnings.append(
            f"the template given: {unused} of its vertices belong to no face and will not follow the motion"
        )
    return ChosenTemplate(mesh, frame, why, TemplateReport(backend="user"), gate, warnings)


def _mean_distance(mesh: TriMesh, points: np.ndarray, seed: int) -> float:
    from scipy.spatial import cKDTree

    from warpdef.geometry.sampling import sample_surface

    samples = sample_surface(mesh.vertices, mesh.faces, 5000, np.random.default_rng(seed))[0]
    there, back = cKDTree(points).query(samples)[0], cKDTree(samples).query(points)[0]
    return float(there.mean() + back.mean()) / 2
