"""Sequences of point clouds in and out.

The .npz layouts, none of which needs pickle:

- ``points`` (T, N, 3), optional ``normals`` (T, N, 3);
- frames of unequal length: ``points_0000`` (N_0, 3), ``points_0001`` (N_1, 3), ..., each with an optional
  ``normals_0000``, ...: ``np.savez(path, **{f"points_{t:04d}": p for t, p in enumerate(clouds)})``.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from warpdef.errors import InputError
from warpdef.files.disk import must_exist
from warpdef.files.frame_files import CLOUD_SUFFIXES, frame_files, natural_key, read_surface, select_frames
from warpdef.files.numpy_files import Npz, write_npz
from warpdef.sequence import MIN_FRAMES, PointSequence

_UNEQUAL = 'np.savez(path, **{f"points_{t:04d}": p for t, p in enumerate(clouds)})'


def read_clouds(path: Path | str, frames: slice | None = None) -> PointSequence:
    """Read a sequence of point clouds, in the input's units.

    Args:
        path: a folder of numbered .ply, .obj, .off, .xyz or .npy files of one kind (natural order, padded or not;
            other files are passed over), or an .npz in a layout of this module. Vertices of meshes are points.
            .npy and .xyz may have 6 columns, the last three being normals.
        frames: frames to use; files outside it are not opened.

    Raises:
        InputError: nothing there, an unknown suffix, fewer than 2 frames, a damaged file, or any frame that
            ``PointSequence.from_arrays`` rejects.
    """
    path = Path(path)
    must_exist(path)
    if path.is_dir():
        files = select_frames(frame_files(path, CLOUD_SUFFIXES), frames, MIN_FRAMES, path)
        surfaces = [read_surface(file, CLOUD_SUFFIXES) for file in files]
        return PointSequence.from_arrays(
            [s.points for s in surfaces], [s.normals for s in surfaces], [file.name for file in files]
        )
    suffix = path.suffix.lower()
    if suffix == ".npz":
        return _read_npz(Npz(path), frames)
    if suffix in CLOUD_SUFFIXES:
        raise InputError(f"{path}: expected a sequence, got one file; give the folder of numbered {suffix} files")
    known = " ".join(CLOUD_SUFFIXES)
    raise InputError(f"{path}: unknown suffix '{suffix}'; expected an .npz, or a folder of numbered files ({known})")


def _read_npz(npz: Npz, frames: slice | None) -> PointSequence:
    file = npz.path.name
    numbered = sorted((n for n in npz.names if re.fullmatch(r"points_[0-9]+", n)), key=natural_key)
    if "points" in npz:
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
        chosen = select_frames(range(shape[0]), frames, MIN_FRAMES, npz.path)
        normals = npz.array("normals") if "normals" in npz else None
        if normals is not None and normals.shape != shape:
            raise InputError(f"{npz.path}: normals: expected shape {shape} as the points have, got {normals.shape}")
        points = npz.array("points")
        return PointSequence.from_arrays(
            points[chosen], None if normals is None else normals[chosen], [f"points[{t}] of {file}" for t in chosen]
        )
    if not numbered:
        meshes = "; it holds meshes: sample them first with `warpdef sample`" if "vertices" in npz else ""
        found = ", ".join(npz.names[:8]) or "no arrays"
        raise InputError(f"{npz.path}: expected an array 'points' (T, N, 3), got {found}{meshes}")
    names = select_frames(numbered, frames, MIN_FRAMES, npz.path)
    normal_names = [name.replace("points", "normals") for name in names]
    return PointSequence.from_arrays(
        [npz.array(name) for name in names],
        [npz.array(name) if name in npz else None for name in normal_names],
        [f"{name} of {file}" for name in names],
    )


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
