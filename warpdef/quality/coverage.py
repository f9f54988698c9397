"""What one frame's points and its mesh say of each other.

Lengths are counted in units of what the points can tell: a point's own spacing, or the noise where that is larger.

    spacing   0.5 / sqrt(density), the mean distance to the nearest neighbour; density from the 8th neighbour
    noise     standard deviation of the points across the surface, from their neighbourhoods' principal axes
    seen      a vertex is seen if the way to its nearest point and from there back to the surface ends beside it, and on
              the same side: the back of a thin limb, or what no camera saw, finds no such point
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdef.cloud import SPACING_NEIGHBOURS
from warpdef.geometry.closest import closest_on_surface
from warpdef.geometry.edges import squared_lengths
from warpdef.geometry.nearby import Fellows, Nearest
from warpdef.geometry.noise import noise_level
from warpdef.geometry.triangles import face_normals, vertex_normals

if TYPE_CHECKING:
    import warp as wp

COVERED = 3.0
"""Lengths from the surface up to which a point counts as covered."""
FAR = 4.0
"""Lengths from every point from which surface counts as far."""
OTHER_SIDE = -0.25
"""Cosine between the normals of a vertex and of its point's place on the surface below which that is another side."""
_SPACING = 0.5 * np.sqrt(np.pi / SPACING_NEIGHBOURS)  # mean distance to the first neighbour over that to the 8th
_SAME_WAY = 0.5  # cosine between the normals of a vertex and of its point's place above which they face one way
_APART = 1.5  # times the distance, plus a length: what was that far apart in the shape does not belong together


@dataclass(frozen=True)
class Coverage:
    """One frame; N points, V vertices, F faces.

    residual:  exact distance of each point to the surface, input units      (N,)
    length:    larger of spacing and noise at each point, input units        (N,)
    spacing:   at each point, input units                                    (N,)
    noise:     input units
    face:      where on the surface each point's closest place is            (N,)
    weights:   its barycentric coordinates there                             (N, 3)
    nearest:   the point nearest to each vertex                              (V,)
    away:      distance of each vertex to it, in lengths                     (V,)
    seen:      whether the frame shows each vertex                           (V,)
    unseen:    share of the surface that the frame does not show, far or not
    far_faces: share of each face farther than ``FAR`` lengths from all      (F,)
    areas:     of the faces, input units squared                             (F,)
    normals:   of the vertices, unit                                         (V, 3)
    """

    residual: np.ndarray
    length: np.ndarray
    spacing: np.ndarray
    noise: float
    face: np.ndarray
    weights: np.ndarray
    nearest: np.ndarray
    away: np.ndarray
    seen: np.ndarray
    unseen: float
    far_faces: np.ndarray
    areas: np.ndarray
    normals: np.ndarray

    @property
    def uncovered(self) -> float:
        """Share of the points that the surface does not reach."""
        return float(np.mean(self.residual > COVERED * self.length))

    @property
    def far(self) -> float:
        """Share of the surface far from every point."""
        return self.share(self.far_faces)

    def share(self, of_faces: np.ndarray) -> float:
        """Mean over the surface of a number a face, shape (F,)."""
        return _mean_by_area(of_faces, self.areas)


def doubled_vertices(
    coverage: Coverage, vertices: np.ndarray, shape: np.ndarray, faces: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices near points that lie on another part of the surface, from which the shape holds them apart.

    The back of a thin limb is as near to the points on its front, but so it is in the shape.

    Args:
        coverage: of this frame. vertices: shape (V, 3). shape: the same in the shape (V, 3). faces: shape (F, 3).

    Returns:
        Those that the frame does not show, (V,) bool, and those that face the way of that other part, as a second layer
        of it, (V,) bool.
    """
    near = np.flatnonzero(coverage.away <= FAR)
    point = coverage.nearest[near]
    corners, weights = faces[coverage.face[point]], coverage.weights[point]

    def there(values: np.ndarray) -> np.ndarray:
        return np.einsum("nk,nki->ni", weights, values[corners])

    now, then = (np.linalg.norm(there(x) - x[near], axis=1) for x in (vertices, shape))
    cosine = (there(coverage.normals) * coverage.normals[near]).sum(axis=1)
    apart = then > _APART * now + coverage.length[point]
    hidden, layered = np.zeros((2, len(vertices)), dtype=bool)
    hidden[near] = apart & ~coverage.seen[near]
    layered[near] = apart & (cosine > _SAME_WAY)
    return hidden, layered


def measure_coverage(
    points: np.ndarray, vertices: np.ndarray, faces: np.ndarray, device: wp.Device | None = None
) -> Coverage:
    """Compare one frame's cloud with its mesh.

    Args:
        points: shape (N, 3) float64. vertices: shape (V, 3) float64, the same units. faces: shape (F, 3).
        device: where Warp looks for what is nearest; None: without Warp. On the CPU its tree of the mesh is three times
            as fast as another, its grid of the points no faster than theirs, which is taken.

    Raises:
        MissingPackageError: gpytoolbox cannot be imported.
    """
    from scipy.spatial import cKDTree

    tree, rank = cKDTree(points), min(SPACING_NEIGHBOURS + 1, len(points))
    if device is None or _by_tree(device):
        query, far_off = tree.query, tree.query(points, k=[rank])[0]
    else:
        query, far_off = _nearest_of(points, device), Fellows(points, rank, device=device).distance[:, -1:]
    spacing = _SPACING * far_off[:, 0]
    noise = noise_level(points, tree, np.random.default_rng(0))
    length = np.maximum(np.maximum(spacing, noise), np.finfo(float).tiny)

    residual, face, weights = closest_on_surface(points, vertices, faces, device)
    corners = vertices[faces]
    back = np.einsum("nk,nki->ni", weights, corners[face])
    distance, nearest = query(vertices)
    reach = FAR * length[nearest]
    normal, areas = face_normals(vertices, faces)
    beside = np.linalg.norm(back[nearest] - vertices, axis=1) <= reach
    normals = vertex_normals(vertices, faces)
    same_side = np.einsum("vi,vi->v", normals, normal[face[nearest]]) > OTHER_SIDE
    far = distance > reach

    far_faces = far[faces].mean(axis=1)
    # Of a face longer than the reach the middle may be far where its corners are not: a web between two limbs.
    ends = np.ascontiguousarray(faces.T)
    longest_sq = np.max([squared_lengths(vertices, ends[k - 1], ends[k]) for k in range(3)], axis=0)
    wide = np.flatnonzero(longest_sq > (FAR * np.median(length)) ** 2)
    if len(wide):
        middle, near = query(corners[wide].mean(axis=1))
        far_faces[wide] = np.maximum(far_faces[wide], middle > FAR * length[near])
    seen = beside & same_side & ~far
    unseen = _mean_by_area(np.maximum(far_faces, (~seen)[faces].mean(axis=1)), areas)
    away = distance / length[nearest]
    of_mesh = far_faces, areas, normals
    return Coverage(residual, length, spacing, noise, face, weights, nearest, away, seen, unseen, *of_mesh)


def _by_tree(device: wp.Device) -> bool:
    from warpdef.device import Way, way_of  # not before a command runs

    return way_of(device) is Way.SPANS


def _nearest_of(points: np.ndarray, device: wp.Device) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Of places, the distances to the nearest of the points, and these: on a device, in the cube."""
    middle = np.median(points, axis=0)
    scale = float(np.abs(points - middle).max()) or 1.0
    nearest = Nearest((points - middle) / scale, device)

    def query(places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        distance, index = nearest.query((places - middle) / scale)
        return scale * distance, index

    return query


def _mean_by_area(of_faces: np.ndarray, areas: np.ndarray) -> float:
    return float((areas * of_faces).sum() / max(areas.sum(), np.finfo(float).tiny))
