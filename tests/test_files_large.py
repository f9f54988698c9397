"""Large archives: read in place, a page at a time, and never unpacked beyond what their size allows."""

from __future__ import annotations

import io
import struct
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mutate import peak_memory, reset_peak
from mutation_samples import CLOUDS, npy_of_zeros, saved, zipped

from warpdef.errors import InputError
from warpdef.files import numpy_files, read_clouds
from warpdef.files.disk import Unpacking
from warpdef.files.numpy_files import Npz

FRAME = 50_000  # points


def sparse_npz(path: Path, shape: tuple[int, int, int], frames: dict[int, np.ndarray]) -> None:
    """An .npz with one array ``points`` that is not compressed, whose frames are holes of the file unless given.

    Written by hand, as zipfile would write every zero; below 4 GiB, so that no longer fields are needed.
    """
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f4", "fortran_order": False, "shape": shape})
    frame_size = shape[1] * 3 * 4
    size, name = len(header.getvalue()) + shape[0] * frame_size, b"points.npy"
    facts = struct.pack("<HHHHHIIIHH", 20, 0, 0, 0, 0, 0, size, size, len(name), 0)
    with open(path, "wb") as stream:
        stream.write(b"PK\3\4" + facts + name + header.getvalue())
        start = stream.tell()
        for frame, points in frames.items():
            stream.seek(start + frame * frame_size)
            stream.write(points.astype("<f4").tobytes())
        stream.seek(start + shape[0] * frame_size)
        directory = stream.tell()
        stream.write(b"PK\1\2" + struct.pack("<H", 20) + facts + struct.pack("<HHHII", 0, 0, 0, 0, 0) + name)
        length = stream.tell() - directory
        stream.write(b"PK\5\6" + struct.pack("<HHHHIIH", 0, 0, 1, 1, length, directory, 0))


def test_three_gigabytes_are_read_in_place(tmp_path, rng):
    frames = {t: rng.normal(size=(FRAME, 3)) + t for t in (2600, 2601, 2602)}
    sparse_npz(tmp_path / "large.npz", (5200, FRAME, 3), frames)
    assert (tmp_path / "large.npz").stat().st_size > 3e9
    if (tmp_path / "large.npz").stat().st_blocks * 512 > 1e8:
        pytest.skip("this file system keeps no holes")
    read_clouds_once = read_clouds(tmp_path / "large.npz", slice(2600, 2603))  # imports and caches are not counted
    base = reset_peak()
    sequence = read_clouds(tmp_path / "large.npz", slice(2600, 2603))
    grown = peak_memory() - base
    for found, again, expected in zip(sequence.points, read_clouds_once.points, frames.values(), strict=True):
        np.testing.assert_array_equal(found, expected.astype(np.float32))
        np.testing.assert_array_equal(again, found)
    # Three frames are 3.6 MB as float64.
    assert grown < 32 << 20


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("kind", ["<f4", ">f8", "<i2"])
def test_mapped_arrays_are_those_that_are_read(tmp_path, monkeypatch, order, kind):
    points = np.asarray(np.rint(np.stack(CLOUDS) * 100), dtype=kind, order=order)
    np.savez(tmp_path / "a.npz", first=np.arange(5), points=points, empty=np.zeros((0, 3)))
    read = Npz(tmp_path / "a.npz").array("points")
    monkeypatch.setattr(numpy_files, "MAPPED_FROM", 0)
    mapped = Npz(tmp_path / "a.npz").array("points")
    assert isinstance(mapped, np.memmap) and not isinstance(read, np.memmap)
    assert mapped.dtype == read.dtype
    np.testing.assert_array_equal(mapped, read)
    assert Npz(tmp_path / "a.npz").array("empty").shape == (0, 3)
    sequence = read_clouds(tmp_path / "a.npz", slice(1, 3))
    for found, expected in zip(sequence.points, points[1:3].astype(np.float64), strict=True):
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: data.replace(b"(4, 40, 3)", b"(9, 40, 3)"), "expected shape .9, 40, 3. .*truncated"),
        (lambda data: data.replace(b"'<f8'", b"'|O8'"), "Python objects"),
        (lambda data: data.replace(b"\x93NUMPY", b"\x93NUMPX"), "cannot be read as .npz"),
    ],
)
def test_damaged_arrays_are_not_mapped(tmp_path, monkeypatch, change, message):
    data = saved(np.savez, points=np.stack(CLOUDS))
    (tmp_path / "a.npz").write_bytes(change(data))
    monkeypatch.setattr(numpy_files, "MAPPED_FROM", 0)
    with pytest.raises(InputError, match=message):
        Npz(tmp_path / "a.npz").array("points")


def test_a_local_header_that_lies_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(numpy_files, "MAPPED_FROM", 0)
    whole = saved(np.savez, points=np.stack(CLOUDS))
    with zipfile.ZipFile(io.BytesIO(whole)) as archive:
        (member,) = archive.infolist()
    cut = bytearray(whole)
    struct.pack_into("<H", cut, member.header_offset + 28, 60_000)  # length of the extra field
    path = tmp_path / "a.npz"
    path.write_bytes(cut)
    with pytest.raises(InputError, match="got fewer; it is truncated"):
        numpy_files._map_array(path, member, "a")
    path.write_bytes(b"x" * len(whole))
    with pytest.raises(ValueError, match="no local header"):
        numpy_files._map_array(path, member, "a")


def test_a_bomb_is_refused_before_it_goes_off(tmp_path):
    path, message = tmp_path / "a.npz", "at most 64 MiB .* np.savez, which does not compress"
    path.write_bytes(zipped({"points.npy": npy_of_zeros((2, 4_000_000, 3))}))
    base = reset_peak()
    with pytest.raises(InputError, match=message):
        read_clouds(path)
    # Each of these is small enough, but not all of them.
    path.write_bytes(zipped({f"points_{t}.npy": npy_of_zeros((1_500_000, 3)) for t in range(2)}))
    archive = Npz(path)
    assert archive.array("points_0").shape == (1_500_000, 3)
    with pytest.raises(InputError, match=message):
        archive.array("points_1")
    assert peak_memory() - base < 128 << 20


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_no_other_compression_goes_off(tmp_path, method):
    """What zipfile would unpack as a whole before a byte of it could be looked at."""
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w", method) as archive:
        archive.writestr("points.npy", npy_of_zeros((2, 4_000_000, 3)))
    base = reset_peak()
    with pytest.raises(InputError, match="points: expected no compression, or that of np.savez_compressed"):
        read_clouds(path)
    assert peak_memory() - base < 64 << 20


def test_a_header_alone_is_no_bomb(tmp_path):
    path = tmp_path / "a.npz"
    path.write_bytes(zipped({"points.npy": b"\x93NUMPY\2\0" + (200 << 20).to_bytes(4, "little") + bytes(200 << 20)}))
    base = reset_peak()
    with pytest.raises(InputError, match="a header of 209715200 bytes"):
        read_clouds(path)
    assert peak_memory() - base < 64 << 20


def test_the_list_of_an_archive_is_read_once(tmp_path, monkeypatch):
    arrays: dict[str, Any] = {f"points_{t}": CLOUDS[t % 4] for t in range(50)}
    np.savez(tmp_path / "a.npz", **arrays)
    opened = []
    archives: Any = zipfile.ZipFile  # what reads the list is no part of what it promises
    whole = archives._RealGetContents
    monkeypatch.setattr(zipfile.ZipFile, "_RealGetContents", lambda self: (opened.append(1), whole(self))[1])
    assert len(read_clouds(tmp_path / "a.npz")) == 50 and len(opened) == 1


def test_what_is_not_compressed_has_no_such_bound(tmp_path):
    (tmp_path / "a").write_bytes(b"x" * 1000)
    unpacking = Unpacking(tmp_path / "a", "write it another way", times=2)
    unpacking.take(2000 + (64 << 20))
    with pytest.raises(InputError, match="if it is not damaged, write it another way"):
        unpacking.take(1)


def test_names_in_an_archive_lead_nowhere(tmp_path):
    inner = tmp_path / "deep" / "in"
    inner.mkdir(parents=True)
    npy = saved(np.save, np.stack(CLOUDS))
    (inner / "a.npz").write_bytes(zipped({"../../out.npy": npy, "/tmp/out.npy": npy, "points.npy": npy}))
    assert len(read_clouds(inner / "a.npz")) == 4
    np.testing.assert_array_equal(Npz(inner / "a.npz").array("../../out"), np.stack(CLOUDS))
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["a.npz", "deep", "in"]


def test_what_hardly_packs_is_written_as_it_is_and_the_rest_compressed(tmp_path, monkeypatch, rng):
    monkeypatch.setattr(numpy_files, "MAPPED_FROM", 1 << 20)
    places = rng.normal(size=(17, 2000, 3)).astype(np.float32)
    arrays = {"places": places, "many": np.repeat(places, 3, axis=0), "zeros": np.zeros((60_000, 3), dtype=np.int32)}
    arrays |= {"count": np.array(7), "names": np.array(["a", "b"]), "none": np.zeros((0, 3), dtype=np.float32)}
    numpy_files.write_npz(tmp_path / "a.npz", arrays)
    with zipfile.ZipFile(tmp_path / "a.npz") as archive:
        kinds = {member.filename: member.compress_type for member in archive.infolist()}
        assert archive.testzip() is None
    # What is large would be mapped if it were not compressed, and no sum of it checked.
    assert kinds.pop("places.npy") == zipfile.ZIP_STORED and set(kinds.values()) == {zipfile.ZIP_DEFLATED}
    with np.load(tmp_path / "a.npz") as read:
        assert all(
            np.array_equal(read[name], array) and read[name].dtype == array.dtype for name, array in arrays.items()
        )
