"""Graphs whose combinatorial Laplacian L = D - A smooths gradients: pruned grids and template edges.

A ``Graph`` holds many independent systems behind each other (a level of a transition each, or one mesh). Only the kept
nodes appear, under compact numbers; ``node`` says where each lives in the full array.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warpdef.kernels.levels import LevelTable


@dataclass(frozen=True)
class Graph:
    """Compressed rows of A, and which system a node belongs to.

    node:    place in the full, flat array            (N,) int32
    system:  independent system of a node, ascending  (N,) int32
    first:   first node of a system                   (systems + 1,) int32
    row:     first neighbour of a node                (N + 1,) int32
    column:  neighbours, compact numbers              (row[-1],) int32
    weight:  lambda of a system                       (systems,) float32
    """

    node: np.ndarray
    system: np.ndarray
    first: np.ndarray
    row: np.ndarray
    column: np.ndarray
    weight: np.ndarray


def _from_pairs(pairs: np.ndarray, node: np.ndarray, system: np.ndarray, weight: np.ndarray) -> Graph:
    """Both directions of undirected ``pairs``, shape (E, 2) compact numbers, as compressed rows."""
    both = np.concatenate([pairs, pairs[:, ::-1]])
    both = both[np.lexsort((both[:, 1], both[:, 0]))]
    row = np.zeros(len(node) + 1, dtype=np.int32)
    row[1:] = np.cumsum(np.bincount(both[:, 0], minlength=len(node)))
    first = np.searchsorted(system, np.arange(len(weight) + 1)).astype(np.int32)
    as32 = [np.ascontiguousarray(a, dtype=np.int32) for a in (node, system, first, row, both[:, 1])]
    return Graph(*as32, weight=np.asarray(weight, dtype=np.float32))


def mesh_graph(edges: np.ndarray, vertex_count: int, weight: float) -> Graph:
    """The edges of a mesh, shape (E, 2), as one system."""
    everything = np.arange(vertex_count)
    return _from_pairs(np.asarray(edges), everything, np.zeros(vertex_count, int), np.array([weight]))


def grid_graph(levels: LevelTable, kept: np.ndarray, lambdas: np.ndarray) -> Graph:
    """Six-neighbour graphs of the kept nodes; system s * L + l is level l of transition s.

    Args:
        levels: the node layout. kept: shape (S, M) bool. lambdas: smoothing weight of each level, L numbers.
    """
    transitions = len(kept)
    compact = np.cumsum(kept.ravel()).reshape(kept.shape) - 1
    pairs = []
    for n, begin in zip(levels.resolution, levels.offset[:-1], strict=True):
        span = slice(begin, begin + n**3)
        keep = kept[:, span].reshape(transitions, n, n, n)
        number = compact[:, span].reshape(transitions, n, n, n)
        for axis in (1, 2, 3):
            low, high = [slice(None)] * 4, [slice(None)] * 4
            low[axis], high[axis] = slice(0, -1), slice(1, None)
            joined = keep[tuple(low)] & keep[tuple(high)]
            pairs.append(np.stack([number[tuple(low)][joined], number[tuple(high)][joined]], axis=1))
    node = np.flatnonzero(kept)
    system = (node // levels.node_count) * levels.count + levels.node_level()[node % levels.node_count]
    return _from_pairs(np.concatenate(pairs), node, system, np.tile(lambdas, transitions))


def kept_nodes(levels: LevelTable, clouds: list[np.ndarray], cells: int) -> np.ndarray:
    """Nodes of one transition to keep: corners of occupied cells, and all within ``cells`` of those.

    Paper, sec. Implementation Details. The neighbourhood is a cube of cells.

    Args:
        levels: the node layout. clouds: the transition's input points, each (N, 3), cube units.
        cells: width of the margin.

    Returns:
        shape (M,) bool.
    """
    points = np.concatenate(clouds)
    kept = []
    for n in levels.resolution:
        occupied = np.zeros((n, n, n), dtype=bool)
        low = np.clip(((points + 1.0) * 0.5 * (n - 1)).astype(int), 0, max(n - 2, 0))
        for corner in np.ndindex(2, 2, 2):
            occupied[tuple(np.minimum(low + corner, n - 1).T)] = True
        for axis in range(3):
            # A cube grows one axis at a time: spread along each line by the margin.
            spread = occupied.copy()
            for shift in range(1, min(cells, n - 1) + 1):
                ahead, behind = [slice(None)] * 3, [slice(None)] * 3
                ahead[axis], behind[axis] = slice(shift, None), slice(0, -shift)
                spread[tuple(ahead)] |= occupied[tuple(behind)]
                spread[tuple(behind)] |= occupied[tuple(ahead)]
            occupied = spread
        kept.append(occupied.ravel())
    return np.concatenate(kept)
