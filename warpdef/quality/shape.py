"""How a frame's mesh has changed against the shape: edges, folds, thickness, volume. It needs no clouds.

Thickness: every vertex is paired with the one opposite, where the largest ball that touches the surface in the first
from inside touches it again (Ma, Bae and Choi 2012, *3D medial axis point approximation using nearest neighbors and the
normal field*: the ball shrinks until no vertex is inside). The pairs are found once, on the shape; a limb that flattens
or swells in a frame brings its pairs together or apart.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from warpdef.geometry.edges import edge_lengths
from warpdef.geometry.triangles import face_normals, is_watertight, signed_volume, unique_edges, vertex_normals
from warpdef.quality.drawn import Patches

STRETCHED = 1.5
"""Ratio of an edge's or a pair's length to that in the shape, or its inverse, from which it counts as changed."""
_PAIRED = 2000  # vertices whose opposite is looked for
_FEWEST = 50  # pairs from which they say something
_SHRINKS = 20
_BESIDE = 0.5  # cosine between a pair as seen from the ball's centre, above which the second is beside the first
_OPPOSITE = -0.5  # largest cosine between the normals of a pair


@dataclass(frozen=True)
class ShapeChange:
    """One frame against the shape; E edges, F faces.

    stretch:   |log l / l_shape| of each edge                                               (E,)
    growth:    median of l / l_shape
    changed:   share of the edges whose ratio differs by more than ``STRETCHED`` from the median of all
    stretched: faces whose vertices are all on edges more than ``STRETCHED`` times as long as that  (F,)
    drawn:     share of the surface drawn out, by patches
    folded:    share of neighbouring faces folded by more than 90 degrees that were not so in the shape
    thickness: median of the pairs' distances over those in the shape; None where it is open
    thinned:   share of the pairs whose distance differs by more than ``STRETCHED`` from what that median makes of it;
               None where it is open
    volume:    over that of the shape; None where it is open
    """

    stretch: np.ndarray
    growth: float
    changed: float
    stretched: np.ndarray
    drawn: float
    folded: float
    thickness: float | None
    thinned: float | None
    volume: float | None


class ReferenceShape:
    """The shape that frames are compared with.

    Args:
        vertices: shape (V, 3) float64. faces: shape (F, 3).
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        self.vertices, self.faces = vertices, faces
        self.edges = unique_edges(faces)
        self.lengths = self.edge_lengths(vertices)
        self._neighbours = neighbouring_faces(faces)
        self._folds = self._folded(vertices)
        self._volume = signed_volume(vertices, faces) if is_watertight(faces) else 0.0

    @property
    def extent(self) -> float:
        """Longest side of its bounding box."""
        return float(np.ptp(self.vertices, axis=0).max())

    @cached_property
    def patches(self) -> Patches:
        return Patches(self.vertices, self.faces, self.edges)

    @cached_property
    def pairs(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertices and those opposite, (P,) each; none of an open surface, whose folds would pass for thin limbs."""
        if not self._volume:
            return np.zeros(0, dtype=int), np.zeros(0, dtype=int)
        return opposite_vertices(self.vertices, self.faces)

    @cached_property
    def thin(self) -> float | None:
        """Thickness of its thin parts: the lower quartile of the pairs' distances; None where it is open."""
        one, other = self.pairs
        return float(np.percentile(_distance(self.vertices, one, other), 25.0)) if len(one) >= _FEWEST else None

    def edge_lengths(self, vertices: np.ndarray) -> np.ndarray:
        """Of a frame (V, 3), shape (E,)."""
        return edge_lengths(vertices, self.edges)

    def compare(self, vertices: np.ndarray, lengths: np.ndarray | None = None) -> ShapeChange:
        """A frame's vertices (V, 3) against the shape, or against other lengths (E,) of the edges."""
        rest = self.lengths if lengths is None else lengths
        usable = rest > 0.0
        stretch = np.zeros(len(rest))
        # An edge that has collapsed altogether counts as e^-7 of its length.
        ratio = np.maximum(self.edge_lengths(vertices)[usable] / rest[usable], 1e-3)
        stretch[usable] = np.log(ratio)
        grown = np.zeros(len(vertices), dtype=bool)
        # A body that grows as a whole is not stretched.
        scale = float(np.median(stretch[usable])) if usable.any() else 0.0
        beyond = float(np.mean(np.abs(stretch - scale)[usable] > np.log(STRETCHED))) if usable.any() else 0.0
        long = stretch - scale > np.log(STRETCHED)
        grown[self.edges[long].ravel()] = True
        thickness = thinned = volume = None
        one, other = self.pairs
        if len(one) >= _FEWEST:
            change = _distance(vertices, one, other) / np.maximum(_distance(self.vertices, one, other), 1e-300)
            thickness = float(np.median(change))
            thinned = float(np.mean(np.abs(np.log(np.maximum(change, 1e-3)) - scale) > np.log(STRETCHED)))
        if self._volume:
            volume = signed_volume(vertices, self.faces) / self._volume
        folded = float(np.mean(self._folded(vertices) & ~self._folds)) if len(self._folds) else 0.0
        torn = np.all(grown[self.faces], axis=1)
        drawn, growth = self.patches.drawn_share(vertices), float(np.exp(scale))
        return ShapeChange(np.abs(stretch), growth, beyond, torn, drawn, folded, thickness, thinned, volume)

    def _folded(self, vertices: np.ndarray) -> np.ndarray:
        normal = face_normals(vertices, self.faces)[0]
        one, other = self._neighbours
        # Right angles of a shape are none, whatever the rounding.
        return np.einsum("ni,ni->n", normal[one], normal[other]) < -1e-3


def neighbouring_faces(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of faces that share an edge, shape (P,) each; of an edge in three faces two pairs."""
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1).astype(np.int64)
    key = edges[:, 0] * (int(faces.max()) + 1) + edges[:, 1]
    order = np.argsort(key, kind="stable")
    same = np.flatnonzero(np.diff(key[order]) == 0)
    face = np.repeat(np.arange(len(faces)), 3)
    return face[order[same]], face[order[same + 1]]


def opposite_vertices(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Some vertices and the vertex that lies opposite to each, across the inside; shape (P,) each.

    None where the surface has no other side within reach, as on an open sheet.
    """
    from scipy.spatial import cKDTree

    normals, tree = vertex_normals(vertices, faces), cKDTree(vertices)
    chosen = np.arange(len(vertices))
    if len(chosen) > _PAIRED:
        chosen = np.random.default_rng(0).choice(chosen, _PAIRED, replace=False)
    touch, inward = vertices[chosen], -normals[chosen]
    radius = np.full(len(chosen), np.ptp(vertices, axis=0).max())
    opposite, active = np.full(len(chosen), -1), np.arange(len(chosen))
    for _ in range(_SHRINKS):
        distance, nearest = tree.query(touch[active] + radius[active, None] * inward[active])
        way = vertices[nearest] - touch[active]
        along = np.einsum("ni,ni->n", way, inward[active])
        inside = (distance < radius[active] * (1.0 - 1e-6)) & (nearest != chosen[active]) & (along > 0.0)
        # The ball through both that touches the surface in the first, and the cosine between both as seen from its
        # centre: where it is small, the second is but roughness beside the first, and the last ball stands.
        smaller = np.einsum("ni,ni->n", way, way) / (2.0 * np.where(inside, along, 1.0))
        inside &= 1.0 - along / np.where(inside, smaller, 1.0) < _BESIDE
        active = active[inside]
        if not len(active):
            break
        radius[active], opposite[active] = smaller[inside], nearest[inside]
    good = opposite >= 0
    good[good] = np.einsum("ni,ni->n", normals[chosen[good]], normals[opposite[good]]) < _OPPOSITE
    return chosen[good], opposite[good]


def _distance(vertices: np.ndarray, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.linalg.norm(vertices[one] - vertices[other], axis=1)
