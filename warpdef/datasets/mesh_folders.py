"""Folders of numbered meshes, plain or in DynoSurf's layout, and what their file names give away."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from warpdef.files.formats import CLOUD_SUFFIXES, MESH_SUFFIXES

CLOUD_FOLDERS = ("point_clouds", "points_clouds", "pcl_seqs")
"""Where DynoSurf's sets keep clouds: the input first, the dense samples for its evaluation last."""
_PLAIN_NAMES = {"gt", "mesh", "meshes", "obj", "objs", "ply"}
SHOWN = 5  # numbers in a message


def mesh_folder(path: Path) -> Path:
    """The folder with the meshes: ``gt`` inside ``path`` where that is in DynoSurf's layout, else ``path``."""
    inner = path / "gt"
    if inner.is_dir() and mesh_files(inner) and not (path.is_dir() and mesh_files(path)):
        return inner
    return path


def mesh_files(folder: Path) -> list[Path]:
    """All mesh files right in a folder, unsorted; hidden ones are passed over."""
    return _files(folder, MESH_SUFFIXES)


def cloud_folder(sequence: Path) -> Path | None:
    """The clouds beside ``gt`` in DynoSurf's layout, or None."""
    return next((sequence / name for name in CLOUD_FOLDERS if _files(sequence / name, CLOUD_SUFFIXES)), None)


def sequence_name(path: Path) -> str:
    """The name of a file or folder, or of the folder around it where its own says nothing (``gt.npz``, ``meshes``)."""
    stem = path.name if path.is_dir() else path.stem
    return path.absolute().parent.name if stem.casefold() in _PLAIN_NAMES and path.absolute().parent.name else stem


def name_problems(names: Sequence[str]) -> list[str]:
    """What is odd about the file names of a sequence, given in natural order: one clause each."""
    stems = [Path(name).stem for name in names]
    rows = [re.split(r"([0-9]+)", stem) for stem in stems]
    if len({len(row) for row in rows}) > 1 or len({tuple(row[0::2]) for row in rows}) > 1:
        odd = next(i for i, row in enumerate(rows) if row[0::2] != rows[0][0::2])
        return [f"names of several patterns ('{names[0]}', '{names[odd]}'): the order may not be that of time"]
    columns = [[int(row[i]) for row in rows] for i in range(1, len(rows[0]), 2)]
    moving = [(i, column) for i, column in enumerate(columns) if len(set(column)) > 1]
    problems = []
    twice = [names[i] for i in range(1, len(rows)) if all(c[i] == c[i - 1] for c in columns)]
    if twice:
        problems.append(f"the same number twice ({', '.join(twice[:SHOWN])})")
    if len(moving) > 1:
        problems.append(f"{len(moving)} numbers change from name to name ('{names[0]}', '{names[-1]}')")
    elif moving:
        place, numbers = moving[0]
        step = min((b - a for a, b in zip(numbers[:-1], numbers[1:], strict=True) if b > a), default=1)
        missing = sorted(set(range(numbers[0], numbers[-1], step)) - set(numbers)) if _few(numbers, step) else []
        if missing:
            shown = ", ".join(map(str, missing[:SHOWN])) + (", ..." if len(missing) > SHOWN else "")
            problems.append(f"numbers missing: {shown} ({len(missing)} in all)")
        elif any((b - a) % step for a, b in zip(numbers[:-1], numbers[1:], strict=True)) or not _few(numbers, step):
            problems.append(f"uneven steps between the numbers {numbers[0]} and {numbers[-1]}")
        widths = {len(row[1 + 2 * place]) for row in rows}
        if len(widths) > 1 and any(row[1 + 2 * place].startswith("0") and len(row[1 + 2 * place]) > 1 for row in rows):
            problems.append("numbers padded to several widths")
    return problems


def _few(numbers: Sequence[int], step: int) -> bool:
    """Few enough that counting what is missing is no work, however large a number in a name may be."""
    return (numbers[-1] - numbers[0]) // step < 1000 * len(numbers)


def _files(folder: Path, suffixes: Sequence[str]) -> list[Path]:
    try:
        entries = list(folder.iterdir())
    except OSError:
        return []
    return [p for p in entries if p.suffix.lower() in suffixes and not p.name.startswith(".") and not p.is_dir()]
