"""A mesh bent onto what a camera saw of it, from coarse to fine: how partly seen frames are followed.

What one camera shows is never the same surface twice: fingers turn out of sight and come back. Nearest points then
shrink onto what is left. So the whole mesh is bent by a few hundred rigid pieces (``embedded``), stiff and with a far
reach first, softer and nearer after that, and by matches of three kinds of honesty: the normals of a match agree (a
point that faces the camera is not on the far side), every point asks for the vertex that suits it best, and a vertex
asks back only if its point asks for it or for a vertex close by. What no point asks for goes along, as rigid as the
pieces are; bent from its own shape each time, it neither shrinks nor drifts.

Places and normals are matched together: nearest neighbours in the six numbers (x, FACING s n), s the point spacing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warpdef.fit.embedded import DeformationGraph, Pose
from warpdef.geometry.rotations import nearest_rotation
from warpdef.geometry.sampling import spread_evenly
from warpdef.geometry.triangles import is_watertight, vertex_normals

NODES = 300
POINTS = 2000
"""Points of a frame, and vertices, that are matched: spread evenly."""
SCHEDULE = ((30.0, 30.0, 4), (20.0, 5.0, 3), (12.0, 1.0, 5), (8.0, 0.3, 5), (5.0, 0.1, 5), (3.0, 0.03, 5))
"""Reach in point spacings, rigidity, and Gauss-Newton steps with them at most."""
STILL = 0.3
"""Largest move of a vertex in a step, in point spacings, below which the next reach is taken."""
FACING = 3.0
AGREEMENT = 0.3
ALONG = 0.1
WAY_BACK = 3.0
"""Distance, in point spacings, between a vertex and the one that its point asks for, at which it counts by 1/e."""
_NOTHING = 1e-3


@dataclass(frozen=True)
class SeenCloud:
    """points: (N, 3). normals: (N, 3), unit, on the camera's side. spacing: mean distance to the nearest point."""

    points: np.ndarray
    normals: np.ndarray
    spacing: float

    @classmethod
    def of(cls, points: np.ndarray, normals: np.ndarray) -> SeenCloud:
        """At most ``POINTS`` of points (N, 3) with normals (N, 3)."""
        from scipy.spatial import cKDTree

        if len(points) > POINTS:
            chosen = spread_evenly(points, POINTS)
            points, normals = points[chosen], normals[chosen]
        return cls(points, normals, float(cKDTree(points).query(points, k=2)[0][:, 1].mean()))


class Bending:
    """A mesh at rest, (V, 3) with faces (F, 3) and edges (E, 2), and the graph that bends it."""

    def __init__(self, rest: np.ndarray, faces: np.ndarray, edges: np.ndarray) -> None:
        self.rest, self.faces = rest, faces
        self.graph = DeformationGraph.build(rest, edges, NODES)
        if is_watertight(faces):
            self.graph = self.graph.braced(rest, vertex_normals(rest, faces))
        self._chosen = spread_evenly(rest, POINTS) if len(rest) > POINTS else np.arange(len(rest))

    def still(self) -> Pose:
        """The pose of the mesh at rest."""
        return Pose.identity(len(self.graph.node))

    def pose_of(self, vertices: np.ndarray) -> Pose:
        """The pose in which the nodes are where they are among vertices (V, 3), turned as their links are."""
        rest, there, (a, b) = self.rest[self.graph.node], vertices[self.graph.node], self.graph.link.T
        turn = np.zeros((len(rest), 3, 3))
        np.add.at(turn, a, (there[b] - there[a])[:, :, None] * (rest[b] - rest[a])[:, None, :])
        return Pose(nearest_rotation(turn), there - rest)

    def place(self, pose: Pose) -> np.ndarray:
        """All vertices in a pose, (V, 3)."""
        return self.graph.place(self.rest, pose)

    def onto(self, cloud: SeenCloud, start: Pose) -> Pose:
        """The pose that brings the mesh onto a cloud, looked for from another."""
        from scipy.spatial import cKDTree

        pose, turned = start, FACING * cloud.spacing
        placed = self.place(pose)
        seen = np.column_stack([cloud.points, turned * cloud.normals])
        tree = cKDTree(seen)
        for reach, rigidity, steps in SCHEDULE:
            for _ in range(steps):
                facing = vertex_normals(placed, self.faces)
                mesh = np.column_stack([placed, turned * facing])[self._chosen]
                asked = self._chosen[cKDTree(mesh).query(seen)[1]]
                asking = tree.query(mesh)[1]
                vertex = np.concatenate([asked, self._chosen])
                point = np.concatenate([np.arange(len(cloud.points)), asking])
                away = np.linalg.norm(placed[vertex] - cloud.points[point], axis=1)
                agree = (facing[vertex] * cloud.normals[point]).sum(axis=1) > AGREEMENT
                weight = np.exp(-((away / (reach * cloud.spacing)) ** 2)) * agree
                back = np.linalg.norm(placed[asked[asking]] - placed[self._chosen], axis=1)
                weight[len(asked) :] *= np.exp(-((back / (WAY_BACK * cloud.spacing)) ** 4))
                kept = weight > _NOTHING
                if not kept.any():
                    return pose
                vertex, point, weight = vertex[kept], point[kept], weight[kept]
                goal = cloud.points[point], cloud.normals[point]
                pose = self.graph.step(self.rest, pose, vertex, *goal, rigidity, ALONG, weight)
                before, placed = placed, self.place(pose)
                if np.abs(placed - before).max() < STILL * cloud.spacing:
                    break
        return pose
