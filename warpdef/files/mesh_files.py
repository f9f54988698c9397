"""Meshes in: one, a list of them, and one that moves. Vertex order is the file's; nothing is merged or cleaned."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from warpdef.appearance import Appearance
from warpdef.errors import InputError
from warpdef.files.disk import must_exist
from warpdef.files.formats import CLOUD_SUFFIXES, MESH_SUFFIXES, TEMPLATE_SUFFIXES, read_surface
from warpdef.files.frame_files import frame_files, select_frames
from warpdef.files.numpy_files import Npz
from warpdef.files.surface import Surface
from warpdef.files.texture import read_texture
from warpdef.mesh import MeshSequence, TriMesh


def read_mesh(path: Path | str, image: bool = True) -> TriMesh:
    """Read one mesh; of .ply, .obj and .off vertex order is kept exactly, polygons are cut into fans.

    Its colours and its texture, where it has any, are its ``appearance``.

    Args:
        path: the file.
        image: read the texture's image, too, as ``read_texture`` does.

    Raises:
        InputError: missing, unknown suffix, damaged, without faces, or with NaN.
    """
    path = Path(path)
    must_exist(path)
    if path.is_dir():
        raise InputError(f"{path}: expected one mesh file, got a folder; give one of its files")
    surface = read_surface(path, TEMPLATE_SUFFIXES)
    if surface.faces is None or len(surface.faces) == 0:
        raise InputError(
            f"{path}: a mesh without faces; expected at least one triangle, got only points; give a surface mesh"
        )
    mesh = _checked(TriMesh, surface.points, surface.faces, path)
    return replace(mesh, appearance=_appearance(surface, path, image))


def read_geometry(path: Path | str) -> Surface:
    """Read one mesh or one set of points, of any suffix a cloud may have, with everything that it carries.

    Vertex order is the file's, nothing is merged; normals are made unit length, and left out where one is 0.

    Raises:
        InputError: missing, a folder, unknown suffix, damaged, without points, or with NaN.
    """
    path = Path(path)
    must_exist(path)
    if path.is_dir():
        raise InputError(f"{path}: expected one file of a mesh or of points, got a folder; give one of its files")
    surface = read_surface(path, CLOUD_SUFFIXES)
    if not len(surface.points) or not np.isfinite(surface.points).all():
        raise InputError(f"{path}: expected points with finite coordinates, got none, or NaN or infinity among them")
    faces = surface.faces if surface.faces is not None and len(surface.faces) else None
    if faces is not None:
        faces = _checked(TriMesh, surface.points, faces, path).faces
    normals = surface.normals
    if normals is not None:
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = normals / length if np.isfinite(normals).all() and (length > 0).all() else None
    look = _appearance(surface, path, image=True) or Appearance()
    surface = replace(surface, normals=normals, faces=faces, texture=look.texture, notes=look.notes)
    return replace(surface, colors=look.colors, uv=look.uv, corner_uv=look.corner_uv)


def _appearance(surface: Surface, path: Path, image: bool) -> Appearance | None:
    counts = len(surface.points), 0 if surface.faces is None else len(surface.faces)
    try:
        found = Appearance.checked(*counts, surface.colors, surface.uv, surface.corner_uv)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    found = replace(found, notes=surface.notes)
    if image and counts[1] and (found.uv is not None or found.corner_uv is not None):
        texture, notes = read_texture(path, surface.named)
        found = replace(found, texture=texture, notes=notes)
    return found if found.arrays() or found.notes else None


def read_mesh_sequence(path: Path | str, frames: slice | None = None) -> MeshSequence:
    """Read meshes that share their triangles: one mesh that moves.

    Args:
        path: an .npz with ``vertices`` (T, V, 3) and ``faces`` (F, 3), a folder of numbered meshes, or a run folder.
        frames: frames to use; files outside it are not opened.

    Raises:
        InputError: as ``read_mesh_frames``, or frames whose triangles differ.
    """
    path = Path(path)
    archive = _archive(path)
    if archive is not None:
        return _read_npz(archive, frames)
    meshes, files = _read_folder(path, frames)
    sequence = same_triangles(meshes)
    if sequence is None:
        odd = next(i for i, mesh in enumerate(meshes) if same_triangles([meshes[0], mesh]) is None)
        raise InputError(
            f"{files[odd]}: expected the triangles of {files[0].name} ({_size(meshes[0])}), got others "
            f"({_size(meshes[odd])}); give meshes with the same vertices and faces in every frame"
        )
    return sequence


def read_mesh_frames(path: Path | str, frames: slice | None = None) -> list[TriMesh]:
    """Read a sequence of meshes whose triangles may differ from frame to frame; arguments as ``read_mesh_sequence``.

    Raises:
        InputError: nothing there, no frame left, or a file that ``read_mesh`` rejects.
    """
    path = Path(path)
    archive = _archive(path)
    if archive is not None:
        sequence = _read_npz(archive, frames)
        return [sequence[t] for t in range(len(sequence))]
    return _read_folder(path, frames)[0]


def same_triangles(meshes: Sequence[TriMesh]) -> MeshSequence | None:
    """The meshes as one that moves, or None where vertex counts or triangles differ."""
    first = meshes[0]
    for mesh in meshes[1:]:
        if mesh.vertices.shape != first.vertices.shape or not np.array_equal(mesh.faces, first.faces):
            return None
    return MeshSequence(np.stack([mesh.vertices for mesh in meshes]), first.faces)


def _archive(path: Path) -> Path | None:
    """The .npz behind ``path``, or None for a folder of mesh files."""
    must_exist(path)
    if path.is_dir():
        return path / "sequence.npz" if (path / "sequence.npz").is_file() else None
    if path.suffix.lower() == ".npz":
        return path
    known = " ".join(MESH_SUFFIXES)
    hint = "got one mesh" if path.suffix.lower() in MESH_SUFFIXES else f"got the unknown suffix '{path.suffix}'"
    raise InputError(f"{path}: expected an .npz, a run folder or a folder of numbered meshes ({known}), {hint}")


def _read_folder(path: Path, frames: slice | None) -> tuple[list[TriMesh], list[Path]]:
    files = select_frames(frame_files(path, MESH_SUFFIXES), frames, 1, path)
    return [read_mesh(file, image=False) for file in files], files


def _read_npz(path: Path, frames: slice | None) -> MeshSequence:
    npz = Npz(path)
    for name in ("vertices", "faces"):
        if name not in npz:
            clouds = "; it holds point clouds, not meshes" if any(n.startswith("points") for n in npz.names) else ""
            raise InputError(f"{path}: expected an array '{name}', got {', '.join(npz.names) or 'no arrays'}{clouds}")
    shape, _ = npz.header("vertices")
    if len(shape) != 3 or shape[2] != 3:
        raise InputError(
            f"{path}: vertices: expected shape (T, V, 3), got {shape}; stack the frames along the first axis"
        )
    chosen = select_frames(range(shape[0]), frames, 1, path)
    return _checked(MeshSequence, npz.array("vertices")[chosen], npz.array("faces"), path)


def _checked(kind: type, vertices: np.ndarray, faces: np.ndarray, path: Path):
    try:
        return kind(vertices, faces)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _size(mesh: TriMesh) -> str:
    return f"{len(mesh.vertices)} vertices, {len(mesh.faces)} faces"
