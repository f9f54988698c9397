"""Landmarks: known correspondences, a line each in a .csv, or an object each in a .json.

    vertex,frame,x,y,z              a vertex of the template given, and where it is in a frame
    kx,ky,kz,frame,x,y,z            a place on the mesh at the keyframe, and where that is in a frame

Columns may stand in any order under such a heading; without one, five or seven in this order. In JSON a list of
``{"vertex": 17, "frame": 3, "place": [x, y, z]}`` or ``{"at": [kx, ky, kz], "frame": 3, "place": [x, y, z]}``. Frames
are counted from 0 among those used, gaps included; places are in input units.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from warpdef.errors import InputError
from warpdef.files.disk import must_exist, read_bytes, reason
from warpdef.files.tables import decode

BY_VERTEX, BY_PLACE = ("vertex", "frame", "x", "y", "z"), ("kx", "ky", "kz", "frame", "x", "y", "z")
_EXAMPLE = "a line as 'vertex,frame,x,y,z' or 'kx,ky,kz,frame,x,y,z'"


@dataclass(frozen=True)
class Landmarks:
    """L known correspondences.

    vertex: of the template, -1 where ``at`` says it  (L,) int64
    at:     at the keyframe, NaN for vertices         (L, 3) float64, input units
    frame:  of the input                              (L,) int64
    place:  in that frame                             (L, 3) float64, input units
    names:  where each stands, for errors             L strings
    """

    vertex: np.ndarray
    at: np.ndarray
    frame: np.ndarray
    place: np.ndarray
    names: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.frame)

    def digest(self) -> str:
        """A short digest of all numbers, hexadecimal."""
        numbers = np.column_stack([self.vertex, self.at, self.frame, self.place])
        return hashlib.blake2b(numbers.tobytes(), digest_size=12).hexdigest()


def read_landmarks(path: Path | str) -> Landmarks:
    """Read landmarks, unchecked against any mesh.

    Raises:
        InputError: missing, neither .csv nor .json, empty, or a line that is no landmark; it is named.
    """
    path = Path(path)
    must_exist(path)
    text = decode(read_bytes(path))
    suffix = path.suffix.lower()
    if suffix not in (".csv", ".txt", ".json"):
        raise InputError(f"{path}: unknown suffix '{path.suffix}'; expected .csv or .json for landmarks")
    rows = _json_rows(text, path) if suffix == ".json" else _table_rows(text, path)
    if not rows:
        raise InputError(f"{path}: expected landmarks, {_EXAMPLE}, got none")
    names, values = zip(*rows, strict=True)
    table = np.array(values)
    return Landmarks(table[:, 0].astype(np.int64), table[:, 1:4], table[:, 4].astype(np.int64), table[:, 5:], names)


def _table_rows(text: str, path: Path) -> list[tuple[str, list[float]]]:
    rows: list[tuple[str, list[float]]] = []
    names: Sequence[str] = ()
    for number, line in enumerate(text.split("\n"), 1):
        words = line.split("#")[0].replace(",", " ").replace(";", " ").split()
        where = f"{path}: line {number}"
        if not words:
            continue
        if not names:
            found = [word.strip("\"'").casefold() for word in words]
            names = found if set(BY_VERTEX) <= set(found) or set(BY_PLACE) <= set(found) else ()
            if names:
                continue
            names = {5: BY_VERTEX, 7: BY_PLACE}.get(len(words), ())
        if len(words) != len(names):
            raise InputError(f"{where}: expected {_EXAMPLE}, got {line.strip()[:60]!r}")
        said = dict(zip(names, words, strict=True))
        at = [said[name] for name in BY_PLACE[:3]] if "kx" in said else None
        rows.append((where, _row(said.get("vertex"), at, said["frame"], [said[a] for a in "xyz"], where)))
    return rows


def _json_rows(text: str, path: Path) -> list[tuple[str, list[float]]]:
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not valid JSON ({reason(error):.120})") from None
    if not isinstance(found, list) or not all(isinstance(entry, dict) for entry in found):
        raise InputError(f'{path}: expected a list of {{"vertex": 17, "frame": 3, "place": [x, y, z]}}, got otherwise')
    rows = []
    for number, entry in enumerate(found):
        where = f"{path}: entry {number}"
        rows.append((where, _row(entry.get("vertex"), entry.get("at"), entry.get("frame"), entry.get("place"), where)))
    return rows


def _row(vertex: Any, at: Any, frame: Any, place: Any, where: str) -> list[float]:
    """Vertex or -1, place at the keyframe or NaN, frame, place: eight numbers."""
    try:
        index, number = -1.0 if vertex is None else float(vertex), float(frame)
        start = [np.nan] * 3 if vertex is not None else [float(value) for value in at]
        end = [float(value) for value in place]
        whole = index == index // 1 and number == number // 1 and number >= 0 and (vertex is None or index >= 0)
        if (
            whole
            and len(start) == len(end) == 3
            and np.isfinite(end).all()
            and (vertex is not None or np.isfinite(start).all())
        ):
            return [index, *start, number, *end]
    except (TypeError, ValueError, OverflowError):
        pass
    raise InputError(
        f"{where}: expected a vertex (from 0) or a place at the keyframe, a frame (from 0) and a place, got "
        f"{vertex if vertex is not None else at!s:.40}, {frame!s:.20}, {place!s:.60}"
    )
