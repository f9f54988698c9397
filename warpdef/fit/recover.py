"""Lost limbs found again: a frame whose points the mesh does not cover is fitted once more, from its neighbour.

A leg that swings by a fifth of the body finds the other leg nearest, and stays there. What tells right from wrong is
the surface: a wrong match is not connected to the rest of the body by matches. So the neighbour's mesh is bent towards
the points by the matches of one connected part alone; all else follows as rigidly as it can. Step by step the hip turns
the thigh, the thigh carries the foot, and the connected part grows until it is the whole mesh. Frame by frame outwards
from the keyframe, so that behind a frame that is found again the next ones are, too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warpdef.fit.embedded import DeformationGraph, Pose
from warpdef.template.normals import estimate_normals, repair_normals, turned_to
from warpdef.topology import component_labels, vertex_normals

NODES = 400
"""Nodes of the deformation graph."""
ROUNDS = 25
"""Gauss-Newton steps, each on new matches."""
REACH = 3.0
"""Largest distance of a match, in point spacings of the frame."""
AGREEMENT = 0.6
"""Least cosine between the normals of a match."""
RIGIDITY = 0.03
"""Weight of rigidity between nodes, mean over links, against the mean squared distance along normals."""
TANGENTIAL = 0.02
"""Weight of a match's distance along the surface."""
LOST = 0.005
"""Share of points that no connected part covers, above twice the keyframe's, from which a frame has lost something."""
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

    def turned_outwards(self) -> Cloud:
        """The same with sides that agree all over, from the points alone; costs about a second."""
        if self.given:
            normals, _ = repair_normals(self.points, self.normals)
        else:
            normals = turned_to(self.normals, estimate_normals(self.points))
        return Cloud(self.points, normals, self.given, oriented=True)


@dataclass(frozen=True)
class Surface:
    """faces: (F, 3). edges: (E, 2), each once. component: which connected component a vertex is in (V,)."""

    faces: np.ndarray
    edges: np.ndarray
    component: np.ndarray

    @classmethod
    def of(cls, faces: np.ndarray, edges: np.ndarray) -> Surface:
        return cls(faces, edges, component_labels(*edges.T, int(max(faces.max(), edges.max())) + 1))


class Matches:
    """Which vertices of a mesh lie on a cloud, in one connected part of the mesh."""

    def __init__(self, cloud: Cloud, surface: Surface) -> None:
        from scipy.spatial import cKDTree

        self.cloud, self.surface = cloud, surface
        self.tree = cKDTree(cloud.points)
        self.reach = REACH * float(np.median(self.tree.query(cloud.points, k=2)[0][:, 1]))

    def find(self, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Trusted vertices (m,), the points (m, 3) nearest to them and their normals (m, 3)."""
        s = self.surface
        distance, nearest = self.tree.query(vertices)
        cosine = (vertex_normals(vertices, s.faces) * self.cloud.normals[nearest]).sum(axis=1)
        on = (distance < self.reach) & ((cosine if self.cloud.oriented else np.abs(cosine)) > AGREEMENT)
        kept = s.edges[on[s.edges].all(axis=1)]
        part = component_labels(*kept.T, len(vertices))
        # A separate object is no lost limb: of every component of the mesh the largest part counts.
        size = np.bincount(part[on], minlength=part.max() + 1)
        largest = np.zeros(s.component.max() + 1, dtype=int)
        np.maximum.at(largest, s.component[on], size[part[on]])
        trusted = np.flatnonzero(on & (size[part] == largest[s.component]))
        return trusted, self.cloud.points[nearest[trusted]], self.cloud.normals[nearest[trusted]]

    def uncovered(self, vertices: np.ndarray) -> float:
        """Share of the cloud's points without a trusted vertex within reach."""
        from scipy.spatial import cKDTree

        trusted, _, _ = self.find(vertices)
        if not len(trusted):
            return 1.0
        distance, nearest = cKDTree(vertices[trusted]).query(self.cloud.points)
        # The middle of a triangle is up to 0.6 of its longest edge away from its corners.
        around, edges = np.zeros(len(vertices)), self.surface.edges
        length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
        np.maximum.at(around, edges, length[:, None])
        return float(np.mean(distance > self.reach + 0.6 * around[trusted][nearest]))


def lost_above(keyframe_uncovered: float) -> float:
    """Uncovered share of points above which a frame has lost something."""
    return 2.0 * keyframe_uncovered + LOST


def recover(
    vertices: np.ndarray, clouds: list[Cloud], faces: np.ndarray, edges: np.ndarray, keyframe: int
) -> tuple[list[int], list[int]]:
    """Fit lost frames again, outwards from the keyframe, in place.

    Args:
        vertices: shape (T, V, 3) float64; recovered frames are overwritten.
        clouds: T of them, in the same units. faces: (F, 3). edges: (E, 2), each once. keyframe: a frame that fits.

    Returns:
        Frames recovered, and frames that stay lost.
    """
    surface = Surface.of(faces, edges)
    matches = [Matches(cloud, surface) for cloud in clouds]
    uncovered = [m.uncovered(v) for m, v in zip(matches, vertices, strict=True)]
    bound = lost_above(uncovered[keyframe])
    recovered, lost = [], []
    graph = None
    for side in (range(keyframe + 1, len(clouds)), range(keyframe - 1, -1, -1)):
        for t in side:
            if uncovered[t] <= bound:
                continue
            inner = t - side.step
            if uncovered[inner] <= _NOTHING:
                graph = graph or DeformationGraph.build(vertices[keyframe], edges, NODES)
                if not clouds[t].oriented:
                    matches[t] = Matches(clouds[t].turned_outwards(), surface)
                    uncovered[t] = matches[t].uncovered(vertices[t])
                again = _bend(graph, vertices[inner], matches[t])
                left = matches[t].uncovered(again)
                if left <= max(_BETTER * uncovered[t], bound):
                    vertices[t], uncovered[t] = again, left
                    recovered.append(t)
            if uncovered[t] > bound:
                lost.append(t)
    return sorted(recovered), sorted(lost)


def _bend(graph: DeformationGraph, rest: np.ndarray, matches: Matches) -> np.ndarray:
    """The mesh ``rest`` bent onto the cloud of ``matches``."""
    pose, placed = Pose.identity(len(graph.node)), rest
    for _ in range(ROUNDS):
        trusted, goal, normal = matches.find(placed)
        if not len(trusted):
            break
        pose = graph.step(rest, pose, trusted, goal, normal, RIGIDITY, TANGENTIAL)
        before, placed = placed, graph.place(rest, pose)
        if np.abs(placed - before).max() < _STILL * matches.reach:
            break
    return placed
