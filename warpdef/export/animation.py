"""A moving mesh with all that a file for other programs can carry."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np

from warpdef.appearance import Appearance, split_seams
from warpdef.errors import InputError
from warpdef.export.measured import VertexValues, measure_vertices
from warpdef.export.origin import choose_origin
from warpdef.export.pace import frame_names, pace
from warpdef.export.vertex_normals import vertex_normals
from warpdef.files.frame_files import select_frames
from warpdef.mesh import MeshSequence
from warpdef.texture import Texture
from warpdef.vertex_measures import VertexMeasures

FPS = 24.0
"""Frames a second where nothing else is said."""

GREY = (0.72, 0.74, 0.78)
"""Colour of a surface that has none, linear light."""
ROUGHNESS = 0.7
"""Roughness of every surface; none is metallic."""


@dataclass(frozen=True)
class Animation:
    """What is exported. Positions stay as they are: ``up`` and ``metres_per_unit`` only say how to read them.

    meshes:          the moving mesh, input units                T frames, V vertices, F faces; float32, from origin
    names:           what the frames are called                  T strings
    fps:             frames a second
    up:              the axis that points up in the data         "y" or "z"
    metres_per_unit: length of the input's unit, metres
    colors:          red, green, blue and perhaps alpha, sRGB    (V, 3) or (V, 4) uint8, or None
    frame_colors:    colours of every frame, in their place      (T, V, 3) uint8, or None
    copies:          of the last vertices, doubled along a texture's seams, the vertex that each copies  (C,), or None
    uv:              texture coordinates, origin lower left      (V, 2) float32, or None
    normals:         where they are not those of the faces       (T, V, 3) float32, or None
    origin:          point that the mesh's positions count from  (3,) float64, input units; chosen if not given: 0, but
                     far from 0, where float32 would lose the shape, a point near the mesh
    texture:         the image on it, where it has uv, or None
    measured:        a number at every vertex and frame, shown in place of colours and texture, or None
    """

    meshes: MeshSequence
    names: tuple[str, ...] = ()
    fps: float = FPS
    up: str = "y"
    metres_per_unit: float = 1.0
    colors: np.ndarray | None = None
    uv: np.ndarray | None = None
    normals: np.ndarray | None = None
    origin: np.ndarray = cast(np.ndarray, None)  # chosen below if not given
    texture: Texture | None = None
    measured: VertexValues | None = None
    frame_colors: np.ndarray | None = None
    copies: np.ndarray | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.fps) and self.fps > 0.0):
            raise InputError(f"--fps: expected a number above 0, got {self.fps}")
        if not (np.isfinite(self.metres_per_unit) and self.metres_per_unit > 0.0):
            raise InputError(f"--metres-per-unit: expected a number above 0, got {self.metres_per_unit}")
        if self.up not in ("y", "z"):
            raise InputError(f"--up: expected y or z, got {self.up}")
        given = self.meshes.vertices
        if self.origin is None:
            object.__setattr__(self, "origin", choose_origin(given))
            given = given - self.origin if self.origin.any() else given
        with np.errstate(over="ignore"):
            vertices = np.asarray(given, dtype=np.float32)
        if not np.isfinite(vertices).all():
            raise InputError("the moving mesh: expected coordinates that fit float32, got larger ones; scale it down")
        object.__setattr__(self, "meshes", MeshSequence(vertices, self.meshes.faces))
        names = tuple(self.names) or tuple(f"frame {t}" for t in range(len(vertices)))
        if len(names) != len(vertices):
            raise InputError(f"frame names: expected {len(vertices)}, got {len(names)}")
        object.__setattr__(self, "names", names)
        look = Appearance.checked(vertices.shape[1], len(self.meshes.faces), self.colors, self.uv, texture=self.texture)
        object.__setattr__(self, "colors", look.colors)
        object.__setattr__(self, "uv", look.uv)
        if self.frame_colors is not None and self.frame_colors.shape != vertices.shape:
            raise InputError(f"frame colours: expected shape {vertices.shape}, got {self.frame_colors.shape}")
        if self.measured is not None and self.measured.values.shape != vertices.shape[:2]:
            raise InputError(f"measure: expected numbers of {vertices.shape[:2]}, got {self.measured.values.shape}")
        if self.normals is not None:
            normals = np.ascontiguousarray(self.normals, dtype=np.float32)
            if normals.shape != vertices.shape or not np.isfinite(normals).all():
                raise InputError(f"normals: expected finite numbers of shape {vertices.shape}, got {normals.shape}")
            object.__setattr__(self, "normals", normals)

    def __len__(self) -> int:
        return len(self.meshes)

    @property
    def vertices(self) -> np.ndarray:
        """Positions from ``origin``, shape (T, V, 3) float32, input units."""
        return self.meshes.vertices

    @property
    def is_far(self) -> bool:
        """Whether positions count from another point than the data's own origin."""
        return bool(self.origin.any())

    @property
    def places(self) -> np.ndarray:
        """Positions from the data's own origin, shape (T, V, 3), input units: float64 if far from it, else float32."""
        return self.vertices + self.origin if self.is_far else self.vertices

    @property
    def faces(self) -> np.ndarray:
        """Triangles, shape (F, 3) int32."""
        return self.meshes.faces

    @property
    def times(self) -> np.ndarray:
        """Seconds from the first frame, shape (T,) float32."""
        return (np.arange(len(self)) / self.fps).astype(np.float32)

    @property
    def base_color(self) -> tuple[float, float, float]:
        """The material's colour, linear light; white where colours or a texture are to show through it."""
        plain = self.colors is None and self.uv is None and self.measured is None
        return GREY if plain else (1.0, 1.0, 1.0)

    def normals_of(self, frame: int) -> np.ndarray:
        """Unit normals of a frame, those given or those of the faces, shape (V, 3) float32."""
        if self.normals is not None:
            return self.normals[frame]
        if self.copies is not None:  # a seam of the texture is no edge of the surface
            normals = self.joined.normals_of(frame)
            return np.concatenate([normals, normals[self.copies]])
        return vertex_normals(self.vertices[frame], self.faces)

    @cached_property
    def joined(self) -> Animation:
        """The same without copies of vertices, for formats whose faces have texture places of their own, or none: the
        mesh's own vertices in their own number and order, without ``uv`` and texture."""
        if self.copies is None:
            return self
        count = self.vertices.shape[1] - len(self.copies)
        owner = np.concatenate([np.arange(count), self.copies])
        meshes = MeshSequence(self.vertices[:, :count], owner[self.faces])
        fewer = {"normals": self.normals, "frame_colors": self.frame_colors}
        own = {name: None if values is None else values[:, :count] for name, values in fewer.items()}
        colors = None if self.colors is None else self.colors[:count]
        return replace(self, meshes=meshes, colors=colors, uv=None, texture=None, copies=None, **own)

    @cached_property
    def moving_colors(self) -> np.ndarray | None:
        """Colours that change from frame to frame, a measure's or their own, sRGB: shape (T, V, 3) uint8, or None."""
        return self.frame_colors if self.measured is None else self.measured.colors()

    def colors_of(self, frame: int) -> np.ndarray | None:
        """The surface's own colours in a frame, shape (V, 3) or (V, 4) uint8, or None."""
        return self.colors if self.frame_colors is None else self.frame_colors[frame]

    def all_normals(self) -> np.ndarray:
        """``normals_of`` every frame, shape (T, V, 3) float32."""
        return np.stack([self.normals_of(frame) for frame in range(len(self))])


def dress(
    vertices: np.ndarray, faces: np.ndarray, look: Appearance, normals: np.ndarray | None = None, **how: Any
) -> Animation:
    """A moving mesh with its colours and texture; vertices of a texture's seams are doubled, copies last.

    Args:
        vertices: shape (T, V, 3). faces: shape (F, 3). normals: shape (T, V, 3). how: other fields of ``Animation``.

    Raises:
        InputError: something does not fit, or a number is out of range.
    """
    colors, uv, moving, copies = look.colors, look.uv, look.frame_colors, None
    if look.corner_uv is not None:
        source, faces, uv = split_seams(look.corner_uv, faces, vertices.shape[1])
        copies = source[vertices.shape[1] :] if len(source) > vertices.shape[1] else None
        vertices = vertices[:, source]
        colors, normals = None if colors is None else colors[source], None if normals is None else normals[:, source]
        moving = None if moving is None else moving[:, source]
    more = {"colors": colors, "uv": uv, "normals": normals, "texture": look.texture, "frame_colors": moving}
    return Animation(MeshSequence(vertices, faces), copies=copies, **more, **how)


def load_animation(
    path: Path | str,
    *,
    frames: slice | None = None,
    fps: float = FPS,
    up: str = "y",
    metres_per_unit: float = 1.0,
    slow: float = 1.0,
    recorded_fps: float | None = None,
    measures: VertexMeasures | None = None,
    color: str = "",
    unit: str = "input units",
) -> Animation:
    """A run folder as an animation, with the colours and the texture of its template where it has them.

    Args:
        path: the run folder. frames: frames of it to use. fps, up, metres_per_unit: as the fields of ``Animation``.
        slow, recorded_fps: as in ``pace``.
        measures: of all frames of the run. color: the one that takes the place of colours and texture; empty: none.
        unit: what a length of 1 is called.

    Raises:
        InputError: not a run folder, damaged, no frame left, a number out of range, or the measure cannot be known.
    """
    from warpdef.files.saved_run import load_run

    run = load_run(path)
    chosen = select_frames(range(len(run.meshes)), frames, 1, run.path)
    times = pace(chosen, fps, slow, recorded_fps)
    how = {"names": frame_names(run.names, times), "fps": fps, "up": up, "metres_per_unit": metres_per_unit}
    if measures is None or not color:
        look = run.appearance
        if look.frame_colors is not None:
            look = replace(look, frame_colors=_colors_at(look.frame_colors, times))
        return dress(run.at(times), run.faces, look, **how)
    measured = measure_vertices(measures, color, times, unit)
    return Animation(MeshSequence(run.at(times), run.faces), measured=measured, **how)


def _colors_at(colors: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Colours (T, V, 3) uint8 at times counted in frames, linear between two of them, shape (n, V, 3) uint8."""
    before = np.floor(times).astype(int)
    after = np.minimum(before + 1, len(colors) - 1)
    share = np.asarray(times) - before
    return np.stack(
        [np.rint((1 - s) * colors[a] + s * colors[b]) for a, b, s in zip(before, after, share, strict=True)]
    ).astype(np.uint8)


def linear_colors(colors: np.ndarray) -> np.ndarray:
    """sRGB colours (V, 3|4) uint8 as linear light in 0..1, float64, alpha unchanged (IEC 61966-2-1)."""
    value = np.asarray(colors) / 255.0
    light = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    light[:, 3:] = value[:, 3:]
    return light
