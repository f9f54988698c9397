"""One true sequence of a set: where it lies, how large it is, and its meshes when asked for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from warpdef.mesh import MeshSequence

KINDS = {
    "npz": "an .npz with vertices (T, V, 3) and faces (F, 3)",
    "dynosurf": "a folder with gt/, and clouds beside it (the layout of DynoSurf's sets)",
    "meshes": "a folder of numbered meshes",
    "anime": "an .anime file of DeformingThings4D",
    "hdf5": "a sequence in an HDF5 file of registrations (DFAUST)",
}


@dataclass(frozen=True)
class TrueSequence:
    """A moving mesh on disk whose triangles are the same in all frames; nothing but its size has been read yet.

    name:     unlike that of any other sequence of the folder searched; fit for a file name
    path:     what to give to ``read_truth``: a file, a folder, or, inside an HDF5 file, that file's path and the
              sequence's name as one path more
    kind:     a key of ``KINDS``
    frames:   number of frames T
    vertices: number of vertices V, in a folder of meshes those of the first frame
    faces:    number of triangles F, likewise
    clouds:   clouds that come with it, for ``read_clouds``, or None
    """

    name: str
    path: Path
    kind: str
    frames: int
    vertices: int
    faces: int
    clouds: Path | None = None

    def load(self, frames: slice | None = None) -> MeshSequence:
        """Read the meshes, or those of the frames asked for.

        Raises:
            InputError: damaged, no frame left, or triangles that differ between frames.
            MissingPackageError: a library for the format is not there.
        """
        from warpdef.datasets.truth import read_moving_mesh

        return read_moving_mesh(self.path, frames)
