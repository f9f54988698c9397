"""A folder of numbered files as frames: which files, in which order, and the reader that a suffix asks for."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

from warpdef.errors import InputError
from warpdef.files.disk import must_exist, reason
from warpdef.files.surface import Surface

MESH_SUFFIXES = (".ply", ".obj", ".off")
CLOUD_SUFFIXES = (*MESH_SUFFIXES, ".xyz", ".npy")

_Item = TypeVar("_Item")


def natural_key(name: str) -> tuple:
    """Sort key under which ``f2`` comes before ``f10``, padded or not, upper and lower case alike."""
    parts = re.split(r"([0-9]+)", name.casefold())
    return tuple((1, int(p), len(p)) if i % 2 else (0, p, 0) for i, p in enumerate(parts)), name


def frame_files(folder: Path, suffixes: Sequence[str]) -> list[Path]:
    """The frames of a folder in natural order; hidden files and other suffixes are passed over.

    Raises:
        InputError: none there, more than one of the suffixes, or files with and without a number.
    """
    must_exist(folder)
    try:
        entries = [p for p in folder.iterdir() if not p.name.startswith(".")]
        # A dangling link is kept: as a frame it must be complained about, not lost.
        files = [p for p in entries if p.suffix.lower() in suffixes and not p.is_dir()]
    except OSError as error:
        raise InputError(f"{folder}: the folder cannot be read ({reason(error)}); check its permissions") from None
    if not files:
        raise InputError(
            f"{folder}: expected numbered files ({' '.join(suffixes)}), got {_what_else(entries, suffixes)}"
        )
    kinds = Counter(p.suffix.lower() for p in files)
    if len(kinds) > 1:
        found = " and ".join(f"{count} {suffix}" for suffix, count in kinds.most_common())
        raise InputError(
            f"{folder}: expected files of one kind, got {found}; put the frames into a folder of their own"
        )
    unnumbered = [p.name for p in files if not re.search("[0-9]", p.stem)]
    if unnumbered and len(unnumbered) < len(files):
        raise InputError(
            f"{folder}: expected a number in every file name, got '{min(unnumbered)}' among numbered files; "
            "number it or move it away"
        )
    return sorted(files, key=lambda p: natural_key(p.stem))


def _what_else(entries: Sequence[Path], suffixes: Sequence[str]) -> str:
    """What a folder without frames holds, and what to do about it."""
    for entry in sorted(entries):
        if entry.is_dir() and any(p.suffix.lower() in suffixes for p in entry.iterdir()):
            return f"none; its folder '{entry.name}' has some: give that"
    archives = sorted(p.name for p in entries if p.suffix.lower() == ".npz")
    if archives:
        return f"none; give the file '{archives[0]}' itself"
    others = sorted({p.suffix.lower() for p in entries if p.suffix and not p.is_dir()})
    return f"other suffixes ({' '.join(others[:6])}); convert the frames" if others else "none; check the path"


def select_frames(items: Sequence[_Item], frames: slice | None, minimum: int, where: Path) -> list[_Item]:
    """The items of a slice, in order.

    Raises:
        InputError: fewer than ``minimum`` are there, or are left by the slice.
    """
    chosen = list(items if frames is None else items[frames])
    if len(items) < minimum:
        raise InputError(
            f"{where}: expected at least {minimum} frames, got {len(items)}; give a folder of numbered files, or an npz"
        )
    if len(chosen) < minimum:
        raise InputError(
            f"{where}: --frames: expected at least {minimum} of {len(items)} frames, got {len(chosen)}; widen the range"
        )
    return chosen


def read_surface(path: Path, suffixes: Sequence[str]) -> Surface:
    """Contents of one file, by its suffix.

    Raises:
        InputError: missing, an unknown suffix, or anything the format's reader complains about.
    """
    from warpdef.files.numpy_files import read_npy
    from warpdef.files.ply import read_ply
    from warpdef.files.text_formats import read_obj, read_off, read_xyz, split_columns

    suffix = path.suffix.lower()
    if suffix not in suffixes:
        why = " (STL keeps no shared vertices)" if suffix == ".stl" else ""
        raise InputError(
            f"{path}: unknown suffix '{suffix}'{why}; expected one of {' '.join(suffixes)}; convert the file"
        )
    if suffix == ".npy":
        return split_columns(read_npy(path).astype("float64"), str(path))
    reader = {".ply": read_ply, ".obj": read_obj, ".off": read_off, ".xyz": read_xyz}[suffix]
    try:
        return reader(path)
    except InputError:
        raise
    except (ValueError, OverflowError, MemoryError) as error:
        raise InputError(
            f"{path}: cannot be read as {suffix} ({reason(error):.120}); it is damaged: write it again"
        ) from None
