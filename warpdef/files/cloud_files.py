"""Sequences of point clouds in and out: folders of numbered files, and archives that hold all frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from warpdef.cloud import MIN_POINTS, FramePoints
from warpdef.errors import InputError
from warpdef.files.cloud_archives import CONTAINERS, NamedFrames, left_behind, times_of
from warpdef.files.columns import parse_columns
from warpdef.files.disk import must_exist
from warpdef.files.formats import CLOUD_SUFFIXES, FRAME_SUFFIXES, read_surface
from warpdef.files.frame_files import WHAT_TO_DO, FrameSlot, find_frames, select_frames
from warpdef.files.mesh_clouds import cloud_of
from warpdef.files.numpy_files import write_npz
from warpdef.files.texture import read_texture
from warpdef.files.texture_colors import pixels_of
from warpdef.sequence import MIN_FRAMES, PointSequence


def read_clouds(
    path: Path | str,
    frames: slice | None = None,
    *,
    strict: bool = False,
    points: int = 0,
    seed: int = 0,
    columns: str = "",
) -> PointSequence:
    """Read a sequence of point clouds, in the input's units.

    Args:
        path: a folder of numbered files of one kind (``formats.FORMATS``; in the order of their numbers, dates or
            times; other files are passed over), a folder of such a file a frame, or an .npz or .npy in a layout of
            ``cloud_archives``. Vertices of meshes are points
            where they are even, else points are drawn from the faces.
        frames: frames to use; files outside it are not opened.
        strict: refuse a frame that cannot be used (empty, damaged, missing); else it becomes a gap of the sequence,
            with a warning, unless more than half of the frames are such.
        points: points kept of a frame, as ``PointSequence.subsample`` does; 0: all. No more than one frame is then
            held whole, and an array of an .npz that is not compressed is read from the file page by page.
        seed: of that choice.
        columns: what the columns of tables are, ``x,y,z,nx,ny,nz,r,g,b`` with ``_`` for one to be passed over; empty:
            by their names, else by their values.

    Raises:
        InputError: nothing there, an unknown suffix, fewer than 2 frames, or frames that cannot be used.
        MissingPackageError: the format needs a package that is not installed.
    """
    path = Path(path)
    must_exist(path)
    if points and points < MIN_POINTS:
        raise InputError(f"--points: expected at least {MIN_POINTS}, got {points}")
    suffix = path.suffix.lower()
    roles, told = parse_columns(columns), ReadingNotes()
    if path.is_dir():
        named = _folder_frames(path, frames, roles, told)
    elif suffix in CONTAINERS:
        named = CONTAINERS[suffix](path, frames)
    elif suffix in CLOUD_SUFFIXES:
        raise InputError(f"{path}: expected a sequence, got one file; give the folder of numbered {suffix} files")
    else:
        what = f"; {WHAT_TO_DO[suffix]}" if suffix in WHAT_TO_DO else ""
        raise InputError(
            f"{path}: unknown suffix '{suffix}'; expected an .npz, or a folder of numbered files "
            f"({' '.join(CLOUD_SUFFIXES)}){what}"
        )
    sequence = PointSequence.from_frames(named.frames, strict=strict, at_most=points, seed=seed, notes=named.notes)
    return replace(sequence, columns=told.line, notes=(*sequence.notes, *told.notes), times=named.times)


@dataclass
class ReadingNotes:
    """What the files said of their columns, by frame, what is left behind, whose points were drawn from faces, and
    which images were missing."""

    lines: dict[str, str] = field(default_factory=dict)
    drawn: list[str] = field(default_factory=list)
    passed: dict[str, None] = field(default_factory=dict)
    untextured: list[str] = field(default_factory=list)

    @property
    def line(self) -> str:
        """That of the first frame."""
        return next(iter(self.lines.values()), "")

    @property
    def notes(self) -> list[str]:
        """A warning where frames differ, and where they are meshes."""
        notes = []
        other = next((name for name, line in self.lines.items() if line != self.line), "")
        if other:
            notes.append(f"the columns differ: '{self.line}' in the first frame, '{self.lines[other]}' in {other}")
        if self.passed:
            notes.append(left_behind(list(self.passed)))
        if self.untextured:
            more = len(self.untextured) - 1
            notes.append(self.untextured[0] + (f" (and {more} frames more)" if more else ""))
        if self.drawn:
            which = f"{len(self.drawn)} frames are meshes of few or uneven vertices"
            notes.append(f"{which}: their points are drawn evenly from the faces")
        return notes


def _folder_frames(path: Path, frames: slice | None, columns: Sequence[str], told: ReadingNotes) -> NamedFrames:
    found = find_frames(path, FRAME_SUFFIXES)
    slots = select_frames(found.slots, frames, MIN_FRAMES, path)
    named = [(slot.name, partial(_read_slot, slot, columns, told)) for slot in slots]
    return NamedFrames(named, found.notes, times_of(slots))


def _read_slot(slot: FrameSlot, columns: Sequence[str], told: ReadingNotes) -> FramePoints:
    surface = read_surface(slot.file(), FRAME_SUFFIXES, columns)
    if surface.columns:
        told.lines[slot.name] = surface.columns
    told.passed |= dict.fromkeys(surface.passed)
    pixels = None
    if (
        surface.colors is None
        and surface.faces is not None
        and (surface.uv is not None or surface.corner_uv is not None)
    ):
        texture, notes = read_texture(slot.file(), surface.named)
        told.untextured += notes
        pixels = None if texture is None else pixels_of(texture)
    cloud, drawn = cloud_of(surface, slot.name, pixels)
    told.drawn += [slot.name] if drawn else []
    return cloud


def write_clouds_npz(path: Path | str, sequence: PointSequence) -> None:
    """Write a sequence so that ``read_clouds`` gives the same numbers back, float64.

    Frames of equal length with normals and colours in all frames or in none go to ``points``, ``normals`` and
    ``colors`` (T, N, 3), others to ``points_0000``, ``normals_0000``, ``colors_0000``, ... The file appears at once or
    not at all; an existing one is replaced.

    Raises:
        InputError: another suffix than .npz, or the file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() != ".npz":
        raise InputError(f"{path}: unknown suffix '{path.suffix}'; expected .npz for a sequence of clouds")
    with_normals = [n for n in sequence.normals if n is not None]
    with_colors = [c for c in sequence.colors if c is not None]
    complete = all(len(given) in (0, len(sequence)) for given in (with_normals, with_colors))
    if len({len(p) for p in sequence.points}) == 1 and complete:
        arrays = {"points": np.stack(sequence.points)}
        if with_normals:
            arrays["normals"] = np.stack(with_normals)
        if with_colors:
            arrays["colors"] = np.stack(with_colors)
    else:
        arrays = {f"points_{t:04d}": p for t, p in enumerate(sequence.points)}
        arrays |= {f"normals_{t:04d}": n for t, n in enumerate(sequence.normals) if n is not None}
        arrays |= {f"colors_{t:04d}": c for t, c in enumerate(sequence.colors) if c is not None}
    write_npz(path, arrays)
