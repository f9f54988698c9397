"""A moving mesh as a folder of numbered files for slicers and their kin: .stl or .3mf, by trimesh."""

from __future__ import annotations

import importlib
from pathlib import Path

import numpy as np

from warpdef.errors import MissingPackageError
from warpdef.export.animation import Animation


def write_stl_folder(animation: Animation, folder: Path) -> None:
    """Make ``folder`` with a binary STL a frame: triangles alone, each with its three corners, in the data's unit.

    Positions count from the animation's origin: the format holds float32.
    """
    import trimesh
    from trimesh.exchange.stl import export_stl

    folder.mkdir()
    animation = animation.joined
    for frame, positions in enumerate(animation.vertices):
        mesh = trimesh.Trimesh(positions, animation.faces, process=False)
        (folder / f"{frame:04d}.stl").write_bytes(export_stl(mesh))


def write_3mf_folder(animation: Animation, folder: Path) -> None:
    """Make ``folder`` with a 3MF a frame: vertices in their order, and triangles.

    Lengths are millimetres, as the format wants them, and positions count from the animation's origin.

    Raises:
        MissingPackageError: lxml or networkx, by which trimesh writes the format, cannot be imported.
    """
    import trimesh

    for name in ("lxml", "networkx"):
        try:
            importlib.import_module(name)
        except ImportError as error:
            raise MissingPackageError(f".3mf needs {name} ({error}); install it: pip install {name}") from error
    folder.mkdir()
    animation = animation.joined
    for frame, positions in enumerate(animation.vertices):
        places = positions.astype(np.float64) * (1000.0 * animation.metres_per_unit)
        mesh = trimesh.Trimesh(places, animation.faces, process=False)
        packed = mesh.export(file_type="3mf")
        assert isinstance(packed, bytes)  # as of every format in a zip file
        (folder / f"{frame:04d}.3mf").write_bytes(packed)
