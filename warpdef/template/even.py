"""Even triangles for a surface: as many as asked for, and of an open one a border that they follow."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from warpdef.errors import InputError
from warpdef.geometry import triangles
from warpdef.template.cut import cut_at_zero
from warpdef.template.poisson import Backend
from warpdef.template.support import Support
from warpdef.template.trim import find_trimming

FACES_AIM = 0.97  # of the target, which is an upper bound
FACES_LEAST = 0.9
REMESH_ATTEMPTS = 4


def remesh_open(
    backend: Backend, support: Support, vertices: np.ndarray, faces: np.ndarray, edge_length: float
) -> tuple[np.ndarray, np.ndarray]:
    """Even triangles first, so that the cut has edges of one length to follow; then again inside the new border."""
    vertices, faces = triangles.compact(*backend.remesh(vertices, faces, edge_length))
    vertices, faces = cut_at_zero(vertices, faces, find_trimming(vertices, faces, support).level)
    return backend.remesh(vertices, faces, edge_length)


def even_triangles(
    vertices: np.ndarray,
    faces: np.ndarray,
    area: float,
    target: int,
    remesh: Callable[[np.ndarray, np.ndarray, float], tuple[np.ndarray, np.ndarray]],
) -> tuple[np.ndarray, np.ndarray, float]:
    """Vertices and faces, just under ``target`` of them, and the edge length h that did it.

    F equilateral faces have the area F sqrt(3) / 4 h^2.
    """
    if not area > 0:
        raise InputError("the reconstructed surface has no area; the cloud does not look like a closed surface")
    edge_length = triangles.equilateral_edge(area, FACES_AIM * target)
    best = None
    for _ in range(REMESH_ATTEMPTS):
        try:
            new_vertices, new_faces = triangles.compact(*remesh(vertices, faces, edge_length))
        except ValueError as error:
            raise InputError(f"the reconstructed surface cannot be remeshed ({error})") from error
        count = len(new_faces)
        usable = count >= 4 and np.isfinite(new_vertices).all()
        if usable and (best is None or _misfit(count, target) < _misfit(len(best[1]), target)):
            best = (new_vertices, new_faces, float(edge_length))
        if FACES_LEAST * target <= count <= target:
            break
        edge_length *= np.sqrt(max(count, target / 4) / (FACES_AIM * target))
    if best is None:
        raise InputError("the remeshing lost the surface; raise template.faces_max or template.faces_per_point")
    return best


def _misfit(count: int, target: int) -> float:
    # Too many faces break the user's bound; too few only cost detail.
    return abs(count - target) + (10.0 * target if count > target else 0.0)
