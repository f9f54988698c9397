"""Files that hold all clouds of a sequence: the layouts of an .npz or .npy, none of which needs pickle.

- ``points`` (T, N, 3), optional ``normals`` (T, N, 3) and ``colors`` (T, N, 3) or, for all frames, (N, 3); or
  (T, N, 6) with normals or colours behind;
- frames of unequal length: ``points_0000`` (N_0, 3), ``points_0001`` (N_1, 3), ..., each with optional
  ``normals_0000``, ``colors_0000``, ...: ``np.savez(path, **{f"points_{t:04d}": p for t, p in enumerate(clouds)})``,
  where a number that is missing is a frame that is missing;
- the same under another name, ``arr_0`` of ``np.savez(path, clouds)`` for one, where nothing else could be meant;
- beside any of them ``valid`` (T, N), or ``valid_0000`` (N_0,), ..., true for rows that are points (``point_masks``);
- ``depth`` images and the camera's ``intrinsics`` (``depth_images``).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from warpdef.cloud import MIN_POINTS, FramePoints
from warpdef.errors import InputError
from warpdef.files.columns import guess_roles, surface_of
from warpdef.files.depth_images import DEPTH_NAMES, INTRINSICS_NAMES, POSE_NAMES, DepthArchive
from warpdef.files.frame_files import FrameFiles, FrameSlot, select_frames
from warpdef.files.frame_numbers import read_names
from warpdef.files.numpy_files import Npz, npy_array, row
from warpdef.files.point_masks import UNCLEAR_NAMES, VALID_NAMES, mask_notes, read_valid
from warpdef.files.surface import Surface
from warpdef.sequence import MIN_FRAMES

NamedFrame = tuple[str, Callable[[], FramePoints]]
"""What a frame is called, and a function that reads it."""


@dataclass(frozen=True)
class NamedFrames:
    """The frames chosen of a file or folder, in the order of time.

    frames: name and reader of each. notes: warnings.
    times:  of the frames, in usual steps from the first, where steps are uneven; else empty
    """

    frames: list[NamedFrame]
    notes: list[str]
    times: tuple[float, ...] = ()


def times_of(slots: Sequence[FrameSlot]) -> tuple[float, ...]:
    """Times of slots from the first, in usual steps; empty where steps are even."""
    return tuple(abs(slot.time - (slots[0].time or 0.0)) for slot in slots if slot.time is not None)


COLOR_NAMES = ("colors", "colours", "color", "colour", "rgb", "rgba", "vertex_colors")
"""What colours are called; of frames of their own with the frame's number behind."""
_KNOWN = {"points", "normals", "names", "fps", "up", *COLOR_NAMES, *VALID_NAMES, *UNCLEAR_NAMES}
_POINTS_OF_A_FRAME = re.compile("points_[0-9]+")
_UNEQUAL = 'np.savez(path, **{f"points_{t:04d}": p for t, p in enumerate(clouds)})'


def read_npz_frames(path: Path, frames: slice | None) -> NamedFrames:
    """The frames chosen of an .npz.

    Raises:
        InputError: no layout of this module, or fewer than 2 frames.
    """
    npz = Npz(path)
    name, notes = _stack_name(npz)
    if name:
        passed = [n for n in npz.names if n not in {name, *_KNOWN} and npz.header(n)[0][:2] == npz.header(name)[0][:2]]
        chosen, told = _stacked_frames(npz, name, frames)
        return NamedFrames(chosen, [*notes, *told, *([left_behind(passed)] if passed else [])])
    if any(name in npz for name in DEPTH_NAMES):
        return _depth_frames(npz, frames)
    numbered = _numbered_names(npz)
    if not numbered:
        what = f"call that of all frames 'points', or save unequal frames with {_UNEQUAL}"
        if "vertices" in npz:
            what = "it holds meshes: sample them first with `warpdef sample`"
        found = ", ".join(npz.names[:8]) or "no arrays"
        raise InputError(f"{npz.path}: expected an array 'points' (T, N, 3), got {found:.200}; {what}")

    def read(slot: FrameSlot) -> FramePoints:
        name = slot.file().as_posix()
        cloud = _columns(npz.array(name), f"{name} of {npz.path.name}")
        stem, number = re.split("(?=[0-9]+$)", name, maxsplit=1)
        normals = _first_of(npz, [f"normals_{number}"])
        colors = _first_of(npz, [f"{c}_{number}" for c in COLOR_NAMES])
        valid = read_valid(npz, [f"{v}_{number}" for v in VALID_NAMES], [cloud.points.shape[:1]])
        return _with(cloud, normals, colors if stem == "points_" else None, valid)

    numbering = read_names(numbered, str(npz.path))
    # As files of a folder are: a number that is missing is a frame that is missing.
    slots = FrameFiles([Path(numbered[i]) for i in numbering.order], [], numbering).slots
    chosen = select_frames(slots, frames, MIN_FRAMES, npz.path)
    named = [(f"{slot.name} of {npz.path.name}", partial(read, slot)) for slot in chosen]
    return NamedFrames(named, [*_called(numbered[0]), *numbering.notes], times_of(chosen))


def read_npy_frames(path: Path, frames: slice | None) -> NamedFrames:
    """The frames chosen of an .npy of shape (T, N, 3) or (T, N, 6).

    Raises:
        InputError: another shape, or fewer than 2 frames.
    """
    points = npy_array(path)
    if points.ndim == 2:
        raise InputError(f"{path}: expected a sequence, got one file; give the folder of numbered .npy files")
    _require_stack(points.shape, str(path))
    chosen = select_frames(range(len(points)), frames, MIN_FRAMES, path)
    name = path.name
    read = [(f"[{t}] of {name}", lambda t=t: _columns(row(points, t), f"[{t}] of {name}")) for t in chosen]
    return NamedFrames(read, [])


def read_npz_points(path: Path) -> Surface:
    """One frame from an .npz: ``points`` (N, 3), optional ``normals``; its only array of shape (N, 3) or (N, 6); or
    ``depth`` images of one frame.

    Raises:
        InputError: neither.
    """
    npz = Npz(path)
    name = "points"
    if name not in npz and any(n in npz for n in DEPTH_NAMES):
        cloud = DepthArchive(npz, _first_of(npz, COLOR_NAMES), single=True).cloud(0)
        return Surface(cloud.points, colors=cloud.colors)
    if name not in npz:
        shapes = {n: npz.header(n)[0] for n in npz.names if "normal" not in n.lower()}
        found = [n for n, shape in shapes.items() if len(shape) == 2 and shape[1] in (3, 6)]
        if len(found) != 1:
            others = ", ".join(npz.names[:8]) or "no arrays"
            raise InputError(f"{path}: expected an array 'points' (N, 3) of one frame, got {others:.200}")
        name = found[0]
    cloud = _columns(npz.array(name), f"{path}: {name}")
    if cloud.points.ndim != 2:
        raise InputError(f"{path}: {name}: expected the points (N, 3) of one frame, got {cloud.points.shape}")
    valid = read_valid(npz, VALID_NAMES, [cloud.points.shape[:1]])
    cloud = _with(cloud, _first_of(npz, ["normals"]), _first_of(npz, COLOR_NAMES), valid)
    passed = [n for n in npz.names if n not in {name, *_KNOWN} and npz.header(n)[0][:1] == (len(cloud.points),)]
    return Surface(cloud.points.astype(np.float64), cloud.normals, colors=cloud.colors, passed=tuple(passed))


CONTAINERS: dict[str, Callable[[Path, slice | None], NamedFrames]] = {
    ".npz": read_npz_frames,
    ".npy": read_npy_frames,
}
"""Files that hold all frames of a sequence, by suffix: a function that gives the frames chosen."""


def _stack_name(npz: Npz) -> tuple[str, list[str]]:
    """The array of all frames: ``points``, or the only one of its shape; empty without one."""
    if "points" in npz:
        return "points", []
    if "vertices" in npz and "faces" in npz or any(_POINTS_OF_A_FRAME.fullmatch(name) for name in npz.names):
        return "", []
    beside = {*_KNOWN, *INTRINSICS_NAMES, *POSE_NAMES, *DEPTH_NAMES}
    shapes = {name: npz.header(name)[0] for name in npz.names if "normal" not in name.lower() and name not in beside}
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
    return numbered


def _depth_frames(npz: Npz, frames: slice | None) -> NamedFrames:
    """The frames chosen of depth images."""
    images = DepthArchive(npz, _first_of(npz, COLOR_NAMES))
    chosen = select_frames(range(len(images)), frames, MIN_FRAMES, npz.path)
    passed = [n for n in npz.names if n not in {*images.used, *_KNOWN}]
    notes = mask_notes(npz, images.valid) + ([left_behind(passed)] if passed else [])
    return NamedFrames([(f"{images.name}[{t}] of {npz.path.name}", partial(images.cloud, t)) for t in chosen], notes)


def _stacked_frames(npz: Npz, name: str, frames: slice | None) -> tuple[list[NamedFrame], list[str]]:
    """Readers of the frames of an array (T, N, 3) or (T, N, 6), and warnings."""
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
    normals, colors = _first_of(npz, ["normals"]), _first_of(npz, COLOR_NAMES)
    allowed = [(*ahead, k) for ahead in (shape[:2], shape[1:2]) for k in (3, 4)]
    if colors is not None and colors.shape not in allowed:
        raise InputError(
            f"{npz.path}: colours: expected shape {allowed[0]} as the points have, or {allowed[2]} for all frames, got "
            f"{colors.shape}"
        )
    if normals is not None and normals.shape != (*shape[:2], 3):
        raise InputError(
            f"{npz.path}: normals: expected shape {(*shape[:2], 3)} as the points have, got {normals.shape}; give one "
            "normal a point, or none"
        )

    valid = read_valid(npz, VALID_NAMES, [shape[:2], shape[1:2]])

    def read(t: int) -> FramePoints:
        rows = row(points, t) if normals is None else row(points, t)[:, :3]
        cloud = _columns(rows, f"{name}[{t}] of {npz.path.name}")
        own = colors if colors is None or colors.ndim == 2 else row(colors, t)
        kept = valid if valid is None or valid.ndim == 1 else valid[t]
        return _with(cloud, None if normals is None else row(normals, t), own, kept)

    return [(f"{name}[{t}] of {npz.path.name}", partial(read, t)) for t in chosen], mask_notes(npz, valid)


def left_behind(names: Sequence[str]) -> str:
    """The warning that names what points carry and a mesh has no place for."""
    return f"of the points {', '.join(names[:12])}{', ...' if len(names) > 12 else ''} left behind: no place on a mesh"


def _first_of(npz: Npz, names: Sequence[str]) -> np.ndarray | None:
    return next((npz.array(name) for name in names if name in npz), None)


def _with(
    cloud: FramePoints, normals: np.ndarray | None, colors: np.ndarray | None, valid: np.ndarray | None
) -> FramePoints:
    """The cloud with arrays of their own in place of columns, and without rows that are no points."""
    normals, colors = cloud.normals if normals is None else normals, cloud.colors if colors is None else colors
    lengths = {len(array) for array in (normals, colors) if array is not None} | {len(cloud.points)}
    whole = FramePoints(cloud.points, normals, colors)
    # Arrays of other lengths are complained about where every cloud is checked.
    return whole if valid is None or len(lengths) > 1 else whole.keep(valid)


def _columns(rows: np.ndarray, where: str) -> FramePoints:
    if rows.ndim == 2 and rows.shape[1] == 6:
        surface = surface_of(rows, guess_roles(rows, where))
        return FramePoints(surface.points, surface.normals, surface.colors)
    return FramePoints(rows)


def _require_stack(shape: Sequence[int], where: str) -> None:
    if len(shape) == 3 and shape[2] in (3, 6) and not shape[1] < MIN_POINTS <= shape[0]:
        return
    turned, order = len(shape) == 3 and (3 in shape[:2] or shape[2] in (3, 6)), (0, 2, 1)
    if turned and shape[2] in (3, 6):
        order = (1, 0, 2)
    elif turned and shape[0] == 3:
        order = (1, 2, 0)
    what = f"transpose it: points.transpose{order}" if turned else f"save unequal frames with {_UNEQUAL}"
    if len(shape) == 4 and shape[3] in (3, 6):
        what = "that is an image of points a frame: make a list of it, points.reshape(len(points), -1, 3)"
    if len(shape) == 3 and shape[2] in (4, 5):
        what = "leave out what is no coordinate: points[..., :3]"
    if len(shape) == 2 and shape[1] in (3, 6):
        what = f"that is one cloud: stack the frames along a new first axis, or {what}"
    raise InputError(f"{where}: expected shape (T, N, 3), got {tuple(shape)}; {what}")
