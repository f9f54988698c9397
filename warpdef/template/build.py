"""The template mesh of one cloud: screened Poisson, trimmed where the cloud ends, with even triangles."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from warpdef.config import TemplateConfig
from warpdef.errors import InputError
from warpdef.geometry import triangles
from warpdef.geometry.cloud_normals import estimate_normals, repair_normals
from warpdef.geometry.coverage import objects_of
from warpdef.geometry.sampling import mean_spacing
from warpdef.mesh import TriMesh
from warpdef.template.closing import closed_flatter
from warpdef.template.cut import cut_at_zero
from warpdef.template.even import even_triangles, remesh_open
from warpdef.template.poisson import Backend, load_backend
from warpdef.template.support import Support
from warpdef.template.tetrahedra import fit_surface
from warpdef.template.trim import crop, find_trimming

FLIPPED_WARN = 0.005  # share of given normals; below, it may be the estimate that errs
SHEET_TOLD = 0.25  # area beyond the border, over what is kept, from which a mesh is called a sheet
CUBE_SIDE = 2.2  # of the lattice around points that fill [-1, 1]^3
FLAT_CELLS = 2.0  # of the lattice, thickness of a cloud below which ...
ASKEW = np.array([[2.0, -2.0, 1.0], [1.0, 2.0, 2.0], [-2.0, -1.0, 2.0]]) / 3.0  # ... it is turned by this
BARE_SHEET = 4.0  # and from which there is no body that it might be the front of
_REPAIRED = {"given": "given normals", "calm": "normals estimated from the noisy cloud"}  # by source, in words
CELLS_AN_EDGE = 8.0  # of the octree: with more it shows what the mesh cannot
LEFT_OUT_WARN = 0.02  # share of the surface in components that were dropped


@dataclass(frozen=True)
class TemplateReport:
    """How a template came about.

    backend:       ``gpytoolbox``, ``pymeshlab``, or ``user``
    normals:       ``given``, ``trusted``, ``estimated``, ``seen`` (their side from one camera), or ``none`` for a mesh
                   of the user's
    flipped:       given normals that were turned over
    method:        ``poisson``, ``tetrahedra``, or ``none`` for a user's mesh
    depth:         octree depth of screened Poisson
    poisson_faces: faces of the reconstructed surface, before its triangles were made even
    faces_target:  upper bound on the faces
    edge_length:   asked of the remeshing, the points' units
    left_out:      share of the Poisson surface in components that were dropped
    surface:       ``closed`` or ``open``; ``none`` for a user's mesh
    trimmed:       area beyond the border, over the area that was kept
    """

    backend: str
    normals: str = "none"
    flipped: int = 0
    depth: int = 0
    poisson_faces: int = 0
    faces_target: int = 0
    edge_length: float = 0.0
    left_out: float = 0.0
    method: str = "none"
    surface: str = "none"
    trimmed: float = 0.0

    def as_dict(self) -> dict:
        """Plain values for ``report.json``."""
        return asdict(self)


def sheet_note(report: TemplateReport) -> str:
    """What to add to the reason for a keyframe, where its mesh is far from a whole body; else nothing."""
    if report.surface != "open" or report.trimmed < SHEET_TOLD:
        return ""
    if report.trimmed > BARE_SHEET:
        return "; the mesh is an open sheet"
    return f"; the mesh is a sheet of what is seen there: closed, it would have {report.trimmed:.0%} more surface"


@dataclass(frozen=True)
class TemplateResult:
    """A template as built, not yet judged; in the units of the points."""

    mesh: TriMesh
    report: TemplateReport
    warnings: list[str]


@dataclass(frozen=True)
class Draft:
    """A reconstructed surface whose triangles are not yet even: enough to tell what it will be, at half the cost.

    mesh:   what stays of it, the points' units
    report: as far as it is known
    """

    mesh: TriMesh
    report: TemplateReport
    warnings: list[str]
    _surface: _Surface
    _backend: Backend

    def finish(self) -> TemplateResult:
        """With about as many even triangles as asked for, never more.

        Raises:
            InputError: the surface cannot be remeshed.
        """
        backend, (vertices, faces, area, support, centre, scale) = self._backend, self._surface
        remesh = backend.remesh if support is None else partial(remesh_open, backend, support)
        vertices, faces, edge_length = even_triangles(vertices, faces, area, self.report.faces_target, remesh)
        if support is None:
            faces = _outwards(vertices, faces)
        report = replace(self.report, edge_length=edge_length * scale)
        return TemplateResult(TriMesh(vertices * scale + centre, faces), report, self.warnings)


class _Surface(NamedTuple):
    """What is remeshed, in the libraries' units: times ``scale`` and from ``centre`` the points'.

    area: that is to be kept of it. support: of the points that an open one is trimmed to; None for a closed one.
    """

    vertices: np.ndarray
    faces: np.ndarray
    area: float
    support: Support | None
    centre: np.ndarray
    scale: float


def build(
    points: np.ndarray,
    normals: np.ndarray | None,
    config: TemplateConfig,
    backend: Backend | None = None,
    source: str = "given",
) -> TemplateResult:
    """A template with about ``config.faces_most(N, 1)`` even triangles, never more: a ``draft``, finished."""
    return draft(points, normals, config, backend, source).finish()


def draft(
    points: np.ndarray,
    normals: np.ndarray | None,
    config: TemplateConfig,
    backend: Backend | None = None,
    source: str = "given",
    frames: int = 1,
) -> Draft:
    """The surface of a template, before its triangles are made even.

    Screened Poisson (Kazhdan and Hoppe 2013) or a deforming tetrahedral grid (``config.method``), one component for
    every object in the cloud, and remeshing to equal edges (Botsch and Kobbelt 2004). A closed template is watertight
    and looks outwards. Where the cloud samples an open surface, it is trimmed to the points (``config.surface``), and
    which side is the front is left open.

    Args:
        points: shape (N, 3), any units.
        normals: shape (N, 3), unit length; clearly inverted ones are turned over. None: estimated.
        config: method, depth, screening, the kind of surface and the number of faces.
        backend: from ``load_backend``; None: the configured one.
        source: of the normals: ``seen`` ones have the side of a camera, ``trusted`` ones that of a user, beyond doubt;
            ``calm`` ones were estimated as the noise was taken off the points, and are repaired as given ones are.
        frames: of the sequence, all of which tell the shape.

    Raises:
        InputError: the reconstruction yields no usable surface.
        MissingPackageError: the library for the reconstruction is not there.
    """
    backend = backend or load_backend(config.backend)
    points = np.asarray(points, dtype=np.float64)
    warnings = []
    flipped = 0
    if normals is None:
        normals, source = estimate_normals(points, config.neighbours), "estimated"
    elif source in _REPAIRED:
        normals, flipped = repair_normals(points, normals, config.neighbours)
        if flipped > FLIPPED_WARN * len(points):
            warnings.append(f"{flipped} of {len(points)} {_REPAIRED[source]} pointed inwards and were turned over")

    # Both libraries get the same, harmless size, whatever the units.
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    scale = float((points.max(axis=0) - points.min(axis=0)).max()) / 2
    unit_points = (points - centre) / scale
    target = max(config.faces_most(len(points), frames), 20)
    depth = config.depth or depth_by_spacing(unit_points, target)
    # Flatter than two cells it would lie in the lattice's own plane, where contours tear: it is put askew.
    turn = ASKEW if np.ptp(unit_points, axis=0).min() < FLAT_CELLS * CUBE_SIDE / 2**depth else np.eye(3)
    placed = unit_points @ turn, normals @ turn
    if config.method == "tetrahedra":
        vertices, faces = fit_surface(*placed, CUBE_SIDE / 2**config.depth if config.depth else 0.0)
    else:
        vertices, faces = backend.poisson(*placed, depth, config.screening)
    vertices, faces = triangles.compact(vertices @ turn.T, faces)
    if len(faces) < 4:
        raise InputError(
            f"the reconstruction ({config.method}) made {len(faces)} faces from {len(points)} points; "
            "the cloud does not look like a closed surface"
        )
    poisson_faces = len(faces)
    vertices, faces, left_out = _keep_objects(vertices, faces, unit_points)
    if left_out > LEFT_OUT_WARN:
        warnings.append(f"{left_out:.0%} of the reconstructed surface lies in separate pieces and was left out")
    support: Support | None = Support.of(unit_points, normals)
    trimming = find_trimming(vertices, faces, support)
    asked_open = config.surface == "open" or (config.surface == "auto" and trimming.share > config.far_share_max)
    if not (trimming.openings and asked_open):
        vertices = closed_flatter(vertices, faces, trimming.opening, support)
        support, trimming = None, None
    trimmed = 0.0
    if trimming is not None and support is not None:
        trimmed = trimming.share
        area = float(triangles.face_areas(vertices, faces).sum()) / (1.0 + trimmed)
        kept = cut_at_zero(vertices, faces, trimming.level)
        vertices, faces = crop(vertices, faces, trimming.level, support)
    else:
        area = float(triangles.face_areas(vertices, faces).sum())
        kept = vertices, _outwards(vertices, faces)
    report = TemplateReport(
        backend=backend.name,
        normals=source,
        flipped=flipped,
        method=config.method,
        depth=depth,
        poisson_faces=poisson_faces,
        faces_target=target,
        left_out=left_out,
        surface="closed" if trimming is None else "open",
        trimmed=trimmed,
    )
    surface = _Surface(vertices, faces, area, support, centre, scale)
    return Draft(TriMesh(kept[0] * scale + centre, kept[1]), report, warnings, surface, backend)


def _outwards(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The faces of a closed surface, turned over if they look inwards."""
    inside_out = triangles.signed_volume(vertices, faces) < 0 and triangles.is_watertight(faces)
    return faces[:, ::-1] if inside_out else faces


def _keep_objects(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """For every object in the cloud the component on which most of its points lie; and the share of area left out."""
    from scipy.spatial import cKDTree

    labels = triangles.face_components(faces)
    if labels.max() == 0:
        return vertices, faces, 0.0
    component = np.zeros(len(vertices), dtype=np.int64)
    component[faces.ravel()] = np.repeat(labels, 3)
    met = component[cKDTree(vertices).query(points)[1]]
    objects = objects_of(points)
    kept = np.unique([np.bincount(met[objects == k]).argmax() for k in range(objects.max() + 1)])
    stays = np.isin(labels, kept)
    areas = triangles.face_areas(vertices, faces)
    return *triangles.compact(vertices, faces[stays]), float(areas[~stays].sum() / max(areas.sum(), 1e-300))


def depth_by_spacing(points: np.ndarray, faces: int = 0) -> int:
    """The depth whose octree cells are about as large as the mean nearest-neighbour distance, from 3 to 12.

    Of a cloud far denser than the mesh of ``faces`` (0: of any number) that it becomes, as large as an eighth of that
    mesh's edges: finer ones cost four times as much a step, and show handles where a body touches itself.

    Deeper trees follow the noise: on a person's 5,000 points with noise of 0.5 % of the diagonal, depth 8 made no
    handle and depth 10 up to eight, and both lay equally near the true surface.
    """
    spacing = mean_spacing(points)
    # That of random points is half the root of a point's area.
    edge = triangles.equilateral_edge(len(points) * (2.0 * spacing) ** 2, faces) if faces else 0.0
    spacing = max(spacing, edge / CELLS_AN_EDGE)
    extent = float((points.max(axis=0) - points.min(axis=0)).max())
    # Both libraries leave a tenth of the extent around the points.
    return int(np.clip(np.ceil(np.log2(1.1 * extent / max(spacing, 1e-12))), 3, 12))
