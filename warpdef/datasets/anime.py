"""The ``.anime`` files of DeformingThings4D (Li et al. 2021), little-endian:

int32 T, int32 V, int32 F; positions of the first frame, V x 3 float32; triangles, F x 3 int32; then for every
further frame the offsets from the first, V x 3 float32

The counts are believed only if the file's size is exactly theirs; frames that are not asked for are not read.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from warpdef.errors import InputError
from warpdef.files.disk import must_exist, reason
from warpdef.files.frame_files import select_frames
from warpdef.mesh import MeshSequence

_HEADER = 12  # bytes


def anime_size(path: Path) -> tuple[int, int, int]:
    """Frames, vertices and faces of an ``.anime`` file.

    Raises:
        InputError: missing, truncated, or of a size that its counts do not explain.
    """
    must_exist(path)
    try:
        with open(path, "rb") as stream:
            header = stream.read(_HEADER)
        size = path.stat().st_size
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({reason(error)}); check the path and its permissions") from None
    if len(header) < _HEADER:
        raise InputError(f"{path}: expected an .anime file, got {size} bytes; it is truncated: fetch it again")
    frames, vertices, faces = struct.unpack("<iii", header)
    if frames < 1 or vertices < 3 or faces < 1:
        raise InputError(
            f"{path}: expected counts of frames, vertices and faces, got {frames}, {vertices} and {faces}; "
            "it is no .anime file, or damaged: fetch it again"
        )
    expected = _HEADER + 12 * (frames * vertices + faces)
    if size != expected:
        raise InputError(
            f"{path}: expected {expected} bytes for {frames} frames of {vertices} vertices and {faces} faces, "
            f"got {size}; it is {'truncated' if size < expected else 'damaged'}: fetch it again"
        )
    return frames, vertices, faces


def read_anime(path: Path, frames: slice | None = None) -> MeshSequence:
    """The moving mesh of an ``.anime`` file, vertices (T, V, 3) float32.

    Raises:
        InputError: as ``anime_size``; no frame left; a face of vertices that are not there; NaN or infinity.
    """
    frame_count, vertex_count, face_count = anime_size(path)
    chosen = select_frames(range(frame_count), frames, 1, path)
    vertices = np.empty((len(chosen), vertex_count, 3), dtype=np.float32)
    try:
        with open(path, "rb") as stream:
            stream.seek(_HEADER)
            first = _read(stream, "<f4", vertex_count)
            faces = _read(stream, "<i4", face_count)
            body = stream.tell()
            for place, frame in enumerate(chosen):
                vertices[place] = first
                if frame:
                    stream.seek(body + 12 * vertex_count * (frame - 1))
                    vertices[place] += _read(stream, "<f4", vertex_count)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({reason(error)}); it is damaged: fetch it again") from None
    try:
        return MeshSequence(vertices, faces)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _read(stream, dtype: str, rows: int) -> np.ndarray:
    data = stream.read(12 * rows)
    return np.frombuffer(data, dtype=dtype).reshape(rows, 3)
