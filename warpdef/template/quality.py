"""The quality gate: may this mesh carry a whole sequence?"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from warpdef.config import TemplateConfig
from warpdef.geometry import triangles
from warpdef.geometry.coverage import object_count
from warpdef.mesh import TriMesh

SAMPLES = 20_000
EDGE_SHARE, EDGE_MOST = 0.5, 0.01  # of the mean edge, and at most of the extent: what a mesh cannot show


@dataclass(frozen=True)
class GateReport:
    """What the gate measured, and what it holds against the mesh.

    vertices, faces: their numbers
    watertight:      each edge in exactly two faces, turned opposite ways
    volume:          signed, in the points' units cubed; above 0 when the faces look outwards
    components:      pieces that share no vertex
    objects:         separate clusters of points, each of which may have a piece of its own
    loops:           closed curves that the boundary consists of; 0 when watertight
    euler:           V - E + F; 2 for a sphere, 2 less for every handle, 1 less for every boundary loop
    handles:         of all pieces together
    quality:         mean of 4 sqrt(3) area / sum of squared edges, 1 for equilateral triangles; reported, not judged
    spacing:         mean distance of a point to its nearest neighbour, the points' units
    far_share:       share of the surface further than ``far_spacings`` spacings from every point
    missed_share:    share of the points further than that from the surface
    failures:        one clause each; empty when the mesh passes
    score:           0 is best: both shares, plus 1 for every failure of the topology
    """

    vertices: int
    faces: int
    watertight: bool
    volume: float
    components: int
    objects: int
    loops: int
    euler: int
    handles: int
    quality: float
    spacing: float
    far_share: float
    missed_share: float
    failures: tuple[str, ...]
    score: float

    @property
    def passed(self) -> bool:
        return not self.failures

    def as_dict(self) -> dict:
        """Plain numbers for ``report.json``."""
        return {**asdict(self), "failures": list(self.failures), "passed": self.passed}


def judge(mesh: TriMesh, points: np.ndarray, config: TemplateConfig, seed: int, is_open: bool = False) -> GateReport:
    """Measure a template against the cloud that it was built on.

    A closed one must be watertight, turned outwards, and have no more pieces than the cloud has objects. An open one
    must be a surface with a boundary (no edge in three faces), in as many pieces as it likes.

    Args:
        mesh: the template.
        points: its keyframe, shape (N, 3), the mesh's units.
        config: the gate's thresholds.
        seed: of the surface samples.
        is_open: whether the template was trimmed on purpose.
    """
    watertight = triangles.is_watertight(mesh.faces)
    volume = triangles.signed_volume(mesh.vertices, mesh.faces)
    components = int(triangles.face_components(mesh.faces).max()) + 1
    objects = object_count(points)
    loops, euler = triangles.boundary_loops(mesh.faces), triangles.euler_number(mesh.faces)
    spacing, far_share, missed_share = far_shares(mesh, points, config.far_spacings, seed)

    broken = []
    if is_open:
        if triangles.edge_use(mesh.faces).max() > 2:
            broken.append("it has edges in more than two faces")
    else:
        if not watertight:
            broken.append("it is not watertight")
        if not volume > 0:
            broken.append("it is inside out or flat (its signed volume is not above 0)")
        if components > objects:
            broken.append(f"it has {components} pieces")
    off = []
    if far_share > config.far_share_max:
        off.append(f"{far_share:.0%} of its surface is far from every point")
    if missed_share > config.missed_share_max:
        off.append(f"{missed_share:.0%} of the points are far from its surface")
    return GateReport(
        vertices=len(mesh.vertices),
        faces=len(mesh.faces),
        watertight=watertight,
        volume=volume,
        components=components,
        objects=objects,
        loops=loops,
        euler=euler,
        handles=(2 * components - loops - euler) // 2,
        quality=triangles.triangle_quality(mesh.vertices, mesh.faces),
        spacing=spacing,
        far_share=far_share,
        missed_share=missed_share,
        failures=tuple(broken + off),
        score=float(len(broken) + far_share + missed_share),
    )


def far_shares(mesh: TriMesh, points: np.ndarray, far_spacings: float, seed: int) -> tuple[float, float, float]:
    """Mean point spacing, share of the surface far from every point, and share of points far from the surface.

    By ``SAMPLES`` area-uniform samples; a surface without area is far everywhere. Nothing is far that is nearer than
    half an edge (of a mesh that is no coarse one): finer than its edges no mesh can be, however dense the cloud.
    """
    from scipy.spatial import cKDTree

    from warpdef.geometry.closest import closest_on_surface
    from warpdef.geometry.sampling import mean_spacing, sample_surface

    tree = cKDTree(points)
    spacing = mean_spacing(points, tree)
    area = float(triangles.face_areas(mesh.vertices, mesh.faces).sum())
    if not area > 0:
        return spacing, 1.0, 1.0
    samples = sample_surface(mesh.vertices, mesh.faces, SAMPLES, np.random.default_rng(seed))[0]
    edge = triangles.equilateral_edge(area, len(mesh.faces))
    bound = max(far_spacings * spacing, min(EDGE_SHARE * edge, EDGE_MOST * float(np.ptp(points, axis=0).max())))
    far = tree.query(samples)[0] > bound
    missed = cKDTree(np.concatenate([samples, mesh.vertices])).query(points)[0] > bound
    if missed.any():
        # A cloud may be denser than the samples: then it is the surface itself that tells.
        missed[missed] = closest_on_surface(points[missed], mesh.vertices, mesh.faces)[0] > bound
    return spacing, float(far.mean()), float(missed.mean())
