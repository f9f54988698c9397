"""A moving mesh as a folder of numbered files: 0000.ply, ... or 0000.obj, ..."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from warpdef.export.animation import Animation

OBJ_MARK = b"# warpdef\n"
"""First line of every OBJ of ours."""


def write_ply_folder(animation: Animation, folder: Path) -> None:
    """Make ``folder`` with a binary PLY a frame; colours are ``red green blue alpha``, texture coordinates ``s t``."""
    folder.mkdir()
    fields = [(axis, "<f4") for axis in "xyz"]
    colors = () if animation.colors is None else ("red", "green", "blue", "alpha")[: animation.colors.shape[1]]
    fields += [(name, "u1") for name in colors]
    fields += [] if animation.uv is None else [("s", "<f4"), ("t", "<f4")]
    rows = np.zeros(animation.vertices.shape[1], dtype=fields)
    for column, name in enumerate(colors):
        rows[name] = animation.colors[:, column]
    if animation.uv is not None:
        rows["s"], rows["t"] = animation.uv.T
    faces = np.empty(len(animation.faces), dtype=[("length", "u1"), ("indices", "<i4", (3,))])
    faces["length"], faces["indices"] = 3, animation.faces
    words = {"<f4": "float", "u1": "uchar"}
    header = ["ply", "format binary_little_endian 1.0", "comment warpdef", f"element vertex {len(rows)}"]
    header += [f"property {words[kind]} {name}" for name, kind in fields]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    for frame, positions in enumerate(animation.vertices):
        rows["x"], rows["y"], rows["z"] = positions.T
        (folder / f"{frame:04d}.ply").write_bytes("\n".join(header).encode() + rows.tobytes() + faces.tobytes())


def write_obj_folder(animation: Animation, folder: Path) -> None:
    """Make ``folder`` with an OBJ a frame, as ``obj_text`` has it."""
    folder.mkdir()
    for frame in range(len(animation)):
        (folder / f"{frame:04d}.obj").write_bytes(obj_text(animation, frame))


def obj_text(animation: Animation, frame: int) -> bytes:
    """One frame as OBJ: nine digits, which hold a float32 exactly; colours follow the position; ``vt`` for ``uv``."""
    # One format string for the whole table: many times faster than a line at a time.
    columns = [animation.vertices[frame]]
    line = "v %.9g %.9g %.9g"
    if animation.colors is not None:
        columns.append(animation.colors[:, :3] / 255.0)
        line += " %.6g %.6g %.6g"
    table = np.column_stack([np.asarray(column, dtype=np.float64) for column in columns])
    text = OBJ_MARK.decode() + f"{line}\n" * len(table) % tuple(table.ravel().tolist())
    corner = "%d"
    indices = animation.faces + 1
    if animation.uv is not None:
        text += "vt %.9g %.9g\n" * len(table) % tuple(animation.uv.astype(np.float64).ravel().tolist())
        corner, indices = "%d/%d", np.repeat(indices, 2, axis=1)
    text += f"f {corner} {corner} {corner}\n" * len(indices) % tuple(indices.ravel().tolist())
    return text.encode("ascii")
