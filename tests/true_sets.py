"""True sets written byte by byte, as their authors distribute them; none of it by the project's own writers."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
"""A tetrahedron, outward."""


def moving(frames: int = 4, shift: float = 0.0) -> np.ndarray:
    """(T, 4, 3) float32, every frame elsewhere; its numbers are exact in six decimals."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=np.float32)
    return corners * (1 + np.arange(frames, dtype=np.float32)[:, None, None] / 8) + np.float32(shift)


def write_anime(path: Path, vertices: np.ndarray, faces: np.ndarray = FACES) -> bytes:
    """An .anime file as DeformingThings4D's own reader takes it apart."""
    data = struct.pack("<3i", len(vertices), vertices.shape[1], len(faces))
    data += vertices[0].astype("<f4").tobytes() + faces.astype("<i4").tobytes()
    data += (vertices[1:] - vertices[0]).astype("<f4").tobytes()
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    return data


def write_obj(path: Path, vertices: np.ndarray, faces: np.ndarray = FACES) -> None:
    """An .obj of ``v`` and ``f`` lines, counted from 1."""
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = ["v {:.6f} {:.6f} {:.6f}".format(*v) for v in vertices] + ["f {} {} {}".format(*(f + 1)) for f in faces]
    path.write_text("\n".join(lines) + "\n")


def write_objs(folder: Path, vertices: np.ndarray, name: str = "{:04d}.obj", faces: np.ndarray = FACES) -> None:
    """One .obj a frame."""
    for frame, positions in enumerate(vertices):
        write_obj(folder / name.format(frame), positions, faces)


def write_dynosurf(folder: Path, vertices: np.ndarray, clouds: str = "point_clouds") -> None:
    """``gt/0000.obj``, the dense ``pcl_seqs/0000.npy`` with normals, and a text cloud a frame in ``clouds``."""
    write_objs(folder / "gt", vertices)
    for frame, positions in enumerate(vertices):
        for name in {"pcl_seqs", clouds}:
            (folder / name).mkdir(exist_ok=True)
        points = np.repeat(positions, 5, axis=0) + np.arange(20)[:, None] / 64
        np.save(folder / "pcl_seqs" / f"{frame:04d}.npy", np.hstack([points, np.eye(3)[np.zeros(20, int)]]))
        if clouds != "pcl_seqs":
            ply = f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n"
            ply += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
            ply += "\n".join("{} {} {}".format(*p) for p in points) + "\n"
            (folder / clouds / f"{frame:04d}.ply").write_text(ply)


def write_registrations(path: Path, sequences: dict[str, np.ndarray], faces: np.ndarray = FACES, **options) -> None:
    """An HDF5 file as DFAUST's: ``faces`` (F, 3) uint32 and (V, 3, T) by ``SUBJECT_SEQUENCE``."""
    import h5py

    path.parent.mkdir(parents=True, exist_ok=True)
    with h5py.File(path, "w") as file:
        file["faces"] = faces.astype(np.uint32)
        for name, vertices in sequences.items():
            file.create_dataset(name, data=vertices.transpose(1, 2, 0), **options)
