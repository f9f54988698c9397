"""A folder of numbered files as frames: which files, in which order."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from warpdef.errors import InputError
from warpdef.files.disk import must_exist, reason

_Item = TypeVar("_Item")


def natural_key(name: str) -> tuple:
    """Sort key under which ``f2`` comes before ``f10``, padded or not, upper and lower case alike."""
    parts = re.split(r"([0-9]+)", name.casefold())
    return tuple((1, int(p), len(p)) if i % 2 else (0, p, 0) for i, p in enumerate(parts)), name


@dataclass(frozen=True)
class FrameFiles:
    """The frames of a folder, and what else there could have been taken for one.

    files: in natural order. others: of a suffix that is read, too, but no frames.
    """

    files: list[Path]
    others: list[Path]

    @property
    def notes(self) -> list[str]:
        """A warning that names what was passed over, if anything."""
        if not self.others:
            return []
        names = ", ".join(f"'{p.name}'" for p in self.others[:3]) + (", ..." if len(self.others) > 3 else "")
        kind = self.files[0].suffix.lower()
        return [
            f"passed over in {self.files[0].parent}: {names}, as the frames are its {len(self.files)} numbered {kind} "
            "files"
        ]


def frame_files(folder: Path, suffixes: Sequence[str]) -> list[Path]:
    """The frames of a folder in natural order, as ``find_frames`` tells them from what else it holds."""
    return find_frames(folder, suffixes).files


def find_frames(folder: Path, suffixes: Sequence[str]) -> FrameFiles:
    """The frames of a folder in natural order: its one series of numbered files.

    Hidden files and other suffixes are passed over silently; files of the suffixes that are not numbered, or whose
    suffix has no series (a template, a mean), are passed over and told. Without any number, files of one suffix are in
    natural order, too.

    Raises:
        InputError: none there, or files of several suffixes none of which is the only one with a series.
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
    numbered = [p for p in files if re.search("[0-9]", p.stem)]
    series = [suffix for suffix, count in Counter(p.suffix.lower() for p in numbered).items() if count > 1]
    kinds = Counter(p.suffix.lower() for p in files)
    if len(series) == 1:
        frames = [p for p in numbered if p.suffix.lower() == series[0]]
    elif len(kinds) == 1 and not 0 < len(numbered) < len(files):
        frames = files
    elif len(kinds) > 1:
        found = " and ".join(f"{count} {suffix}" for suffix, count in kinds.most_common())
        raise InputError(
            f"{folder}: expected files of one kind, got {found}; put the frames into a folder of their own"
        )
    else:
        raise InputError(
            f"{folder}: expected a number in every file name, got '{min(p.name for p in files if p not in numbered)}' "
            f"and one file with a number; number the frames"
        )
    others = sorted(set(files) - set(frames))
    return FrameFiles(sorted(frames, key=lambda p: natural_key(p.stem)), others)


def _what_else(entries: Sequence[Path], suffixes: Sequence[str]) -> str:
    """What a folder without frames holds, and what to do about it."""
    for entry in sorted(entries):
        try:
            if entry.is_dir() and any(p.suffix.lower() in suffixes for p in entry.iterdir()):
                return f"none; its folder '{entry.name}' has some: give that"
        except OSError:
            continue  # not ours to look into
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
