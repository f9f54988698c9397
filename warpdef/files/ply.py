"""PLY files: ASCII and both binary orders in, binary little-endian out.

The header's counts are checked against the file's size before anything is allocated. An ASCII body becomes one array
of doubles and is then read by the same code as a binary body whose every property is a double.
"""

from __future__ import annotations

import os
import re
import struct
from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from warpdef.errors import InputError
from warpdef.files.columns import PASSED_OVER, POINTS, named_surface, plain_numbers, roles_of
from warpdef.files.disk import TEXT_BLOCK, read_bytes, replacing
from warpdef.files.surface import NamedImages, Surface, fan_triangles
from warpdef.mesh import check_faces

_NAMED_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "bool": "u1"}
_NAMED_TYPES |= {"float": "f4", "double": "f8", "half": "f2", "long": "i8", "ulong": "u8"}
_SIZED_TYPE = re.compile(r"(u?int|float)(8|16|32|64)")
_ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}
_HEADER_MAX = 1 << 20
_BLANK = re.compile(rb"\s")
_ELEMENTS = {"vertices": "vertex", "points": "vertex", "point": "vertex", "faces": "face"}
_PLACES_ON_IMAGE = ("s", "t", "u", "v", "texture_u", "texture_v")
_BOM = b"\xef\xbb\xbf"


@dataclass
class _Element:
    name: str
    count: int
    # (name, type of a value, type of the list's length or None for a single value)
    properties: list[tuple[str, np.dtype, np.dtype | None]] = field(default_factory=list)
    # whether the header declares whole numbers, which an ASCII body's doubles no longer tell
    is_whole: dict[str, bool] = field(default_factory=dict)

    def row_dtype(self, lengths: dict[str, int]) -> np.dtype:
        """Layout of a row whose lists have the given lengths."""
        fields: list[tuple] = []
        for name, value, length in self.properties:
            if length is None:
                fields.append((name, value))
            else:
                fields += [(f"{name} length", length), (name, value, (lengths[name],))]
        return np.dtype(fields)


def read_ply(path: Path) -> Surface:
    """Points, normals (``nx ny nz``), colours, texture coordinates and faces of a PLY file.

    Normals and colours may be called anything that ``columns.role_of`` knows; other properties are passed over by their
    size. Colours are bytes or fractions of 1; texture coordinates are ``s t``, ``u v`` or ``texture_u texture_v`` of a
    vertex, or ``texcoord`` of a triangle's corners. The image is named by ``comment TextureFile``, as MeshLab has it.

    Raises:
        InputError: not a PLY file, a damaged header, no x, y, z, or fewer data than the header declares.
    """
    data = read_bytes(path).removeprefix(_BOM)
    header, offset = _header_lines(data, str(path))
    elements, ascii_body = _parse_header(header, str(path))
    buffer = _numbers(data[offset:], str(path)) if ascii_body else memoryview(data)[offset:]
    surface = faces = uv = corner_uv = None
    for element in elements:
        columns, buffer = _read_element(element, buffer, str(path))
        if element.name == "vertex":
            surface, uv = _vertices(columns, element, str(path)), _texture(columns)
        elif element.name == "face":
            indices = columns.get("vertex_indices", columns.get("vertex_index"))
            if isinstance(indices, tuple):
                faces = fan_triangles(_whole_numbers(indices[0], str(path)), indices[1], str(path))
                wedges = columns.get("texcoord")
                if isinstance(wedges, tuple) and (indices[1] == 3).all() and (wedges[1] == 6).all():
                    corner_uv = wedges[0].reshape(-1, 3, 2).astype(np.float64)
    if surface is None:
        raise InputError(f"{path}: expected an element 'vertex' in the PLY header, got none; export the points")
    names = [line.split(None, 2)[2] for line in header if re.match(r"comment TextureFile[ \t]+\S", line)]
    named = NamedImages(images=tuple(os.fsdecode(name.rstrip().encode("latin-1")) for name in names))
    return replace(surface, faces=faces, uv=uv, corner_uv=corner_uv, named=named)


def _vertices(columns: dict, element: _Element, where: str) -> Surface:
    """Points, normals and colours by the names of their properties."""
    single = [name for name, column in columns.items() if isinstance(column, np.ndarray)]
    named = dict(zip(roles_of(single), single, strict=True))
    named.pop(PASSED_OVER, None)
    if not set(POINTS) <= set(named):
        raise InputError(f"{where}: expected vertex properties x, y, z, got {', '.join(columns) or 'none'}")
    passed = [name for name in columns if name not in named.values() and name not in _PLACES_ON_IMAGE]
    whole = element.is_whole.get(named.get("red", ""), False)
    return named_surface({role: columns[name] for role, name in named.items()}, passed, whole)


def _header_lines(data: bytes, where: str) -> tuple[list[str], int]:
    """Lines of the header behind the first, and where the body starts."""
    if data[:3].lower() != b"ply":
        raise InputError(f"{where}: expected a PLY file, got one that does not start with 'ply'; check its suffix")
    # A body may begin with any byte, so that the first line tells what ends the last.
    first = re.match(rb"ply[ \t]*(\r\n|\n|\r)", data[:100], re.IGNORECASE)
    line_end = first[1] if first else b"\n"
    ending = rb"\r?\n" if line_end != b"\r" else rb"\r"
    end = re.search(rb"[\r\n]end_header[ \t]*" + ending, data[:_HEADER_MAX], re.IGNORECASE)
    if end is None:
        raise InputError(f"{where}: the PLY header has no end; the file is truncated: write it again")
    return data[: end.start()].decode("latin-1").splitlines()[1:], end.end()


def _parse_header(lines: Sequence[str], where: str) -> tuple[list[_Element], bool]:
    """Elements, and whether the body is ASCII."""
    elements: list[_Element] = []
    form, order = None, ""
    for line in lines:
        words = line.lower().split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        try:
            if words[0] == "format":
                form, order = words[1], _ORDERS[words[1]]
            elif words[0] == "element":
                elements.append(_Element(_ELEMENTS.get(words[1], words[1]), int(words[2])))
            elif words[0] == "property" and words[1] == "list":
                length, value = (_value_type(w, form, order) for w in words[2:4])
                elements[-1].properties.append((words[4], value, length))
            elif words[0] == "property":
                elements[-1].properties.append((words[2], _value_type(words[1], form, order), None))
                elements[-1].is_whole[words[2]] = _known_type(words[1])[0] in "iu"
            else:
                raise KeyError
        except (KeyError, IndexError, ValueError):
            raise InputError(f"{where}: PLY header: cannot read the line {line[:80]!r}; write the file again") from None
        if elements and elements[-1].count < 0:
            raise InputError(f"{where}: PLY header: expected counts from 0, got {elements[-1].count}")
    if form is None:
        raise InputError(f"{where}: PLY header: expected a 'format' line, got none; write the file again")
    return elements, form == "ascii"


def _known_type(word: str) -> str:
    sized = _SIZED_TYPE.fullmatch(word)
    return (
        _NAMED_TYPES[word]
        if sized is None
        else {"uint": "u", "int": "i", "float": "f"}[sized[1]] + str(int(sized[2]) // 8)
    )


def _value_type(word: str, form: str | None, order: str) -> np.dtype:
    known = _known_type(word)
    return np.dtype("<f8") if form == "ascii" else np.dtype(order + known)


def _numbers(body: bytes, where: str) -> memoryview:
    body = plain_numbers(body)
    # Block by block: as words the numbers would take twenty times the memory.
    numbers, at = array("d"), 0
    try:
        while at < len(body):
            end = _BLANK.search(body, at + TEXT_BLOCK)
            numbers.extend([float(word) for word in body[at : end.start() if end else len(body)].split()])
            at = end.end() if end else len(body)
    except ValueError as error:
        raise InputError(f"{where}: expected numbers after the PLY header, got something else ({error})") from None
    return memoryview(numbers).cast("B")


def _read_element(element: _Element, buffer: memoryview, where: str) -> tuple[dict, memoryview]:
    """Columns by name (a list property: flat values and lengths), and the rest of the buffer."""
    if element.count == 0 or not element.properties:
        return {name: np.zeros(0) for name, _, length in element.properties if length is None}, buffer
    lists = [name for name, _, length in element.properties if length is not None]
    smallest = element.row_dtype(dict.fromkeys(lists, 0))
    _require_bytes(element, element.count * smallest.itemsize, buffer, where)
    lengths = _first_lengths(element, buffer, where) if lists else {}
    row = element.row_dtype(lengths) if max(lengths.values(), default=0) < 256 else None
    if row is not None and element.count * row.itemsize <= len(buffer):
        table = np.frombuffer(buffer, row, element.count)
        if all((table[f"{name} length"] == lengths[name]).all() for name in lists):
            columns = {
                name: (table[name].reshape(-1), np.full(element.count, lengths[name])) if name in lists else table[name]
                for name, _, _ in element.properties
            }
            return columns, buffer[element.count * row.itemsize :]
    if not lists:
        _require_bytes(element, element.count * smallest.itemsize, buffer, where)
    return _walk_rows(element, buffer, where)


def _require_bytes(element: _Element, needed: int, buffer: memoryview, where: str) -> None:
    if needed > len(buffer):
        raise InputError(
            f"{where}: expected {element.count} of '{element.name}' as the PLY header says, got a file too short for "
            "them; it is truncated: write it again"
        )


def _list_length(buffer: memoryview, at: int, kind: np.dtype, element: _Element, where: str) -> int:
    _require_bytes(element, at + kind.itemsize, buffer, where)
    code = {"i8": "q", "u8": "Q"}.get(kind.str[1:], kind.char)  # NumPy has other letters for 8 bytes
    length = struct.unpack_from(("<" if kind.str[0] != ">" else ">") + code, buffer, at)[0]
    if not length >= 0 or length != length // 1:
        raise InputError(f"{where}: '{element.name}': expected list lengths from 0, got {length}; the file is damaged")
    _require_bytes(element, at + kind.itemsize + int(min(length, 1e18)), buffer, where)
    return int(length)


def _first_lengths(element: _Element, buffer: memoryview, where: str) -> dict[str, int]:
    at, lengths = 0, {}
    for name, value, length in element.properties:
        if length is not None:
            lengths[name] = _list_length(buffer, at, length, element, where)
            at += length.itemsize
        at += value.itemsize * lengths.get(name, 1)
    return lengths


def _walk_rows(element: _Element, buffer: memoryview, where: str) -> tuple[dict, memoryview]:
    """Rows of unequal length, one after the other."""
    pieces = {name: bytearray() for name, _, _ in element.properties}
    counts = {name: array("q") for name, _, length in element.properties if length is not None}
    at = 0
    for _ in range(element.count):
        for name, value, length in element.properties:
            number = 1
            if length is not None:
                number = _list_length(buffer, at, length, element, where)
                at += length.itemsize
                counts[name].append(number)
            _require_bytes(element, at + number * value.itemsize, buffer, where)
            pieces[name] += buffer[at : at + number * value.itemsize]
            at += number * value.itemsize
    columns = {}
    for name, value, length in element.properties:
        flat = np.frombuffer(pieces[name], value)
        columns[name] = flat if length is None else (flat, np.array(counts[name], dtype=np.int64))
    return columns, buffer[at:]


def _texture(columns: dict) -> np.ndarray | None:
    for pair in zip(_PLACES_ON_IMAGE[0::2], _PLACES_ON_IMAGE[1::2], strict=True):
        found = [column for name in pair if isinstance(column := columns.get(name), np.ndarray)]
        if len(found) == len(pair):
            with np.errstate(invalid="ignore"):
                return np.stack(found, axis=1).astype(np.float64)
    return None


def _whole_numbers(values: np.ndarray, where: str) -> np.ndarray:
    if values.dtype.kind == "f" and not (np.abs(values) < 2**53).all() or (values != values // 1).any():
        raise InputError(f"{where}: faces: expected whole vertex indices, got fractions; the file is damaged")
    return values.astype(np.int64)


def write_ply(path: Path, vertices: np.ndarray, faces: np.ndarray, colors: np.ndarray | None = None) -> None:
    """Write a mesh as binary little-endian PLY; the file appears at once or not at all.

    Args:
        path: where to; an existing file is replaced.
        vertices: shape (V, 3); float32 is stored as float, anything else as double.
        faces: shape (F, 3), indices into ``vertices``.
        colors: shape (V, 3) or (V, 4) uint8, written as red, green, blue and alpha.

    Raises:
        InputError: wrong shapes or indices, or the file cannot be written.
    """
    path, vertices = Path(path), np.asarray(vertices)
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise InputError(f"{path}: vertices: expected shape (V, 3), got {vertices.shape}")
    single = vertices.dtype == np.float32
    rows = np.empty(len(faces), dtype=[("length", "u1"), ("indices", "<i4", (3,))])
    rows["length"], rows["indices"] = 3, check_faces(faces, len(vertices), str(path))
    real = "float" if single else "double"
    header = ["ply", "format binary_little_endian 1.0", "comment warpdef", f"element vertex {len(vertices)}"]
    header += [f"property {real} {axis}" for axis in "xyz"]
    shades = () if colors is None else ("red", "green", "blue", "alpha")[: colors.shape[1]]
    header += [f"property uchar {name}" for name in shades]
    kind = "<f4" if single else "<f8"
    points = np.empty(len(vertices), dtype=[("xyz", kind, (3,)), ("rgb", "u1", (len(shades),))])
    points["xyz"] = vertices
    if colors is not None:
        points["rgb"] = colors
    header += [f"element face {len(rows)}", "property list uchar int vertex_indices", "end_header", ""]
    with replacing(path) as stream:
        stream.write("\n".join(header).encode("ascii"))
        stream.write(points.tobytes())
        stream.write(rows.tobytes())
