"""What is in a true sequence: its surface, whether that stays the same over the frames, and what is odd about it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from warpdef.datasets.mesh_folders import SHOWN, mesh_folder, name_problems
from warpdef.datasets.sequences import TrueSequence
from warpdef.files.formats import MESH_SUFFIXES
from warpdef.files.frame_files import find_frames, frame_files
from warpdef.geometry import triangles
from warpdef.mesh import TriMesh


@dataclass(frozen=True)
class SequenceReport:
    """What ``check_sequence`` found out; surface and counts are those of the first frame.

    same_triangles: all frames have the vertices and faces of the first
    watertight:     each edge in exactly two faces, turned opposite ways
    boundary_edges: edges of one face only: 0 where the surface is closed
    crowded_edges:  edges of more than two faces
    components:     pieces that share no vertex
    unused:         vertices of no face
    problems:       one clause each
    """

    name: str
    path: str
    kind: str
    frames: int
    vertices: int
    faces: int
    clouds: str | None
    same_triangles: bool
    watertight: bool
    boundary_edges: int
    crowded_edges: int
    components: int
    unused: int
    problems: tuple[str, ...]

    @property
    def surface(self) -> str:
        """The surface in a few words."""
        if self.watertight:
            return "watertight"
        words = [f"{self.boundary_edges} boundary edges"] if self.boundary_edges else []
        words += [f"{self.crowded_edges} edges of 3 or more faces"] if self.crowded_edges else []
        return "open: " + ", ".join(words) if words else "closed, faces turned both ways"

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {**asdict(self), "problems": list(self.problems)}


def check_sequence(sequence: TrueSequence) -> SequenceReport:
    """Read all of a sequence and describe it. A folder of meshes is read one file at a time.

    Raises:
        InputError: a frame that cannot be read. MissingPackageError: a library for the format is not there.
    """
    problems: list[str] = []
    meshes = mesh_folder(sequence.path)
    if sequence.kind in ("meshes", "dynosurf"):
        found = find_frames(meshes, MESH_SUFFIXES)
        problems += name_problems([file.name for file in found.files]) + found.notes
    frames = _frames(sequence)
    first = next(frames)
    other, flat, still = [], [], []
    before = first
    for number, mesh in enumerate(frames, start=1):
        if mesh.vertices.shape != first.vertices.shape or not np.array_equal(mesh.faces, first.faces):
            other.append(number)
        elif mesh.vertices.shape == before.vertices.shape and np.array_equal(mesh.vertices, before.vertices):
            still.append(number)
        if not triangles.face_areas(mesh.vertices, mesh.faces).sum() > 0:
            flat.append(number)
        before = mesh
    if other:
        problems.append(f"other vertices or faces than the first frame in {_list(other)}")
    if flat:
        problems.append(f"no area in {_list(flat)}")
    if still:
        problems.append(f"nothing moves before {_list(still)}")
    if sequence.kind == "dynosurf":
        problems += _cloud_problems(sequence)
    use = triangles.edge_use(first.faces)
    return SequenceReport(
        name=sequence.name,
        path=str(sequence.path),
        kind=sequence.kind,
        frames=sequence.frames,
        vertices=len(first.vertices),
        faces=len(first.faces),
        clouds=None if sequence.clouds is None else str(sequence.clouds),
        same_triangles=not other,
        watertight=triangles.is_watertight(first.faces),
        boundary_edges=int((use == 1).sum()),
        crowded_edges=int((use > 2).sum()),
        components=int(triangles.face_components(first.faces).max()) + 1,
        unused=len(first.vertices) - len(np.unique(first.faces)),
        problems=tuple(problems),
    )


def _frames(sequence: TrueSequence) -> Iterator[TriMesh]:
    from warpdef.files import read_mesh

    if sequence.kind in ("meshes", "dynosurf"):
        for file in frame_files(mesh_folder(sequence.path), MESH_SUFFIXES):
            yield read_mesh(file, image=False)
        return
    meshes = sequence.load()
    for frame in range(len(meshes)):
        yield meshes[frame]


def _cloud_problems(sequence: TrueSequence) -> list[str]:
    from warpdef.files.formats import CLOUD_SUFFIXES

    if sequence.clouds is None:
        return ["no clouds beside gt"]
    count = len([p for p in sequence.clouds.iterdir() if p.suffix.lower() in CLOUD_SUFFIXES and p.name[0] != "."])
    return [f"{count} clouds in {sequence.clouds.name}, {sequence.frames} meshes"] if count != sequence.frames else []


def _list(frames: list[int]) -> str:
    shown = ", ".join(map(str, frames[:SHOWN])) + (", ..." if len(frames) > SHOWN else "")
    return f"frame {shown}" if len(frames) == 1 else f"{len(frames)} frames ({shown})"
