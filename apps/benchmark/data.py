"""The sequences that ``warpdef bench`` works on: the built-in figure, a true mesh sequence, or clouds of one's own."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from warpdef.apps.benchmark.meshes import resize_mesh
from warpdef.apps.benchmark.sizes import Size
from warpdef.config import Config
from warpdef.config_values import parse_slice
from warpdef.errors import InputError
from warpdef.files.numpy_files import Npz
from warpdef.mesh import MeshSequence
from warpdef.sequence import PointSequence, Similarity


@dataclass(frozen=True)
class Work:
    """One problem, cube units.

    clouds, normals: a frame each, (N_t, 3) float32. vertices: template at the keyframe, (V, 3) float32. faces: (F, 3).
    """

    clouds: list[np.ndarray]
    normals: list[np.ndarray]
    vertices: np.ndarray
    faces: np.ndarray
    keyframe: int

    def save(self, path: Path) -> None:
        """To an uncompressed .npz, for a process of its own."""
        np.savez(
            path,
            sizes=[len(c) for c in self.clouds],
            clouds=np.concatenate(self.clouds),
            normals=np.concatenate(self.normals),
            vertices=self.vertices,
            faces=self.faces,
            keyframe=self.keyframe,
        )

    @classmethod
    def load(cls, path: Path) -> Work:
        with np.load(path) as stored:
            ends = np.cumsum(stored["sizes"])[:-1]
            clouds, normals = (np.split(stored[name], ends) for name in ("clouds", "normals"))
            return cls(clouds, normals, stored["vertices"], stored["faces"], int(stored["keyframe"]))


@dataclass(frozen=True)
class Source:
    """What problems are made from: a moving mesh to sample (any size), or clouds with a template (up to their size)."""

    name: str
    truth: MeshSequence | None = None
    clouds: PointSequence | None = None

    @property
    def frames(self) -> int:
        given = self.truth if self.truth is not None else self.clouds
        assert given is not None  # a source has one of the two
        return len(given)

    def retimed(self, span: int, frames: int) -> Source:
        """The motion of the first ``span`` frames in ``frames`` of them, in between by straight lines.

        A sweep over frames takes this, for the cost of a search depends on its distance: a longer walk would be a
        harder one. Clouds cannot be retimed and stay as they are.

        Raises:
            InputError: fewer than ``span`` frames.
        """
        if self.truth is None or frames == span:
            return self
        _require_frames(self, span)
        at = np.linspace(0.0, span - 1.0, frames)
        low = np.minimum(at.astype(int), span - 2)
        share = (at - low)[:, None, None]
        x = self.truth.vertices
        return Source(self.name, MeshSequence((1.0 - share) * x[low] + share * x[low + 1], self.truth.faces))


def load_source(data: Path | None, frames: str, most_frames: int) -> Source:
    """The built-in figure, or a file: vertices (T, V, 3) and faces of a true sequence, or clouds.

    Args:
        frames: slice of the file's frames. most_frames: frames the figure is to have.

    Raises:
        InputError: not such a file. MissingPackageError: no file, and the figure's mesh cannot be made here.
    """
    if data is None:
        from warpdef.truth.figure import walking_figure

        return Source("the built-in figure", walking_figure(most_frames))
    from warpdef.files import read_clouds, read_mesh_sequence

    chosen = parse_slice(frames)
    if data.suffix.lower() == ".npz" and data.exists() and "vertices" in Npz(data):
        return Source(data.name, read_mesh_sequence(data, chosen))
    return Source(data.name, clouds=read_clouds(data, chosen))


def make_work(source: Source, size: Size) -> Work:
    """A problem of this size; every call with the same arguments gives the same numbers.

    Raises:
        InputError: the source has fewer frames or points than asked for.
    """
    _require_frames(source, size.frames)
    if source.truth is None:
        assert source.clouds is not None  # a source has one of the two
        return _from_clouds(source.clouds, size)
    from warpdef.geometry.sampling import sample_surface

    mesh = source.truth
    clouds, normals = [], []
    for frame in range(size.frames):
        rng = np.random.default_rng([0, frame])
        cloud, normal, _, _ = sample_surface(mesh.vertices[frame], mesh.faces, size.points, rng)
        clouds.append(cloud)
        normals.append(normal.astype(np.float32))
    keyframe = size.frames // 2
    into = Similarity.into_cube(clouds, Config().fill)
    vertices, faces = resize_mesh(into.to_cube(mesh.vertices[keyframe]), mesh.faces, size.vertices)
    clouds = [into.to_cube(c).astype(np.float32) for c in clouds]
    return Work(clouds, normals, vertices.astype(np.float32), faces, keyframe)


def _require_frames(source: Source, frames: int) -> None:
    if source.frames < frames:
        raise InputError(f"--data: expected at least {frames} frames, got {source.frames}; give a longer sequence")


def _from_clouds(sequence: PointSequence, size: Size) -> Work:
    fewest = min(len(p) for p in sequence.points)
    if fewest < size.points:
        raise InputError(
            f"--data: expected at least {size.points} points a frame for size {size.name!r}, got {fewest}; "
            "give a true sequence (vertices, faces), which can be sampled at will, or --only a smaller size"
        )
    from warpdef.geometry.cloud_planes import pca_normals
    from warpdef.template.choose import choose_template

    config = Config()
    sequence = sequence.select(slice(size.frames)).subsample(size.points, config.seed)
    into = Similarity.into_cube(sequence.points, config.fill)
    clouds = [into.to_cube(p) for p in sequence.points]
    config = replace(config, template=replace(config.template, faces_max=2 * size.vertices))
    chosen = choose_template(clouds, sequence.normals, config)
    neighbours = config.template.neighbours
    pairs = zip(clouds, sequence.normals, strict=True)
    normals = [(pca_normals(p, neighbours) if n is None else n).astype(np.float32) for p, n in pairs]
    vertices, faces = resize_mesh(chosen.mesh.vertices, chosen.mesh.faces, size.vertices)
    clouds = [c.astype(np.float32) for c in clouds]
    return Work(clouds, normals, vertices.astype(np.float32), faces, chosen.keyframe)
