"""The template: a closed mesh with even triangles on the keyframe (sec. Keyframe Selection), or a mesh of your own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from warpdef.config import Config, TemplateConfig
from warpdef.errors import InputError
from warpdef.mesh import TriMesh
from warpdef.template import topology
from warpdef.template.keyframe import rank_keyframes
from warpdef.template.normals import estimate_normals, repair_normals
from warpdef.template.poisson import Backend, load_backend
from warpdef.template.quality import GateReport, judge

FLIPPED_WARN = 0.005  # share of given normals; below, it may be the estimate that errs
FACES_AIM = 0.97  # of the target, which is an upper bound
FACES_LEAST = 0.9
REMESH_ATTEMPTS = 4
LEFT_OUT_WARN = 0.02  # share of the surface in components that were dropped


@dataclass(frozen=True)
class TemplateReport:
    """How a template came about.

    backend:       ``gpytoolbox``, ``pymeshlab``, or ``user``
    normals:       ``given``, ``estimated``, or ``none`` for a user's mesh
    flipped:       given normals that were turned over
    depth:         octree depth of screened Poisson
    poisson_faces: faces of the Poisson surface, before its triangles were made even
    faces_target:  upper bound on the faces
    edge_length:   asked of the remeshing, the points' units
    left_out:      share of the Poisson surface in components that were dropped
    """

    backend: str
    normals: str = "none"
    flipped: int = 0
    depth: int = 0
    poisson_faces: int = 0
    faces_target: int = 0
    edge_length: float = 0.0
    left_out: float = 0.0

    def as_dict(self) -> dict:
        """Plain values for ``report.json``."""
        return asdict(self)


@dataclass(frozen=True)
class TemplateResult:
    """A template as built, not yet judged; in the units of the points."""

    mesh: TriMesh
    report: TemplateReport
    warnings: list[str]


@dataclass(frozen=True)
class ChosenTemplate:
    """The template of a sequence and the frame that it belongs to.

    mesh:     cube units
    keyframe: frame index from 0
    why:      why that frame, one sentence
    report:   how the mesh was made
    gate:     what the quality gate measured
    warnings: everything that a user should hear of
    """

    mesh: TriMesh
    keyframe: int
    why: str
    report: TemplateReport
    gate: GateReport
    warnings: list[str]


def choose_template(
    clouds: Sequence[np.ndarray], normals: Sequence[np.ndarray | None], config: Config
) -> ChosenTemplate:
    """Build templates on the best keyframes, in order, until one passes the quality gate.

    At most ``config.template.attempts`` frames are tried, and only one where the user named it. If none passes, the
    best by the gate's score is taken, with a warning. A frame that fails with given normals of doubtful side is tried
    once more with normals estimated from its points.

    Args:
        clouds: one array a frame, each (N_t, 3), cube units.
        normals: one array a frame, each (N_t, 3), unit length, or None where unknown.
        config: the whole configuration; ``seed``, ``keyframe`` and ``template`` matter here.

    Raises:
        InputError: the keyframe asked for does not exist, or no surface came out of any frame tried.
        MissingPackageError: the library for the reconstruction is not there.
    """
    backend = load_backend(config.template.backend)
    candidates = rank_keyframes(clouds, config.keyframe)[: config.template.attempts]
    attempts = []
    for candidate in candidates:
        if normals[candidate.frame] is not None:
            attempts.append((candidate, "given"))
        attempts.append((candidate, "estimated"))
    warnings: list[str] = []
    tried: list[ChosenTemplate] = []
    while attempts:
        candidate, source = attempts.pop(0)
        frame = candidate.frame
        try:
            built = build(clouds[frame], normals[frame] if source == "given" else None, config.template, backend)
        except InputError as error:
            warnings.append(f"keyframe {frame} gave no template: {error}{_next(frame, attempts)}")
            continue
        gate = judge(built.mesh, clouds[frame], config.template, config.seed)
        made = [f"keyframe {frame}: {w}" for w in built.warnings]
        chosen = ChosenTemplate(built.mesh, frame, candidate.why, built.report, gate, made)
        if gate.passed:
            return replace(chosen, warnings=warnings + made)
        tried.append(chosen)
        if source == "given" and built.report.flipped <= FLIPPED_WARN * len(clouds[frame]):
            attempts.pop(0)  # the given normals are not to blame
        reasons = " and ".join(gate.failures)
        warnings.append(f"keyframe {frame} failed the template gate: {reasons}{_next(frame, attempts)}")
    if not tried:
        raise InputError(f"no template: {warnings[-1]}; give a mesh of your own with --template")
    best = min(tried, key=lambda c: c.gate.score)
    warnings += best.warnings
    if best.gate.far_share > config.template.far_share_max:
        advice = (
            "an open or partly seen surface cannot be closed well: check the template, or give your own with --template"
        )
    else:
        advice = (
            "a thin limb may be lost: try more points, a larger template.attempts, or your own mesh with --template"
        )
    warnings.append(
        f"no keyframe passed the template gate; using the best, frame {best.keyframe}, though "
        f"{' and '.join(best.gate.failures)}; {advice}"
    )
    return replace(best, warnings=warnings)


def _next(frame: int, attempts: list) -> str:
    if not attempts:
        return ""
    candidate, _ = attempts[0]
    return "; trying estimated normals" if candidate.frame == frame else f"; trying frame {candidate.frame}"


def build(
    points: np.ndarray, normals: np.ndarray | None, config: TemplateConfig, backend: Backend | None = None
) -> TemplateResult:
    """A closed, outward template with about min(faces_max, faces_per_point * N) even triangles, never more.

    Screened Poisson (Kazhdan and Hoppe 2013), largest component, remeshing to equal edges (Botsch and Kobbelt 2004).

    Args:
        points: shape (N, 3), any units.
        normals: shape (N, 3), unit length; clearly inverted ones are turned over. None: estimated.
        config: depth, screening and the number of faces.
        backend: from ``load_backend``; None: the configured one.

    Raises:
        InputError: the reconstruction yields no usable surface.
        MissingPackageError: the library for the reconstruction is not there.
    """
    backend = backend or load_backend(config.backend)
    points = np.asarray(points, dtype=np.float64)
    warnings = []
    flipped, source = 0, "estimated" if normals is None else "given"
    if normals is None:
        normals = estimate_normals(points, config.neighbours)
    else:
        normals, flipped = repair_normals(points, normals, config.neighbours)
        if flipped > FLIPPED_WARN * len(points):
            warnings.append(f"{flipped} of {len(points)} given normals pointed inwards and were turned over")

    # Both libraries get the same, harmless size, whatever the units.
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    scale = float((points.max(axis=0) - points.min(axis=0)).max()) / 2
    unit_points = (points - centre) / scale
    depth = config.depth or depth_by_spacing(unit_points)
    vertices, faces = backend.poisson(unit_points, normals, depth, config.screening)
    vertices, faces = topology.compact(vertices, faces)
    if len(faces) < 4:
        raise InputError(
            f"screened Poisson made {len(faces)} faces from {len(points)} points; "
            "the cloud does not look like a closed surface"
        )
    poisson_faces = len(faces)
    vertices, faces, left_out = topology.largest_component(vertices, faces)
    if left_out > LEFT_OUT_WARN:
        warnings.append(
            f"{left_out:.0%} of the reconstructed surface lies in separate pieces and was left out; "
            "if the sequence shows several bodies, reconstruct each by itself"
        )
    target = int(min(config.faces_max, config.faces_per_point * len(points)))
    vertices, faces, edge_length = _even_triangles(vertices, faces, max(target, 20), backend)
    if topology.signed_volume(vertices, faces) < 0 and topology.is_watertight(faces):
        faces = faces[:, ::-1]
    report = TemplateReport(backend.name, source, flipped, depth, poisson_faces, target, edge_length * scale, left_out)
    return TemplateResult(TriMesh(vertices * scale + centre, faces), report, warnings)


def depth_by_spacing(points: np.ndarray) -> int:
    """The depth whose octree cells are about as large as the mean nearest-neighbour distance, from 3 to 12.

    Deeper trees follow the noise: on a person's 5,000 points with noise of 0.5 % of the diagonal, depth 8 made no
    handle and depth 10 up to eight, and both lay equally near the true surface.
    """
    from scipy.spatial import cKDTree

    spacing = float(cKDTree(points).query(points, k=2)[0][:, 1].mean())
    extent = float((points.max(axis=0) - points.min(axis=0)).max())
    # Both libraries leave a tenth of the extent around the points.
    return int(np.clip(np.ceil(np.log2(1.1 * extent / max(spacing, 1e-12))), 3, 12))


def _even_triangles(
    vertices: np.ndarray, faces: np.ndarray, target: int, backend: Backend
) -> tuple[np.ndarray, np.ndarray, float]:
    """Vertices and faces, just under ``target`` of them, and the edge length h that did it.

    F equilateral faces have the area F sqrt(3) / 4 h^2.
    """
    area = float(topology.face_areas(vertices, faces).sum())
    if not area > 0:
        raise InputError("the reconstructed surface has no area; the cloud does not look like a closed surface")
    edge_length = np.sqrt(4.0 * area / (np.sqrt(3.0) * FACES_AIM * target))
    best = None
    for _ in range(REMESH_ATTEMPTS):
        try:
            new_vertices, new_faces = topology.compact(*backend.remesh(vertices, faces, edge_length))
        except ValueError as error:
            raise InputError(f"the reconstructed surface cannot be remeshed ({error})") from error
        count = len(new_faces)
        usable = count >= 4 and np.isfinite(new_vertices).all()
        if usable and (best is None or _misfit(count, target) < _misfit(len(best[1]), target)):
            best = (new_vertices, new_faces, float(edge_length))
        if FACES_LEAST * target <= count <= target:
            break
        edge_length *= np.sqrt(max(count, target / 4) / (FACES_AIM * target))
    if best is None:
        raise InputError("the remeshing lost the surface; raise template.faces_max or template.faces_per_point")
    return best


def _misfit(count: int, target: int) -> float:
    # Too many faces break the user's bound; too few only cost detail.
    return abs(count - target) + (10.0 * target if count > target else 0.0)


def accept_user_template(mesh: TriMesh, clouds: Sequence[np.ndarray], config: Config) -> ChosenTemplate:
    """Take a mesh of the user's own, vertices and faces exactly as they are.

    With ``keyframe.choice`` ``auto`` it belongs to the frame whose cloud is nearest to it (mean nearest distance, both
    ways); else to the frame named. What the quality gate finds is told as warnings: an open template is a user's right.

    Args:
        mesh: the template, cube units.
        clouds: one array a frame, each (N_t, 3), cube units.
        config: the whole configuration; ``seed``, ``keyframe`` and ``template`` matter here.

    Raises:
        InputError: the keyframe asked for does not exist, or the mesh has no area.
    """
    if not topology.face_areas(mesh.vertices, mesh.faces).sum() > 0:
        raise InputError("--template: expected a surface with an area above 0, got only degenerate faces")
    warnings = []
    if config.keyframe.choice == "auto":
        distance = [_mean_distance(mesh, cloud, config.seed) for cloud in clouds]
        frame = int(np.argmin(distance))
        why = f"the frame nearest to the template given: mean distance {distance[frame]:.4f} cube units"
        warnings.append(
            f"--template without --keyframe: taking frame {frame}, whose points are nearest to it; "
            "name the frame with --keyframe if that is wrong"
        )
    else:
        candidate = rank_keyframes(clouds, config.keyframe)[0]
        frame, why = candidate.frame, candidate.why
    gate = judge(mesh, clouds[frame], config.template, config.seed)
    warnings += [f"the template given for keyframe {frame}: {failure}" for failure in gate.failures]
    unused = len(mesh.vertices) - len(np.unique(mesh.faces))
    if unused:
        warnings.append(
            f"the template given: {unused} of its vertices belong to no face and will not follow the motion"
        )
    return ChosenTemplate(mesh, frame, why, TemplateReport(backend="user"), gate, warnings)


def _mean_distance(mesh: TriMesh, points: np.ndarray, seed: int) -> float:
    from scipy.spatial import cKDTree

    from warpdef.truth.sample import sample_surface

    samples = sample_surface(mesh.vertices, mesh.faces, 5000, np.random.default_rng(seed))[0]
    there, back = cKDTree(points).query(samples)[0], cKDTree(samples).query(points)[0]
    return float(there.mean() + back.mean()) / 2
