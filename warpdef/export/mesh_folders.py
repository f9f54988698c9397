"""A moving mesh as a folder of numbered files: 0000.ply, ... or 0000.obj, ..."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from warpdef.export.animation import Animation
from warpdef.export.image import LIBRARY, MATERIAL, image_name, write_library

OBJ_MARK = b"# warpdef\n"
"""First line of every OBJ of ours."""


def write_ply_folder(animation: Animation, folder: Path) -> None:
    """Make ``folder`` with a binary PLY a frame; colours are ``red green blue alpha``, texture coordinates ``s t``.

    Normals are in every file: programs shade a PLY with them smoothly, and one without them in facets. Positions are
    ``double`` where ``float`` would lose the shape, far from the origin. A texture's image lies in the folder, named by
    a ``comment TextureFile``. A measure is a property called after it; a comment says what it is and in which unit.
    """
    faces = np.empty(len(animation.faces), dtype=[("length", "u1"), ("indices", "<i4", (3,))])
    faces["length"], faces["indices"] = 3, animation.faces
    texture = animation.texture
    comments = () if texture is None else (f"TextureFile {image_name(texture)}",)
    numbers = {}
    if animation.measured is not None:
        numbers = {animation.measured.name: animation.measured.values}
        comments += (f"{animation.measured.name}: {animation.measured.what}",)
    normals = animation.all_normals()
    colors = animation.colors if animation.frame_colors is None else animation.frame_colors
    write_ply_frames(folder, animation.places, normals, colors, animation.uv, faces, comments, numbers)
    if texture is not None:
        (folder / image_name(texture)).write_bytes(texture.data)


def write_ply_frames(
    folder: Path,
    points: np.ndarray,
    normals: np.ndarray | None,
    colors: np.ndarray | None,
    uv: np.ndarray | None = None,
    faces: np.ndarray | None = None,
    comments: tuple[str, ...] = (),
    numbers: Mapping[str, np.ndarray] | None = None,
) -> None:
    """Make ``folder`` with a binary PLY for each of T frames.

    Args:
        points: shape (T, N, 3), float32 or float64, and so in the file. normals: shape (T, N, 3).
        colors: shape (N, 3) or (N, 4) uint8, or of every frame, (T, N, 3). uv: shape (N, 2).
        faces: rows of the face element as they stand in the file. comments: lines of the header.
        numbers: further properties by name, each (T, N).
    """
    folder.mkdir()
    fields = [(axis, "<f8" if points.dtype == np.float64 else "<f4") for axis in "xyz"]
    fields += [] if normals is None else [(f"n{axis}", "<f4") for axis in "xyz"]
    shades = () if colors is None else ("red", "green", "blue", "alpha")[: colors.shape[-1]]
    fields += [(name, "u1") for name in shades]
    fields += [] if uv is None else [("s", "<f4"), ("t", "<f4")]
    fields += [(name, "<f4") for name in numbers or ()]
    rows = np.zeros(points.shape[1], dtype=fields)
    if uv is not None:
        rows["s"], rows["t"] = uv.T
    words = {"<f4": "float", "<f8": "double", "u1": "uchar"}
    header = ["ply", "format binary_little_endian 1.0", "comment warpdef", *(f"comment {line}" for line in comments)]
    header.append(f"element vertex {len(rows)}")
    header += [f"property {words[kind]} {name}" for name, kind in fields]
    if faces is not None:
        header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    header += ["end_header", ""]
    for frame, positions in enumerate(points):
        rows["x"], rows["y"], rows["z"] = positions.T
        if normals is not None:
            rows["nx"], rows["ny"], rows["nz"] = normals[frame].T
        if colors is not None and (frame == 0 or colors.ndim == 3):
            own = colors[frame] if colors.ndim == 3 else colors
            for column, name in enumerate(shades):
                rows[name] = own[:, column]
        for name, values in (numbers or {}).items():
            rows[name] = values[frame]
        end = b"" if faces is None else faces.tobytes()
        (folder / f"{frame:04d}.ply").write_bytes("\n".join(header).encode() + rows.tobytes() + end)


def write_obj_folder(animation: Animation, folder: Path) -> None:
    """Make ``folder`` with an OBJ a frame, as ``obj_text`` has it, and the image and material file of a texture."""
    folder.mkdir()
    for frame in range(len(animation)):
        (folder / f"{frame:04d}.obj").write_bytes(obj_text(animation, frame))
    if animation.texture is not None:
        write_library(animation.texture, folder)


def obj_text(animation: Animation, frame: int, local: bool = False) -> bytes:
    """One frame as OBJ: nine digits, which hold a float32 exactly, or all of a float64's far from the origin; colours
    follow the position; ``vt`` for ``uv``, ``vn`` for normals, ``s 1`` for smooth shading. Vertices are the mesh's own:
    along seams of a texture only its places are doubled.

    Args:
        local: for a mesh alone that another file will move: positions count from the animation's origin, which a
            comment names, no material is, and normals only where they are given, as those of the faces move with them.
    """
    # One format string for the whole table: many times faster than a line at a time.
    shown = animation.joined
    positions = shown.vertices[frame]
    columns = [positions if local or not animation.is_far else positions + animation.origin]
    line = "v %.9g %.9g %.9g" if columns[0].dtype == np.float32 else "v %.17g %.17g %.17g"
    if (colors := shown.colors_of(frame)) is not None:
        columns.append(colors[:, :3] / 255.0)
        line += " %.6g %.6g %.6g"
    table = np.column_stack([np.asarray(column, dtype=np.float64) for column in columns])
    mark = OBJ_MARK.decode()
    if local and animation.is_far:
        mark += "# origin {:.17g} {:.17g} {:.17g}\n".format(*animation.origin)
    if animation.texture is not None and not local:
        mark += f"mtllib {LIBRARY}\nusemtl {MATERIAL}\n"
    text = mark + f"{line}\n" * len(table) % tuple(table.ravel().tolist())
    corner, given = "%d", [shown.faces]
    has_normals = animation.normals is not None or not local
    if has_normals:
        # Seven digits: normals are directions of unit length.
        text += "vn %.7g %.7g %.7g\n" * len(table) % tuple(shown.normals_of(frame).astype(float).ravel().tolist())
        corner, given = "%d//%d", [shown.faces, shown.faces]
    if animation.uv is not None:
        uv = animation.uv.astype(np.float64)
        text += "vt %.9g %.9g\n" * len(uv) % tuple(uv.ravel().tolist())
        corner, given = "%d/%d/%d" if has_normals else "%d/%d", [shown.faces, animation.faces, *given[1:]]
    indices = np.stack(given, axis=2).reshape(len(shown.faces), -1) + 1
    text += "s 1\n" + f"f {corner} {corner} {corner}\n" * len(indices) % tuple(indices.ravel().tolist())
    return text.encode("ascii")
