"""A moving set of points, without faces: a folder of PLY files, or an npz that reads back as a sequence of clouds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from warpdef.errors import InputError
from warpdef.export.mesh_folders import write_ply_frames
from warpdef.mesh import float32_where_exact


@dataclass(frozen=True)
class MovingPoints:
    """What is exported of points.

    points:  places, input units                          (T, N, 3); float32, or float64 far from the origin
    names:   what the frames are called                   T strings
    fps:     frames a second
    normals: of the points, in every frame, or None       (T, N, 3)
    colors:  red, green, blue and perhaps alpha, or None  (N, 3) or (N, 4) uint8
    """

    points: np.ndarray
    names: tuple[str, ...]
    fps: float
    normals: np.ndarray | None = None
    colors: np.ndarray | None = None

    def __post_init__(self) -> None:
        points = np.asarray(self.points)
        if points.ndim != 3 or points.shape[2] != 3 or len(self.names) != len(points):
            raise InputError(f"moving points: expected shape ({len(self.names)}, N, 3), got {points.shape}")
        points = np.ascontiguousarray(float32_where_exact(points))
        object.__setattr__(self, "points", points)


def write_points_ply_folder(moving: MovingPoints, folder: Path) -> None:
    """Make ``folder`` with a binary PLY a frame."""
    write_ply_frames(folder, moving.points, moving.normals, moving.colors)


def write_points_npz(moving: MovingPoints, path: Path) -> None:
    """``points`` (T, N, 3), which are a sequence of clouds, with ``normals``, ``vertex_colors``, ``names``, ``fps``."""
    arrays = {"points": moving.points, "names": np.array(moving.names, dtype=np.str_), "fps": np.float64(moving.fps)}
    optional = {"normals": moving.normals, "vertex_colors": moving.colors}
    arrays |= {name: array for name, array in optional.items() if array is not None}
    with open(path, "wb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)
