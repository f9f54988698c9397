"""A folder of numbered files as frames: which files, in which order, and which are missing."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from warpdef.errors import InputError
from warpdef.files.disk import must_exist, reason
from warpdef.files.formats import WEAK_SUFFIXES
from warpdef.files.frame_numbers import Numbering, natural_key, pattern, read_names, refuse_several

_Item = TypeVar("_Item")

WHAT_TO_DO = {
    **dict.fromkeys((".vtk", ".vtp", ".vtu"), "save them as .ply: pyvista.read(name).extract_surface().save(other)"),
    **dict.fromkeys((".usd", ".usda", ".usdc", ".usdz", ".abc", ".fbx", ".blend"), "export a mesh a frame, as .obj"),
    **dict.fromkeys((".bag", ".db3", ".mcap"), "play it beside pcl_ros' pointcloud_to_pcd, which writes .pcd files"),
    **dict.fromkeys((".gz", ".zip", ".7z", ".xz", ".bz2", ".tar", ".tgz", ".rar", ".zst"), "unpack it"),
    **dict.fromkeys(
        (".png", ".tif", ".tiff", ".exr", ".pgm", ".jpg", ".jpeg", ".raw"),
        "images are no points: save depth images as an .npz of depth (T, H, W) and the camera's intrinsics (3, 3), or "
        "make points of each by warpdef.points_of_depth",
    ),
}
"""By suffix, what to do with files that people have in place of clouds."""


@dataclass(frozen=True)
class FrameSlot:
    """A place in time: the file that fills it, or why there is none. time: where times are uneven; else None."""

    name: str
    path: Path | None
    why: str = ""
    time: float | None = None

    def file(self) -> Path:
        """The file.

        Raises:
            InputError: there is none.
        """
        if self.path is None:
            raise InputError(self.why)
        return self.path


@dataclass(frozen=True)
class FrameFiles:
    """The frames of a folder, and what else there could have been taken for one.

    files: in the order of time. others: of a suffix that is read, too, but no frames. numbering: what the names say.
    """

    files: list[Path]
    others: list[Path]
    numbering: Numbering

    @property
    def notes(self) -> list[str]:
        """Warnings: what was passed over, and what was concluded from names."""
        notes = list(self.numbering.notes)
        if self.others:
            names = ", ".join(f"'{p.name}'" for p in self.others[:3]) + (", ..." if len(self.others) > 3 else "")
            kind = self.files[0].suffix.lower()
            notes.append(
                f"passed over in {self.files[0].parent}: {names}, as the frames are its {len(self.files)} numbered "
                f"{kind} files"
            )
        return notes

    @property
    def slots(self) -> list[FrameSlot]:
        """The frames with a place for each that the numbering misses."""
        slots: list[FrameSlot] = []
        for place, file in enumerate(self.files):
            for behind in range(self.numbering.missing.get(place, 0)):
                slots.append(self._missing(place, behind))
            nested = file.parent != self.files[0].parent or len({p.name for p in self.files}) < len(self.files)
            time = None if self.numbering.times is None else self.numbering.times[place]
            slots.append(FrameSlot(f"{file.parent.name}/{file.name}" if nested else file.name, file, time=time))
        return slots

    def _missing(self, place: int, behind: int) -> FrameSlot:
        before, after = self.files[place - 1], self.files[place]
        numbers = self.numbering.numbers
        if numbers is None:
            name = f"missing after {before.name}"
            return FrameSlot(name, None, f"a frame is missing between {before.name} and {after.name}, by their times")
        step = (numbers[place] - numbers[place - 1]) // (self.numbering.missing[place] + 1)
        number = numbers[place - 1] + step * (behind + 1)
        other = [p.name for p in self.others if re.findall("[0-9]+", p.stem)[-1:] and _last_number(p) == number]
        known = f"; '{other[0]}' is no {after.suffix.lower()} file" if other else ""
        why = f"number {number} is missing between {before.name} and {after.name}{known}"
        return FrameSlot(f"missing number {number}", None, why)


def _last_number(path: Path) -> int:
    return int(re.findall("[0-9]+", path.stem)[-1])


def frame_files(folder: Path, suffixes: Sequence[str]) -> list[Path]:
    """The frames of a folder in the order of time, as ``find_frames`` tells them from what else it holds."""
    return find_frames(folder, suffixes).files


def find_frames(folder: Path, suffixes: Sequence[str]) -> FrameFiles:
    """The frames of a folder in the order of time: its one series of numbered files.

    Hidden files and other suffixes are passed over silently; files of the suffixes that are not numbered, or belong to
    no series (a template, a mean), are passed over and told. Without any number, files of one suffix are in natural
    order, too. Where there are no such files, folders a frame with one file each, or with one of the same name, are
    taken. Texts and archives, which lie beside frames, too, are frames only where there are no others.

    Raises:
        InputError: none there, files of several suffixes none of which is the only one with a series, or several
            series.
    """
    must_exist(folder)
    try:
        entries = [p for p in folder.iterdir() if not p.name.startswith(".")]
        # A dangling link is kept: as a frame it must be complained about, not lost.
        files = _without_weak([p for p in entries if p.suffix.lower() in suffixes and not p.is_dir()])
    except OSError as error:
        raise InputError(f"{folder}: the folder cannot be read ({reason(error)}); check its permissions") from None
    if not files:
        nested = _frame_folders(entries, suffixes)
        if nested:
            return _numbered(nested, [], folder, lambda p: p.parent.name)
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
    return _numbered(frames, files, folder, lambda p: p.stem)


def _without_weak(files: list[Path]) -> list[Path]:
    """The files without such as may only lie beside the frames; those of them with numbers where no others are."""
    strong = [p for p in files if p.suffix.lower() not in WEAK_SUFFIXES]
    weak = [p for p in files if p.suffix.lower() in WEAK_SUFFIXES and re.search("[0-9]", p.stem)]
    few = len([p for p in strong if re.search("[0-9]", p.stem)]) < 2
    return weak if few and len(weak) > max(len(strong), 1) else strong


def _numbered(frames: list[Path], files: Sequence[Path], folder: Path, stem: Callable[[Path], str]) -> FrameFiles:
    """The one series among the frames, in order; the others of the files are passed over."""
    series = _one_series(frames, folder, stem)
    numbering = read_names([stem(p) for p in series], str(folder))
    ordered = [series[i] for i in numbering.order]
    return FrameFiles(ordered, sorted(set(files) - set(ordered)), numbering)


def _one_series(frames: list[Path], folder: Path, stem: Callable[[Path], str]) -> list[Path]:
    """Names whose text is alike; all of them where the first number alone tells them apart, or no text is shared."""
    kinds: dict[tuple[str, ...], list[Path]] = {}
    for frame in sorted(frames, key=lambda p: natural_key(stem(p))):
        kinds.setdefault(pattern(stem(frame)), []).append(frame)
    several = [kind for kind in kinds.values() if len(kind) > 1]
    if len(several) == 1 and 2 * len(several[0]) > len(frames):
        return several[0]
    first = [(key[0], (re.findall("[0-9]+", stem(p)) or [""])[0]) for key, kind in kinds.items() for p in kind]
    if several and not (len({text for text, _ in first}) == 1 and len({int(n or 0) for _, n in first}) == len(frames)):
        refuse_several([[p.name for p in kind] for kind in several], str(folder))
    return frames


def _frame_folders(entries: Sequence[Path], suffixes: Sequence[str]) -> list[Path]:
    """One file of each numbered folder: its only one, or the one whose name all of them have; else empty."""
    inside: list[list[Path]] = []
    try:
        for folder in entries:
            if folder.is_dir() and re.search("[0-9]", folder.name):
                files = [p for p in folder.iterdir() if p.suffix.lower() in suffixes and p.name[0] != "."]
                inside += [files] if files else []
    except OSError:
        return []
    if len(inside) < 2:
        return []
    if all(len(files) == 1 for files in inside):
        return [files[0] for files in inside]
    common = set.intersection(*({p.name for p in files} for files in inside))
    return [next(p for p in files if p.name in common) for files in inside] if len(common) == 1 else []


def _what_else(entries: Sequence[Path], suffixes: Sequence[str]) -> str:
    """What a folder without frames holds, and what to do about it."""
    inside: dict[str, set[str]] = {}
    for entry in sorted(entries):
        try:
            found = {p.name for p in entry.iterdir() if p.suffix.lower() in suffixes} if entry.is_dir() else None
        except OSError:
            continue  # not ours to look into
        if found:
            inside[entry.name] = found
    if inside:
        first, *others = inside
        alike = [name for name in others if len(inside[name] & inside[first]) > 1]
        if alike:
            return (
                f"none; its folders '{first}' and '{alike[0]}' have files of the same names: give one of them, or, if "
                "these are cameras in one place, put the points of each moment into one file"
            )
        return f"none; its folder '{first}' has some: give that"
    archives = sorted(p.name for p in entries if p.suffix.lower() == ".npz")
    if archives:
        return f"none; give the file '{archives[0]}' itself"
    others = sorted({p.suffix.lower() for p in entries if p.suffix and not p.is_dir()})
    what = next((WHAT_TO_DO[s] for s in others if s in WHAT_TO_DO), "convert the frames")
    return f"other suffixes ({' '.join(others[:6])}); {what}" if others else "none; check the path"


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
