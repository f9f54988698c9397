"""Any true mesh sequence by its path, whatever its format."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from warpdef.datasets.mesh_folders import mesh_folder

if TYPE_CHECKING:
    from warpdef.mesh import MeshSequence, TriMesh


def read_moving_mesh(path: Path | str, frames: slice | None = None) -> MeshSequence:
    """A sequence whose triangles are the same in all frames.

    Args:
        path: an .npz, an .anime file, an HDF5 file of registrations with a sequence's name behind it, a folder of
            numbered meshes, a folder with ``gt/``, or the folder of a run.
        frames: frames to use; others are not read where the format allows it.

    Raises:
        InputError: damaged, unknown, no frame left, or triangles that differ between frames.
        MissingPackageError: a library for the format is not there.
    """
    from warpdef.files import read_mesh_sequence

    found = _one_file(Path(path), frames)
    return read_mesh_sequence(mesh_folder(Path(path)), frames) if found is None else found


def read_truth(path: Path | str, frames: slice | None = None) -> MeshSequence | list[TriMesh]:
    """As ``read_moving_mesh``, but meshes in a folder may differ from frame to frame."""
    from warpdef.files import read_mesh_frames

    found = _one_file(Path(path), frames)
    return read_mesh_frames(mesh_folder(Path(path)), frames) if found is None else found


def _one_file(path: Path, frames: slice | None) -> MeshSequence | None:
    from warpdef.datasets.anime import read_anime
    from warpdef.datasets.registrations import read_registration, split_path

    if path.suffix.lower() == ".anime" and not path.is_dir():
        return read_anime(path, frames)
    registration = split_path(path)
    if registration is not None and not registration[0].is_dir():
        return read_registration(*registration, frames)
    return None
