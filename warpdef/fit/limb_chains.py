"""Limbs of a mesh as chains of three links, each rigid, which hang on the body where it was found.

A limb (``geometry.limbs``) reaches a width into the body, where its first joint is: a finger bends in the knuckle, not
where it leaves the palm. A pose of it is a rotation vector a link, in the frame of the link before; that before the
first is the rigid motion of the body around it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warpdef.fit.embedded import DeformationGraph, Pose, rotations
from warpdef.geometry.edges import edge_graph
from warpdef.geometry.limbs import Limb, find_limbs
from warpdef.geometry.rotations import nearest_rotation
from warpdef.geometry.triangles import vertex_normals
from warpdef.quality.swollen import LEAST_SHARE

LARGEST = 0.25
"""Share of the vertices from which a limb is the body."""
JOINTS = (0.0, 0.42, 0.72)
"""Where along it a limb bends, by the lengths of a finger's bones."""
INTO = 0.9
"""Its widths that it reaches into the body."""
SAMPLES, FEWEST = 40, 5
"""Vertices of a limb that stand for it, at most and at least."""
_AT_JOINT = 0.12  # of the length: what is that close to a joint has its middle there
_AT_BASE = 0.08  # of it: what is that close to where it parts from the body, from which its reach into that is told
_RINGS = 2  # of nodes around a limb that tell how the body moves there
_ALIGNED = 1e-3  # share of the nodes' own rotations where they lie on a line


Rigid = tuple[np.ndarray, np.ndarray]
"""Rotation (3, 3) and shift (3,)."""


@dataclass(frozen=True)
class LimbChain:
    """joints: (3, 3). axis, normal: unit, from the first joint to the tip and out of its middle (3,). vertex, link:
    vertices that stand for it, and the link each is on (m,). standing: vertices that each of them stands for.
    node, node_link: the same of the graph (n,). around: nodes around its base, those of limbs beside it too (r,)."""

    joints: np.ndarray
    axis: np.ndarray
    normal: np.ndarray
    vertex: np.ndarray
    link: np.ndarray
    standing: float
    node: np.ndarray
    node_link: np.ndarray
    around: np.ndarray


class LimbChains:
    """All limbs of a mesh at rest, (V, 3), faces (F, 3), edges (E, 2), with the graph that bends it; ``sample``: its
    vertices that are matched. body: those of them that are on no limb. normals: of all at rest (V, 3)."""

    def __init__(
        self, rest: np.ndarray, faces: np.ndarray, edges: np.ndarray, graph: DeformationGraph, sample: np.ndarray
    ) -> None:
        self.rest, self.normals, self._at = rest, vertex_normals(rest, faces), rest[graph.node]
        count = len(rest)
        limbs = [x for x in find_limbs(rest, edges) if LEAST_SHARE * count < len(x.vertex) < LARGEST * count]
        reaching = _into_the_body(rest, edges, limbs)
        on, along = np.full(count, -1), np.zeros(count)
        for i, (vertex, far, _) in enumerate(reaching):
            on[vertex], along[vertex] = i, far
        link = np.searchsorted(JOINTS[1:], along)
        self.body, self.chains = sample[on[sample] < 0], list[LimbChain]()
        one, other = graph.link.T
        for i, (limb, (_, _, joints)) in enumerate(zip(limbs, reaching, strict=True)):
            of_limb = on[graph.node] == i
            near = of_limb.copy()
            for _ in range(_RINGS):
                near[other[near[one]]] = True
            node, around = np.flatnonzero(of_limb), np.flatnonzero(near & ~of_limb)
            vertex = sample[on[sample] == i]
            if len(vertex) < FEWEST or not len(node) or len(around) < 3:
                continue
            some = vertex[np.linspace(0, len(vertex) - 1, min(len(vertex), SAMPLES)).astype(int)]
            axis, normal = _unit(rest[limb.tip] - joints[0]), self.normals[limb.vertex].mean(axis=0)
            normal = _unit(normal - axis * (normal @ axis))
            of_nodes = node, link[graph.node[node]], around
            self.chains.append(LimbChain(joints, axis, normal, some, link[some], len(vertex) / len(some), *of_nodes))

    def base(self, chain: LimbChain, pose: Pose) -> Rigid:
        """How the body moves in a pose where a limb begins."""
        rest, there = self._at[chain.around], self._at[chain.around] + pose.shift[chain.around]
        from_, to = rest.mean(axis=0), there.mean(axis=0)
        spread = (there - to).T @ (rest - from_)
        spread += _ALIGNED * np.linalg.norm(spread) * pose.rotation[chain.around].mean(axis=0)
        turn = nearest_rotation(spread)
        return turn, to - turn @ from_

    def turns_of(self, chain: LimbChain, pose: Pose) -> np.ndarray:
        """Rotation vectors (3, 3) that bend a limb as it is in a pose."""
        from scipy.spatial.transform import Rotation

        before, found = self.base(chain, pose)[0], []
        for link in range(3):
            of_link = chain.node[chain.node_link == link]
            turn = nearest_rotation(pose.rotation[of_link].mean(axis=0)) if len(of_link) else before
            found.append(Rotation.from_matrix(before.T @ turn).as_rotvec())
            before = turn
        return np.array(found)

    def links(self, chain: LimbChain, turns: np.ndarray, base: Rigid) -> Rigid:
        """Rigid motions of a limb's links in h poses ``turns`` (h, 3, 3): (h, 3, 3, 3) and (h, 3, 3)."""
        turn, shift = (np.broadcast_to(part, (len(turns), *part.shape)) for part in base)
        all_turns, shifts = [], []
        for link, joint in enumerate(chain.joints):
            own = rotations(turns[:, link])
            shift = np.einsum("hij,hj->hi", turn, joint - own @ joint) + shift
            turn = turn @ own
            all_turns.append(turn)
            shifts.append(shift)
        return np.stack(all_turns, axis=1), np.stack(shifts, axis=1)

    def place(self, chain: LimbChain, turns: np.ndarray, base: Rigid) -> tuple[np.ndarray, np.ndarray]:
        """Vertices that stand for a limb in h poses, and their normals, (h, m, 3) each."""
        turn, shift = (part[:, chain.link] for part in self.links(chain, turns, base))
        placed = np.einsum("hmij,mj->hmi", turn, self.rest[chain.vertex]) + shift
        return placed, np.einsum("hmij,mj->hmi", turn, self.normals[chain.vertex])

    def put(self, pose: Pose, turns: list[np.ndarray]) -> Pose:
        """The same pose with its limbs bent by rotation vectors (3, 3) each."""
        rotation, shift = pose.rotation.copy(), pose.shift.copy()
        for chain, own in zip(self.chains, turns, strict=True):
            turn, moved = (part[0][chain.node_link] for part in self.links(chain, own[None], self.base(chain, pose)))
            at = self._at[chain.node]
            rotation[chain.node], shift[chain.node] = turn, np.einsum("nij,nj->ni", turn, at) + moved - at
        return Pose(rotation, shift)


def _into_the_body(
    rest: np.ndarray, edges: np.ndarray, limbs: list[Limb]
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Of each limb the vertices and how far along it they are, below 0 in the body, (n,) each, and joints (3, 3)."""
    from scipy.sparse.csgraph import dijkstra

    taken, graph = np.zeros(len(rest), dtype=bool), edge_graph(rest, edges)
    away, joints = np.full((len(limbs), len(rest)), np.inf), []
    for i, limb in enumerate(limbs):
        taken[limb.vertex] = True
        own = np.array([_middle(rest, limb, along) for along in JOINTS])
        axis = _unit(rest[limb.tip] - own[0])
        low = rest[limb.vertex[limb.along < 0.5]] - own[0]
        across = low - (low @ axis)[:, None] * axis
        widest = np.linalg.svd(across - across.mean(axis=0), full_matrices=False)[2][0]
        reach = INTO * float(np.ptp(np.percentile(across @ widest, [5.0, 95.0])))
        first = limb.vertex[limb.along <= max(_AT_BASE, limb.along.min())]
        away[i] = dijkstra(graph, indices=first, min_only=True, limit=reach)
        own[0] -= reach * axis
        joints.append(own)
    nearest = away.argmin(axis=0) if limbs else np.zeros(len(rest), dtype=int)
    near = np.isfinite(away.min(axis=0, initial=np.inf)) & ~taken
    found = []
    for i, limb in enumerate(limbs):
        more = np.flatnonzero(near & (nearest == i))
        along = np.concatenate([limb.along, -away[i, more] / limb.length])
        found.append((np.concatenate([limb.vertex, more]), along, joints[i]))
    return found


def _middle(rest: np.ndarray, limb: Limb, along: float) -> np.ndarray:
    near = np.abs(limb.along - along) < _AT_JOINT
    near[np.abs(limb.along - along).argmin()] = True
    return rest[limb.vertex[near]].mean(axis=0)


def _unit(v: np.ndarray) -> np.ndarray:
    return v / max(float(np.linalg.norm(v)), 1e-300)
