"""Checkpoint files: back bit for bit, never half, never believed when damaged."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import numpy as np
import pytest

from warpdef.errors import InputError
from warpdef.files import checkpoint as module
from warpdef.files.checkpoint import digests, read_checkpoint, write_checkpoint

ARRAYS = {
    "grids.u": np.random.default_rng(0).normal(size=(3, 5, 8)).astype(np.float32),
    "grids.step": np.array([7], dtype=np.int32),
    "template.vertices": np.array([[np.nan, np.inf, -0.0]]),
    "empty": np.zeros((0, 3), dtype=np.float32),
}
FACTS = {"third": 1 / 3, "text": "Zürich", "none": None, "list": [1, 2.5e-300], "numpy": np.float32(0.5), "yes": True}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    write_checkpoint(tmp_path / "a.checkpoint", FACTS, ARRAYS)
    return tmp_path / "a.checkpoint"


def test_everything_comes_back_bit_for_bit(path: Path) -> None:
    read = read_checkpoint(path)
    assert read.facts == FACTS
    assert list(read.arrays) == list(ARRAYS)
    for name, array in ARRAYS.items():
        assert read.arrays[name].dtype == array.dtype and read.arrays[name].shape == array.shape
        assert read.arrays[name].tobytes() == array.tobytes()
    assert set(read.part("grids")) == {"u", "step"}
    assert os.listdir(path.parent) == ["a.checkpoint"]


def test_arrays_that_are_not_contiguous(tmp_path: Path) -> None:
    array = np.arange(24, dtype=np.float32).reshape(4, 6)[:, ::2].T
    write_checkpoint(tmp_path / "c", {}, {"a": array})
    np.testing.assert_array_equal(read_checkpoint(tmp_path / "c").arrays["a"], array)


def test_damage_is_never_believed(path: Path, rng: np.random.Generator) -> None:
    data = path.read_bytes()
    lengths = [1, 10, 21, 28, 29, 60, len(data) - 33, len(data) - 1, *rng.integers(1, len(data), 30)]
    for length in lengths:
        path.write_bytes(data[:length])
        with pytest.raises(InputError, match="start the run anew"):
            read_checkpoint(path)
    for place, bit in zip(rng.integers(0, len(data), 100), rng.integers(0, 8, 100), strict=True):
        turned = bytearray(data)
        turned[place] ^= 1 << int(bit)
        path.write_bytes(turned)
        with pytest.raises(InputError, match="start the run anew"):
            read_checkpoint(path)
    path.write_bytes(data + b"\0")
    with pytest.raises(InputError, match="the checksum does not hold"):
        read_checkpoint(path)


def test_other_files_are_no_checkpoints(path: Path) -> None:
    for other in (b"warpdef checkpoint\n", b"warpdef checkpoint x\n", b"ply\n"):
        path.write_bytes(other + bytes(100))
        with pytest.raises(InputError, match="expected a checkpoint of this warpdef, got something else"):
            read_checkpoint(path)
    with pytest.raises(InputError, match="got nothing there"):
        read_checkpoint(path.with_name("missing"))


@pytest.mark.parametrize("failing", ["fsync", "replace"])
def test_what_cannot_be_written_leaves_the_older_one(path: Path, monkeypatch, failing: str) -> None:
    def full(*_args: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, failing, full)
    with pytest.raises(InputError, match="No space left on device"):
        write_checkpoint(path, {}, {})
    assert read_checkpoint(path).facts == FACTS
    assert os.listdir(path.parent) == ["a.checkpoint"]


def test_the_data_are_on_the_disk_before_the_name_is(path: Path, monkeypatch) -> None:
    done: list[str] = []
    for name in ("fsync", "replace"):
        real = getattr(os, name)
        monkeypatch.setattr(os, name, lambda *args, real=real, name=name: (done.append(name), real(*args)))
    write_checkpoint(path, {}, {})
    assert done == ["fsync", "replace", "fsync"]  # the data, the name, and the folder that holds it


def test_what_a_checkpoint_cannot_hold(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="cannot hold object"):
        write_checkpoint(tmp_path / "c", {"a": object()}, {})
    assert not list(tmp_path.iterdir())


def test_digests_tell_frames_apart(rng: np.random.Generator) -> None:
    points = [rng.normal(size=(20, 3)) for _ in range(3)]
    normals = [rng.normal(size=(20, 3)), None, None]
    first = digests(points, normals)
    assert len(set(first)) == 3 and digests([p.copy() for p in points], normals) == first
    points[1] = points[1] + np.where(np.arange(60).reshape(20, 3) == 7, 1e-15, 0.0)
    assert [a == b for a, b in zip(first, digests(points, normals), strict=True)] == [True, False, True]
    normals[0] = -normals[0]
    assert [a == b for a, b in zip(first, digests(points, normals), strict=True)] == [False, False, True]


def test_the_format_is_the_documented_one(path: Path) -> None:
    data = path.read_bytes()
    assert data.startswith(b"warpdef checkpoint %d\n" % module.FORMAT) and module._DIGEST == 32 and module.FORMAT < 10
    length = int.from_bytes(data[21:29], "little")
    assert data[29:30] == b"{" and len(data) == 29 + length + sum(a.nbytes for a in ARRAYS.values()) + 32


def sealed(path: Path, content: bytes, magic: bytes = module._MAGIC) -> None:
    """Write ``content`` as a checkpoint whose checksum holds."""
    data = magic + content
    path.write_bytes(data + hashlib.blake2b(data, digest_size=32).digest())


def test_another_format_is_named(path: Path) -> None:
    sealed(path, path.read_bytes()[21:-32], b"warpdef checkpoint 1\n")
    with pytest.raises(InputError, match=f"expected a checkpoint of format {module.FORMAT}, got format 1, of another"):
        read_checkpoint(path)


@pytest.mark.parametrize(
    "header",
    [
        b"{",
        b"[]",
        b"{}",
        b'{"facts": 1, "arrays": []}',
        b'{"facts": {}, "arrays": 3}',
        b'{"facts": {}, "arrays": [["a", "<f4"]]}',
        b'{"facts": {}, "arrays": [["a", "|O", [1]]]}',
        b'{"facts": {}, "arrays": [["a", "<f4", [-1]]]}',
        b'{"facts": {}, "arrays": [["a", "<f4", [99999999999999]]]}',
        b'{"facts": {}, "arrays": [["a", "<f4", ["1"]]]}',
        b'{"facts": {}, "arrays": [["a", "<f4", [1]]]}',  # and the bytes of another after it
        b"[" * 5000,
    ],
)
def test_a_foreign_header_is_refused_in_one_sentence(header: bytes, path: Path) -> None:
    sealed(path, len(header).to_bytes(8, "little") + header + bytes(8))
    with pytest.raises(InputError, match="a checkpoint of another warpdef: .*; go on with the one that began the run"):
        read_checkpoint(path)
