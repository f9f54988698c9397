"""Sequences of point clouds in and out.

The .npz layouts, none of which needs pickle:

- ``points`` (T, N, 3), optional ``normals`` (T, N, 3);
- frames of unequal length: ``points_0000`` (N_0, 3), ``points_0001`` (N_1, 3), ..., each with an optional
  ``normals_0000``, ...: ``np.savez(path, **{f"points_{t:04d}": p for t, p in enumerate(clouds)})``.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from warpdef.errors import InputError
from warpdef.files.disk import must_exist
from warpdef.files.formats import CLOUD_SUFFIXES, read_surface
from warpdef.files.frame_files import find_frames, natural_key, select_frames
from warpdef.files.numpy_files import Npz, row, write_npz
from warpdef.sequence import MIN_FRAMES, MIN_POINTS, Cloud, PointSequence

_UNEQUAL = 'np.savez(path, **{f"points_{t:04d}": p for t, p in enumerate(clouds)})'

NamedFrame = tuple[str, Callable[[], Cloud]]
"""What a frame is called, and a function that reads it."""


def read_clouds(
    path: Path | str, frames: slice | None = None, *, strict: bool = False, points: int = 0, seed: int = 0
) -> PointSequence:
    """Read a sequence of point clouds, in the input's units.

    Args:
        path: a folder of numbered .ply, .obj, .off, .xyz, .npy, .pcd, .las or .laz files of one kind (natural order,
            padded or not; other files are passed over), or an .npz in a layout of this module. Vertices of meshes are
            points. .npy and .xyz may have 6 columns, the last three being normals.
        frames: frames to use; files outside it are not opened.
        strict: refuse a frame that cannot be used (empty, damaged, missing); else it becomes a gap of the sequence,
            with a warning, unless more than half of the frames are such.
        points: points kept of a frame, as ``PointSequence.subsample`` does; 0: all. No more than one frame is then
            held whole, and an array of an .npz that is not compressed is read from the file page by page.
        seed: of that choice.

    Raises:
        InputError: nothing there, an unknown suffix, fewer than 2 frames, or frames that cannot be used.
        MissingPackageError: the format needs a package that is not installed.
    """
    path = Path(path)
    must_exist(path)
    if points and points < MIN_POINTS:
        raise InputError(f"--points: expected at least {MIN_POINTS}, got {points}")
    if path.is_dir():
        found = find_frames(path, CLOUD_SUFFIXES)
        files = select_frames(found.files, frames, MIN_FRAMES, path)
        named, notes = [(file.name, partial(_read_file, file)) for file in files], found.notes
    elif path.suffix.lower() in CONTAINERS:
        named, notes = CONTAINERS[path.suffix.lower()](path, frames), []
    elif path.suffix.lower() in CLOUD_SUFFIXES:
        suffix = path.suffix.lower()
        raise InputError(f"{path}: expected a sequence, got one file; give the folder of numbered {suffix} files")
    else:
        known = " ".join(CLOUD_SUFFIXES)
        raise InputError(
            f"{path}: unknown suffix '{path.suffix.lower()}'; expected an .npz, or a folder of numbered files ({known})"
        )
    return PointSequence.from_frames(named, strict=strict, at_most=points, seed=seed, notes=notes)


def _read_file(path: Path) -> Cloud:
    surface = read_surface(path, CLOUD_SUFFIXES)
    return surface.points, surface.normals


def _npz_frames(path: Path, frames: slice | None) -> list[NamedFrame]:
    npz = Npz(path)
    file = npz.path.name
    if "points" in npz:
        points, normals, chosen = _npz_arrays(npz, frames)
        return [
            (f"points[{t}] of {file}", lambda t=t: (row(points, t), None if normals is None else row(normals, t)))
            for t in chosen
        ]
    numbered = sorted((n for n in npz.names if re.fullmatch(r"points_[0-9]+", n)), key=natural_key)
    if not numbered:
        meshes = "; it holds meshes: sample them first with `warpdef sample`" if "vertices" in npz else ""
        found = ", ".join(npz.names[:8]) or "no arrays"
        raise InputError(f"{npz.path}: expected an array 'points' (T, N, 3), got {found:.200}{meshes}")

    def read(name: str) -> Cloud:
        normals = name.replace("points", "normals")
        return npz.array(name), npz.array(normals) if normals in npz else None

    chosen = select_frames(numbered, frames, MIN_FRAMES, npz.path)
    return [(f"{name} of {file}", partial(read, name)) for name in chosen]


CONTAINERS: dict[str, Callable[[Path, slice | None], list[NamedFrame]]] = {".npz": _npz_frames}
"""Files that hold all frames of a sequence, by suffix: a function that gives name and reader of each frame chosen."""


def _npz_arrays(npz: Npz, frames: slice | None) -> tuple[np.ndarray, np.ndarray | None, list[int]]:
    """The arrays of all frames, (T, N, 3), and the frames chosen."""
    shape, dtype = npz.header("points")
    if dtype.hasobject:
        raise InputError(
            f"{npz.path}: points: expected numbers of shape (T, N, 3), got objects, which is not read: it "
            f"could run code; save unequal frames with {_UNEQUAL}"
        )
    if len(shape) != 3 or shape[2] != 3:
        raise InputError(
            f"{npz.path}: points: expected shape (T, N, 3), got {shape}; save unequal frames with {_UNEQUAL}"
        )
    # Looked at before the frames are counted out: a damaged header may promise any number of them.
    points = npz.array("points")
    chosen = select_frames(range(len(points)), frames, MIN_FRAMES, npz.path)
    normals = npz.array("normals") if "normals" in npz else None
    if normals is not None and normals.shape != shape:
        raise InputError(f"{npz.path}: normals: expected shape {shape} as the points have, got {normals.shape}")
    return points, normals, chosen


def write_clouds_npz(path: Path | str, sequence: PointSequence) -> None:
    """Write a sequence so that ``read_clouds`` gives the same numbers back, float64.

    Frames of equal length with normals in all frames or in none go to ``points`` and ``normals`` (T, N, 3), others to
    ``points_0000``, ``normals_0000``, ... The file appears at once or not at all; an existing one is replaced.

    Raises:
        InputError: another suffix than .npz, or the file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() != ".npz":
        raise InputError(f"{path}: unknown suffix '{path.suffix}'; expected .npz for a sequence of clouds")
    with_normals = [n for n in sequence.normals if n is not None]
    if len({len(p) for p in sequence.points}) == 1 and len(with_normals) in (0, len(sequence)):
        arrays = {"points": np.stack(sequence.points)}
        if with_normals:
            arrays["normals"] = np.stack(with_normals)
    else:
        arrays = {f"points_{t:04d}": p for t, p in enumerate(sequence.points)}
        arrays |= {f"normals_{t:04d}": n for t, n in enumerate(sequence.normals) if n is not None}
    write_npz(path, arrays)
