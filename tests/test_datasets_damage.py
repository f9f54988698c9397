"""Damaged true sequences: whatever the bytes, a reader gives a result or one ``InputError``, in little memory."""

from __future__ import annotations

import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from true_sets import FACES, moving, write_anime, write_objs, write_registrations

from warpdef.datasets import find_sequences
from warpdef.datasets.truth import read_moving_mesh, read_truth
from warpdef.errors import InputError


def refuse(path: Path, match: str) -> None:
    """Both ways to read ``path`` complain, and name it, without taking memory that it does not fill."""
    for read in (read_moving_mesh, read_truth):
        tracemalloc.start()
        with pytest.raises(InputError, match=match) as caught:
            read(path)
        assert tracemalloc.get_traced_memory()[1] < 4e6
        tracemalloc.stop()
        assert str(caught.value).startswith(str(path))


def test_every_truncation_of_an_anime_file(tmp_path: Path) -> None:
    path = tmp_path / "a.anime"
    data = write_anime(path, moving())
    for cut in [0, 1, 11, 12, 13, 12 + 48, 12 + 96, len(data) - 48, len(data) - 12, len(data) - 1]:
        path.write_bytes(data[:cut])
        refuse(path, "truncated")
        with pytest.raises(InputError, match="truncated"):
            find_sequences(path)
    path.write_bytes(data + b"x")
    refuse(path, "damaged")


@pytest.mark.parametrize("place", [0, 1, 2])
@pytest.mark.parametrize("count", [0, -1, 1, 3, 5, 10**6, 2**31 - 1, -(2**31)])
def test_wrong_counts_in_an_anime_file(tmp_path: Path, place: int, count: int) -> None:
    path = tmp_path / "a.anime"
    data = write_anime(path, moving())
    path.write_bytes(data[: 4 * place] + struct.pack("<i", count) + data[4 * place + 4 :])
    refuse(path, "expected counts|truncated|damaged")


def test_faces_and_positions_in_an_anime_file(tmp_path: Path) -> None:
    path = tmp_path / "a.anime"
    for index in (4, -1):
        write_anime(path, moving(), np.where(FACES == 3, index, FACES))
        refuse(path, "vertex indices in 0..3")
    vertices = moving()
    vertices[2, 1, 0] = np.nan
    write_anime(path, vertices)
    refuse(path, "NaN or infinity in frame 2")


def test_any_byte_of_a_file_of_registrations_may_be_wrong(tmp_path: Path) -> None:
    pytest.importorskip("h5py")
    path = tmp_path / "r.hdf5"
    write_registrations(path, {"hips": moving()}, chunks=(4, 3, 2), compression="gzip")
    data = path.read_bytes()
    rng = np.random.default_rng(0)
    refused = 0
    for place in [*range(0, 120), *rng.integers(0, len(data), 300)]:
        path.write_bytes(data[:place] + bytes([data[place] ^ 0xFF]) + data[place + 1 :])
        try:
            read_truth(path / "hips")
        except InputError:
            refused += 1
    assert refused > 50


def test_every_truncation_of_a_file_of_registrations(tmp_path: Path) -> None:
    pytest.importorskip("h5py")
    path = tmp_path / "r.hdf5"
    write_registrations(path, {"hips": moving()})
    data = path.read_bytes()
    path.write_bytes(b"")
    refuse(path, "cannot be read as HDF5")
    for cut in [1, 8, 100, 1000, len(data) // 2, len(data) - 1]:
        path.write_bytes(data[:cut])
        refuse(path, "cannot be read as HDF5")
        with pytest.raises(InputError, match="cannot be read as HDF5"):
            find_sequences(path)


@pytest.mark.parametrize("shape", [(10**9, 3, 10**6), (4, 3, 10**9), (10**12, 3, 1)])
def test_registrations_that_claim_more_than_is_stored(tmp_path: Path, shape: tuple) -> None:
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "r.hdf5"
    with h5py.File(path, "w") as file:
        file["faces"] = FACES
        file.create_dataset("hips", shape=shape, dtype="f4", chunks=(4, 3, 1))
    refuse(path, "got 0 bytes; it is truncated")


@pytest.mark.parametrize(
    ("content", "match"),
    [
        ({"hips": moving().transpose(1, 2, 0)}, "expected a dataset 'faces' .* got a file of hips"),
        ({"faces": FACES}, "got 'none'"),
        ({"faces": FACES, "hips": moving()}, r"hips: expected numbers \(V, 3, T\), got float32 of shape \(4, 4, 3\)"),
        ({"faces": FACES, "hips": np.zeros((4, 3, 0))}, r"of shape \(4, 3, 0\)"),
        ({"faces": FACES, "hips": moving().transpose(1, 2, 0).astype(int)}, "got int64"),
        ({"faces": FACES.astype(float), "hips": moving().transpose(1, 2, 0)}, "expected whole numbers"),
        ({"faces": FACES[:, :2], "hips": moving().transpose(1, 2, 0)}, r"faces: expected whole numbers \(F, 3\)"),
        ({"faces": FACES + 1, "hips": moving().transpose(1, 2, 0)}, "vertex indices in 0..3, got 1..4"),
        ({"faces": FACES, "hips": np.full((4, 3, 2), np.inf)}, "NaN or infinity in frame 0"),
        ({"faces": FACES, "hips/more": moving().transpose(1, 2, 0)}, "got a group"),
    ],
)
def test_other_contents_of_an_hdf5_file(tmp_path: Path, content: dict, match: str) -> None:
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "r.hdf5"
    with h5py.File(path, "w") as file:
        for name, array in content.items():
            file[name] = array
    refuse(path, match)


def test_an_hdf5_file_without_sequences_is_not_found(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "r.hdf5", "w") as file:
        file["faces"] = FACES
    with pytest.raises(InputError, match="expected sequences beside 'faces', got none"):
        find_sequences(tmp_path)


def test_an_hdf5_file_leads_nowhere_else(tmp_path: Path) -> None:
    """Neither links nor external or virtual data open another file."""
    h5py = pytest.importorskip("h5py")
    write_registrations(tmp_path / "secret.hdf5", {"hips": moving()})
    (tmp_path / "raw").write_bytes(b"\0" * 192)
    layout = h5py.VirtualLayout((4, 3, 4), "f4")
    layout[:] = h5py.VirtualSource(str(tmp_path / "secret.hdf5"), "hips", (4, 3, 4))
    for name, match in (("linked", "got 'linked'|one of its"), ("virtual", "a reference"), ("external", "a reference")):
        path = tmp_path / f"{name}.hdf5"
        with h5py.File(path, "w") as file:
            file["faces"] = FACES
            file["other"] = moving().transpose(1, 2, 0)
            if name == "linked":
                file[name] = h5py.ExternalLink(str(tmp_path / "secret.hdf5"), "hips")
            elif name == "virtual":
                file.create_virtual_dataset(name, layout)
            else:
                file.create_dataset(name, (4, 3, 4), "f4", external=[(str(tmp_path / "raw"), 0, 192)])
        with pytest.raises(InputError, match=match):
            read_truth(path / name)


def test_damaged_meshes_and_archives(tmp_path: Path) -> None:
    write_objs(tmp_path / "walk", moving())
    (tmp_path / "walk" / "0002.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n")
    (sequence,) = find_sequences(tmp_path)
    with pytest.raises(InputError, match=r"0002\.obj"):
        sequence.load()
    for frame in range(2):
        (tmp_path / "walk" / f"{frame:04d}.off").write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    with pytest.raises(InputError, match="walk: "):  # two series of frames
        find_sequences(tmp_path)
    np.savez(tmp_path / "flat.npz", vertices=moving()[0], faces=FACES)
    with pytest.raises(InputError, match=r"expected vertices \(T, V, 3\) and faces \(F, 3\), got \(4, 3\)"):
        find_sequences(tmp_path / "flat.npz")
    (tmp_path / "half.npz").write_bytes((tmp_path / "flat.npz").read_bytes()[:100])
    with pytest.raises(InputError, match=r"half\.npz: cannot be read"):
        find_sequences(tmp_path / "half.npz")
