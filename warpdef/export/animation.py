"""A moving mesh with all that a file for other programs can carry."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from warpdef.errors import InputError
from warpdef.files.frame_files import select_frames
from warpdef.mesh import MeshSequence

FPS = 24.0
"""Frames a second where nothing else is said."""


@dataclass(frozen=True)
class Animation:
    """What is exported. Positions stay as they are: ``up`` and ``metres_per_unit`` only say how to read them.

    meshes:          the moving mesh, input units                T frames, V vertices, F faces; made float32
    names:           what the frames are called                  T strings
    fps:             frames a second
    up:              the axis that points up in the data         "y" or "z"
    metres_per_unit: length of the input's unit, metres
    colors:          red, green, blue and perhaps alpha, sRGB    (V, 3) or (V, 4) uint8, or None
    uv:              texture coordinates, origin lower left      (V, 2) float32, or None
    """

    meshes: MeshSequence
    names: tuple[str, ...] = ()
    fps: float = FPS
    up: str = "y"
    metres_per_unit: float = 1.0
    colors: np.ndarray | None = None
    uv: np.ndarray | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.fps) and self.fps > 0.0):
            raise InputError(f"--fps: expected a number above 0, got {self.fps}")
        if not (np.isfinite(self.metres_per_unit) and self.metres_per_unit > 0.0):
            raise InputError(f"--metres-per-unit: expected a number above 0, got {self.metres_per_unit}")
        if self.up not in ("y", "z"):
            raise InputError(f"--up: expected y or z, got {self.up}")
        with np.errstate(over="ignore"):
            vertices = np.asarray(self.meshes.vertices, dtype=np.float32)
        if not np.isfinite(vertices).all():
            raise InputError("the moving mesh: expected coordinates that fit float32, got larger ones; scale it down")
        object.__setattr__(self, "meshes", MeshSequence(vertices, self.meshes.faces))
        names = tuple(self.names) or tuple(f"frame {t}" for t in range(len(vertices)))
        if len(names) != len(vertices):
            raise InputError(f"frame names: expected {len(vertices)}, got {len(names)}")
        object.__setattr__(self, "names", names)
        count = vertices.shape[1]
        if self.colors is not None:
            colors = np.asarray(self.colors)
            if colors.dtype != np.uint8 or colors.shape not in ((count, 3), (count, 4)):
                raise InputError(
                    f"vertex colours: expected uint8 of shape ({count}, 3) or ({count}, 4), got {colors.dtype} of "
                    f"{colors.shape}; give one colour a vertex"
                )
            object.__setattr__(self, "colors", np.ascontiguousarray(colors))
        if self.uv is not None:
            uv = np.asarray(self.uv, dtype=np.float32)
            if uv.shape != (count, 2) or not np.isfinite(uv).all():
                raise InputError(
                    f"texture coordinates: expected finite numbers of shape ({count}, 2), got shape {uv.shape}; "
                    "give one pair a vertex"
                )
            object.__setattr__(self, "uv", np.ascontiguousarray(uv))

    def __len__(self) -> int:
        return len(self.meshes)

    @property
    def vertices(self) -> np.ndarray:
        """Positions, shape (T, V, 3) float32, input units."""
        return self.meshes.vertices

    @property
    def faces(self) -> np.ndarray:
        """Triangles, shape (F, 3) int32."""
        return self.meshes.faces

    @property
    def times(self) -> np.ndarray:
        """Seconds from the first frame, shape (T,) float32."""
        return (np.arange(len(self)) / self.fps).astype(np.float32)


def load_animation(
    path: Path | str, *, frames: slice | None = None, fps: float = FPS, up: str = "y", metres_per_unit: float = 1.0
) -> Animation:
    """A run folder as an animation; ``vertex_colors`` and ``uv`` of its sequence.npz come along where it has them.

    Raises:
        InputError: not a run folder, damaged, no frame left, or a number out of range.
    """
    from warpdef.files.numpy_files import Npz
    from warpdef.files.run_folder import load_run

    run = load_run(path)
    chosen = select_frames(range(len(run.meshes)), frames, 1, run.path)
    npz = Npz(run.path / "sequence.npz")
    colors, uv = (npz.array(name) if name in npz else None for name in ("vertex_colors", "uv"))
    return Animation(
        MeshSequence(run.meshes.vertices[chosen], run.meshes.faces),
        tuple(run.names[t] for t in chosen),
        fps,
        up,
        metres_per_unit,
        colors,
        uv,
    )


def linear_colors(colors: np.ndarray) -> np.ndarray:
    """sRGB colours (V, 3|4) uint8 as linear light in 0..1, float64, alpha unchanged (IEC 61966-2-1)."""
    value = np.asarray(colors) / 255.0
    light = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    light[:, 3:] = value[:, 3:]
    return light
