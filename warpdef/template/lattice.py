"""A regular grid of tetrahedra, six to a cube, and the triangles of a level set on it (Doi and Koide 1991).

Every cube is cut along its diagonal from its lowest to its highest corner (Kuhn 1960), so that neighbouring cubes agree
on their common face; a tetrahedron's edges then lead from a corner to a corner that is nowhere lower, in one of seven
directions. Nodes are numbered x slowest, z fastest; lengths are in cells.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np

# Corner c of a cube stands at its bits (x, y, z) = (c & 1, c >> 1 & 1, c >> 2 & 1).
CORNERS = np.array([[c & 1, c >> 1 & 1, c >> 2 & 1] for c in range(8)])
DIRECTIONS = CORNERS[1:]
AXES = np.array([0, 1, 3])  # the directions along one axis


def _tetrahedra() -> np.ndarray:
    """Corners of the six, each with the last three counter-clockwise as seen from the first's far side; (6, 4)."""
    found = []
    for a, b, c in permutations((1, 2, 4)):
        corners = [0, a, a + b, a + b + c]
        edges = CORNERS[corners[1:]] - CORNERS[corners[0]]
        found.append(corners if np.linalg.det(edges) > 0 else [corners[i] for i in (0, 2, 1, 3)])
    return np.array(found)


def _triangles() -> dict[int, list[list[tuple[int, int]]]]:
    """By the set of inside corners of a tetrahedron (as bits): outward triangles, each corner a crossed edge."""
    places = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
    table = {}
    for inside_bits in range(1, 15):
        inside = [i for i in range(4) if inside_bits >> i & 1]
        outside = [i for i in range(4) if i not in inside]
        if len(inside) == 2:
            (a, b), (c, d) = inside, outside
            ring = [(a, c), (a, d), (b, d), (b, c)]
            found = [[ring[0], ring[1], ring[2]], [ring[0], ring[2], ring[3]]]
        else:
            found = [[(i, j) for i in inside for j in outside]]
        outward = places[outside].mean(axis=0) - places[inside].mean(axis=0)
        for triangle in found:
            p, q, r = (places[list(edge)].mean(axis=0) for edge in triangle)
            if np.dot(np.cross(q - p, r - p), outward) < 0:
                triangle.reverse()
        table[inside_bits] = found
    return table


_TETRAHEDRA = _tetrahedra()
_TRIANGLES = _triangles()


@dataclass(frozen=True)
class Lattice:
    """Nodes of a box: node (i, j, k) rests at ``origin + cell * (i, j, k)``.

    shape:  nodes an axis
    origin: of node (0, 0, 0), the points' units  (3,) float64
    cell:   edge of a cube, the points' units
    """

    shape: tuple[int, int, int]
    origin: np.ndarray
    cell: float

    def finer(self) -> Lattice:
        """The same box with cells half as large; old nodes are every second one."""
        x, y, z = (2 * n - 1 for n in self.shape)
        return Lattice((x, y, z), self.origin, self.cell / 2)

    def places(self, nodes: np.ndarray) -> np.ndarray:
        """Rest places of flat node numbers, in cells from the origin, shape (N, 3) float32."""
        return np.stack(np.unravel_index(nodes, self.shape), axis=1).astype(np.float32)

    def to_cells(self, points: np.ndarray) -> np.ndarray:
        """The points' units to cells from the origin."""
        return (points - self.origin) / self.cell

    def from_cells(self, places: np.ndarray) -> np.ndarray:
        """Cells from the origin to the points' units."""
        return np.asarray(places, dtype=np.float64) * self.cell + self.origin

    def steps(self, corners: np.ndarray) -> np.ndarray:
        """What to add to a flat node number to get to its neighbours at ``corners`` (K, 3)."""
        return corners @ np.array([self.shape[1] * self.shape[2], self.shape[2], 1])


def refine(values: np.ndarray) -> np.ndarray:
    """Values on the nodes of a lattice, (X, Y, Z, ...), to those of its ``finer()``, by linear interpolation."""
    for axis in range(3):
        values = np.moveaxis(values, axis, 0)
        finer = np.empty((2 * len(values) - 1, *values.shape[1:]), dtype=values.dtype)
        finer[::2] = values
        finer[1::2] = 0.5 * (values[:-1] + values[1:])
        values = np.moveaxis(finer, 0, axis)
    return np.ascontiguousarray(values)


def edges_within(lattice: Lattice, kept: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Edges along ``directions`` between kept nodes, (E, 2) flat node numbers, in the order of their first node.

    Args:
        kept: shape of the lattice, bool; no node on its far sides may be kept.
    """
    nodes = np.flatnonzero(kept)
    flat = kept.ravel()
    ends = nodes[:, None] + lattice.steps(directions)
    there = flat[ends]
    starts = np.broadcast_to(nodes[:, None], ends.shape)
    return np.stack([starts[there], ends[there]], axis=1)


def crossed_cells(distance: np.ndarray) -> np.ndarray:
    """Cubes with corners on both sides, by their lowest corner; bool, one less an axis than ``distance``."""
    inside = distance < 0
    x, y, z = (n - 1 for n in distance.shape)
    parts = [inside[i : i + x, j : j + y, k : k + z] for i, j, k in CORNERS]
    return np.logical_or.reduce(parts) & ~np.logical_and.reduce(parts)


def march(lattice: Lattice, distance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of the level set 0: crossed edges (E, 2) flat node numbers, and faces (F, 3) of these edges.

    The surface is a manifold, outward, and closed where no node of the lattice's sides is inside.

    Args:
        distance: shape of the lattice, below 0 inside; 0 counts as outside.
    """
    inside = (distance < 0).ravel()
    cells = np.argwhere(crossed_cells(distance))
    lowest = np.asarray(np.ravel_multi_index(tuple(cells.T), lattice.shape))
    ends = [np.zeros((0, 3, 2), dtype=np.int64)]
    for corners in _TETRAHEDRA:
        nodes = lowest[:, None] + lattice.steps(CORNERS[corners])
        case = inside[nodes] @ (1 << np.arange(4))
        for bits, triangles in _TRIANGLES.items():
            chosen = nodes[case == bits]
            ends += [chosen[:, np.array(triangle)] for triangle in triangles]
    # (F, 3, 2): each corner of a face an edge, both its nodes; either way round it is the same edge.
    corners = np.sort(np.concatenate(ends), axis=2)
    keys, faces = np.unique(corners[..., 0] * distance.size + corners[..., 1], return_inverse=True)
    return np.stack(np.divmod(keys, distance.size), axis=1), faces.reshape(-1, 3).astype(np.int32)
