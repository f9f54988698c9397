"""The formats that hold one cloud or one mesh a file, by suffix: one table, and the way to read a file by it.

A new format is a file with a function ``read(path) -> Surface`` and a line in ``FORMATS``. Files that hold all frames
of a sequence have a table of their own, ``cloud_archives.CONTAINERS``.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from warpdef.errors import InputError
from warpdef.files.disk import reason
from warpdef.files.surface import Surface


@dataclass(frozen=True)
class InputFormat:
    """One format.

    reader:    ``module:function`` of this package, called with a path
    has_faces: it can hold a mesh, not points alone
    merges:    vertices at one place are made one, so that the file's own order is lost
    columns:   its columns may have no names: the reader is given their roles, where people say them, as well
    weak:      such files lie beside frames, too: in a folder they are frames only where no others are
    """

    reader: str
    has_faces: bool = False
    merges: bool = False
    columns: bool = False
    weak: bool = False


_TABLE = InputFormat("tables:read_table", columns=True)
_WEAK_TABLE = replace(_TABLE, weak=True)

FORMATS = {
    ".ply": InputFormat("ply:read_ply", has_faces=True),
    ".obj": InputFormat("text_formats:read_obj", has_faces=True),
    ".off": InputFormat("text_formats:read_off", has_faces=True),
    **dict.fromkeys((".xyz", ".pts", ".asc", ".xyzn", ".xyzrgb"), _TABLE),
    **dict.fromkeys((".txt", ".csv", ".tsv"), _WEAK_TABLE),
    ".npy": InputFormat("numpy_files:read_npy_points", columns=True),
    ".pcd": InputFormat("pcd:read_pcd"),
    ".las": InputFormat("las:read_las"),
    ".laz": InputFormat("las:read_las"),
    **dict.fromkeys((".stl", ".glb", ".gltf", ".3mf", ".dae"), InputFormat("scenes:read_scene", True, merges=True)),
    ".e57": InputFormat("e57:read_e57"),
    ".ptx": InputFormat("ptx:read_ptx"),
    ".npz": InputFormat("cloud_archives:read_npz_points", weak=True),
}
"""Formats of one frame by suffix."""

FRAME_SUFFIXES = tuple(FORMATS)
CLOUD_SUFFIXES = tuple(suffix for suffix in FORMATS if suffix != ".npz")
"""Those of files that never hold more than one frame."""
WEAK_SUFFIXES = tuple(suffix for suffix, form in FORMATS.items() if form.weak)
TEMPLATE_SUFFIXES = tuple(suffix for suffix, form in FORMATS.items() if form.has_faces)
MESH_SUFFIXES = tuple(suffix for suffix in TEMPLATE_SUFFIXES if not FORMATS[suffix].merges)
"""Meshes whose vertices keep their order, so that frames can share them."""


def read_surface(path: Path, suffixes: Sequence[str], columns: Sequence[str] = ()) -> Surface:
    """Contents of one file, by its suffix.

    Args:
        suffixes: those that are welcome.
        columns: roles of a table's columns, where people say them (``columns.parse_columns``).

    Raises:
        InputError: missing, an unknown suffix, or anything the format's reader complains about.
        MissingPackageError: the format needs a package that is not installed.
    """
    suffix = path.suffix.lower()
    if suffix not in suffixes:
        merges = suffix in FORMATS and FORMATS[suffix].merges
        why = " (its vertices have no order of their own)" if merges else ""
        raise InputError(
            f"{path}: unknown suffix '{suffix}'{why}; expected one of {' '.join(suffixes)}; convert the file"
        )
    if columns and not FORMATS[suffix].columns:
        tables = " ".join(s for s, form in FORMATS.items() if form.columns)
        raise InputError(f"{path}: --columns is for tables without names ({tables}); leave it out")
    module, function = FORMATS[suffix].reader.split(":")
    read = getattr(importlib.import_module(f"warpdef.files.{module}"), function)
    try:
        return read(path, columns) if columns else read(path)
    except InputError:
        raise
    except (ValueError, OverflowError, MemoryError) as error:
        raise InputError(
            f"{path}: cannot be read as {suffix} ({reason(error):.120}); it is damaged: write it again"
        ) from None
