"""Files that hold all clouds of a sequence: the layouts of an .npz or .npy, none of which needs pickle.

- ``points`` (T, N, 3), optional ``normals`` (T, N, 3); or (T, N, 6) with the normals behind;
- frames of unequal length: ``points_0000`` (N_0, 3), ``points_0001`` (N_1, 3), ..., each with an optional
  ``normals_0000``, ...: ``np.savez(path, **{f"points_{t:04d}": p for t, p in enumerate(clouds)})``;
- the same under another name, ``arr_0`` of ``np.savez(path, clouds)`` for one, where nothing else could be meant.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from warpdef.errors import InputError
from warpdef.files.columns import guess_roles, surface_of
from warpdef.files.frame_files import select_frames
from warpdef.files.frame_numbers import natural_key
from warpdef.files.numpy_files import Npz, npy_array, row
from warpdef.files.surface import Surface
from warpdef.sequence import MIN_FRAMES, Cloud

NamedFrame = tuple[str, Callable[[], Cloud]]
"""What a frame is called, and a function that reads it."""

_POINTS_OF_A_FRAME = re.compile("points_[0-9]+")
_UNEQUAL = 'np.savez(path, **{f"points_{t:04d}": p for t, p in enumerate(clouds)})'


def read_npz_frames(path: Path, frames: slice | None) -> tuple[list[NamedFrame], list[str]]:
    """Name and reader of each frame chosen of an .npz, and notes.

    Raises:
        InputError: no layout of this module, or fewer than 2 frames.
    """
    npz = Npz(path)
    name, notes = _stack_name(npz)
    if name:
        return _stacked_frames(npz, name, frames), notes
    numbered = _numbered_names(npz)
    if not numbered:
        meshes = "; it holds meshes: sample them first with `warpdef sample`" if "vertices" in npz else ""
        found = ", ".join(npz.names[:8]) or "no arrays"
        raise InputError(f"{npz.path}: expected an array 'points' (T, N, 3), got {found:.200}{meshes}")

    def read(name: str) -> Cloud:
        normals = name.replace("points", "normals")
        if normals != name and normals in npz:
            return npz.array(name), npz.array(normals)
        return _columns(npz.array(name), f"{name} of {npz.path.name}")

    chosen = select_frames(numbered, frames, MIN_FRAMES, npz.path)
    return [(f"{name} of {npz.path.name}", partial(read, name)) for name in chosen], _called(numbered[0])


def read_npy_frames(path: Path, frames: slice | None) -> tuple[list[NamedFrame], list[str]]:
    """Name and reader of each frame chosen of an .npy of shape (T, N, 3) or (T, N, 6), and notes.

    Raises:
        InputError: another shape, or fewer than 2 frames.
    """
    points = npy_array(path)
    if points.ndim == 2:
        raise InputError(f"{path}: expected a sequence, got one file; give the folder of numbered .npy files")
    _require_stack(points.shape, str(path))
    chosen = select_frames(range(len(points)), frames, MIN_FRAMES, path)
    name = path.name
    return [(f"[{t}] of {name}", lambda t=t: _columns(row(points, t), f"[{t}] of {name}")) for t in chosen], []


def read_npz_points(path: Path) -> Surface:
    """One frame from an .npz: ``points`` (N, 3), optional ``normals``; or its only array of shape (N, 3) or (N, 6).

    Raises:
        InputError: neither.
    """
    npz = Npz(path)
    name = "points"
    if name not in npz:
        shapes = {n: npz.header(n)[0] for n in npz.names if "normal" not in n.lower()}
        found = [n for n, shape in shapes.items() if len(shape) == 2 and shape[1] in (3, 6)]
        if len(found) != 1:
            others = ", ".join(npz.names[:8]) or "no arrays"
            raise InputError(f"{path}: expected an array 'points' (N, 3) of one frame, got {others:.200}")
        name = found[0]
    points, normals = _columns(npz.array(name), f"{path}: {name}")
    if points.ndim != 2:
        raise InputError(f"{path}: {name}: expected the points (N, 3) of one frame, got {points.shape}")
    return Surface(points.astype(np.float64), npz.array("normals") if "normals" in npz else normals)


CONTAINERS: dict[str, Callable[[Path, slice | None], tuple[list[NamedFrame], list[str]]]] = {
    ".npz": read_npz_frames,
    ".npy": read_npy_frames,
}
"""Files that hold all frames of a sequence, by suffix: a function that gives name and reader of each frame chosen."""


def _stack_name(npz: Npz) -> tuple[str, list[str]]:
    """The array of all frames: ``points``, or the only one of its shape; empty without one."""
    if "points" in npz:
        return "points", []
    if "vertices" in npz and "faces" in npz or any(_POINTS_OF_A_FRAME.fullmatch(name) for name in npz.names):
        return "", []
    shapes = {name: npz.header(name)[0] for name in npz.names if "normal" not in name.lower()}
    stacks = [name for name, shape in shapes.items() if len(shape) == 3 and shape[2] in (3, 6)]
    return (stacks[0], _called(stacks[0])) if len(stacks) == 1 else ("", [])


def _called(name: str) -> list[str]:
    return [] if name.startswith("points") else [f"the array '{name}' is taken for the points"]


def _numbered_names(npz: Npz) -> list[str]:
    """One array a frame: ``points_0``, ..., or another name that all arrays of that shape share."""
    numbered = [n for n in npz.names if _POINTS_OF_A_FRAME.fullmatch(n)]
    if not numbered:
        names = [n for n in npz.names if re.fullmatch(r"[^0-9]*[0-9]+", n) and "normal" not in n.lower()]
        names = [n for n in names if len(s := npz.header(n)[0]) == 2 and s[1] in (3, 6)]
        numbered = names if len({re.sub("[0-9]+", "", n) for n in names}) == 1 and len(names) > 1 else []
    return sorted(numbered, key=natural_key)


def _stacked_frames(npz: Npz, name: str, frames: slice | None) -> list[NamedFrame]:
    """Readers of the frames of an array (T, N, 3) or (T, N, 6)."""
    shape, dtype = npz.header(name)
    if dtype.hasobject:
        raise InputError(
            f"{npz.path}: {name}: expected numbers of shape (T, N, 3), got objects, which is not read: it "
            f"could run code; save unequal frames with {_UNEQUAL}"
        )
    _require_stack(shape, f"{npz.path}: {name}")
    # Looked at before the frames are counted out: a damaged header may promise any number of them.
    points = npz.array(name)
    chosen = select_frames(range(len(points)), frames, MIN_FRAMES, npz.path)
    normals = npz.array("normals") if "normals" in npz else None
    if normals is not None and normals.shape != (*shape[:2], 3):
        raise InputError(
            f"{npz.path}: normals: expected shape {(*shape[:2], 3)} as the points have, got {normals.shape}"
        )

    def read(t: int) -> Cloud:
        where = f"{name}[{t}] of {npz.path.name}"
        if normals is not None:
            return row(points, t)[:, :3], row(normals, t)
        return _columns(row(points, t), where)

    return [(f"{name}[{t}] of {npz.path.name}", partial(read, t)) for t in chosen]


def _columns(rows: np.ndarray, where: str) -> Cloud:
    if rows.ndim == 2 and rows.shape[1] == 6:
        surface = surface_of(rows, guess_roles(rows, where))
        return surface.points, surface.normals
    return rows, None


def _require_stack(shape: Sequence[int], where: str) -> None:
    if len(shape) == 3 and shape[2] in (3, 6):
        return
    turned = len(shape) == 3 and 3 in shape[:2]
    order = {True: (1, 2, 0), False: (0, 2, 1)}[turned and shape[0] == 3]
    what = f"transpose it: points.transpose{order}" if turned else f"save unequal frames with {_UNEQUAL}"
    raise InputError(f"{where}: expected shape (T, N, 3), got {tuple(shape)}; {what}")
