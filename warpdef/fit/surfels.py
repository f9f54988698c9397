"""A body as oriented points, bent as one onto what a camera saw of it: how a surface is followed that still grows.

A mesh that is but a part of the body slides over it when the body turns: its border is drawn to where the cloud ends,
and the cloud's to where the mesh does. So neither a border of the model nor one of the cloud is ever matched here, and
a motion begins with what frame and frame before say of it: each piece goes on as it went, then all turns as one rigid
body, and only then rigid pieces (``embedded``) bend, stiffly, so that nothing is stretched to fit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from warpdef.fit.bending import AGREEMENT, ALONG, FACING, STILL, WAY_BACK
from warpdef.fit.embedded import DeformationGraph, Pose, rotations
from warpdef.geometry.borders import border_points
from warpdef.geometry.cloud_planes import unit_vectors
from warpdef.geometry.rotations import nearest_rotation
from warpdef.geometry.sampling import mean_spacing, spread_evenly

MATCHED = 2000
"""Points of a frame that are matched: spread evenly."""
TURNED, TURN_SHRINK, TURN_REACH, TURN_STEPS = 30.0, 0.8, 3.0, 40
"""Reach of the first step of the rigid motion in spacings, its factor from step to step, the least, and most steps."""
_STILL_TURN = 1e-3  # largest component of a step's rotation and shift, cube units, below which it has arrived ...
_SETTLED_TURN = 12  # ... once the reach is small
STAGES = ((12.0, 2.0, 4), (8.0, 1.0, 4), (5.0, 0.5, 4), (3.0, 0.1, 4))
"""Reach in spacings, rigidity, and Gauss-Newton steps at most of the bending that follows."""
SEEN = 0.1  # least cosine to the camera of a surfel that asks for points
_NEGLIGIBLE = 1e-3  # weight of a match
NEIGHBOURS = 8
LINKED = 3.0  # largest length of an edge between surfels, in spacings
SURFELS_A_NODE, NODES_LEAST, NODES_MOST = 10, 50, 400
EXPLAINED_ACROSS, EXPLAINED_ALONG, EXPLAINED_FACING = 2.0, 1.2, 0.5
"""A point is explained that is within these many spacings of a surfel, and whose normal has at least this cosine."""
MET = 0.5  # weight of its matches from which a frame shows a surfel
HELD = 0.2  # share of a node's surfels that a frame must show to hold it
CARRIERS = 4  # surfels whose motions are averaged at a place
JOINED = 2.5  # largest distance of neighbours in a cloud, in spacings, over which a surface goes on


@dataclass(frozen=True)
class SeenFrame:
    """What a camera saw: points (N, 3), normals (N, 3) on its side, and where the camera is, view (3,)."""

    points: np.ndarray
    normals: np.ndarray
    view: np.ndarray

    @cached_property
    def sample(self) -> np.ndarray:
        """The points that are matched, (n,)."""
        return spread_evenly(self.points, MATCHED)

    @cached_property
    def border(self) -> np.ndarray:
        """Which of these lie where the cloud ends, (n,) bool."""
        return border_points(self.points[self.sample], self.normals[self.sample])

    @cached_property
    def spacing(self) -> float:
        """Mean distance of the sample's points to their nearest."""
        return mean_spacing(self.points[self.sample])

    def turned_onto(self, other: SeenFrame) -> np.ndarray:
        """The rotation (3, 3) of the rigid motion that brings this frame onto another."""
        chosen = self.sample
        return _turn(self.points[chosen], self.normals[chosen], self.border, other)[0]


@dataclass(frozen=True)
class Pulled:
    """Points of a frame where they were at rest: points, normals (N, 3); explained, whether surfels are there (N,);
    anchor, the surfel with which each moves (N,); distance to an explained one along the surface, inf if none (N,)."""

    points: np.ndarray
    normals: np.ndarray
    explained: np.ndarray
    anchor: np.ndarray
    distance: np.ndarray


class Surfels:
    """points, normals: at rest, (M, 3). spacing: of the samples that they are matched with."""

    def __init__(self, points: np.ndarray, normals: np.ndarray, spacing: float) -> None:
        from scipy.spatial import cKDTree

        self.points, self.normals, self.spacing = points, normals, spacing
        count = min(NEIGHBOURS, len(points) - 1)
        distance, index = cKDTree(points).query(points, k=count + 1)
        one, other = np.repeat(np.arange(len(points)), count), index[:, 1:].ravel()
        linked = (distance[:, 1:].ravel() < LINKED * spacing) & ((normals[one] * normals[other]).sum(axis=1) > 0)
        edges = np.unique(np.sort(np.column_stack([one, other])[linked], axis=1), axis=0)
        nodes = int(np.clip(len(points) / SURFELS_A_NODE, NODES_LEAST, NODES_MOST))
        self.graph = _connected(DeformationGraph.build(points, edges, nodes), points)
        self.border = border_points(points, normals)

    def still(self) -> Pose:
        """The pose at rest."""
        return Pose.identity(len(self.graph.node))

    def motions(self, pose: Pose, surfels: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """x -> A x + b of some surfels, or of all: A (m, 3, 3), b (m, 3)."""
        g = self.graph
        index, weight = (g.index, g.weight) if surfels is None else (g.index[surfels], g.weight[surfels])
        anchor = self.points[g.node]
        shift = anchor + pose.shift - np.einsum("nab,nb->na", pose.rotation, anchor)
        return np.einsum("vk,vkab->vab", weight, pose.rotation[index]), np.einsum("vk,vka->va", weight, shift[index])

    def place(self, pose: Pose) -> tuple[np.ndarray, np.ndarray]:
        """Points and unit normals in a pose, (M, 3) both."""
        turn, shift = self.motions(pose)
        return np.einsum("vab,vb->va", turn, self.points) + shift, unit_vectors(
            np.einsum("vab,vb->va", turn, self.normals)
        )

    def carry(self, points: np.ndarray, normals: np.ndarray, pose: Pose) -> np.ndarray:
        """Oriented points at rest, (m, 3) both, where the nearest surfels take them in a pose, (m, 3)."""
        distance, index = nearest_facing(self.points, self.normals, points, normals, self.spacing, CARRIERS)
        weight = 1.0 / (distance + 0.1 * self.spacing)
        weight /= weight.sum(axis=1, keepdims=True)
        turn, shift = self.motions(pose)
        turn, shift = np.einsum("mk,mkab->mab", weight, turn[index]), np.einsum("mk,mka->ma", weight, shift[index])
        return np.einsum("mab,mb->ma", turn, points) + shift

    def supported(self, frame: SeenFrame, pose: Pose) -> np.ndarray:
        """Which nodes a frame holds in a pose, by the share of their surfels that it shows, (n,) bool."""
        g = self.graph
        surfel, _, weight = _matches(*self.place(pose), self.border, frame, STAGES[-1][0])
        met = np.bincount(surfel, weight, minlength=len(self.points)) > MET
        index, share = g.index.ravel(), g.weight.ravel()
        whole = np.bincount(index, share, minlength=len(g.node))
        held = np.bincount(index, share * np.repeat(met, g.index.shape[1]), minlength=len(g.node))
        return held > HELD * whole

    def going_on(self, pose: Pose, before: Pose, supported: np.ndarray) -> Pose:
        """The next pose, if every node goes on as it came here from the pose before; one that was not supported (n,)
        goes with all others, as one rigid body: what no frame shows would swing ever farther."""
        here, there = (self.points[self.graph.node] + p.shift for p in (pose, before))
        turn = pose.rotation @ before.rotation.transpose(0, 2, 1)
        step = np.einsum("nab,nb->na", turn, here - there)
        if supported.any():
            middle, was = here[supported].mean(axis=0), there[supported].mean(axis=0)
            spread = (here[supported] - middle).T @ (there[supported] - was)
            whole = nearest_rotation(spread)
            alone = ~supported
            turn[alone] = whole
            step[alone] = (here[alone] - was) @ whole.T + middle - here[alone]
        return Pose(turn @ pose.rotation, pose.shift + step)

    def onto(self, frame: SeenFrame, start: Pose) -> Pose:
        """The pose in which the surfels lie on a frame, looked for from another."""
        placed, facing = self.place(start)
        turn, shift = _turn(placed, facing, self.border, frame)
        anchor = self.points[self.graph.node]
        pose = Pose(turn @ start.rotation, (anchor + start.shift) @ turn.T + shift - anchor)
        for stage in STAGES:
            pose = self.settled(frame, pose, stage)
        return pose

    def settled(
        self, frame: SeenFrame, start: Pose, stage: tuple[float, float, int], bend: np.ndarray | None = None
    ) -> Pose:
        """The pose bent onto a frame from one near it, with reach, rigidity and steps at most as in ``STAGES``.

        bend: how links are bent where nothing else is known, (e, 3) in the frame of their first node; None: not at all.
        """
        points, normals = frame.points[frame.sample], frame.normals[frame.sample]
        reach, rigidity, steps = stage
        pose, (placed, facing) = start, self.place(start)
        for _ in range(steps):
            surfel, point, weight = _matches(placed, facing, self.border, frame, reach)
            if not len(surfel):
                break
            goal = points[point], normals[point]
            usual = None if bend is None else np.einsum("eab,eb->ea", pose.rotation[self.graph.link[:, 0]], bend)
            pose = self.graph.step(self.points, pose, surfel, *goal, rigidity, ALONG, weight, usual)
            before = placed
            placed, facing = self.place(pose)
            if np.abs(placed - before).max() < STILL * frame.spacing:
                break
        return pose

    def pull_back(self, frame: SeenFrame, pose: Pose) -> Pulled:
        """All points of a frame where they were at rest. What the surfels do not reach yet moves with the surfel that
        is nearest along the frame's own surface."""
        from scipy.sparse import csr_matrix
        from scipy.sparse.csgraph import dijkstra
        from scipy.spatial import cKDTree

        points, normals, spacing, total = frame.points, frame.normals, self.spacing, len(frame.points)
        placed, facing = self.place(pose)
        anchor = nearest_facing(placed, facing, points, normals, spacing)[1]
        off = points - placed[anchor]
        across = (off * facing[anchor]).sum(axis=1)
        along = np.linalg.norm(off - across[:, None] * facing[anchor], axis=1)
        explained = (np.abs(across) < EXPLAINED_ACROSS * spacing) & (along < EXPLAINED_ALONG * spacing)
        explained &= (facing[anchor] * normals).sum(axis=1) > EXPLAINED_FACING
        away = np.full(total, np.inf)
        if explained.any():
            near, index = cKDTree(points).query(points, k=min(NEIGHBOURS, total - 1) + 1)
            joined = near[:, 1:] < JOINED * spacing
            ends = np.repeat(np.arange(total), joined.sum(axis=1)), index[:, 1:][joined]
            walk = csr_matrix((np.maximum(near[:, 1:][joined], 1e-12), ends), shape=(total, total))
            known = np.flatnonzero(explained)
            away, _, source = dijkstra(walk, directed=False, indices=known, min_only=True, return_predecessors=True)
            reached = np.isfinite(away)
            anchor[reached] = anchor[source[reached]]
        turn, shift = self.motions(pose, anchor)
        rest = np.linalg.solve(turn, (points - shift)[:, :, None])[:, :, 0]
        return Pulled(rest, unit_vectors(np.einsum("vba,vb->va", turn, normals)), explained, anchor, away)

    def grown(
        self, points: np.ndarray, normals: np.ndarray, anchor: np.ndarray, poses: Mapping[int, Pose]
    ) -> tuple[Surfels, dict[int, Pose]]:
        """The same with more of them, (m, 3), that move with the surfels ``anchor`` (m,); and in all poses."""
        all_points, all_normals = np.concatenate([self.points, points]), np.concatenate([self.normals, normals])
        more = Surfels(all_points, all_normals, self.spacing)
        node = more.graph.node
        leader = np.concatenate([np.arange(len(self.points)), anchor])[node]
        rest, again = all_points[node], {}
        for frame, pose in poses.items():
            turn, shift = self.motions(pose, leader)
            again[frame] = Pose(nearest_rotation(turn), np.einsum("nab,nb->na", turn, rest) + shift - rest)
        return more, again


def _matches(
    placed: np.ndarray, facing: np.ndarray, border: np.ndarray, frame: SeenFrame, reach: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Surfels, points of the sample, and weights, (m,) each: both ask for what suits them best, in place and normal.

    What is on a border matches nothing; a surfel asks only if the camera could see it, and, as in ``bending``, if its
    point asks for a surfel close by.
    """
    points, normals = frame.points[frame.sample], frame.normals[frame.sample]
    asked = nearest_facing(placed, facing, points, normals, frame.spacing)[1]
    asking = nearest_facing(points, normals, placed, facing, frame.spacing)[1]
    surfel = np.concatenate([asked, np.arange(len(placed))])
    point = np.concatenate([np.arange(len(points)), asking])
    away = np.linalg.norm(placed[surfel] - points[point], axis=1)
    weight = np.exp(-((away / (reach * frame.spacing)) ** 2))
    weight *= ((facing[surfel] * normals[point]).sum(axis=1) > AGREEMENT) & ~border[surfel] & ~frame.border[point]
    back = np.linalg.norm(placed[asked[asking]] - placed, axis=1)
    weight[len(points) :] *= np.exp(-((back / (WAY_BACK * frame.spacing)) ** 4)) * (facing @ frame.view > SEEN)
    kept = weight > _NEGLIGIBLE
    return surfel[kept], point[kept], weight[kept]


def _turn(
    placed: np.ndarray, facing: np.ndarray, border: np.ndarray, frame: SeenFrame
) -> tuple[np.ndarray, np.ndarray]:
    """The rigid motion (3, 3), (3,) that brings oriented points onto a frame: point to plane, reach after reach."""
    points, normals = frame.points[frame.sample], frame.normals[frame.sample]
    turn, shift = np.eye(3), np.zeros(3)
    for step in range(TURN_STEPS):
        reach = max(TURNED * TURN_SHRINK**step, TURN_REACH)
        x = placed @ turn.T + shift
        surfel, point, weight = _matches(x, facing @ turn.T, border, frame, reach)
        if not len(surfel):
            break
        x, n = x[surfel], normals[point]
        middle = x.mean(axis=0)
        derivative = np.column_stack([np.cross(x - middle, n), n])
        weighed = derivative * weight[:, None]
        matrix, residual = weighed.T @ derivative, ((x - points[point]) * n).sum(axis=1)
        move = np.linalg.solve(matrix + 1e-9 * np.trace(matrix) * np.eye(6), -(weighed.T @ residual))
        more = rotations(move[None, :3])[0]
        turn, shift = more @ turn, more @ (shift - middle) + middle + move[3:]
        if step > _SETTLED_TURN and np.abs(move).max() < _STILL_TURN:
            break
    return turn, shift


def _connected(graph: DeformationGraph, points: np.ndarray) -> DeformationGraph:
    """The same with links between pieces that no edge joins: each of their nodes to the two nearest of others."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    total, place = len(graph.node), points[graph.node]
    walk = coo_matrix((np.ones(len(graph.link)), tuple(graph.link.T)), shape=(total, total))
    pieces, piece = connected_components(walk, directed=False)
    if pieces == 1:
        return graph
    near = cKDTree(place).query(place, k=min(NEIGHBOURS, total))[1]
    more = [(a, b) for a in range(total) for b in near[a][piece[near[a]] != piece[a]][:2]]
    if not more:
        return graph
    both = np.array(more)
    return replace(graph, link=np.unique(np.concatenate([graph.link, both, both[:, ::-1]]), axis=0))


def nearest_facing(
    points: np.ndarray, normals: np.ndarray, places: np.ndarray, sides: np.ndarray, spacing: float, count: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """Distances and indices (m,) of the oriented points nearest to oriented places (m, 3), in (x, FACING s n); of so
    many (m, count)."""
    from scipy.spatial import cKDTree

    turned = FACING * spacing
    tree = cKDTree(np.column_stack([points, turned * normals]))
    return tree.query(np.column_stack([places, turned * sides]), k=count)
