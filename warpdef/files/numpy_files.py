"""Checked reading of .npy and .npz: no pickle, and no allocation that the file's size does not cover."""

from __future__ import annotations

import math
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import IO, TypeVar

import numpy as np

from warpdef.errors import InputError
from warpdef.files.disk import must_exist, reason, replacing

_DAMAGE = (
    *(OSError, ValueError, EOFError, MemoryError, OverflowError, RuntimeError, SyntaxError, TypeError, KeyError),
    *(zlib.error, zipfile.BadZipFile, tokenize.TokenError),
)
_Result = TypeVar("_Result")


def read_npy(path: Path) -> np.ndarray:
    """One array of numbers.

    Raises:
        InputError: not an .npy file, truncated, or anything but real numbers.
    """
    must_exist(path)

    def read() -> np.ndarray:
        with open(path, "rb") as stream:
            return _read_array(stream, path.stat().st_size, str(path))

    return _guarded(read, path)


class Npz:
    """The arrays of an .npz, each read only when asked for.

    Raises:
        InputError: missing, not an .npz, or its list of arrays is damaged.
    """

    def __init__(self, path: Path) -> None:
        must_exist(path)
        self.path = path
        self._sizes = _guarded(self._list, path)

    def _list(self) -> dict[str, int]:
        with zipfile.ZipFile(self.path) as archive:
            return {m.filename[:-4]: m.file_size for m in archive.infolist() if m.filename.endswith(".npy")}

    @property
    def names(self) -> list[str]:
        """Names of the arrays, in the file's order."""
        return list(self._sizes)

    def __contains__(self, name: str) -> bool:
        return name in self._sizes

    def header(self, name: str) -> tuple[tuple[int, ...], np.dtype]:
        """Shape and type of an array, without reading it."""
        return self._with(name, lambda stream: _read_header(stream))

    def array(self, name: str) -> np.ndarray:
        """One array of numbers.

        Raises:
            InputError: no such array, damaged, or anything but real numbers.
        """
        return self._with(name, lambda stream: _read_array(stream, self._sizes[name], f"{self.path}: {name}"))

    def texts(self, name: str) -> list[str]:
        """An array of strings, as a list."""
        return self._with(name, lambda stream: np.lib.format.read_array(stream, allow_pickle=False).tolist())

    def _with(self, name: str, use: Callable[[IO[bytes]], _Result]) -> _Result:
        if name not in self:
            raise InputError(f"{self.path}: expected an array '{name}', got {', '.join(self.names) or 'no arrays'}")

        def opened() -> _Result:
            with zipfile.ZipFile(self.path) as archive, archive.open(f"{name}.npy") as stream:
                return use(stream)

        return _guarded(opened, self.path)


def write_npz(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write compressed arrays; the file appears at once or not at all.

    Raises:
        InputError: the file cannot be written.
    """
    with replacing(path) as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)


def _guarded(read: Callable[[], _Result], path: Path) -> _Result:
    try:
        return read()
    except InputError:
        raise
    except _DAMAGE as error:
        kind = path.suffix.lower()
        raise InputError(
            f"{path}: cannot be read as {kind} ({reason(error):.120}); it is damaged: write it again"
        ) from None


def _read_header(stream: IO[bytes]) -> tuple[tuple[int, ...], np.dtype]:
    version = np.lib.format.read_magic(stream)
    readers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    if version not in readers:
        raise ValueError(f"npy version {version}")
    shape, _, dtype = readers[version](stream)
    return shape, dtype


def _read_array(stream: IO[bytes], size: int, where: str) -> np.ndarray:
    shape, dtype = _read_header(stream)
    if dtype.hasobject:
        raise InputError(f"{where}: expected numbers, got Python objects, which are not read as they can run code")
    if dtype.kind not in "fiu":
        raise InputError(f"{where}: expected real numbers, got {dtype}; convert them to float32")
    if math.prod(shape) * dtype.itemsize > size - stream.tell():
        raise InputError(f"{where}: expected shape {shape} of {dtype}, got fewer data; it is truncated: write it again")
    stream.seek(0)
    return np.lib.format.read_array(stream, allow_pickle=False)
