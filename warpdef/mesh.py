"""Triangle meshes as checked arrays: one mesh, and one mesh that moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warpdef.appearance import Appearance
from warpdef.errors import InputError


def check_faces(faces: np.ndarray, vertex_count: int, where: str) -> np.ndarray:
    """Return ``faces`` as contiguous int32, shape (F, 3).

    Raises:
        InputError: on a wrong shape, no faces, or an index outside ``0 .. vertex_count - 1``.
    """
    faces = np.asarray(faces)
    if faces.ndim != 2 or faces.shape[1] != 3:
        raise InputError(f"{where}: faces: expected shape (F, 3), got {faces.shape}; triangulate the mesh first")
    if len(faces) == 0:
        raise InputError(
            f"{where}: a mesh without faces; expected at least one triangle, got none; give a surface mesh"
        )
    if not np.issubdtype(faces.dtype, np.integer):
        raise InputError(f"{where}: faces: expected integer indices, got {faces.dtype}")
    low, high = int(faces.min()), int(faces.max())
    if low < 0 or high >= vertex_count:
        raise InputError(
            f"{where}: faces: expected vertex indices in 0..{vertex_count - 1}, got {low}..{high}; the file is damaged"
        )
    return np.ascontiguousarray(faces, dtype=np.int32)


def float32_where_exact(vertices: np.ndarray) -> np.ndarray:
    """Positions (T, V, 3) as float32, or as float64 where float32 would lose some of the shape.

    Coordinates of 1,000,000 are 0.06 apart in float32: far from the origin a shape would be lost. The bound is a
    millionth of the extent of all frames, about what a fit in float32 within the unit cube resolves.
    """
    low, high = vertices.min(axis=(0, 1)), vertices.max(axis=(0, 1))
    with np.errstate(over="ignore"):
        step = np.spacing(np.maximum(np.abs(low), np.abs(high)).max().astype(np.float32))
    return vertices.astype(np.float32 if step <= 1e-6 * (high - low).max() else np.float64)


@dataclass(frozen=True)
class TriMesh:
    """One triangle mesh.

    vertices:   positions, input units            (V, 3) float64
    faces:      vertex indices, counter-clockwise (F, 3) int32
    appearance: colours and texture coordinates, where it has any
    """

    vertices: np.ndarray
    faces: np.ndarray
    appearance: Appearance | None = None

    def __post_init__(self) -> None:
        vertices = np.ascontiguousarray(self.vertices, dtype=np.float64)
        if vertices.ndim != 2 or vertices.shape[1] != 3:
            raise InputError(f"mesh vertices: expected shape (V, 3), got {vertices.shape}")
        if not np.isfinite(vertices).all():
            raise InputError("mesh vertices: expected finite numbers, got NaN or infinity")
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", check_faces(self.faces, len(vertices), "mesh"))


@dataclass(frozen=True)
class MeshSequence:
    """The same triangles in every frame.

    vertices: positions, input units            (T, V, 3) float64 or float32, kept as given
    faces:    vertex indices, counter-clockwise (F, 3) int32
    """

    vertices: np.ndarray
    faces: np.ndarray

    def __post_init__(self) -> None:
        vertices = np.asarray(self.vertices)
        if vertices.dtype not in (np.float32, np.float64):
            vertices = vertices.astype(np.float64)
        if vertices.ndim != 3 or vertices.shape[2] != 3:
            raise InputError(f"mesh sequence vertices: expected shape (T, V, 3), got {vertices.shape}")
        if not np.isfinite(vertices).all():
            frame = int(np.flatnonzero(~np.isfinite(vertices).all(axis=(1, 2)))[0])
            raise InputError(f"mesh sequence vertices: expected finite numbers, got NaN or infinity in frame {frame}")
        object.__setattr__(self, "vertices", np.ascontiguousarray(vertices))
        object.__setattr__(self, "faces", check_faces(self.faces, vertices.shape[1], "mesh sequence"))

    def __len__(self) -> int:
        return len(self.vertices)

    def __getitem__(self, frame: int) -> TriMesh:
        return TriMesh(self.vertices[frame], self.faces)

    def select(self, frames: slice) -> MeshSequence:
        """The frames of a slice, in order."""
        return MeshSequence(self.vertices[frames], self.faces)
