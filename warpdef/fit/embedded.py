"""Embedded deformation: rigid motions at nodes spread over a mesh, blended at its vertices (Sumner et al. 2007).

A vertex x with nodes j of weight w_j goes to sum_j w_j (R_j (x - g_j) + g_j + t_j). A few hundred nodes bend a limb in
a handful of Gauss-Newton steps, where moving every vertex by itself would need hundreds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from warpdef.geometry.edges import edge_graph
from warpdef.kernels.embedding import EmbeddedMesh
from warpdef.kernels.embedding_serial import BlockOrder

_NEAREST = 4  # nodes a vertex
_STRAIGHT = 0.8  # least cosine of a chord with the normals at its ends


@dataclass(frozen=True)
class Pose:
    """rotation: of every node (n, 3, 3). shift: of every node (n, 3)."""

    rotation: np.ndarray
    shift: np.ndarray

    @classmethod
    def identity(cls, count: int) -> Pose:
        return cls(np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)))


@dataclass(frozen=True)
class DeformationGraph:
    """Nodes of a mesh of V vertices.

    node:   vertices that are nodes (n,)
    index:  nodes of each vertex (V, 4), nearest along the surface first
    weight: their weights (V, 4), sum 1
    link:   ordered pairs of nodes that share a vertex (e, 2)
    """

    node: np.ndarray
    index: np.ndarray
    weight: np.ndarray
    link: np.ndarray

    @classmethod
    def build(cls, vertices: np.ndarray, edges: np.ndarray, count: int) -> DeformationGraph:
        """Spread ``count`` nodes over vertices (V, 3) with edges (E, 2), each the farthest from those before it."""
        from scipy import sparse
        from scipy.sparse.csgraph import dijkstra

        total = len(vertices)
        count = min(count, total)
        walk = edge_graph(vertices, edges)

        # The nearest nodes so far of every vertex, and how far along the surface.
        near = np.full((total, _NEAREST + 1), np.inf)
        who = np.zeros((total, _NEAREST + 1), dtype=np.int64)
        node = np.zeros(count, dtype=np.int64)
        for k in range(count):
            # A component without a node is infinitely far and comes first.
            node[k] = np.argmax(near[:, 0]) if k else 0
            reach = near[node[k], 0]
            far = dijkstra(walk, indices=node[k], limit=3.0 * reach if np.isfinite(reach) else np.inf)
            touched = np.flatnonzero(far < near[:, -1])
            values = np.column_stack([near[touched], far[touched]])
            names = np.column_stack([who[touched], np.full(len(touched), k)])
            order = np.argsort(values, axis=1, kind="stable")[:, :-1]
            near[touched] = np.take_along_axis(values, order, axis=1)
            who[touched] = np.take_along_axis(names, order, axis=1)

        # Weights fall to 0 at the first node that is left out, so that they are continuous over the surface.
        edge = np.where(np.isfinite(near), near, 0.0).max(axis=1, keepdims=True) * 1.01 + 1e-12
        edge = np.where(np.isfinite(near[:, -1:]), near[:, -1:], edge)
        weight = np.maximum(1.0 - near[:, :-1] / edge, 0.0) ** 2
        weight[~(weight.sum(axis=1) > 0), 0] = 1.0
        weight /= weight.sum(axis=1, keepdims=True)
        index = who[:, :-1]
        touch = sparse.csr_matrix(
            ((weight > 0).astype(float).ravel(), (np.repeat(np.arange(total), _NEAREST), index.ravel())),
            shape=(total, count),
        )
        shared = (touch.T @ touch).tocoo()
        apart = (shared.row != shared.col) & (shared.data > 0)
        return cls(node, index, weight, np.column_stack([shared.row[apart], shared.col[apart]]).astype(np.int64))

    def braced(self, rest: np.ndarray, normals: np.ndarray) -> DeformationGraph:
        """The same with links through the inside of a closed mesh, each node to the nearest on the other side.

        A shell alone flattens where nothing holds its far side; with chords a body keeps its thickness. Of a mesh
        ``rest`` (V, 3) with outward unit normals (V, 3).
        """
        from scipy.spatial import cKDTree

        chords = np.full(len(self.node), -1)
        for k, node in enumerate(self.node):
            step = rest - rest[node]
            length = np.linalg.norm(step, axis=1)
            across = (-(step @ normals[node]) > _STRAIGHT * length) & (
                (step * normals).sum(axis=1) > _STRAIGHT * length
            )
            if across.any():
                # Nodes stand far apart: the nearest vertex is on the same limb, the nearest node need not be.
                chords[k] = self.index[np.flatnonzero(across)[np.argmin(length[across])], 0]
        a, b = np.flatnonzero(chords >= 0), chords[chords >= 0]
        within, tree = np.ones(len(a), dtype=bool), cKDTree(rest)
        for share in (0.2, 0.35, 0.5, 0.65, 0.8):
            middle = (1.0 - share) * rest[self.node[a]] + share * rest[self.node[b]]
            nearest = tree.query(middle)[1]
            within &= ((middle - rest[nearest]) * normals[nearest]).sum(axis=1) < 0
        a, b = a[within], b[within]
        link = np.unique(np.concatenate([self.link, np.column_stack([a, b]), np.column_stack([b, a])]), axis=0)
        return replace(self, link=link[link[:, 0] != link[:, 1]])

    def place(self, rest: np.ndarray, pose: Pose) -> np.ndarray:
        """All vertices, (V, 3), of the mesh ``rest`` (V, 3) in ``pose``."""
        return self._of(rest).place(pose.rotation, pose.shift)

    def bend(self, rest: np.ndarray, pose: Pose) -> np.ndarray:
        """What links differ by from a rigid motion of their first node, turned back with it: (e, 3)."""
        anchor, (j, k) = rest[self.node], self.link.T
        away = anchor[j] + pose.shift[j] - anchor[k] - pose.shift[k]
        return anchor[k] - anchor[j] + np.einsum("eba,eb->ea", pose.rotation[j], away)

    def step(
        self,
        rest: np.ndarray,
        pose: Pose,
        chosen: np.ndarray,
        goal: np.ndarray,
        normal: np.ndarray,
        rigidity: float,
        tangential: float,
        weight: np.ndarray | None = None,
        usual: np.ndarray | None = None,
    ) -> Pose:
        """One Gauss-Newton step of

            1/sum_i w_i sum_i w_i ((n_i . r_i)^2 + tangential |r_i|^2)
            + rigidity/e sum_(j,k) |R_j (g_k - g_j) + g_j + t_j - g_k - t_k|^2

        with r_i the vertex ``chosen[i]`` minus its ``goal`` (m, 3), n its unit ``normal`` (m, 3), and w its
        ``weight`` (m,), all 1 if not given. From what links differ by (e, 3) their ``usual`` difference is taken off.
        """
        if weight is None:
            weight = np.ones(len(chosen))
        weight = weight / max(float(weight.sum()), 1e-300)
        scale = rigidity / max(len(self.link), 1)
        matched = chosen, goal, normal, weight, tangential
        move = self._of(rest).step(pose.rotation, pose.shift, *matched, scale, usual)
        return Pose(rotations(move[:, :3]) @ pose.rotation, pose.shift + move[:, 3:])

    def _of(self, rest: np.ndarray) -> EmbeddedMesh:
        return EmbeddedMesh(rest, self.index, self.weight, self.link, rest[self.node], self._order)

    @cached_property
    def _order(self) -> BlockOrder:
        """In which nodes are eliminated in a step: those of least degree first, as far as SuperLU can tell."""
        from scipy.sparse import coo_matrix, eye_array
        from scipy.sparse.linalg import splu

        count, (j, k) = len(self.node), self.link.T
        linked = coo_matrix((np.ones(len(j)), (j, k)), shape=(count, count))
        matrix = ((len(j) + 1.0) * eye_array(count) - linked - linked.T).tocsc()
        place = splu(matrix, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).perm_c

        # What a column has below its diagonal, the first of it has too.
        below: list[set[int]] = [set() for _ in range(count)]
        for a, b in zip(place[j].tolist(), place[k].tolist(), strict=True):
            below[min(a, b)].add(max(a, b))
        for column in below:
            if column:
                below[min(column)] |= column - {min(column)}
        row = np.concatenate([[c, *sorted(column)] for c, column in enumerate(below)])
        start = np.concatenate([[0], np.cumsum([1 + len(column) for column in below])])
        known = np.repeat(np.arange(count), np.diff(start)) * count + row

        def block(first: np.ndarray, second: np.ndarray) -> np.ndarray:
            """That in the row of the first and the column of the second node, -1 where there is none."""
            key = place[second] * count + place[first]
            at = np.minimum(np.searchsorted(known, key), len(known) - 1)
            return np.where((known[at] == key) & (place[first] >= place[second]), at, -1)

        pairs = block(self.index[:, :, None], self.index[:, None, :]).reshape(len(self.index), -1)
        tables = place, start, row, pairs, np.maximum(block(j, k), block(k, j))
        return BlockOrder(*(table.astype(np.int32) for table in tables))


def _cross_matrix(v: np.ndarray) -> np.ndarray:
    """[v]_x for vectors (..., 3): (..., 3, 3)."""
    x, y, w = np.moveaxis(v, -1, 0)
    z = np.zeros_like(x)
    return np.stack([z, -w, y, w, z, -x, -y, x, z], axis=-1).reshape(*v.shape, 3)


def rotations(v: np.ndarray) -> np.ndarray:
    """Rotations by the vectors (n, 3), angle their length (Rodrigues): (n, 3, 3)."""
    angle = np.linalg.norm(v, axis=1)[:, None, None]
    cross = _cross_matrix(v)
    # numpy's sinc(x) is sin(pi x) / (pi x).
    return np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * cross @ cross
