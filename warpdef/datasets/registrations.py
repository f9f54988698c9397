"""HDF5 files of registrations, as DFAUST (Bogo et al. 2017) and Dyna (Pons-Moll et al. 2015) come in.

``faces`` (F, 3) for all, and beside it a dataset a sequence, (V, 3, T), named as ``50002_chicken_wings``. Needs h5py.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from warpdef.errors import InputError, MissingPackageError
from warpdef.files.disk import must_exist, reason
from warpdef.files.frame_files import select_frames
from warpdef.files.frame_numbers import natural_key
from warpdef.mesh import MeshSequence, check_faces

HDF5_SUFFIXES = (".hdf5", ".h5")
_COMPRESSION_MAX = 1100  # deflate reaches 1032; beyond it the shape is a lie


def split_path(path: Path) -> tuple[Path, str] | None:
    """The HDF5 file and the sequence that a path means, the name empty for the file itself; None for other paths."""
    if path.suffix.lower() in HDF5_SUFFIXES:
        return path, ""
    if path.parent.suffix.lower() in HDF5_SUFFIXES and not path.parent.is_dir():
        return path.parent, path.name
    return None


def registration_sizes(path: Path) -> dict[str, tuple[int, int, int]]:
    """Frames, vertices and faces of every sequence in the file, by its name, in natural order.

    Raises:
        InputError: not HDF5, damaged, without ``faces``, or without a sequence. MissingPackageError: no h5py.
    """
    with _opened(path) as file:
        face_count = _dataset(file, "faces", path, "iu", (None, 3)).shape[0]
        names = sorted((name for name in _names(file) if name != "faces"), key=natural_key)
        if not names:
            raise InputError(f"{path}: expected sequences beside 'faces', got none; it is damaged: fetch it again")
        sizes = {}
        for name in names:
            vertices, _, frames = _sequence(file, name, path).shape
            sizes[name] = (frames, vertices, face_count)
    return sizes


def read_registration(path: Path, name: str, frames: slice | None = None) -> MeshSequence:
    """One sequence of the file; the vertices' type is the file's.

    Args:
        path: the HDF5 file.
        name: the sequence; may be empty where the file holds one only.
        frames: frames to use; others are not read where the file allows it.

    Raises:
        InputError: as ``registration_sizes``; no such sequence; no frame left; unusable faces; NaN or infinity.
        MissingPackageError: no h5py.
    """
    with _opened(path) as file:
        names = sorted((n for n in _names(file) if n != "faces"), key=natural_key)
        if not name and len(names) == 1:
            name = names[0]
        if name not in names:
            some = ", ".join(names[:4]) + (", ..." if len(names) > 4 else "")
            raise InputError(
                f"{path}: expected the name of one of its {len(names)} sequences ({some}), got {name or 'none'!r}; "
                f"write it behind the path, as {path}/{names[0] if names else 'NAME'}"
            )
        faces = _dataset(file, "faces", path, "iu", (None, 3))[()]
        data = _sequence(file, name, path)
        chosen = select_frames(range(data.shape[2]), frames, 1, path)
        # A range in h5py must go upwards.
        low, high = min(chosen), max(chosen) + 1
        part = data[:, :, low:high]
        vertices = np.ascontiguousarray(part[:, :, np.asarray(chosen) - low].transpose(2, 0, 1))
    try:
        return MeshSequence(vertices, check_faces(faces, vertices.shape[1], name))
    except InputError as error:
        raise InputError(f"{path}/{name}: {error}") from None


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    must_exist(path)
    try:
        import h5py
    except ImportError as error:
        raise MissingPackageError(
            f"{path}: HDF5 files need h5py, which does not import ({error}); pip install 'warpdef[hdf5]'"
        ) from error
    try:
        with h5py.File(path, "r") as file:
            yield file
    except InputError:
        raise
    # h5py has no error of its own: damage shows as any of these, depending on which byte is wrong.
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, MemoryError, OverflowError) as error:
        raise InputError(
            f"{path}: cannot be read as HDF5 ({reason(error):.120}); it is damaged: fetch it again"
        ) from None


def _names(file: Any) -> list[str]:
    """What is stored in the file itself: links into other files are not followed."""
    import h5py

    return [name for name in file if isinstance(file.get(name, getlink=True), h5py.HardLink)]


def _sequence(file: Any, name: str, path: Path) -> Any:
    return _dataset(file, name, path, "f", (None, 3, None))


def _dataset(file: Any, name: str, path: Path, kinds: str, shape: tuple[int | None, ...]) -> Any:
    """A dataset of numbers of the shape expected (None: any length from 1), whose data are really there."""
    import h5py

    data = file.get(name) if name in _names(file) else None
    letters = {"iu": "whole numbers (F, 3)", "f": "numbers (V, 3, T)"}[kinds]
    if not isinstance(data, h5py.Dataset):
        found = ", ".join(list(file)[:4]) or "nothing"
        got = f"a file of {found}" if data is None else "a group"
        raise InputError(f"{path}: expected a dataset '{name}' of {letters}, got {got}; it holds no registrations")
    fits = len(data.shape) == len(shape) and all(
        want in (None, have) and have > 0 for want, have in zip(shape, data.shape, strict=True)
    )
    if not fits or data.dtype.kind not in kinds:
        raise InputError(f"{path}: {name}: expected {letters}, got {data.dtype} of shape {data.shape}; convert it")
    if data.is_virtual or data.external:
        raise InputError(f"{path}: {name}: expected data in the file itself, got a reference to other files; copy them")
    stored = data.id.get_storage_size()
    if math.prod(data.shape) * data.dtype.itemsize > stored * (_COMPRESSION_MAX if data.chunks else 1):
        raise InputError(f"{path}: {name}: expected shape {data.shape}, got {stored} bytes; it is truncated")
    return data
