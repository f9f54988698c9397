"""Limbs of a surface: fingers, arms, legs, a tail; where the distance along it has a peak of its own.

The distance from the surface's middle rises along every limb to its tip. From the tips down, what lies farther than a
level falls into pieces, which meet where limbs part from the body: the merge tree of the distance (Carr, Snoeyink and
Axen 2003, *Computing contour trees in all dimensions*). Each of its outer branches that is long enough is a limb.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warpdef.geometry.edges import edge_graph
from warpdef.geometry.triangles import component_labels

SHORTEST = 0.05
"""Length of a limb along the surface, in the longest way from tip to tip, from which it is one and no bump."""


@dataclass(frozen=True)
class Limb:
    """vertex: those on it (n,). along: from 0 where it parts from the body to 1 at its tip (n,). tip: a vertex.
    length: from there to the tip along the surface."""

    vertex: np.ndarray
    along: np.ndarray
    tip: int
    length: float


def find_limbs(vertices: np.ndarray, edges: np.ndarray) -> list[Limb]:
    """Limbs of the largest connected part of a mesh, vertices (V, 3), edges (E, 2), each once; by their tips.

    Where there are two tips alone, as of a bar or a snake, they are two limbs that meet in the middle.
    """
    from scipy.sparse.csgraph import dijkstra

    if not len(edges) or not np.ptp(vertices, axis=0).any():
        return []
    part = component_labels(edges[:, 0], edges[:, 1], len(vertices))
    inside = part == np.bincount(part).argmax()
    graph = edge_graph(vertices, edges)

    def ways(start: int) -> np.ndarray:
        return np.where(inside, dijkstra(graph, indices=start), -1.0)

    one = ways(int(ways(int(inside.argmax())).argmax()))
    other = ways(int(one.argmax()))
    middle = np.where(inside, np.maximum(one, other), np.inf).argmin()
    distance = ways(int(middle))
    found = []
    for tip, level in sorted(_outer_branches(distance, graph.indices, graph.indptr, SHORTEST * one.max()).items()):
        beyond = edges[(distance > level)[edges].all(axis=1)]
        piece = component_labels(beyond[:, 0], beyond[:, 1], len(vertices))
        vertex = np.flatnonzero(piece == piece[tip])
        length = float(distance[tip] - level)
        found.append(Limb(vertex, (distance[vertex] - level) / length, tip, length))
    return found


def _outer_branches(height: np.ndarray, neighbour: np.ndarray, start: np.ndarray, least: float) -> dict[int, float]:
    """Peaks of a height (V,) on a graph, and the level of each at which it first meets another; where both rise above
    that level by more than ``least``. Where the height is negative there is nothing."""
    order = np.argsort(-height, kind="stable")
    order = order[height[order] >= 0.0].tolist()
    level, begin, beside = height.tolist(), start.tolist(), neighbour.tolist()
    root, found = [-1] * len(level), dict[int, float]()
    peak = list(range(len(level)))

    def root_of(vertex: int) -> int:
        while root[vertex] != vertex:
            root[vertex] = root[root[vertex]]
            vertex = root[vertex]
        return vertex

    for vertex in order:
        root[vertex] = mine = vertex
        for other in beside[begin[vertex] : begin[vertex + 1]]:
            if root[other] < 0 or (theirs := root_of(other)) == mine:
                continue
            lower, higher = sorted((mine, theirs), key=lambda r: level[peak[r]])
            if level[peak[lower]] - level[vertex] > least:
                for of in (peak[lower], peak[higher]):
                    found.setdefault(of, level[vertex])
            root[lower] = mine = higher
    return found
