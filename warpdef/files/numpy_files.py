"""Checked reading of .npy and .npz: no pickle, and no allocation that the file's size does not cover."""

from __future__ import annotations

import math
import struct
import tokenize
import warnings
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import IO, TypeVar

import numpy as np

from warpdef.errors import InputError
from warpdef.files.columns import guess_roles, surface_of
from warpdef.files.disk import Unpacking, must_exist, reason, refuse_pointer, replacing
from warpdef.files.surface import Surface

MAPPED_FROM = 1 << 26
"""Arrays of at least so many bytes, 64 MiB, that are not compressed are mapped into memory, not read into it."""

NUMBERS = "fiu"
"""Kinds of real numbers among NumPy's types."""
_DAMAGE = (
    *(OSError, ValueError, EOFError, MemoryError, OverflowError, RuntimeError, SyntaxError, TypeError, KeyError),
    *(zlib.error, zipfile.BadZipFile, tokenize.TokenError, struct.error),
)
_HEADER_MAX = 1 << 16
_PACKED_TO_SEE, _WORTH_PACKING = 1 << 16, 0.8  # bytes, and share of them that compression leaves
_LOCAL_HEADER = struct.Struct("<4s22xHH")  # signature, and the lengths of name and extra field, which follow it
_Result = TypeVar("_Result")


def read_npy(path: Path) -> np.ndarray:
    """One array of numbers.

    Raises:
        InputError: not an .npy file, truncated, or anything but real numbers.
    """
    must_exist(path)

    def read() -> np.ndarray:
        if not path.is_file():
            raise ValueError("it is no file")
        with open(path, "rb") as stream:
            return _read_array(stream, path.stat().st_size, str(path))

    return _guarded(read, path)


def npy_array(path: Path) -> np.ndarray:
    """As ``read_npy``; a large array is mapped in place, and read-only.

    Raises:
        InputError: as ``read_npy``.
    """
    must_exist(path)
    if not path.is_file() or path.stat().st_size < MAPPED_FROM:
        return read_npy(path)

    def read() -> np.ndarray:
        with open(path, "rb") as stream:
            shape, dtype, first_fastest = _checked_header(stream, path.stat().st_size, str(path))
            order = "F" if first_fastest else "C"
            return np.memmap(path, dtype=dtype, mode="r", offset=stream.tell(), shape=shape, order=order)

    return _guarded(read, path)


def read_npy_points(path: Path, columns: Sequence[str] = ()) -> Surface:
    """Positions (N, 3), with normals (N, 6), or more columns; their roles as people say, else by their values.

    Raises:
        InputError: as ``read_npy``, or another shape.
    """
    table = read_npy(path)
    shape = table.shape
    if table.ndim != 2 or len(columns) > shape[1] or (shape[0] in (3, 6) and shape[1] > 2 * shape[0]):
        what = "save one row a point"
        if table.ndim == 3 and shape[2] in (3, 6):
            what = f"an image of points becomes a list by points.reshape(-1, {shape[2]})"
        elif table.ndim == 2 and shape[0] in (3, 6):
            what = "transpose it: points.T"
        raise InputError(f"{path}: expected shape (N, {len(columns) or 3}), or more columns, got {shape}; {what}")
    return surface_of(table, columns or guess_roles(table, str(path)))


class Npz:
    """The arrays of an .npz, each read only when asked for; large ones that are not compressed are mapped in place.

    Members are read by the names that the archive lists; nothing is ever unpacked to disk.

    Raises:
        InputError: missing, not an .npz, or its list of arrays is damaged.
    """

    def __init__(self, path: Path) -> None:
        must_exist(path)
        self.path = path
        self._members = _guarded(self._list, path)

    def _list(self) -> dict[str, zipfile.ZipInfo]:
        if not self.path.is_file():
            raise ValueError("it is no file")
        self._unpacking = Unpacking(self.path, "write it with np.savez, which does not compress")
        # Kept open: its list of members is read once, however many arrays there are.
        self._archive = zipfile.ZipFile(self.path)
        return {m.filename[:-4]: m for m in self._archive.infolist() if m.filename.endswith(".npy")}

    @property
    def names(self) -> list[str]:
        """Names of the arrays, in the file's order."""
        return list(self._members)

    def __contains__(self, name: str) -> bool:
        return name in self._members

    def header(self, name: str) -> tuple[tuple[int, ...], np.dtype]:
        """Shape and type of an array, without reading it."""
        return self._with(name, lambda stream: _read_header(stream)[:2])

    def array(self, name: str, kinds: str = NUMBERS) -> np.ndarray:
        """One array of numbers, or of other ``kinds`` as NumPy's types name them; read-only where it is mapped.

        Raises:
            InputError: no such array, damaged, of another kind, or far larger than the file's size allows.
        """
        where = f"{self.path}: {name}"

        def read(stream: IO[bytes]) -> np.ndarray:
            member = self._members[name]
            if member.compress_type != zipfile.ZIP_STORED:
                shape, dtype, _ = _read_header(stream)
                # As float64 it is a second array, unless it is that already.
                self._unpacking.take(math.prod(shape) * (dtype.itemsize + (8 if dtype.itemsize != 8 else 0)))
                stream.seek(0)
            elif member.file_size >= MAPPED_FROM:
                return _map_array(self.path, member, where, kinds)
            return _read_array(stream, member.file_size, where, kinds)

        return self._with(name, read)

    def texts(self, name: str) -> list[str]:
        """An array of strings, as a list."""

        def read(stream: IO[bytes]) -> list[str]:
            shape, dtype, _ = _read_header(stream)
            size = math.prod(shape) * dtype.itemsize
            if dtype.kind not in "US" or size > self._members[name].file_size:
                raise ValueError(f"{name} is no text")
            self._unpacking.take(2 * size)
            stream.seek(0)
            return np.lib.format.read_array(stream, allow_pickle=False).astype(np.str_).tolist()

        return self._with(name, read)

    def _with(self, name: str, use: Callable[[IO[bytes]], _Result]) -> _Result:
        if name not in self:
            raise InputError(f"{self.path}: expected an array '{name}', got {', '.join(self.names) or 'no arrays'}")

        def opened() -> _Result:
            member = self._members[name]
            if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                # Others are unpacked by zipfile as a whole, whatever that takes.
                raise InputError(
                    f"{self.path}: {name}: expected no compression, or that of np.savez_compressed, got another; write "
                    "it with np.savez"
                )
            with self._archive.open(member) as stream:
                return use(stream)

        return _guarded(opened, self.path)


def row(array: np.ndarray, index: int) -> np.ndarray:
    """``array[index]``; of a mapped array by a mapping of its own, so that its pages leave memory together with it."""
    if not isinstance(array, np.memmap) or not array.flags.c_contiguous or not array[index].size:
        return array[index]
    assert array.filename is not None  # it is mapped from a file
    offset = array.offset + index * array.strides[0]
    return np.memmap(array.filename, dtype=array.dtype, mode="r", offset=offset, shape=array.shape[1:])


def write_npz(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays as ``np.savez_compressed`` does, but as they are where that hardly makes them smaller.

    The file appears at once or not at all.

    Raises:
        InputError: the file cannot be written.
    """
    with replacing(path) as stream, zipfile.ZipFile(stream, "w") as archive:
        for name, array in arrays.items():
            member = zipfile.ZipInfo(f"{name}.npy")
            member.compress_type = zipfile.ZIP_DEFLATED if _packs_well(np.asarray(array)) else zipfile.ZIP_STORED
            with archive.open(member, "w", force_zip64=True) as place:
                np.lib.format.write_array(place, np.asarray(array), allow_pickle=False)


def _packs_well(array: np.ndarray) -> bool:
    """Whether compression is worth its time: coordinates keep nine tenths of their size. Large arrays always are
    compressed: else they would be mapped, which checks no sum."""
    sample = array.reshape(-1)[: _PACKED_TO_SEE // max(array.itemsize, 1)].tobytes()
    small = len(sample) == array.nbytes
    return small or array.nbytes >= MAPPED_FROM or len(zlib.compress(sample, 1)) < _WORTH_PACKING * len(sample)


def _guarded(read: Callable[[], _Result], path: Path) -> _Result:
    try:
        # NumPy warns of headers that it has to mend; what cannot be read is refused all the same.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return read()
    except InputError:
        raise
    except _DAMAGE as error:
        if path.is_file():
            with path.open("rb") as stream:
                refuse_pointer(stream.read(64), path)
        kind = path.suffix.lower()
        raise InputError(
            f"{path}: cannot be read as {kind} ({reason(error):.120}); it is damaged: write it again"
        ) from None


def _read_header(stream: IO[bytes]) -> tuple[tuple[int, ...], np.dtype, bool]:
    """Shape, type, and whether the first index runs fastest."""
    version = np.lib.format.read_magic(stream)
    readers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    if version not in readers:
        raise ValueError(f"npy version {version}")
    if version == (2, 0):
        start = stream.tell()
        (length,) = struct.unpack("<I", stream.read(4))
        if length > _HEADER_MAX:
            raise ValueError(f"a header of {length} bytes")
        stream.seek(start)
    shape, first_fastest, dtype = readers[version](stream)
    return shape, dtype, first_fastest


def _checked_header(
    stream: IO[bytes], size: int, where: str, kinds: str = NUMBERS
) -> tuple[tuple[int, ...], np.dtype, bool]:
    shape, dtype, first_fastest = _read_header(stream)
    if dtype.hasobject:
        raise InputError(
            f"{where}: expected numbers, got Python objects, which are not read as they can run code; "
            'save clouds of unequal length with np.savez(path, **{f"points_{t:04d}": p for t, p in enumerate(clouds)})'
        )
    if dtype.kind not in kinds:
        raise InputError(f"{where}: expected real numbers, got {dtype}; convert them to float32")
    if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize > size - stream.tell():
        raise InputError(f"{where}: expected shape {shape} of {dtype}, got fewer data; it is truncated: write it again")
    return shape, dtype, first_fastest


def _read_array(stream: IO[bytes], size: int, where: str, kinds: str = NUMBERS) -> np.ndarray:
    _checked_header(stream, size, where, kinds)
    stream.seek(0)
    return np.lib.format.read_array(stream, allow_pickle=False)


def _map_array(path: Path, member: zipfile.ZipInfo, where: str, kinds: str = NUMBERS) -> np.ndarray:
    """The array of a member stored as it is: pages are read from the file when they are looked at."""
    with open(path, "rb") as stream:
        stream.seek(member.header_offset)
        signature, name_length, extra_length = _LOCAL_HEADER.unpack(stream.read(_LOCAL_HEADER.size))
        if signature != b"PK\3\4":
            raise ValueError("no local header")
        start = member.header_offset + _LOCAL_HEADER.size + name_length + extra_length
        if start + member.file_size > path.stat().st_size:
            raise InputError(f"{where}: expected {member.file_size} bytes, got fewer; it is truncated: write it again")
        stream.seek(start)
        shape, dtype, first_fastest = _checked_header(stream, start + member.file_size, where, kinds)
        if math.prod(shape) == 0:
            return np.zeros(shape, dtype)
        order = "F" if first_fastest else "C"
        return np.memmap(path, dtype=dtype, mode="r", offset=stream.tell(), shape=shape, order=order)
