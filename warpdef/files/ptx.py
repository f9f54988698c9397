"""PTX files of terrestrial scanners (Leica): scans as text, a point a pixel, all scans of a file together.

A scan is its columns and rows, the scanner's place and axes (four lines), a matrix that takes its points into the world
(four lines, row vectors: [x y z 1] M), and a line ``x y z intensity`` or ``x y z intensity r g b`` for each pixel;
0 0 0 is a pixel that saw nothing.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from warpdef.cloud import byte_colors
from warpdef.errors import InputError
from warpdef.files.disk import read_bytes
from warpdef.files.surface import Surface

_HEAD = 10  # lines


def read_ptx(path: Path) -> Surface:
    """Positions of all scans of a file in the world, and colours where all scans have them.

    Raises:
        InputError: another header, a line that is no point, or fewer points than a header declares.
    """
    lines = read_bytes(path).decode("latin-1").splitlines()
    while lines and not lines[-1].strip():
        lines.pop()
    clouds, shades, at = [], [], 0
    while at < len(lines):
        table, world, at = _read_scan(lines, at, path)
        table = table[table[:, :3].any(axis=1)]
        with np.errstate(invalid="ignore", over="ignore"):  # a damaged file's numbers are refused by their frame's name
            clouds.append(table[:, :3] @ world[:3, :3] + world[3, :3])
        shades.append(table[:, 4:7])
    points, colors = np.concatenate(clouds), None
    if not len(points):
        raise InputError(f"{path}: expected points, got only pixels that saw nothing; export the scan again")
    if all(shade.shape[1] == 3 for shade in shades):
        colors = byte_colors(np.concatenate(shades), whole=True)
    return Surface(points, colors=colors, passed=("intensity",))


def _read_scan(lines: list[str], at: int, path: Path) -> tuple[np.ndarray, np.ndarray, int]:
    """Rows (N, 4) or (N, 7) of the scan whose head begins at a line, its matrix (4, 4), and the line behind it."""
    try:
        columns, rows = int(lines[at]), int(lines[at + 1])
        world = np.array([[float(w) for w in line.split()] for line in lines[at + 6 : at + _HEAD]])
        if min(columns, rows) < 0 or world.shape != (4, 4):
            raise ValueError
    except (ValueError, IndexError):
        raise InputError(
            f"{path}: line {at + 1}: expected the head of a PTX scan (columns, rows, place, axes, matrix), got "
            f"{lines[at].strip()[:60]!r}; write the file again"
        ) from None
    first, end = at + _HEAD, at + _HEAD + columns * rows
    if end > len(lines):
        raise InputError(
            f"{path}: line {at + 1}: expected {columns * rows} points, got {len(lines) - first}; it is truncated: "
            "write it again"
        )
    if end == first:
        return np.zeros((0, 4)), world, end
    try:
        table = np.loadtxt(lines[first:end], dtype=np.float64, comments=None, ndmin=2)
    except ValueError as error:
        raise InputError(
            f"{path}: from line {first + 1} on: expected points x y z intensity, got {error!s:.60}; write the "
            "file again"
        ) from None
    if len(table) != columns * rows or table.shape[1] not in (4, 7):
        raise InputError(
            f"{path}: from line {first + 1} on: expected {columns * rows} rows of 4 or 7 numbers, got {table.shape}; "
            "write the file again"
        )
    return table, world, end
