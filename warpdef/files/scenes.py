"""Meshes of other programs through trimesh: .stl .glb .gltf .3mf .dae, their parts put together, in the scene's place.

These formats keep no shared vertices, or split them where an image has a seam: vertices at one place are merged, so
that the surface hangs together. Shape and colours are taken, those of an image at the places of the vertices. 3MF
and Collada need the extra ``warpdef[meshes]``.
"""

from __future__ import annotations

import re
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from warpdef.errors import InputError, MissingPackageError
from warpdef.files.disk import Unpacking, read_bytes, reason
from warpdef.files.surface import Surface

_TIMES = 60  # XML packs that much


def read_scene(path: Path) -> Surface:
    """Vertices and faces of all parts of a file, or its points where it has no faces.

    Raises:
        InputError: damaged, or without geometry.
        MissingPackageError: the format needs a package that is not installed.
    """
    data = read_bytes(path)
    _check_size(data, path)
    try:
        import trimesh

        # A library that reads anything raises anything.
        scene = trimesh.load_scene(path, process=False)
        parts: list[Any] = scene.dump()  # meshes, clouds and paths
    except (ImportError, ModuleNotFoundError) as error:
        raise _missing(path, error) from error
    except Exception as error:
        if "lxml" in str(error) or "collada" in str(error) or "networkx" in str(error):
            raise _missing(path, error) from error
        raise InputError(
            f"{path}: cannot be read as {path.suffix.lower()} ({reason(error):.120}); it is damaged: write it again"
        ) from None
    meshes = [part for part in parts if getattr(part, "faces", None) is not None and len(part.faces)]
    if meshes:
        counts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
        vertices = np.concatenate([np.asarray(mesh.vertices, dtype=np.float64) for mesh in meshes])
        faces = np.concatenate([np.asarray(mesh.faces) + start for mesh, start in zip(meshes, counts, strict=False)])
        if faces.min() < 0 or faces.max() >= len(vertices):
            raise InputError(f"{path}: a face names a vertex that is not there; the file is damaged")
        merged, kept, faces = _merged(vertices, faces.astype(np.int64))
        colors = _colors(meshes)
        return Surface(merged, None, faces, None if colors is None else colors[kept])
    parts = [part for part in parts if len(getattr(part, "vertices", ()))]
    clouds = [np.asarray(part.vertices, dtype=np.float64).reshape(-1, 3) for part in parts]
    if not clouds:
        raise InputError(f"{path}: expected a mesh or points, got neither; export the surface")
    return Surface(np.concatenate(clouds), colors=_colors(parts))


def _kind(part: Any) -> str:
    return str(getattr(getattr(part, "visual", None), "kind", None) or "")


def _colors(parts: list[Any]) -> np.ndarray | None:
    """Colours of the vertices of all parts, (N, 3) uint8, where all of them have some."""
    found = [_colors_of(part) for part in parts]
    if not all(c is not None and np.shape(c) == (len(part.vertices), 4) for c, part in zip(found, parts, strict=True)):
        return None
    return np.concatenate([np.asarray(c, dtype=np.uint8)[:, :3] for c in found])


def _colors_of(part: Any) -> Any:
    """Colours of one part's vertices: its own, or its image's at their places; else None."""
    if _kind(part) == "vertex":
        return part.visual.vertex_colors
    if _kind(part) != "texture":
        return getattr(part, "colors", None)
    material = part.visual.material
    image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    if image is None or part.visual.uv is None:
        return None
    try:
        return part.visual.to_color().vertex_colors
    except Exception:  # of the library that decodes images: a mesh without its image is still a mesh
        return None


def _merged(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices at one place made one, which of them were kept, in their order, and faces without those that vanish."""
    _, first, index = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    faces = place[index.reshape(-1)][faces]
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return vertices[first[order]], first[order], faces[whole]


def _check_size(data: bytes, path: Path) -> None:
    """Nothing is unpacked or allocated that the file's size does not cover."""
    suffix = path.suffix.lower()
    if suffix == ".3mf":
        unpacking = Unpacking(path, "write it as .ply", times=_TIMES)
        try:
            with zipfile.ZipFile(path) as archive:
                unpacking.take(sum(member.file_size for member in archive.infolist()))
        except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as error:
            raise InputError(f"{path}: cannot be read as .3mf ({reason(error):.120}); write it again") from None
    elif suffix == ".dae" and b"<!ENTITY" in data:
        raise InputError(f"{path}: expected Collada without entities of its own; write it again")
    elif suffix in (".glb", ".gltf"):
        beside = sum(p.stat().st_size for p in path.parent.glob("*.bin")) if suffix == ".gltf" else 0
        counts = [int(n) for n in re.findall(rb'"(?:count|byteLength)"\s*:\s*([0-9]+)', data)]
        if max(counts, default=0) > len(data) + beside:
            raise InputError(f"{path}: declares more data than there are; it is truncated: write it again")


def _missing(path: Path, error: BaseException) -> MissingPackageError:
    return MissingPackageError(
        f"{path}: {path.suffix.lower()} needs another package ({reason(error):.80}); install it: "
        "pip install 'warpdef[meshes]', or convert the file to .ply"
    )
