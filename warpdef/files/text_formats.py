"""OBJ and OFF files in. Text only; vertex order as in the file, nothing merged."""

from __future__ import annotations

import io
import os
import re
from array import array
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np

from warpdef.cloud import byte_colors
from warpdef.errors import InputError
from warpdef.files.columns import plain_numbers
from warpdef.files.disk import read_bytes
from warpdef.files.surface import NamedImages, Surface, fan_triangles, vertex_or_corner_uv

_BLOCK = 1 << 14  # rows that are kept as words before they become numbers


def read_obj(path: Path) -> Surface:
    """Vertices, faces, normals, texture coordinates and vertex colours of an OBJ file; materials by name only.

    Normals are taken where there are as many ``vn`` as ``v`` and no face pairs a vertex with another's normal; texture
    coordinates where all corners of all faces have them; colours where every ``v`` has six numbers.

    Raises:
        InputError: no vertices, a line that is no vertex or face, or an index that points nowhere.
    """
    text = read_bytes(path)
    if b"\\" in text:
        text = text.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")
    vertices, normals = _Rows(f"{path}: vertex"), _Rows(f"{path}: normal")
    textures, colors = _Rows(f"{path}: texture coordinate"), _Rows(f"{path}: vertex colour")
    indices, counts, texture_indices = array("q"), array("q"), array("q")
    libraries: list[str] = []
    materials: list[tuple[int, str]] = []  # each with the number of its first face
    paired = True
    for number, line in _lines(text):
        words = line.split()
        if not words:
            continue
        if words[0] == b"v":
            vertices.add(words[1:4])
            if len(words) == 7:
                colors.add(words[4:7])
        elif words[0] == b"vn":
            normals.add(words[1:4])
        elif words[0] == b"vt":
            textures.add([*words[1:3], b"0", b"0"][:3])
        elif words[0] == b"f":
            corners = words[1 : words.index(b"#")] if b"#" in words else words[1:]
            try:
                for corner in corners:
                    parts = corner.split(b"/")
                    index = _index(parts[0])
                    indices.append(index - 1 if index > 0 else vertices.count + index)
                    if len(parts) > 1 and parts[1]:
                        texture = _index(parts[1])
                        texture_indices.append(texture - 1 if texture > 0 else textures.count + texture)
                    if len(parts) == 3 and parts[2]:
                        normal = int(parts[2])
                        paired &= (normal - 1 if normal > 0 else normals.count + normal) == indices[-1]
            except ValueError:
                raise InputError(f"{path}: line {number}: expected a face like 'f 1 2 3', got {_shown(line)}") from None
            counts.append(len(corners))
        elif words[0] == b"mtllib":
            libraries.append(_rest(line))
        elif words[0] == b"usemtl":
            materials.append((len(counts), _rest(line)))
    if not vertices.count:
        raise InputError(f"{path}: expected lines 'v x y z', got none; export the vertices")
    usable = normals.count == vertices.count and paired
    faces = fan_triangles(_indices(indices, vertices.count, str(path)), counts, str(path)) if counts else None
    shades = byte_colors(colors.table()) if colors.count == vertices.count else None
    uv = corner_uv = None
    if faces is not None and len(texture_indices) == len(indices):
        places = textures.table()[:, :2]
        corners = fan_triangles(_indices(texture_indices, len(places), str(path)), counts, str(path))
        uv, corner_uv = vertex_or_corner_uv(places[corners], faces, vertices.count)
    left = len(indices) - len(texture_indices)
    notes = (
        (f"{path}: goes on without texture coordinates: {left} of the {len(indices)} corners of its faces have none",)
        if faces is not None and 0 < left < len(indices)
        else ()
    )
    ends = [first for first, _ in materials[1:]] + [len(counts)]
    used = dict.fromkeys(name for (first, name), end in zip(materials, ends, strict=False) if end > first)
    named = NamedImages(libraries=tuple(libraries), materials=tuple(used))
    given = normals.table() if usable else None
    return Surface(vertices.table(), given, faces, shades, uv, corner_uv, named, notes=notes)


def read_off(path: Path) -> Surface:
    """Vertices, faces, (NOFF) normals and (COFF) colours of an ASCII OFF file; texture coordinates are passed over.

    Raises:
        InputError: not an OFF file, binary OFF, another dimension than 3, or fewer lines than declared.
    """
    text = read_bytes(path)
    if b"#" in text:
        text = re.sub(rb"#[^\r\n]*", b"", text)
    rows = (words for _, line in _lines(text) if (words := line.split()))
    first = next(rows, [])
    # The counts may follow the keyword on its own line, and some writers leave the blank or the keyword out.
    keyword = re.match(rb"(ST)?(C)?(N)?(4)?(n)?OFF", first[0]) if first else None
    has_normals = bool(keyword and keyword[3])
    if keyword:
        if keyword[4] or keyword[5] or b"BINARY" in first:
            raise InputError(f"{path}: expected ASCII OFF in three dimensions, got {b' '.join(first)[:40]!r}")
        first = [word for word in (first[0][keyword.end() :], *first[1:]) if word] or next(rows, [])
    try:
        vertex_count, face_count = (int(word) for word in first[:2])
        if vertex_count < 0 or face_count < 0:
            raise ValueError
    except (ValueError, IndexError):
        raise InputError(f"{path}: expected OFF with its counts of vertices and faces, got something else") from None
    vertices, found = _Rows(f"{path}: vertex"), 0
    coordinates = 6 if has_normals else 3
    width = coordinates + 3 if keyword and keyword[2] else coordinates
    for words in islice(rows, min(vertex_count, len(text))):
        vertices.add(words[:width])
        found += 1
    indices, counts = array("q"), array("q")
    for words in islice(rows, min(face_count, len(text))):
        try:
            count = int(words[0])
            corners = [_index(word) for word in words[1 : 1 + max(count, 0)]]
            if count < 1 or len(corners) != count:
                raise ValueError
            indices.extend(corners)
        except ValueError:
            raise InputError(
                f"{path}: face {len(counts)}: expected a count and as many indices, got {_shown(b' '.join(words))}"
            ) from None
        counts.append(count)
        found += 1
    if found < vertex_count + face_count:
        raise InputError(
            f"{path}: expected {vertex_count} vertices and {face_count} faces as OFF declares, got {found} "
            "lines; the file is truncated: write it again"
        )
    columns = vertices.table()
    if has_normals and columns.shape[1] < 6 and vertex_count:
        raise InputError(f"{path}: expected 6 columns in a NOFF file, got {columns.shape[1]}")
    faces = fan_triangles(_indices(indices, vertex_count, str(path)), counts, str(path)) if counts else None
    colors = byte_colors(columns[:, coordinates:]) if columns.shape[1] == coordinates + 3 else None
    return Surface(columns[:, :3], columns[:, 3:6] if has_normals else None, faces, colors)


class _Rows:
    """Rows of words that become float64 block by block: as words they would take thirty times the memory.

    what: what a row is called in errors. count: rows so far. width: columns of every row, set by the first; at least 3.
    """

    def __init__(self, what: str) -> None:
        self.what, self.count, self.width = what, 0, 0
        self._numbers, self._words = array("d"), []

    def add(self, words: list[bytes]) -> None:
        """Append a row.

        Raises:
            InputError: at the end of a block, if one of its rows has another width or something that is no number.
        """
        self.width = self.width or max(3, len(words))
        self._words.append(words)
        self.count += 1
        if len(self._words) == _BLOCK:
            self._convert()

    def table(self) -> np.ndarray:
        """All rows, shape (count, width).

        Raises:
            InputError: as ``add``.
        """
        self._convert()
        # Not copied; a buffer of nothing has no view.
        numbers = np.frombuffer(self._numbers) if self._numbers else np.zeros(0)
        return numbers.reshape(-1, self.width or 3)

    def _convert(self) -> None:
        words, self._words = self._words, []
        for plain in (False, True):
            words = [[plain_numbers(word) for word in row] for row in words] if plain else words
            try:
                if all(len(row) == self.width for row in words):
                    self._numbers.extend([float(word) for row in words for word in row])
                    return
            except ValueError:
                pass
        for number, row in enumerate(words, self.count - len(words)):
            try:
                if len([float(word) for word in row]) == self.width:
                    continue
            except ValueError:
                pass
            raise InputError(
                f"{self.what} {number}: expected {self.width} numbers, got {_shown(b' '.join(row))}; "
                "write the file again"
            )


def _lines(text: bytes) -> Iterator[tuple[int, bytes]]:
    """Lines and their numbers from 1, one at a time; they may end as on any system."""
    if b"\r" in text:
        text = text.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return enumerate(io.BytesIO(text), 1)


def _rest(line: bytes) -> str:
    """What follows a line's first word, blanks and all."""
    return os.fsdecode(b"".join(line.split(None, 1)[1:]).strip())


def _index(word: bytes) -> int:
    """An index; one too large for 64 bits becomes one that is surely not there."""
    index = int(word)
    return index if abs(index) < 1 << 60 else -(1 << 60)


def _indices(indices: array, vertex_count: int, where: str) -> np.ndarray:
    numbers = np.array(indices, dtype=np.int64)
    if len(numbers) and (numbers.min() < 0 or numbers.max() >= vertex_count):
        raise InputError(
            f"{where}: a face names a vertex that is not there (there are {vertex_count}); the file is damaged"
        )
    return numbers


def _shown(line: bytes) -> str:
    text = line.decode("utf-8", errors="replace").strip()
    return repr(text if len(text) <= 60 else text[:57] + "...")
