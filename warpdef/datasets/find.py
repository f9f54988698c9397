"""Which true sequences a folder holds: every format in one walk, sizes only, in natural order."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

from warpdef.datasets.mesh_folders import CLOUD_FOLDERS, cloud_folder, mesh_files, mesh_folder, sequence_name
from warpdef.datasets.registrations import HDF5_SUFFIXES, registration_sizes, split_path
from warpdef.datasets.sequences import TrueSequence
from warpdef.errors import InputError, WarpdefError
from warpdef.files.disk import must_exist
from warpdef.files.formats import MESH_SUFFIXES, read_surface
from warpdef.files.frame_files import frame_files
from warpdef.files.frame_numbers import natural_key
from warpdef.files.run_folder import REQUIRED


@dataclass
class Survey:
    """What a walk found.

    sequences: in natural order of their paths, names unlike each other
    problems:  what looks like a sequence and cannot be read, the errors as raised
    passed:    what was passed over, one sentence each
    """

    sequences: list[TrueSequence] = field(default_factory=list)
    problems: list[WarpdefError] = field(default_factory=list)
    passed: list[str] = field(default_factory=list)


def find_sequences(folder: Path) -> list[TrueSequence]:
    """All true sequences in a folder and the folders in it, or in one file; only their sizes are read.

    Args:
        folder: a set as distributed, one of its sequences, or one file. Found are: .npz files with vertices and faces;
            folders with ``gt/`` (DynoSurf's layout); folders of numbered .obj, .ply or .off; .anime files; the
            sequences in .hdf5 and .h5 files. Hidden folders and results of this program are passed over.

    Returns:
        Sequences in natural order of their paths. Where two would have the same name, the folders above tell them
        apart.

    Raises:
        InputError: nothing there, no sequence, or one that cannot be read: it is not dropped in silence.
        MissingPackageError: an HDF5 file without h5py.
    """
    found = survey(folder)
    if found.problems:
        more = len(found.problems) - 1
        note = f"; `warpdef datasets check` lists {more} more" if more else ""
        raise type(found.problems[0])(f"{found.problems[0]}{note}")
    if not found.sequences:
        passed = f" ({found.passed[0]})" if found.passed else ""
        raise InputError(
            f"{folder}: expected true mesh sequences (.npz, .anime, .hdf5, folders of numbered meshes), got none"
            f"{passed}; check the path"
        )
    return found.sequences


def survey(folder: Path) -> Survey:
    """As ``find_sequences``, but with what cannot be read listed instead of raised.

    Raises:
        InputError: nothing there.
    """
    folder = Path(folder)
    inside = split_path(folder)
    if inside is None or not inside[1]:
        must_exist(folder)
    found = Survey()
    for path in [folder] if not folder.is_dir() else _walk(folder):
        try:
            found.sequences += _look(path, found.passed)
        except WarpdefError as error:
            found.problems.append(error)
    found.sequences = _with_own_names(found.sequences)
    return found


def _walk(folder: Path) -> Iterator[Path]:
    """Folders and files in natural order, a folder before what is in it; nothing inside a sequence or a result."""
    seen: set[str] = set()
    waiting = [folder]
    while waiting:
        path = waiting.pop()
        if not path.is_dir():
            yield path
            continue
        real = os.path.realpath(path)
        if real in seen:  # links may go in circles
            continue
        seen.add(real)
        if all((path / name).is_file() for name in REQUIRED):
            continue
        yield path
        try:
            entries = [p for p in path.iterdir() if not p.name.startswith(".")]
        except OSError:
            continue
        inner = {"gt", *CLOUD_FOLDERS} if mesh_folder(path) != path else set()
        entries = [p for p in entries if (p.name not in inner if p.is_dir() else p.suffix.lower() in _SUFFIXES)]
        waiting += sorted(entries, key=lambda p: natural_key(p.name), reverse=True)


def _look(path: Path, passed: list[str]) -> list[TrueSequence]:
    """The sequences that one file is, or that the mesh files right in a folder are; none where it is neither."""
    if path.is_dir():
        return _look_into_folder(path, passed)
    inside = split_path(path)
    if inside is not None:
        file, name = inside
        sizes = registration_sizes(file)
        if name and name not in sizes:
            raise InputError(f"{file}: expected one of its {len(sizes)} sequences, got '{name}'; check the name")
        return [TrueSequence(n, file / n, "hdf5", *size) for n, size in sizes.items() if name in ("", n)]
    if path.suffix.lower() == ".anime":
        from warpdef.datasets.anime import anime_size

        return [TrueSequence(sequence_name(path), path, "anime", *anime_size(path))]
    if path.suffix.lower() == ".npz":
        return _look_into_npz(path, passed)
    raise InputError(f"{path}: expected a folder, or a file {' '.join(_SUFFIXES)}, got another; check the path")


def _look_into_folder(path: Path, passed: list[str]) -> list[TrueSequence]:
    meshes = mesh_folder(path)
    files = mesh_files(meshes)
    if not files:
        return []
    if len(files) == 1:
        passed.append(f"{files[0]}: one mesh is no sequence")
        return []
    if not any(c.isdecimal() for file in files for c in file.stem):
        passed.append(f"{meshes}: {len(files)} meshes without numbers are no sequence")
        return []
    files = frame_files(meshes, MESH_SUFFIXES)
    first = read_surface(files[0], MESH_SUFFIXES)
    if first.faces is None or len(first.faces) == 0:
        passed.append(f"{meshes}: points without faces are no true meshes")
        return []
    kind, clouds = ("dynosurf", cloud_folder(path)) if meshes != path else ("meshes", None)
    size = (len(files), len(first.points), len(first.faces))
    return [TrueSequence(sequence_name(path), path, kind, *size, clouds)]


def _look_into_npz(path: Path, passed: list[str]) -> list[TrueSequence]:
    from warpdef.files.numpy_files import Npz

    npz = Npz(path)
    if "vertices" not in npz or "faces" not in npz:
        passed.append(f"{path}: no array 'vertices' with 'faces', but {', '.join(npz.names[:4]) or 'nothing'}")
        return []
    shape, faces = npz.header("vertices")[0], npz.header("faces")[0]
    if len(shape) != 3 or shape[2] != 3 or len(faces) != 2 or 0 in shape:
        raise InputError(
            f"{path}: expected vertices (T, V, 3) and faces (F, 3), got {shape} and {faces}; "
            "stack the frames along the first axis"
        )
    clouds = path.with_name("points.npz")
    found = clouds if clouds != path and clouds.is_file() else None
    return [TrueSequence(sequence_name(path), path, "npz", shape[0], shape[1], faces[0], found)]


def _with_own_names(sequences: list[TrueSequence]) -> list[TrueSequence]:
    """Names made unlike each other by as many folders above as it takes, joined by dashes."""
    named = sequences
    for depth in range(1, 1 + max((len(s.path.absolute().parts) for s in sequences), default=0)):
        counts = Counter(s.name.casefold() for s in named)
        if max(counts.values(), default=0) <= 1:
            break
        named = [
            replace(s, name="-".join([*_above(old, depth), old.name])) if counts[s.name.casefold()] > 1 else s
            for s, old in zip(named, sequences, strict=True)
        ]
    return named


def _above(sequence: TrueSequence, depth: int) -> list[str]:
    """The last ``depth`` folders above the one that gave the name."""
    parts = [Path(part).stem if part.endswith(HDF5_SUFFIXES) else part for part in sequence.path.absolute().parts[1:]]
    at = max(
        (i for i, part in enumerate(parts) if Path(part).stem == sequence.name or part == sequence.name), default=0
    )
    while at > 0 and parts[at - 1] == sequence.name:  # bear/bear.anime
        at -= 1
    return parts[max(0, at - depth) : at]


_SUFFIXES = (".npz", ".anime", *HDF5_SUFFIXES)
