"""LAS files, versions 1.0 to 1.4, and LAZ, the same compressed by LASzip. Positions and colours.

Every point record begins with X, Y, Z as int32; a position is ``X * scale + offset`` by the header's doubles, so that
nothing of large map coordinates is lost. Colours have 16 bits, or 8 in files of some programs. The compressed body is
unpacked by lazrs, an extra: ``warpdef[las]``.
"""

from __future__ import annotations

import io
import os
import struct
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from warpdef.cloud import byte_colors
from warpdef.errors import InputError, MissingPackageError
from warpdef.files.disk import Unpacking, read_bytes, reason
from warpdef.files.surface import Surface

_LEAST_HEADER = 227
_RECORD_HEADER = struct.Struct("<2x16sHH32x")  # of a variable length record: user, id, length
_LEAST_RECORDS = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)  # bytes of a point, by format
_COLORS_AT = {2: 20, 3: 28, 5: 28, 7: 30, 8: 30, 10: 30}  # by format
_CHUNK = 1 << 16  # points unpacked at once
_LASZIP = (b"laszip encoded", 22204)


@dataclass(frozen=True)
class _LasHeader:
    """count: points. start: of the points. length: of a point's record. records: of variable length, before start.
    kind: format of a point."""

    count: int
    start: int
    length: int
    compressed: bool
    scale: np.ndarray
    offset: np.ndarray
    header_size: int
    records: int
    kind: int

    @property
    def row(self) -> np.dtype:
        """What is read of a point's record."""
        fields = {"xyz": ("<i4", 3, 0), "intensity": ("<u2", 1, 12), "class": ("u1", 1, 16 if self.kind > 5 else 15)}
        fields |= {"rgb": ("<u2", 3, _COLORS_AT[self.kind])} if self.kind in _COLORS_AT else {}
        formats = [(kind, (n,)) if n > 1 else kind for kind, n, _ in fields.values()]
        places = [at for _, _, at in fields.values()]
        return np.dtype({"names": [*fields], "formats": formats, "offsets": places, "itemsize": self.length})

    def placed(self, steps: np.ndarray) -> np.ndarray:
        """Float64 positions of X, Y, Z (N, 3) int32: counts of steps, often a millimetre, from an offset."""
        return steps * self.scale + self.offset


def read_las(path: Path) -> Surface:
    """Positions, float64 in the file's own coordinates, and colours of a .las or .laz file.

    Raises:
        InputError: not a LAS file, a damaged header, or fewer data than the header declares.
        MissingPackageError: the file is compressed and lazrs is not installed.
    """
    data = read_bytes(path)
    header = _parse_header(data, path)
    rows = _unpacked(data, header, path) if header.compressed else _records(data, header, path)
    colors = rows["rgb"] if header.kind in _COLORS_AT and rows["rgb"].any() else None
    passed = [name for field, name in (("intensity", "intensity"), ("class", "classification")) if rows[field].any()]
    shades = None if colors is None else byte_colors(colors, whole=True)
    return Surface(header.placed(rows["xyz"]), colors=shades, passed=tuple(passed))


def _parse_header(data: bytes, path: Path) -> _LasHeader:
    if not data.startswith(b"LASF") or len(data) < _LEAST_HEADER:
        raise InputError(f"{path}: expected a LAS file, got one that does not start as one; check its suffix")
    minor, header_size, start, records = data[25], *struct.unpack_from("<HII", data, 94)
    kind, length, count = struct.unpack_from("<BHI", data, 104)
    scale, offset = np.frombuffer(data, "<f8", 6, 131).reshape(2, 3)
    if minor >= 4 and header_size >= 375 and len(data) >= 375:
        count = struct.unpack_from("<Q", data, 247)[0] or count
    # LASzip marks its files by the high bits of the format.
    compressed, kind = kind >= 128, kind & 63
    fits = _LEAST_HEADER <= header_size <= start <= len(data)
    if not fits or kind >= len(_LEAST_RECORDS) or length < _LEAST_RECORDS[kind] or not np.isfinite(scale).all():
        raise InputError(f"{path}: the LAS header is damaged; write the file again")
    if not np.isfinite(offset).all() or records > (start - header_size) // _RECORD_HEADER.size:
        raise InputError(f"{path}: the LAS header is damaged; write the file again")
    return _LasHeader(count, start, length, compressed, scale, offset, header_size, records, kind)


def _records(data: bytes, header: _LasHeader, path: Path) -> np.ndarray:
    """Rows of a body that is not compressed, shape (N,)."""
    if header.count > (len(data) - header.start) // header.length:
        raise InputError(
            f"{path}: expected {header.count} points as the LAS header says, got a file too short for them; it is "
            "truncated: write it again"
        )
    return np.frombuffer(data, header.row, header.count, header.start)


def _unpacked(data: bytes, header: _LasHeader, path: Path) -> np.ndarray:
    """Rows of a compressed body, shape (N,), of what is read of them only."""
    try:
        import lazrs
    except ImportError as error:
        raise MissingPackageError(
            f"{path}: .laz needs lazrs ({error}); install it: pip install 'warpdef[las]', or convert to .las"
        ) from error
    # A dense scan takes two or three bytes a point, and 24 as float64, besides colours.
    kept = np.dtype([(name, header.row[name]) for name in header.row.names or ()])
    Unpacking(path, "convert it to .las", times=24).take(header.count * 24)
    settings = next((body for name, body in _variable_records(data, header) if name == _LASZIP), None)
    if settings is None:
        raise InputError(f"{path}: expected the record of LASzip in a compressed file, got none; it is damaged")
    _check_chunks(data, header, path)
    try:
        points, at = np.empty(header.count, kept), 0
        with _no_standard_error():
            for chunk in _chunks(lazrs, data, settings, header):
                for name in kept.names or ():
                    points[name][at : at + len(chunk)] = chunk[name]
                at += len(chunk)
        return points
    except BaseException as error:
        # A panic of the library is no Exception, but says no more than that the data are damaged.
        damage = (lazrs.LazrsError, ValueError, OverflowError, MemoryError)
        if not isinstance(error, damage) and type(error).__name__ != "PanicException":
            raise
        raise InputError(f"{path}: cannot be unpacked ({reason(error):.120}); it is damaged: write it again") from None


@contextmanager
def _no_standard_error() -> Iterator[None]:
    """Keep quiet what the library writes there when it gives up on damaged data; the error itself is told later."""
    sys.stderr.flush()
    try:
        kept = os.dup(2)
    except OSError:  # no descriptor 2 at all
        yield
        return
    try:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 2)
        os.close(nowhere)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)


def _chunks(lazrs: Any, data: bytes, settings: bytes, header: _LasHeader) -> Iterator[np.ndarray]:
    stream = io.BytesIO(data)
    stream.seek(header.start)
    unpacker = lazrs.LasZipDecompressor(stream, settings)
    if unpacker.vlr().item_size() != header.length:
        raise ValueError("the sizes of a point differ")
    left = header.count
    while left:
        rows = np.zeros((min(left, _CHUNK), header.length), dtype=np.uint8)
        unpacker.decompress_many(rows.reshape(-1))
        yield rows.reshape(-1).view(header.row)
        left -= len(rows)


def _check_chunks(data: bytes, header: _LasHeader, path: Path) -> None:
    """The table of chunks stands behind the points; its length is checked before the library allocates it."""
    try:
        (table,) = struct.unpack_from("<q", data, header.start)
        if table < 0:
            # Written by a program that could not go back: then the place of the table ends the file.
            (table,) = struct.unpack_from("<q", data, len(data) - 8)
        if table < header.start:
            raise ValueError
        (chunks,) = struct.unpack_from("<4xI", data, table)
        if chunks > len(data) - table:
            raise ValueError
    except (struct.error, ValueError):
        raise InputError(f"{path}: the table of chunks is damaged; write the file again") from None


def _variable_records(data: bytes, header: _LasHeader) -> Iterator[tuple[tuple[bytes, int], bytes]]:
    at = header.header_size
    for _ in range(header.records):
        if at + _RECORD_HEADER.size > header.start:
            return
        user, number, length = _RECORD_HEADER.unpack_from(data, at)
        at += _RECORD_HEADER.size
        yield (user.rstrip(b"\0"), number), data[at : min(at + length, header.start)]
        at += length
