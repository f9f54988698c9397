"""OBJ, OFF and XYZ files in. Text only; vertex order as in the file, nothing merged."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from warpdef.errors import InputError
from warpdef.files.disk import read_bytes
from warpdef.files.surface import Surface, fan_triangles


def read_obj(path: Path) -> Surface:
    """Vertices, faces and vertex normals of an OBJ file; textures, materials and groups are passed over.

    Normals are taken where there are as many ``vn`` as ``v`` and no face pairs a vertex with another's normal.

    Raises:
        InputError: no vertices, a line that is no vertex or face, or an index that points nowhere.
    """
    text = read_bytes(path).replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")
    vertices: list[list[bytes]] = []
    normals: list[list[bytes]] = []
    indices: list[int] = []
    counts: list[int] = []
    paired = True
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split()
        if not words:
            continue
        if words[0] == b"v":
            vertices.append(words[1:4])
        elif words[0] == b"vn":
            normals.append(words[1:4])
        elif words[0] == b"f":
            corners = words[1 : words.index(b"#")] if b"#" in words else words[1:]
            try:
                for corner in corners:
                    parts = corner.split(b"/")
                    index = int(parts[0])
                    indices.append(index - 1 if index > 0 else len(vertices) + index)
                    if len(parts) == 3 and parts[2]:
                        normal = int(parts[2])
                        paired &= (normal - 1 if normal > 0 else len(normals) + normal) == indices[-1]
            except ValueError:
                raise InputError(f"{path}: line {number}: expected a face like 'f 1 2 3', got {_shown(line)}") from None
            counts.append(len(corners))
    if not vertices:
        raise InputError(f"{path}: expected lines 'v x y z', got none; export the vertices")
    points = _table(vertices, f"{path}: vertex")
    usable = len(normals) == len(vertices) and paired
    faces = fan_triangles(_indices(indices, len(points), str(path)), np.array(counts), str(path)) if counts else None
    return Surface(points, _table(normals, f"{path}: normal") if usable else None, faces)


def read_off(path: Path) -> Surface:
    """Vertices, faces and (NOFF) normals of an ASCII OFF file; colours and texture coordinates are passed over.

    Raises:
        InputError: not an OFF file, binary OFF, another dimension than 3, or fewer lines than declared.
    """
    text = re.sub(rb"#[^\r\n]*", b"", read_bytes(path))
    lines = [words for line in text.splitlines() if (words := line.split())]
    # The counts may follow the keyword on its own line, and some writers leave the blank or the keyword out.
    keyword = re.match(rb"(ST)?(C)?(N)?(4)?(n)?OFF", lines[0][0]) if lines else None
    has_normals = bool(keyword and keyword[3])
    if keyword:
        if keyword[4] or keyword[5] or b"BINARY" in lines[0]:
            raise InputError(f"{path}: expected ASCII OFF in three dimensions, got {b' '.join(lines[0])[:40]!r}")
        rest = [word for word in (lines[0][0][keyword.end() :], *lines[0][1:]) if word]
        lines = ([rest] if rest else []) + lines[1:]
    try:
        vertex_count, face_count = (int(word) for word in lines[0][:2])
        if vertex_count < 0 or face_count < 0:
            raise ValueError
    except (ValueError, IndexError):
        raise InputError(f"{path}: expected OFF with its counts of vertices and faces, got something else") from None
    if len(lines) - 1 < vertex_count + face_count:
        raise InputError(
            f"{path}: expected {vertex_count} vertices and {face_count} faces as OFF declares, got {len(lines) - 1} "
            "lines; the file is truncated: write it again"
        )
    columns = _table([words[: 6 if has_normals else 3] for words in lines[1 : 1 + vertex_count]], f"{path}: vertex")
    if has_normals and columns.shape[1] != 6 and vertex_count:
        raise InputError(f"{path}: expected 6 columns in a NOFF file, got {columns.shape[1]}")
    indices, counts = [], []
    for face, words in enumerate(lines[1 + vertex_count : 1 + vertex_count + face_count]):
        try:
            count = int(words[0])
            corners = [int(word) for word in words[1 : 1 + max(count, 0)]]
        except ValueError:
            count, corners = 0, []
        if count < 1 or len(corners) != count:
            raise InputError(
                f"{path}: face {face}: expected a count and as many indices, got {_shown(b' '.join(words))}"
            )
        counts.append(count)
        indices += corners
    faces = fan_triangles(_indices(indices, vertex_count, str(path)), np.array(counts), str(path)) if counts else None
    return Surface(columns[:, :3], columns[:, 3:] if has_normals else None, faces)


def read_xyz(path: Path) -> Surface:
    """Rows of 3 columns (positions) or 6 (and normals); blanks or commas between, comments after ``#``, ``//``, ``;``.

    Raises:
        InputError: other columns, something that is no number, or colours where normals should be.
    """
    rows = []
    text = read_bytes(path).replace(b",", b" ")
    if any(mark in text for mark in (b"#", b"//", b";")):
        text = re.sub(rb"(#|//|;)[^\r\n]*", b"", text)
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split()
        if words:
            if len(words) not in (3, 6) or len(words) != len(rows[0] if rows else words):
                expected = f"{len(rows[0])} columns as before" if rows else "3 columns (x y z) or 6 (and normals)"
                raise InputError(f"{path}: line {number}: expected {expected}, got {len(words)}: {_shown(line)}")
            rows.append(words)
    return split_columns(_table(rows, f"{path}: row"), str(path))


def split_columns(columns: np.ndarray, where: str) -> Surface:
    """Positions and, with 6 columns, normals; shape (N, 3) or (N, 6).

    Raises:
        InputError: another shape, or colours in columns 4 to 6: nowhere negative, and not of unit length.
    """
    if columns.ndim != 2 or columns.shape[1] not in (3, 6):
        raise InputError(f"{where}: expected shape (N, 3), or (N, 6) with normals, got {columns.shape}")
    if columns.shape[1] == 3:
        return Surface(columns)
    normals = columns[:, 3:]
    if len(normals) and (normals >= 0).all() and (np.abs(np.linalg.norm(normals, axis=1) - 1) > 0.05).any():
        raise InputError(
            f"{where}: expected normals in columns 4 to 6, got what looks like colours; keep columns 1 to 3"
        )
    return Surface(columns[:, :3], normals)


def _table(rows: list[list[bytes]], what: str) -> np.ndarray:
    """Words to float64, shape (rows, columns); at least three columns, all rows alike."""
    if not rows:
        return np.zeros((0, 3))
    try:
        width = max(3, len(rows[0]))
        if all(len(row) == width for row in rows):
            return np.array([float(word) for row in rows for word in row]).reshape(-1, width)
    except ValueError:
        pass
    for number, row in enumerate(rows):
        try:
            if len([float(word) for word in row]) == max(3, len(rows[0])):
                continue
        except ValueError:
            pass
        expected = max(3, len(rows[0]))
        raise InputError(
            f"{what} {number}: expected {expected} numbers, got {_shown(b' '.join(row))}; write the file again"
        )
    raise InputError(f"{what}s: expected rows of numbers; write the file again")


def _indices(indices: list[int], vertex_count: int, where: str) -> np.ndarray:
    # Checked on Python integers: a huge one must not overflow on its way into an array.
    if indices and (min(indices) < 0 or max(indices) >= vertex_count):
        raise InputError(
            f"{where}: a face names a vertex that is not there (there are {vertex_count}); the file is damaged"
        )
    return np.array(indices, dtype=np.int64)


def _shown(line: bytes) -> str:
    text = line.decode("utf-8", errors="replace").strip()
    return repr(text if len(text) <= 60 else text[:57] + "...")
