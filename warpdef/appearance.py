"""What a mesh looks like, apart from its shape: colours, which may change from frame to frame, and a texture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from warpdef.errors import InputError
from warpdef.texture import Texture


@dataclass(frozen=True)
class Appearance:
    """Colours and the texture of a mesh of V vertices and F faces; each may be None.

    colors:    red, green, blue and perhaps alpha, sRGB              (V, 3) or (V, 4) uint8
    uv:        texture coordinates of vertices, origin lower left    (V, 2) float32
    corner_uv: those of the faces' corners, where vertices of a seam (F, 3, 2) float32
               have several; instead of ``uv``
    texture:   the image on it, where it has texture coordinates
    frame_colors: colours of every frame of a mesh that moves            (T, V, 3) uint8, beside ``colors``
    notes:     why an image that the mesh names is missing, a line each
    """

    NAMES: ClassVar[tuple[str, ...]] = ("vertex_colors", "uv", "corner_uv", "frame_colors")
    """Names of the arrays in an .npz."""

    colors: np.ndarray | None = None
    uv: np.ndarray | None = None
    corner_uv: np.ndarray | None = None
    texture: Texture | None = None
    notes: tuple[str, ...] = ()
    frame_colors: np.ndarray | None = None

    @classmethod
    def checked(
        cls,
        vertex_count: int,
        face_count: int,
        colors: np.ndarray | None = None,
        uv: np.ndarray | None = None,
        corner_uv: np.ndarray | None = None,
        texture: Texture | None = None,
        frame_colors: np.ndarray | None = None,
    ) -> Appearance:
        """Take arrays that fit a mesh.

        Raises:
            InputError: one has another shape or type, or is not finite, or there is an image without coordinates.
        """
        if colors is not None:
            colors = np.asarray(colors)
            shapes = [(vertex_count, 3), (vertex_count, 4)]
            if colors.dtype != np.uint8 or colors.shape not in shapes:
                raise InputError(
                    f"vertex colours: expected uint8 of shape {shapes[0]} or {shapes[1]}, got {colors.dtype} of "
                    f"{colors.shape}; give one colour a vertex"
                )
            colors = np.ascontiguousarray(colors)
        uv = _coordinates(uv, (vertex_count, 2), "one pair a vertex")
        corner_uv = _coordinates(corner_uv, (face_count, 3, 2), "one pair a corner of a face")
        if texture is not None and uv is None and corner_uv is None:
            raise InputError("texture image: expected texture coordinates with it, got none; give uv or corner_uv")
        if frame_colors is not None:
            frame_colors = np.asarray(frame_colors)
            shape = (*frame_colors.shape[:1], vertex_count, 3)
            if frame_colors.dtype != np.uint8 or frame_colors.shape != shape:
                raise InputError(
                    f"colours of the frames: expected uint8 of shape (T, {vertex_count}, 3), got {frame_colors.dtype} "
                    f"of {frame_colors.shape}"
                )
        return cls(colors, uv, corner_uv, texture, frame_colors=frame_colors)

    def over(self, other: Appearance | None) -> Appearance:
        """This look, with the other's colours where it has neither colours nor an image."""
        if other is None or self.colors is not None or self.texture is not None:
            return self
        return replace(self, colors=other.colors, frame_colors=other.frame_colors)

    def colors_of(self, frame: int) -> np.ndarray | None:
        """Colours that a frame shows: its own, else those of all frames, else None."""
        return self.colors if self.frame_colors is None else self.frame_colors[frame]

    def arrays(self) -> dict[str, np.ndarray]:
        """What there is, by its names in an .npz."""
        found = zip(self.NAMES, (self.colors, self.uv, self.corner_uv, self.frame_colors), strict=True)
        return {name: array for name, array in found if array is not None}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray], vertex_count: int, face_count: int) -> Appearance:
        """The way back from ``arrays``; other names are passed over.

        Raises:
            InputError: an array does not fit the mesh.
        """
        colors, uv, corner_uv, frame_colors = (arrays.get(name) for name in cls.NAMES)
        return cls.checked(vertex_count, face_count, colors, uv, corner_uv, frame_colors=frame_colors)


def split_seams(corner_uv: np.ndarray, faces: np.ndarray, vertex_count: int) -> tuple[np.ndarray, ...]:
    """Vertices doubled along the seams of a texture, for programs that know one texture place a vertex.

    Args:
        corner_uv: shape (F, 3, 2). faces: shape (F, 3).

    Returns:
        For each new vertex the old one that it copies, shape (W,): the old ones first and in their order, copies after
        them; faces, shape (F, 3) int32; texture coordinates, shape (W, 2) float32.
    """
    corners = faces.reshape(-1).astype(np.int64)
    keys = np.ascontiguousarray(corner_uv.reshape(-1, 2) + np.float32(0.0)).view(np.int32)  # -0 is 0
    pairs, first, pair_of = np.unique(np.column_stack([corners, keys]), axis=0, return_index=True, return_inverse=True)
    owner = pairs[:, 0]
    # Of a vertex's places the one used first stays with it.
    order = np.lexsort((first, owner))
    is_copy = np.r_[False, owner[order][1:] == owner[order][:-1]]
    number = np.empty(len(pairs), dtype=np.int64)
    number[order] = np.where(is_copy, vertex_count + np.cumsum(is_copy) - 1, owner[order])
    source = np.concatenate([np.arange(vertex_count), owner[order][is_copy]])
    uv = np.zeros((len(source), 2), dtype=np.float32)
    uv[number] = corner_uv.reshape(-1, 2)[first]
    return source, number[pair_of.ravel()].reshape(-1, 3).astype(np.int32), uv


def _coordinates(uv: np.ndarray | None, shape: tuple[int, ...], advice: str) -> np.ndarray | None:
    if uv is None:
        return None
    uv = np.ascontiguousarray(uv, dtype=np.float32)
    if uv.shape != shape or not np.isfinite(uv).all():
        raise InputError(
            f"texture coordinates: expected finite numbers of shape {shape}, got shape {uv.shape}; give {advice}"
        )
    return uv
