"""A moving mesh as a folder of numbered files: 0000.ply, ... or 0000.obj, ..."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from warpdef.export.animation import Animation

OBJ_MARK = b"# warpdef\n"
"""First line of every OBJ of ours."""


def write_ply_folder(animation: Animation, folder: Path) -> None:
    """Make ``folder`` with a binary PLY a frame; colours are ``red green blue alpha``, texture coordinates ``s t``."""
    faces = np.empty(len(animation.faces), dtype=[("length", "u1"), ("indices", "<i4", (3,))])
    faces["length"], faces["indices"] = 3, animation.faces
    write_ply_frames(folder, animation.vertices, animation.normals, animation.colors, animation.uv, faces)


def write_ply_frames(
    folder: Path,
    points: np.ndarray,
    normals: np.ndarray | None,
    colors: np.ndarray | None,
    uv: np.ndarray | None = None,
    faces: np.ndarray | None = None,
) -> None:
    """Make ``folder`` with a binary PLY for each of T frames.

    Args:
        points, normals: shape (T, N, 3). colors: shape (N, 3) or (N, 4) uint8. uv: shape (N, 2).
        faces: rows of the face element as they stand in the file.
    """
    folder.mkdir()
    fields = [(axis, "<f4") for axis in "xyz"]
    fields += [] if normals is None else [(f"n{axis}", "<f4") for axis in "xyz"]
    shades = () if colors is None else ("red", "green", "blue", "alpha")[: colors.shape[1]]
    fields += [(name, "u1") for name in shades]
    fields += [] if uv is None else [("s", "<f4"), ("t", "<f4")]
    rows = np.zeros(points.shape[1], dtype=fields)
    for column, name in enumerate(shades):
        rows[name] = colors[:, column]
    if uv is not None:
        rows["s"], rows["t"] = uv.T
    words = {"<f4": "float", "u1": "uchar"}
    header = ["ply", "format binary_little_endian 1.0", "comment warpdef", f"element vertex {len(rows)}"]
    header += [f"property {words[kind]} {name}" for name, kind in fields]
    if faces is not None:
        header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    header += ["end_header", ""]
    for frame, positions in enumerate(points):
        rows["x"], rows["y"], rows["z"] = positions.T
        if normals is not None:
            rows["nx"], rows["ny"], rows["nz"] = normals[frame].T
        end = b"" if faces is None else faces.tobytes()
        (folder / f"{frame:04d}.ply").write_bytes("\n".join(header).encode() + rows.tobytes() + end)


def write_obj_folder(animation: Animation, folder: Path) -> None:
    """Make ``folder`` with an OBJ a frame, as ``obj_text`` has it."""
    folder.mkdir()
    for frame in range(len(animation)):
        (folder / f"{frame:04d}.obj").write_bytes(obj_text(animation, frame))


def obj_text(animation: Animation, frame: int) -> bytes:
    """One frame as OBJ: nine digits, which hold a float32 exactly; colours follow the position; ``vt`` for ``uv``,
    ``vn`` for normals given."""
    # One format string for the whole table: many times faster than a line at a time.
    columns = [animation.vertices[frame]]
    line = "v %.9g %.9g %.9g"
    if animation.colors is not None:
        columns.append(animation.colors[:, :3] / 255.0)
        line += " %.6g %.6g %.6g"
    table = np.column_stack([np.asarray(column, dtype=np.float64) for column in columns])
    text = OBJ_MARK.decode() + f"{line}\n" * len(table) % tuple(table.ravel().tolist())
    corner, given = "%d", 1
    if animation.normals is not None:
        text += "vn %.9g %.9g %.9g\n" * len(table) % tuple(animation.normals[frame].astype(float).ravel().tolist())
        corner, given = "%d//%d", 2
    if animation.uv is not None:
        text += "vt %.9g %.9g\n" * len(table) % tuple(animation.uv.astype(np.float64).ravel().tolist())
        corner, given = ("%d/%d", 2) if animation.normals is None else ("%d/%d/%d", 3)
    indices = np.repeat(animation.faces + 1, given, axis=1)
    text += f"f {corner} {corner} {corner}\n" * len(indices) % tuple(indices.ravel().tolist())
    return text.encode("ascii")
