"""Embedded deformation: rigid motions at nodes spread over a mesh, blended at its vertices (Sumner et al. 2007).

A vertex x with nodes j of weight w_j goes to sum_j w_j (R_j (x - g_j) + g_j + t_j). A few hundred nodes bend a limb in
a handful of Gauss-Newton steps, where moving every vertex by itself would need hundreds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from warpdef.geometry.edges import edge_graph

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix

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
        anchor = rest[self.node]
        placed = np.zeros_like(rest)
        for j, w in zip(self.index.T, self.weight.T, strict=True):
            turned = np.einsum("vab,vb->va", pose.rotation[j], rest - anchor[j])
            placed += w[:, None] * (turned + anchor[j] + pose.shift[j])
        return placed

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
        from scipy.sparse.linalg import splu

        count, anchor = len(self.node), rest[self.node]
        if weight is None:
            weight = np.ones(len(chosen))
        weight = weight / max(float(weight.sum()), 1e-300)
        # Of a vertex all matches at once: A the sum of w (n n^T + tangential I), b that of w (n n^T + tangential I) r.
        vertex, match = np.unique(chosen, return_inverse=True)
        index, share = self.index[vertex], self.weight[vertex]
        arm = np.einsum("vjab,vjb->vja", pose.rotation[index], rest[vertex, None] - anchor[index])
        placed = np.einsum("vj,vja->va", share, arm + anchor[index] + pose.shift[index])
        asked = weight[:, None, None] * (normal[:, :, None] * normal[:, None, :] + tangential * np.eye(3))
        pull = np.einsum("iab,ib->ia", asked, placed[match] - goal)
        asked, pull = _sums(asked, match, len(vertex)), _sums(pull, match, len(vertex))
        derivative = np.concatenate([-_cross_matrix(arm), np.broadcast_to(np.eye(3), (*arm.shape, 3))], axis=3)
        derivative = (derivative * share[:, :, None, None]).transpose(0, 2, 1, 3)
        derivative = derivative.reshape(len(vertex), 3, 6 * index.shape[1])
        fit = derivative.transpose(0, 2, 1) @ asked @ derivative
        right = self._scattered(index, np.einsum("vac,va->vc", derivative, pull))

        j, k = self.link.T
        scale = rigidity / max(len(j), 1)
        arm = np.einsum("eab,eb->ea", pose.rotation[j], anchor[k] - anchor[j])
        derivative = np.zeros((len(j), 3, 12))
        derivative[:, :, :3] = -_cross_matrix(arm)
        derivative[:, :, 3:6] = np.eye(3)
        derivative[:, :, 9:] = -np.eye(3)
        bent = arm + anchor[j] + pose.shift[j] - anchor[k] - pose.shift[k]
        if usual is not None:
            bent = bent - usual
        right += scale * self._scattered(self.link, np.einsum("eac,ea->ec", derivative, bent))
        stiff = scale * (derivative.transpose(0, 2, 1) @ derivative)

        system = self._assembled((self._of_vertices[vertex], fit), (self._of_links, stiff))
        options = {"SymmetricMode": True}
        solve = splu(system, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
        move = solve.solve(-right).reshape(count, 6)
        return Pose(rotations(move[:, :3]) @ pose.rotation, pose.shift + move[:, 3:])

    @cached_property
    def _pattern(self) -> np.ndarray:
        """Row times the number of nodes plus column of all blocks of a step's matrix, ascending."""
        own, (j, k) = np.arange(len(self.node)), self.link.T
        return np.unique(np.concatenate([own, j, k]) * len(own) + np.concatenate([own, k, j]))

    @cached_property
    def _of_vertices(self) -> np.ndarray:
        """Where in the pattern the pairs of nodes of each vertex are, (V, 16)."""
        return self._in_pattern(self.index)

    @cached_property
    def _of_links(self) -> np.ndarray:
        """The same of each link, (e, 4)."""
        return self._in_pattern(self.link)

    def _in_pattern(self, node: np.ndarray) -> np.ndarray:
        pairs = node[:, :, None] * len(self.node) + node[:, None, :]
        at = np.searchsorted(self._pattern, pairs.reshape(len(node), -1))
        return np.minimum(at, len(self._pattern) - 1)

    def _assembled(self, *parts: tuple[np.ndarray, np.ndarray]) -> csc_matrix:
        """The sum of symmetric matrices (m, 6 p, 6 p) at pairs of p nodes (m, p p); without any, 1e-12 of the unit."""
        from scipy.sparse import bsr_matrix, csc_matrix, csr_matrix

        count, pattern = len(self.node), self._pattern
        blocks = np.zeros((len(pattern), 36))
        for pairs, matrices in parts:
            m, p = len(pairs), matrices.shape[1] // 6
            each = matrices.reshape(m, p, 6, p, 6).transpose(0, 1, 3, 2, 4).reshape(-1, 36)
            gather = csr_matrix(
                (np.ones(pairs.size), (pairs.ravel(), np.arange(pairs.size))), (len(pattern), pairs.size)
            )
            blocks += gather @ each
        # Nodes that nothing holds, on their own in a component, stay.
        row, column = np.divmod(pattern, count)
        blocks[row == column] += 1e-12 * np.eye(6).ravel()
        begin = np.searchsorted(row, np.arange(count + 1))
        rows = bsr_matrix((blocks.reshape(-1, 6, 6), column, begin), shape=(6 * count, 6 * count)).tocsr()
        return csc_matrix((rows.data, rows.indices, rows.indptr), shape=rows.shape)  # symmetric: rows are columns

    def _scattered(self, node: np.ndarray, vectors: np.ndarray) -> np.ndarray:
        """The sum of vectors (m, 6 p) at nodes (m, p): shape (6 n,)."""
        return _sums(vectors.reshape(-1, 6), node.ravel(), len(self.node)).ravel()


def _sums(values: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    """Values (m, ...) summed by group (m,): shape (count, ...)."""
    flat = values.reshape(len(values), int(np.prod(values.shape[1:])))
    sums = [np.bincount(group, weights=column, minlength=count) for column in flat.T]
    return np.column_stack(sums).astype(np.float64).reshape(count, *values.shape[1:])  # of nothing: integers


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
