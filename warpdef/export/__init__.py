"""A moving mesh to a file of another program, the format chosen by the suffix.

A new format is a file with a function ``write(animation, path)`` and a line in ``FORMATS``; one that holds bones has a
function ``write(animation, path, rig)``. Points without faces have formats of their own.
"""

from __future__ import annotations

import importlib
import os
import re
import shutil
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpdef.errors import InputError
from warpdef.export.animation import Animation
from warpdef.export.image import image_name, is_image_of_export
from warpdef.export.mesh_folders import OBJ_MARK
from warpdef.export.points import MovingPoints
from warpdef.files.disk import reason, sibling
from warpdef.texture import Texture

if TYPE_CHECKING:
    from warpdef.rig.decompose import Rig


@dataclass(frozen=True)
class ExportFormat:
    """One format.

    writer:    ``module:function`` of the package, called with the animation and a path in an empty folder; empty where
               the format holds bones alone
    what:      one line for people
    is_folder: the format's place is a folder of numbered files
    beside:    what is written next to the file, as a pattern over its stem; files end in a suffix, folders do not
    image:     a texture's image is written next to the file, too
    rigged:    as ``writer``, for a mesh that is moved by a rig, which is its third argument; empty where it holds none
    measured:  holds a measure at the vertices, as numbers or as colours
    quantised: numbers are whole multiples of a step, unless ``precise=True`` is given to ``writer``
    carries:   which of ``up`` and ``unit`` (metres a unit) it says, or turns and scales its coordinates by
    packed:    ``writer`` and ``rigged`` take ``meshopt=True``, for a smaller file that fewer programs read
    """

    writer: str
    what: str
    is_folder: bool = False
    beside: tuple[str, ...] = ()
    image: bool = False
    rigged: str = ""
    quantised: bool = False
    measured: bool = False
    carries: tuple[str, ...] = ()
    packed: bool = False

    def places(self, path: Path, texture: Texture | None = None) -> list[Path]:
        """Everything that an export to ``path`` makes."""
        names = [pattern.format(path.stem) for pattern in self.beside]
        names += [image_name(texture, path)] if self.image and texture is not None else []
        return [path, *(path.with_name(name) for name in names)]


_BOTH = ("up", "unit")
_USDZ = ExportFormat(
    "usd:write_usd", "Universal Scene Description, time samples; needs the extra [usd]", measured=True, carries=_BOTH
)
_USD = replace(_USDZ, image=True)

FORMATS = {
    "glb": ExportFormat(
        "gltf:write_glb",
        "binary glTF, a morph target a frame, or a rig: web, Blender, game engines",
        rigged="gltf_rig:write_rigged_glb",
        quantised=True,
        measured=True,
        carries=_BOTH,
        packed=True,
    ),
    "usd": _USD,
    "usda": _USD,
    "usdc": _USD,
    "usdz": _USDZ,
    "pc2": ExportFormat("point_cache:write_pc2", "point cache, with the base mesh as .obj", beside=("{}_pc2.obj",)),
    "mdd": ExportFormat("point_cache:write_mdd", "point cache, with the base mesh as .obj", beside=("{}_mdd.obj",)),
    "pvd": ExportFormat(
        "paraview:write_pvd", "ParaView, with a folder of .vtp files", beside=("{}_vtp",), measured=True
    ),
    "obj": ExportFormat("mesh_folders:write_obj_folder", "a folder of OBJ files", is_folder=True),
    "ply": ExportFormat("mesh_folders:write_ply_folder", "a folder of binary PLY files", is_folder=True, measured=True),
    "stl": ExportFormat("print_folders:write_stl_folder", "a folder of binary STL files", is_folder=True),
    "3mf": ExportFormat(
        "print_folders:write_3mf_folder", "a folder of 3MF files, in millimetres", True, carries=("unit",)
    ),
    "npz": ExportFormat(
        "archive:write_npz_animation", "NumPy: vertices (T, V, 3), faces, fps, names, up", measured=True, carries=_BOTH
    ),
    "anime": ExportFormat("anime:write_anime", "DeformingThings4D"),
    "bvh": ExportFormat("", "the bones of a rig, as motion capture has them", rigged="bvh:write_bvh", carries=("up",)),
}
"""Formats of moving meshes by suffix, without the dot."""

POINT_FORMATS = {
    "ply": ExportFormat("points:write_points_ply_folder", "a folder of binary PLY files", is_folder=True),
    "npz": ExportFormat("points:write_points_npz", "NumPy: points (T, N, 3), as a sequence of clouds, names, fps"),
}
"""Formats of moving points."""

_INSTEAD = {
    "abc": "write .usdc, and turn it into Alembic where that is wanted (in Blender: import .usdc, export Alembic)",
    "fbx": "write .glb, with --bones auto for a rig, and turn it into FBX (in Blender: import the .glb, export as FBX)",
    "blend": "write .usdc or .glb and import it in Blender",
    **dict.fromkeys(("mp4", "gif"), "a movie is made by warpdef view --movie"),
    "html": "a page is made by warpdef view --html",
    **dict.fromkeys(("png", "jpg"), "a picture is made by warpdef view --screenshot"),
}
"""By suffix, what to do for formats that are not written."""
_NUMBERED = re.compile(r"[0-9]{4,}\.(obj|ply|vtp|stl|3mf)")


def format_of(path: Path | str, name: str = "", points: bool = False) -> ExportFormat:
    """The format of a name without a dot, or, where that is empty, of the suffix of ``path``.

    Args:
        points: it is to hold points without faces.

    Raises:
        InputError: there is no such format; the message lists those there are.
    """
    path = Path(path)
    key = (name or path.suffix).lower().removeprefix(".")
    if points and key in FORMATS and key not in POINT_FORMATS:
        known = " or ".join(f".{key}" for key in POINT_FORMATS)
        raise InputError(f"{path}: expected {known} for points without faces, got '.{key}', which holds meshes only")
    if key in FORMATS:
        return (POINT_FORMATS if points else FORMATS)[key]
    if key in _INSTEAD:
        raise InputError(f"{path}: .{key} is not written; {_INSTEAD[key]}")
    hint = {"gltf": "glb", "vtp": "pvd"}.get(key) or next(iter(get_close_matches(key, FORMATS, 1)), "")
    meant = f"; did you mean .{hint}?" if hint else ""
    known = " ".join(f".{key}" for key in FORMATS)
    got = f"'.{key}'" if key else "none"
    raise InputError(f"{path}: unknown suffix {got}; expected one of {known}{meant}")


def check_place(path: Path | str, form: ExportFormat, overwrite: bool = False, texture: Texture | None = None) -> None:
    """Check, before anything is read or computed, that an export to ``path`` would find its places free.

    Args:
        texture: the image to be written, as far as it is known.

    Raises:
        InputError: something stands there that may not be replaced, or there is no such folder.
    """
    path = Path(path)
    try:
        ground = "\0" not in str(path) and path.parent.is_dir()
        for place in form.places(path, texture) if path.name else []:
            _check_free(place, path, place == path and form.is_folder or not place.suffix, overwrite)
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path!s:.200}: cannot be written ({reason(error)}); choose another place") from None
    if not ground or not path.name:
        raise InputError(f"{path}: expected a file in a folder that is there, got '{path.parent}'; make it first")


def export(
    animation: Animation | MovingPoints,
    path: Path | str,
    *,
    format: str = "",
    overwrite: bool = False,
    rig: Rig | None = None,
    precise: bool = False,
    meshopt: bool = False,
) -> list[Path]:
    """Write a moving mesh, or moving points, to ``path`` and, for some formats, to places beside it: all, or nothing.

    Args:
        animation: what to write.
        path: where to; its suffix chooses the format.
        format: a key of ``FORMATS`` that overrules the suffix.
        overwrite: replace what an earlier export left there.
        rig: bones that move the mesh in place of the frames themselves, ``fit_rig(animation.vertices)``.
        precise: float32 where the format's numbers would be quantised.
        meshopt: pack the arrays of a .glb by meshoptimizer.

    Returns:
        The places written, ``path`` first.

    Raises:
        InputError: an unknown suffix, a format without bones for a rig, or with nothing else and no rig, a place that
            is taken, or one that cannot be written.
        MissingPackageError: the format needs a package that is not installed.
    """
    path = Path(path)
    form = format_of(path, format, isinstance(animation, MovingPoints))
    texture = animation.texture if isinstance(animation, Animation) else None
    check_place(path, form, overwrite, texture)
    measured = isinstance(animation, Animation) and animation.measured is not None
    check_content(path, form, rig is not None, measured, meshopt)
    module, function = (form.writer if rig is None else form.rigged).split(":")
    write = getattr(importlib.import_module(f"warpdef.export.{module}"), function)
    extras: dict[str, Any] = {} if rig is None else {"rig": rig}
    extras |= {"precise": True} if precise and form.quantised and rig is None else {}
    extras |= {"meshopt": True} if meshopt else {}
    stage = sibling(path, "partial")
    try:
        stage.mkdir()
        write(animation, stage / path.name, **extras)
        places = form.places(path, texture)
        check_place(path, form, overwrite, texture)  # once more: the writing took its time
        for place in reversed(places):  # the file that people name comes last, when all else is there
            _move(stage / place.name, place)
        return places
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({reason(error)}); choose another place or free space") from None
    finally:
        shutil.rmtree(stage, ignore_errors=True)


def check_content(path: Path | str, form: ExportFormat, rigged: bool, measured: bool, meshopt: bool = False) -> None:
    """Check that a format can hold what it is to hold.

    Args:
        rigged: a mesh moved by bones; else one given frame by frame.
        measured: a number at every vertex.
        meshopt: packed by meshoptimizer.

    Raises:
        InputError: it cannot; the message lists the formats that can.
        MissingPackageError: meshopt is not installed.
    """
    if rigged and not form.rigged:
        known = " or ".join(f".{key}" for key, other in FORMATS.items() if other.rigged)
        raise InputError(f"{path}: expected {known} for a rig, got a format without bones; leave --bones out")
    if measured and not form.measured:
        known = " ".join(f".{key}" for key, other in FORMATS.items() if other.measured)
        raise InputError(f"{path}: expected one of {known} for a measure, got a format without; leave --color out")
    if meshopt and not form.packed:
        known = " or ".join(f".{key}" for key, other in FORMATS.items() if other.packed)
        raise InputError(f"{path}: expected {known} for --meshopt, got another format; leave it out")
    if meshopt:
        from warpdef.export.gltf_buffer import meshopt_encoder

        meshopt_encoder()
    if not rigged and not form.writer:
        raise InputError(f"{path}: expected a rig for a format of bones alone, got none; give --bones auto")


def _is_ours(base: Path) -> bool:
    if is_image_of_export(base.name):
        return True
    with open(base, "rb") as stream:
        return stream.read(len(OBJ_MARK)) == OBJ_MARK


def _is_of_folder(name: str) -> bool:
    return _NUMBERED.fullmatch(name) is not None or is_image_of_export(name)


def _check_free(place: Path, path: Path, is_folder: bool, overwrite: bool) -> None:
    if not os.path.lexists(place):
        return
    if not overwrite:
        raise InputError(f"{place}: already exists; choose another place, or replace it with --overwrite")
    if not is_folder and place.is_dir():
        raise InputError(f"{place}: expected a file to replace, got a folder; choose another place")
    if not is_folder and place != path and not _is_ours(place):
        raise InputError(f"{place}: --overwrite replaces only base meshes of earlier exports; choose another place")
    if is_folder:
        foreign = "" if place.is_dir() and not place.is_symlink() else place.name
        foreign = foreign or next((p.name for p in sorted(place.iterdir()) if not _is_of_folder(p.name)), "")
        if foreign:
            raise InputError(
                f"{place}: --overwrite replaces only folders of numbered meshes, but found '{foreign}'; "
                "choose another place"
            )


def _move(new: Path, place: Path) -> None:
    """Rename ``new`` to ``place``; an old folder goes only after the new one is in place."""
    if not place.is_dir():
        os.replace(new, place)
        return
    old = sibling(place, "old")
    os.rename(place, old)
    try:
        os.rename(new, place)
    except BaseException:
        os.rename(old, place)
        raise
    shutil.rmtree(old, ignore_errors=True)
