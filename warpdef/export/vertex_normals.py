"""Unit vertex normals of a mesh, fast enough to be taken anew for every frame shown."""

from __future__ import annotations

import numpy as np


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Normals weighted by the area of the faces around a vertex, shape (V, 3) float32.

    A vertex without area around it gets (0, 0, 1), so that every normal has length 1.
    """
    vertices = np.asarray(vertices, dtype=np.float64)
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    # Twice the area times the unit normal: larger faces weigh more by themselves.
    face = np.cross(b - a, c - a)
    corners = np.asarray(faces).reshape(-1)
    total = np.stack(
        [np.bincount(corners, np.repeat(face[:, axis], 3), minlength=len(vertices)) for axis in range(3)], axis=1
    )
    length = np.linalg.norm(total, axis=1, keepdims=True)
    flat = length[:, 0] <= np.finfo(np.float64).tiny
    normals = (total / np.where(length > 0.0, length, 1.0)).astype(np.float32)
    normals[flat] = (0.0, 0.0, 1.0)
    return normals
