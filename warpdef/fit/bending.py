"""A mesh bent onto what a camera saw of it, from coarse to fine: how partly seen frames are followed.

What one camera shows is never the same surface twice: fingers turn out of sight and come back. Nearest points then
shrink onto what is left. So the whole mesh is bent by a few hundred rigid pieces (``embedded``), stiff and with a far
reach first, softer and nearer after that, and by matches of three kinds of honesty: the normals of a match agree (a
point that faces the camera is not on the far side), every point asks for the vertex that suits it best, and a vertex
asks back only if its point asks for it or for a vertex close by. What no point asks for goes along, as rigid as the
pieces are; bent from its own shape each time, it neither shrinks nor drifts. Where the camera would have seen it and
did not, it is pushed out of sight, gently.

Where a finger moves by more than the gap to the next, nearest points lead it to the place of another. Then points are
shared out first (``transport``), which no finger can have twice; but where fingers are hidden that leads others astray.
So both ways are gone, and what leaves less uncovered, doubled and stretched is taken. A finger that went astray leads
the next frames astray, too: points are shared out once more by the mesh at rest, whose fingers are apart.

Places and normals are matched together: nearest neighbours in the six numbers (x, FACING s n), s the point spacing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from warpdef.fit.embedded import DeformationGraph, Pose
from warpdef.fit.measures import stretched_share
from warpdef.fit.transport import partial_transport, transport_cost
from warpdef.geometry.edges import edge_lengths
from warpdef.geometry.rotations import nearest_rotation
from warpdef.geometry.sampling import mean_spacing, spread_evenly
from warpdef.geometry.triangles import is_watertight, vertex_normals
from warpdef.geometry.viewpoint import Picture

NODES = 300
POINTS = 2000
"""Points of a frame, and vertices, that are matched: spread evenly."""
COARSE = 1000
"""The same while they are far apart."""
COARSE_SCHEDULE = ((20.0, 30.0, 4), (14.0, 5.0, 3), (8.0, 1.0, 5), (6.0, 0.3, 5))
"""Reach in point spacings, rigidity, and Gauss-Newton steps with them at most."""
SCHEDULE = ((5.0, 0.1, 5), (3.0, 0.03, 5))
"""The same of all points."""
STILL = 0.3
"""Largest move of a vertex in a step, in point spacings, below which the next reach is taken."""
FACING = 3.0
AGREEMENT = 0.3
ALONG = 0.1
WAY_BACK = 3.0
"""Distance, in point spacings, between a vertex and the one that its point asks for, at which it counts by 1/e."""
_NOTHING = 1e-3
SHARED = 600
"""Points of a frame, and vertices, that share each other."""
SHARES = ((4.0, 8.0, 30.0, 4), (2.5, 8.0, 3.0, 5), (1.5, 6.0, 0.5, 6), (1.0, 4.0, 0.2, 6))
"""Blur and reach in the spacing of the points that are shared, rigidity, and Gauss-Newton steps at most."""
TURN = 8.0
"""What opposite normals cost half of, in the square of that spacing."""
FAULTLESS = 0.015
"""Fault up to which no other way is tried."""
BETTER = 0.85
"""Share of a fault below which the other way is taken: by the first what is hidden stays nearer to where it was."""
HALF, RIGHT = 0.5, 0.03
"""From another start than the frame before: share of its fault that is better beyond doubt, as a leg found again leaves
0.3 to 0.4 of it; and fault below which ``BETTER`` will do. What is wrong either way stays where it was."""
ON = 4.0
"""Distance in (x, FACING s n), in point spacings, up to which a point and a vertex meet."""
ELSEWHERE = 1.5
"""Distance at rest over that in a pose, from which vertices that meet the same points do not belong together."""
ROOM = 4.0
"""Distance, in point spacings, from which a vertex stands where the camera would have seen it."""
FULL_VIEW = 12.0
"""The same from which that is beyond doubt."""
PUSH = 0.05
"""Weight of such a vertex, back to what was seen."""
_UNMET = 0.1  # weight of a vertex's own match below which it is no match
_LITTLE = 1e-2
_TINY = 1e-30


Schedule = tuple[tuple[float, float, int], ...]
Matched = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Vertices (m,), their goals and the normals there, (m, 3) each, and weights (m,)."""


@dataclass(frozen=True)
class SeenCloud:
    """points: (N, 3). normals: (N, 3), unit, on the camera's side. spacing: mean distance to the nearest point.
    eye: place of the camera (3,), None if there is none."""

    points: np.ndarray
    normals: np.ndarray
    spacing: float
    eye: np.ndarray | None = None

    @classmethod
    def of(cls, points: np.ndarray, normals: np.ndarray, eye: np.ndarray | None = None) -> SeenCloud:
        """At most ``POINTS`` of points (N, 3) with normals (N, 3)."""
        chosen = spread_evenly(points, POINTS)
        return cls(points[chosen], normals[chosen], mean_spacing(points[chosen]), eye)

    @cached_property
    def picture(self) -> Picture | None:
        """Its points as the camera saw them."""
        return None if self.eye is None else Picture.of(self.points, self.eye)

    def thinned(self, count: int) -> SeenCloud:
        """At most ``count`` of its points."""
        chosen = spread_evenly(self.points, count)
        return replace(
            self, points=self.points[chosen], normals=self.normals[chosen], spacing=mean_spacing(self.points[chosen])
        )


@dataclass(frozen=True)
class _Sample:
    """vertex: those that are matched (m,). faces: that touch them (f, 3), which alone tell their normals."""

    vertex: np.ndarray
    faces: np.ndarray

    @classmethod
    def of(cls, rest: np.ndarray, faces: np.ndarray, count: int) -> _Sample:
        """At most ``count`` vertices of a mesh at rest, spread evenly."""
        chosen = spread_evenly(rest, count)
        return cls(chosen, faces[np.isin(faces, chosen).any(axis=1)])

    def facing(self, placed: np.ndarray) -> np.ndarray:
        """Normals at its vertices among all of them, placed (V, 3); elsewhere they mean nothing."""
        return vertex_normals(placed, self.faces)


def worth(fault: float) -> float:
    """Fault below which a pose found from another start is taken for one of this fault."""
    return max(HALF * fault, min(BETTER * fault, RIGHT))


class Bending:
    """A mesh at rest, (V, 3) with faces (F, 3) and edges (E, 2), and the graph that bends it."""

    def __init__(self, rest: np.ndarray, faces: np.ndarray, edges: np.ndarray) -> None:
        self.rest, self.faces = rest, faces
        self.graph = DeformationGraph.build(rest, edges, NODES)
        if is_watertight(faces):
            self.graph = self.graph.braced(rest, vertex_normals(rest, faces))
        self._chosen, self._coarse, self._sharing = (_Sample.of(rest, faces, n) for n in (POINTS, COARSE, SHARED))
        self.edges, self._lengths = edges, edge_lengths(rest, edges)

    @property
    def matched(self) -> np.ndarray:
        """Vertices that are matched, spread evenly; at most ``POINTS``."""
        return self._chosen.vertex

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

    def facing(self, placed: np.ndarray) -> np.ndarray:
        """Normals at vertices that are matched among all of them, placed (V, 3); elsewhere they mean nothing."""
        return self._chosen.facing(placed)

    def settled(self, cloud: SeenCloud, start: Pose) -> Pose:
        """The pose by nearest points from one that is close to it."""
        return self._by_nearest(cloud, start, SCHEDULE, self._chosen)

    def by_part(self, cloud: SeenCloud, start: Pose, vertex: np.ndarray, schedule: Schedule) -> Pose:
        """The same by some vertices alone (m,); what has no match stays bent as at rest."""
        part = _Sample(vertex, self.faces[np.isin(self.faces, vertex).any(axis=1)])
        return self._by_nearest(cloud, start, schedule, part, self.still())

    def onto(self, cloud: SeenCloud, start: Pose, usual: float = 0.0) -> Pose:
        """The pose that brings the mesh onto a cloud, looked for from another by nearest points or, if better, shares;
        arguments as ``best``."""
        return self.best(cloud, start, usual)[0]

    def best(self, cloud: SeenCloud, start: Pose, usual: float = 0.0, other: Pose | None = None) -> tuple[Pose, float]:
        """That pose and its fault; by shares from an ``other`` pose as well, if there is one.

        What is found is enough where it leaves no more than the ``usual`` fault, that of the frame before: what no way
        could mend there is the shape's.
        """
        near = self._by_nearest(cloud.thinned(COARSE), start, COARSE_SCHEDULE, self._coarse)
        found = self._by_nearest(cloud, near, SCHEDULE, self._chosen, start)
        left = self.fault(cloud, found)
        for begin in (start, other):
            if begin is None or left <= max(FAULTLESS, usual):
                break
            shared = self._by_shares(cloud.thinned(SHARED), begin)
            shared = self._by_nearest(cloud, shared, SCHEDULE, self._chosen, begin)
            instead = self.fault(cloud, shared)
            if instead < (BETTER * left if begin is start else worth(left)):
                found, left = shared, instead
        return found, left

    def fault(self, cloud: SeenCloud, pose: Pose) -> float:
        """Shares of points uncovered, of vertices on the place of others, of edges stretched, and half of the share of
        vertices that stand in full view unseen: sensors do lose what is steep, or dark, or alone.

        A vertex is on the place of another where the vertex that suits its point best is near, but far from it in
        the mesh at rest.
        """
        from scipy.spatial import cKDTree

        placed, s = self.place(pose), cloud.spacing
        facing, chosen = self._chosen.facing(placed), self._chosen.vertex
        seen = np.column_stack([cloud.points, FACING * s * cloud.normals])
        mesh = np.column_stack([placed[chosen], FACING * s * facing[chosen]])
        away, asked = cKDTree(mesh).query(seen)
        met, asking = cKDTree(seen).query(mesh)
        best = chosen[asked[asking]]
        apart = np.linalg.norm(self.rest[best] - self.rest[chosen], axis=1)
        beside = np.linalg.norm(placed[best] - placed[chosen], axis=1)
        double = (met < ON * s) & (apart > ELSEWHERE * beside + ON * s)
        unseen = len(self._contradicted(cloud, placed, facing, chosen[met > ON * s], FULL_VIEW)[0])
        shares = np.mean(away > ON * s), np.mean(double), stretched_share(placed, self.edges, self._lengths)
        return float(sum(shares)) + 0.5 * unseen / len(chosen)

    def _by_shares(self, cloud: SeenCloud, start: Pose) -> Pose:
        """From a pose towards where vertices have their share of the points (``transport``), ever closer."""
        points, normals, s = cloud.points, cloud.normals, cloud.spacing
        vertex = self._sharing.vertex
        own = mean_spacing(self.rest[vertex])
        pose, placed = start, self.place(start)
        for blur, reach, rigidity, steps in SHARES:
            for _ in range(steps):
                facing = self._sharing.facing(placed)
                cost = transport_cost(placed[vertex] / s, facing[vertex], points / s, normals, TURN)
                plan = partial_transport(cost, (own / s) ** 2, 1.0, blur**2, reach**2)
                weight = plan.sum(axis=1)
                goal = plan @ points / np.maximum(weight, _TINY)[:, None]
                normal = plan @ normals
                normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), _TINY)
                weight = np.minimum(weight * (s / own) ** 2, 1.0)
                kept = weight > _LITTLE
                if not kept.any():
                    return pose
                matched = (vertex[kept], goal[kept], normal[kept], weight[kept])
                matched = self._with_pushed(matched, cloud, placed, facing, vertex[weight < _UNMET])
                pose = self.graph.step(self.rest, pose, *matched[:3], rigidity, 1.0, matched[3])
                before, placed = placed, self.place(pose)
                if np.abs(placed - before).max() < STILL * s:
                    break
        return pose

    def _by_nearest(
        self,
        cloud: SeenCloud,
        start: Pose,
        schedule: Schedule,
        sample: _Sample,
        usual: Pose | None = None,
    ) -> Pose:
        """From a pose by nearest neighbours; what has none stays bent as in the ``usual`` pose, or where it starts."""
        from scipy.spatial import cKDTree

        pose, turned, bend = start, FACING * cloud.spacing, self.graph.bend(self.rest, usual or start)
        placed, chosen = self.place(pose), sample.vertex
        seen = np.column_stack([cloud.points, turned * cloud.normals])
        tree = cKDTree(seen)
        for reach, rigidity, steps in schedule:
            for _ in range(steps):
                facing = sample.facing(placed)
                mesh = np.column_stack([placed[chosen], turned * facing[chosen]])
                asked = chosen[cKDTree(mesh).query(seen)[1]]
                asking = tree.query(mesh)[1]
                vertex = np.concatenate([asked, chosen])
                point = np.concatenate([np.arange(len(cloud.points)), asking])
                away = np.linalg.norm(placed[vertex] - cloud.points[point], axis=1)
                agree = (facing[vertex] * cloud.normals[point]).sum(axis=1) > AGREEMENT
                weight = np.exp(-((away / (reach * cloud.spacing)) ** 2)) * agree
                back = np.linalg.norm(placed[asked[asking]] - placed[chosen], axis=1)
                weight[len(asked) :] *= np.exp(-((back / (WAY_BACK * cloud.spacing)) ** 4))
                kept = weight > _NOTHING
                if not kept.any():
                    return pose
                unmet = chosen[weight[len(asked) :] < _UNMET]
                vertex, point = vertex[kept], point[kept]
                matched = (vertex, cloud.points[point], cloud.normals[point], weight[kept])
                # A camera hides limbs; where all is seen, what no match holds is lost, and looked for.
                stays = None if cloud.picture is None else self._usual(pose, bend, vertex, weight[kept])
                matched = self._with_pushed(matched, cloud, placed, facing, unmet)
                pose = self.graph.step(self.rest, pose, *matched[:3], rigidity, ALONG, matched[3], stays)
                before, placed = placed, self.place(pose)
                if np.abs(placed - before).max() < STILL * cloud.spacing:
                    break
        return pose

    def _usual(self, pose: Pose, bend: np.ndarray, vertex: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """Of links with a node that no match (m,) holds, how they usually are bent (e, 3), turned as they are now."""
        graph = self.graph
        share = graph.weight[vertex] * weight[:, None]
        held = np.bincount(graph.index[vertex].ravel(), weights=share.ravel(), minlength=len(graph.node))
        hidden = np.any((held < _UNMET)[graph.link], axis=1)
        return np.einsum("eab,eb->ea", pose.rotation[graph.link[:, 0]], bend) * hidden[:, None]

    def _contradicted(
        self, cloud: SeenCloud, placed: np.ndarray, facing: np.ndarray, vertex: np.ndarray, room: float = ROOM
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Which of some vertices (m,) the camera would have seen and did not, where they may be, and the way there."""
        if cloud.picture is None:
            return vertex[:0], placed[:0], placed[:0]
        towards = vertex[(facing[vertex] * (cloud.picture.eye - placed[vertex])).sum(axis=1) > 0.0]
        which, goal, way = cloud.picture.contradicts(placed[towards], room * cloud.spacing)
        return towards[which], goal, way

    def _with_pushed(self, matched: Matched, *asked: Any) -> Matched:
        """Matches, and what is pushed to where the camera may not have seen it."""
        vertex, goal, way = self._contradicted(*asked)
        more = vertex, goal, way, np.full(len(vertex), PUSH)
        first, second, third, fourth = (np.concatenate(pair) for pair in zip(matched, more, strict=True))
        return first, second, third, fourth
