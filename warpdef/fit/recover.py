"""Lost limbs found again: a frame whose points the mesh does not cover is fitted once more, from its neighbour.

A leg that swings by a fifth of the body finds the other leg nearest, and stays there. What tells right from wrong is
the surface: a wrong match is not connected to the rest of the body by matches. So the neighbour's mesh is bent towards
the points by the matches of one connected part alone; all else follows as rigidly as it can. Step by step the hip turns
the thigh, the thigh carries the foot, and the connected part grows until it is the whole mesh. Frame by frame outwards
from the keyframe, so that behind a frame that is found again the next ones are, too; what stays lost is tried once more
from the other side, where the frames behind it are covered.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import warp as wp

from warpdef.fit.embedded import DeformationGraph, Pose
from warpdef.geometry.cloud_normals import estimate_normals, repair_normals
from warpdef.geometry.cloud_planes import turned_to
from warpdef.geometry.edges import edge_lengths
from warpdef.geometry.nearby import Fellows, Nearest
from warpdef.geometry.triangles import component_labels, vertex_normals

NODES = 400
"""Nodes of the deformation graph."""
ROUNDS = 25
"""Gauss-Newton steps, each on new matches."""
REACH, AGREEMENT = 3.0, 0.6
"""Largest distance of a match, in point spacings of the frame, and least cosine between its normals."""
LOOSER = ((5.0, 0.6), (3.0, 0.3))
"""The same for further tries where the first leaves something lost: joints that turn by a right angle in a frame."""
MATCHES = 3000
"""Matches of a step, spread evenly over the vertices' order: more than a few a node say nothing new."""
RIGIDITY = 0.03
"""Weight of rigidity between nodes, mean over links, against the mean squared distance along normals."""
TANGENTIAL = 0.02
"""Weight of a match's distance along the surface."""
LOST = 0.005
"""Share of points that no connected part covers, above twice the keyframe's, from which a frame has lost something."""
LOST_NOISY = 0.01
"""The same of clouds with wide noise, which leaves as much uncovered of limbs as thin as itself."""
_STILL = 0.02  # of the reach: a largest move below it ends the bending
_BETTER = 0.7  # of the old uncovered share: what a second fit must reach to be taken, where it leaves something lost
_NOTHING = 0.3  # uncovered share of a neighbour from which nothing can be learnt


@dataclass(frozen=True)
class Cloud:
    """points: (N, 3). normals: (N, 3), unit. given: not estimated. oriented: their side is beyond doubt."""

    points: np.ndarray
    normals: np.ndarray
    given: bool
    oriented: bool

    def turned_outwards(self, vertices: np.ndarray, faces: np.ndarray) -> Cloud:
        """The same with sides that agree all over, from the points alone; costs about a second.

        Which side it is, most of a mesh nearby decide, vertices (V, 3) and faces (F, 3): an open sheet has no outside.
        """
        from scipy.spatial import cKDTree

        if self.given:
            normals, _ = repair_normals(self.points, self.normals)
        else:
            normals = turned_to(self.normals, estimate_normals(self.points))
        facing = vertex_normals(vertices, faces)[cKDTree(vertices).query(self.points)[1]]
        side = -1.0 if (normals * facing).sum() < 0.0 else 1.0
        return Cloud(self.points, side * normals, self.given, oriented=True)


@dataclass(frozen=True)
class ConnectedSurface:
    """faces: (F, 3). edges: (E, 2), each once. component: which connected component a vertex is in (V,)."""

    faces: np.ndarray
    edges: np.ndarray
    component: np.ndarray

    @classmethod
    def of(cls, faces: np.ndarray, edges: np.ndarray) -> ConnectedSurface:
        starts, ends = edges.T
        return cls(faces, edges, component_labels(starts, ends, int(max(faces.max(), edges.max())) + 1))


class Matches:
    """Which vertices of a mesh lie on a cloud, in one connected part of the mesh.

    Args:
        cloud: of one frame. surface: of the mesh. device: where the nearest is looked for; None: on the host.
    """

    def __init__(self, cloud: Cloud, surface: ConnectedSurface, device: wp.Device | None = None) -> None:
        self.cloud, self.surface, self._device = cloud, surface, device
        self._nearest = Nearest(cloud.points, device)
        fellow = Fellows(cloud.points, 2, device=device).distance[:, 1]
        self.spacing, self._mean_spacing = float(np.median(fellow)), float(fellow.mean())

    def far(self, vertices: np.ndarray, spacings: float, noise: float = 0.0) -> float:
        """Share of vertices (V, 3) farther than so many mean spacings, or times the noise, from all of the points."""
        return float(np.mean(self._nearest.query(vertices)[0] > spacings * max(self._mean_spacing, noise)))

    def find(
        self, vertices: np.ndarray, rule: tuple[float, float] = (REACH, AGREEMENT)
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Trusted vertices (m,), the points (m, 3) nearest to them and their normals (m, 3)."""
        reach, agreement = rule
        s = self.surface
        distance, nearest = self._nearest.query(vertices)
        cosine = (vertex_normals(vertices, s.faces) * self.cloud.normals[nearest]).sum(axis=1)
        on = distance < reach * self.spacing
        on &= (cosine if self.cloud.oriented else np.abs(cosine)) > agreement
        on[len(s.component) :] = False  # the last vertices of a template given may be of no face
        kept = s.edges[on[s.edges].all(axis=1)]
        part = component_labels(kept[:, 0], kept[:, 1], len(vertices))
        # A separate object is no lost limb: of every component of the mesh the largest part counts.
        size = np.bincount(part[on], minlength=part.max() + 1)
        largest = np.zeros(s.component.max() + 1, dtype=int)
        of_faces = slice(len(s.component))
        np.maximum.at(largest, s.component[on[of_faces]], size[part[on]])
        trusted = np.flatnonzero(on[of_faces] & (size[part[of_faces]] == largest[s.component]))
        return trusted, self.cloud.points[nearest[trusted]], self.cloud.normals[nearest[trusted]]

    def uncovered(self, vertices: np.ndarray) -> float:
        """Share of the cloud's points without a trusted vertex within reach."""
        trusted, _, _ = self.find(vertices)
        if not len(trusted):
            return 1.0
        distance, nearest = Nearest(vertices[trusted], self._device).query(self.cloud.points)
        # The middle of a triangle is up to 0.6 of its longest edge away from its corners.
        around, edges = np.zeros(len(vertices)), self.surface.edges
        np.maximum.at(around, edges, edge_lengths(vertices, edges)[:, None])
        return float(np.mean(distance > REACH * self.spacing + 0.6 * around[trusted][nearest]))


def lost_above(keyframe_uncovered: float, noisy: bool = False) -> float:
    """Uncovered share of points above which a frame has lost something."""
    least = LOST_NOISY if noisy else LOST
    return 2.0 * keyframe_uncovered + least


def recover(
    vertices: np.ndarray,
    clouds: list[Cloud],
    faces: np.ndarray,
    edges: np.ndarray,
    keyframe: int,
    device: wp.Device | None = None,
) -> tuple[list[int], list[int]]:
    """Fit lost frames again, in place: outwards from the keyframe, then inwards from covered frames behind lost ones.

    Args:
        vertices: shape (T, V, 3) float64; recovered frames are overwritten.
        clouds: T of them, in the same units. faces: (F, 3). edges: (E, 2), each once. keyframe: a frame that fits.
        device: see ``Matches``.

    Returns:
        Frames recovered, and frames that stay lost.
    """
    search = Search(vertices, clouds, ConnectedSurface.of(faces, edges), keyframe, device)
    for side in (range(keyframe + 1, len(clouds)), range(keyframe - 1, -1, -1)):
        for t in side:
            if search.lost(t):
                search.learn(t, t - side.step)
        for t in reversed(side[:-1]):
            if search.lost(t) and not search.lost(t + side.step):
                search.learn(t, t + side.step)
    return sorted(search.recovered), [t for t in range(len(clouds)) if t != keyframe and search.lost(t)]


class Search:
    """Frames, how much of their points is not covered, and which were recovered so far.

    Args:
        vertices: shape (T, V, 3) float64; frames that learn are overwritten. clouds: T of them, in the same unit.
        surface: of the mesh. keyframe: a frame that fits. device: where the nearest is looked for; None: on the host.
        noisy: whether the clouds' noise is wide.
    """

    def __init__(
        self,
        vertices: np.ndarray,
        clouds: list[Cloud],
        surface: ConnectedSurface,
        keyframe: int,
        device: wp.Device | None = None,
        noisy: bool = False,
    ) -> None:
        self.vertices, self._clouds, self._surface, self._keyframe = vertices, clouds, surface, keyframe
        self._device = device
        self._matches = [Matches(cloud, surface, device) for cloud in clouds]
        self._uncovered: dict[int, float] = {}
        self._bound = lost_above(self.uncovered(keyframe), noisy)
        self.recovered: set[int] = set()

    def uncovered(self, t: int) -> float:
        """Share of frame t's points that its mesh does not cover."""
        if t not in self._uncovered:
            self._uncovered[t] = self._matches[t].uncovered(self.vertices[t])
        return self._uncovered[t]

    def far(self, t: int, spacings: float, noise: float = 0.0) -> float:
        """Share of frame t's vertices farther than so many of its points' spacings, or noise, from all of these."""
        return self._matches[t].far(self.vertices[t], spacings, noise)

    def place(self, t: int, vertices: np.ndarray) -> None:
        """Frame t has these vertices (V, 3) now."""
        self.vertices[t] = vertices
        self._uncovered.pop(t, None)

    def lost(self, t: int) -> bool:
        """Whether a part of frame t's points is not covered."""
        return self.uncovered(t) > self._bound

    @cached_property
    def _graph(self) -> DeformationGraph:
        return DeformationGraph.build(self.vertices[self._keyframe], self._surface.edges, NODES)

    def learn(self, t: int, neighbour: int) -> bool:
        """Bend a neighbour's mesh onto frame t, and keep what covers more; says whether it did."""
        if self.uncovered(neighbour) > _NOTHING:
            return False
        if not self._matches[t].cloud.oriented:
            cloud = self._clouds[t].turned_outwards(self.vertices[neighbour], self._surface.faces)
            self._matches[t] = Matches(cloud, self._surface, self._device)
            self._uncovered.pop(t, None)
        found, rest = False, self.vertices[neighbour]
        looser = () if self.lost(neighbour) else LOOSER  # what is lost itself teaches little
        for rule in ((REACH, AGREEMENT), *looser):
            again = _bend(self._graph, rest, self._matches[t], rule)
            left = self._matches[t].uncovered(again)
            # Looser matches are trusted only if in the end nothing is lost.
            enough = self._bound if rule in looser else max(_BETTER * self.uncovered(t), self._bound)
            if left <= enough:
                self.vertices[t], self._uncovered[t] = again, left
                self.recovered.add(t)
                found = True
            if not self.lost(t):
                break
        return found


def _bend(graph: DeformationGraph, rest: np.ndarray, matches: Matches, rule: tuple[float, float]) -> np.ndarray:
    """The mesh ``rest`` bent onto the cloud of ``matches``, by those that ``rule`` (reach, agreement) trusts."""
    pose, placed = Pose.identity(len(graph.node)), rest
    for _ in range(ROUNDS):
        trusted, goal, normal = matches.find(placed, rule)
        if not len(trusted):
            break
        some = np.unique(np.linspace(0, len(trusted) - 1, MATCHES).astype(int))
        pose = graph.step(rest, pose, trusted[some], goal[some], normal[some], RIGIDITY, TANGENTIAL)
        before, placed = placed, graph.place(rest, pose)
        if np.abs(placed - before).max() < _STILL * REACH * matches.spacing:
            break
    return placed
