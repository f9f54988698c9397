"""Unit vertex normals of a mesh as files and the viewer want them."""

from __future__ import annotations

import numpy as np

from warpdef.geometry import triangles


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Normals weighted by the area of the faces around a vertex, shape (V, 3) float32.

    A vertex without area around it gets (0, 0, 1), so that every normal has length 1.
    """
    normals = triangles.vertex_normals(np.asarray(vertices, dtype=np.float64), np.asarray(faces)).astype(np.float32)
    normals[~normals.any(axis=1)] = (0.0, 0.0, 1.0)
    return normals
