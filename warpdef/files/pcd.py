"""PCD files of the Point Cloud Library, version 0.7 and before: ascii, binary and binary_compressed.

Read are x, y, z and, where all three are there, normals and colours under any usual name, or colours as PCL packs them,
``rgb`` or ``rgba``: red, green and blue in the bytes of one number. All other fields are passed over. Points are taken
as they stand: the acquisition VIEWPOINT is not applied, as PCL does not apply it either. Points that a sensor did not
see are NaN and are left out later, with a warning.
"""

from __future__ import annotations

import re
import struct
from array import array
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from warpdef.errors import InputError
from warpdef.files.columns import COLORS, NORMALS, POINTS, named_surface, plain_numbers, role_of, roles_of
from warpdef.files.disk import TEXT_BLOCK, Unpacking, read_bytes
from warpdef.files.lzf import lzf_decompress
from warpdef.files.surface import Surface

_HEADER_MAX = 1 << 16
_KINDS = {("F", 4), ("F", 8), *((kind, size) for kind in "IU" for size in (1, 2, 4, 8))}
_PACKED = ("rgb", "rgba")
_VALUES_MAX = 1 << 16  # values of a field


@dataclass(frozen=True)
class _PcdHeader:
    """names, dtypes, counts: of each field. points: their number. form: of the data, which begin at ``start``."""

    names: tuple[str, ...]
    dtypes: tuple[np.dtype, ...]
    counts: tuple[int, ...]
    points: int
    form: str
    start: int

    @property
    def row(self) -> np.dtype:
        """Layout of a point in a binary body; fields are told apart by position, as names may repeat."""
        return np.dtype([(f"f{i}", d, (c,)) for i, (d, c) in enumerate(zip(self.dtypes, self.counts, strict=True))])


def read_pcd(path: Path) -> Surface:
    """Points, normals and colours of a PCD file.

    Raises:
        InputError: not a PCD file, a damaged header, no x, y, z, or fewer data than the header declares.
    """
    data = read_bytes(path)
    header = _parse_header(data, str(path))
    columns = {"ascii": _read_text, "binary": _read_rows, "binary_compressed": _read_compressed}[header.form](
        data, header, path
    )
    if not set(POINTS) <= set(columns):
        raise InputError(f"{path}: expected the fields x, y, z, got {', '.join(header.names)[:80]}")
    packed = columns.pop(_PACKED[0], None)
    passed = [
        n for n in header.names if role_of(n) not in columns and n != "_" and (packed is None or n not in _PACKED)
    ]
    if packed is not None:
        columns |= dict(zip(COLORS, _unpacked(packed), strict=True))
    whole = packed is not None or columns.get("red", np.zeros(0)).dtype.kind in "iu"
    return named_surface(columns, passed, whole)


def _unpacked(column: np.ndarray) -> list[np.ndarray]:
    """Red, green and blue of numbers that hold all three: the bits of a float32, or a whole number; each (N,) uint8."""
    with np.errstate(invalid="ignore", over="ignore"):
        # Written as text some programs give the number itself, others that of the same bits, far below 1.
        is_whole = column.dtype.kind in "iu" or bool(((column == np.rint(column)) & (np.abs(column) < 1 << 24)).all())
        bits = column.astype(np.int64) if is_whole else column.astype(np.float32).view(np.uint32)
    return [(bits >> shift & 255).astype(np.uint8) for shift in (16, 8, 0)]


def _parse_header(data: bytes, where: str) -> _PcdHeader:
    end = re.search(rb"^DATA[ \t]+(\w+)[ \t]*\r?(\n|\Z)", data[:_HEADER_MAX], re.MULTILINE)
    if end is None:
        raise InputError(f"{where}: expected a PCD header with a line DATA, got none; check the file's suffix")
    words: dict[str, list[str]] = {}
    for line in data[: end.start()].decode("latin-1").splitlines():
        key, *values = line.split() or [""]
        words[key] = values
    form = end[1].decode("latin-1")
    if form not in ("ascii", "binary", "binary_compressed"):
        raise InputError(f"{where}: expected DATA ascii, binary or binary_compressed, got {form[:40]}")
    try:
        names = words.get("FIELDS") or words["COLUMNS"]
        counts = [int(word) for word in words.get("COUNT", ["1"] * len(names))]
        sizes = [int(word) for word in words["SIZE"]]
        kinds = list(zip(words["TYPE"], sizes, strict=True))
        points = int(words["POINTS"][0]) if "POINTS" in words else int(words["WIDTH"][0]) * int(words["HEIGHT"][0])
        if not len(names) == len(counts) == len(kinds) or not set(kinds) <= _KINDS:
            raise ValueError
        if points < 0 or not all(0 <= count <= _VALUES_MAX for count in counts):
            raise ValueError
    except (KeyError, IndexError, ValueError):
        raise InputError(
            f"{where}: PCD header: expected FIELDS, SIZE, TYPE and COUNT that fit together, and POINTS; it is damaged: "
            "write the file again"
        ) from None
    dtypes = tuple(np.dtype(f"<{kind.lower()}{size}") for kind, size in kinds)
    return _PcdHeader(tuple(names), dtypes, tuple(counts), points, form, end.end())


def _read_text(data: bytes, header: _PcdHeader, path: Path) -> dict[str, np.ndarray]:
    """Columns of an ascii body, a point a line. Block by block: as words the numbers would take far more memory."""
    width = sum(header.counts)
    if not width or header.points > len(data) // width:
        raise _truncated(path, header)
    numbers, at = array("d"), header.start
    try:
        while at < len(data):
            end = data.find(b"\n", at + TEXT_BLOCK) + 1 or len(data)
            numbers.extend([float(word) for word in plain_numbers(data[at:end]).split()])
            at = end
    except ValueError as error:
        raise InputError(f"{path}: expected numbers after the PCD header, got something else ({error})") from None
    if len(numbers) < header.points * width:
        raise _truncated(path, header)
    table = np.frombuffer(numbers, dtype=np.float64)[: header.points * width].reshape(header.points, width)
    first = np.cumsum([0, *header.counts])
    return {name: table[:, first[i]] for i, name in _single(header)}


def _read_rows(data: bytes, header: _PcdHeader, path: Path) -> dict[str, np.ndarray]:
    """Columns of a binary body: points one after the other."""
    row = header.row
    if not row.itemsize or header.points > (len(data) - header.start) // row.itemsize:
        raise _truncated(path, header)
    table = np.frombuffer(data, row, header.points, header.start)
    return {name: table[f"f{i}"][:, 0] for i, name in _single(header)}


def _read_compressed(data: bytes, header: _PcdHeader, path: Path) -> dict[str, np.ndarray]:
    """Columns of a compressed body: two sizes, then fields one after the other, packed together by LZF."""
    if len(data) - header.start < 8:
        raise _truncated(path, header)
    packed, size = struct.unpack_from("<II", data, header.start)
    start = header.start + 8
    if packed > len(data) - start or size != header.points * header.row.itemsize:
        raise _truncated(path, header)
    Unpacking(path, "write it as binary").take(size + 48 * header.points)
    try:
        body = lzf_decompress(data[start : start + packed], size)
    except ValueError as error:
        raise InputError(f"{path}: {error}; it is damaged: write it again") from None
    columns, at = {}, 0
    wanted = dict(_single(header))
    for i, (dtype, count) in enumerate(zip(header.dtypes, header.counts, strict=True)):
        if i in wanted:
            columns[wanted[i]] = np.frombuffer(body, dtype, header.points, at)
        at += dtype.itemsize * count * header.points
    return columns


def _single(header: _PcdHeader) -> list[tuple[int, str]]:
    """Index and role of the fields that are read; they must have one value a point. Packed colours are ``rgb``."""
    packed = [i for i, name in enumerate(header.names) if name in _PACKED and header.dtypes[i].itemsize == 4]
    roles = roles_of(header.names)
    if packed:
        roles[packed[0]] = _PACKED[0]
    wanted = (*POINTS, *NORMALS, *(_PACKED[:1] if packed else COLORS))
    return [(i, role) for i, role in enumerate(roles) if role in wanted and header.counts[i] == 1]


def _truncated(path: Path, header: _PcdHeader) -> InputError:
    return InputError(
        f"{path}: expected {header.points} points as the PCD header says, got other data than that; it is truncated: "
        "write it again"
    )
