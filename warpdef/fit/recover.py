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
from warpdef.template.normals import estimate_normals, repair_normals

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
            outward = estimate_normals(self.points)
            normals = np.where((self.normals * outward).sum(axis=1, keepdims=True) < 0, -self.normals, self.normals)
        return Cloud(self.points, normals, self.given, oriented=True)


class Matches:
    """Which vertices of a mesh lie on a cloud, in one connected part of the mesh."""

    def __init__(self, cloud: Cloud, faces: np.ndarray, edges: np.ndarray) -> None:
        from scipy.spatial import cKDTree

        self.cloud, self.faces, self.edges = cloud, faces, edges
        self.component = _components(edges, int(max(faces.max(), edges.max())) + 1)
        self.tree = cKDTree(cloud.points)
        self.reach = REACH * float(np.median(self.tree.query(cloud.points, k=2)[0][:, 1]))

    def find(self, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Trusted vertices (m,), the points (m, 3) nearest to them and their normals (m, 3)."""
        distance, nearest = self.tree.query(vertices)
        cosine = (vertex_normals(vertices, self.faces) * self.cloud.normals[nearest]).sum(axis=1)
        on = (distance < self.reach) & ((cosine if self.cloud.oriented else np.abs(cosine)) > AGREEMENT)
        kept = self.edges[on[self.edges].all(axis=1)]
        part = _components(kept, len(vertices))
        # A separate object is no lost limb: of every component of the mesh the largest part counts.
        size = np.bincount(part[on], minlength=part.max() + 1)
        largest = np.zeros(self.component.max() + 1, dtype=int)
        np.maximum.at(largest, self.component[on], size[part[on]])
        trusted = np.flatnonzero(on & (size[part] == largest[self.component]))
        return trusted, self.cloud.points[nearest[trusted]], self.cloud.normals[nearest[trusted]]

    def uncovered(self, vertices: np.ndarray) -> float:
        """Share of the cloud's points without a trusted vertex within reach."""
        from scipy.spatial import cKDTree

        trusted, _, _ = self.find(vertices)
        if not len(trusted):
            return 1.0
        distance, nearest = cKDTree(vertices[trusted]).query(self.cloud.points)
        # The middle of a triangle is up to 0.6 of its longest edge away from its corners.
        around = np.zeros(len(vertices))
        length = np.linalg.norm(vertices[self.edges[:, 0]] - vertices[self.edges[:, 1]], axis=1)
        np.maximum.at(around, self.edges, length[:, None])
        return float(np.mean(distance > self.reach + 0.6 * around[trusted][nearest]))


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
    matches = [Matches(cloud, faces, edges) for cloud in clouds]
    uncovered = [m.uncovered(v) for m, v in zip(matches, vertices, strict=True)]
    bound = 2.0 * uncovered[keyframe] + LOST
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
                    matches[t] = Matches(clouds[t].turned_outwards(), faces, edges)
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


def _components(edges: np.ndarray, count: int) -> np.ndarray:
    """Number of the connected component of each of ``count`` vertices."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import connected_components

    linked = csr_matrix((np.ones(len(edges)), tuple(edges.T)), shape=(count, count))
    return connected_components(linked, directed=False)[1]


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normals (V, 3), weighted by area; zero where all faces around are degenerate."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    total = np.stack(
        [np.bincount(faces.ravel(), np.repeat(across[:, k], 3), minlength=len(vertices)) for k in range(3)], axis=1
    )
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30)
