"""A moving mesh for ParaView: a .pvd list of times, and a folder of .vtp files beside it."""

from __future__ import annotations

from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from warpdef.errors import MissingPackageError
from warpdef.export.animation import Animation


def write_pvd(animation: Animation, path: Path) -> None:
    """Write ``path`` and ``<stem>_vtp/0000.vtp``, ...; times are seconds.

    A measure is an array called after it and its unit.

    Raises:
        MissingPackageError: PyVista cannot be imported.
    """
    try:
        import pyvista
    except ImportError as error:
        raise MissingPackageError(
            f".pvd needs pyvista, which failed to import ({error}); install it: pip install pyvista"
        ) from error
    folder = path.with_name(f"{path.stem}_vtp")
    folder.mkdir()
    mesh = pyvista.PolyData.from_regular_faces(animation.places[0].copy(), animation.faces)
    if animation.uv is not None:
        mesh.active_texture_coordinates = animation.uv
    lines = ['<?xml version="1.0"?>', '<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">']
    lines += ["  <Collection>"]
    for frame, positions in enumerate(animation.places):
        mesh.points = np.array(positions)
        if (colors := animation.colors_of(frame)) is not None:
            mesh.point_data["colors"] = colors
        mesh.point_data["Normals"] = animation.normals_of(frame)
        mesh.point_data.active_normals_name = "Normals"
        if animation.measured is not None:
            mesh.point_data[animation.measured.title] = animation.measured.values[frame]
            mesh.point_data.active_scalars_name = animation.measured.title
        mesh.save(folder / f"{frame:04d}.vtp", binary=True)
        file = quoteattr(f"{folder.name}/{frame:04d}.vtp")
        lines.append(f'    <DataSet timestep="{frame / animation.fps:.9g}" part="0" file={file}/>')
    lines += ["  </Collection>", "</VTKFile>", ""]
    path.write_text("\n".join(lines), encoding="utf-8")
