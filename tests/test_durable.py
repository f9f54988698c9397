"""A power failure finds a whole result or a whole checkpoint: what is deleted goes after what is on the disk."""

from __future__ import annotations

import errno
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from warpdef.config import Config
from warpdef.errors import InputError
from warpdef.files.run_folder import RunFolder


@pytest.fixture
def done(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, str]]:
    """What was put on the disk, renamed and deleted, in order; partial names without their random part."""
    told: list[tuple[str, str]] = []
    fsync, rename = os.fsync, os.rename

    def name(path: object) -> str:
        text = os.path.basename(str(path))
        return "partial" if text.endswith(".partial") else text

    def noted_fsync(descriptor: int) -> None:
        told.append(("fsync", name(os.readlink(f"/proc/self/fd/{descriptor}"))))
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", noted_fsync)
    monkeypatch.setattr(os, "rename", lambda a, b: (told.append(("rename", name(b))), rename(a, b)))
    return told


def save(path: Path) -> Path:
    vertices = np.random.default_rng(0).normal(size=(2, 4, 3))
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    place = RunFolder.prepare(path)
    return place.save(
        vertices=vertices, faces=faces, keyframe=0, config=Config(), report={}, steps=[], names=["a", "b"]
    )


@pytest.mark.skipif(not os.path.isdir("/proc/self/fd"), reason="descriptors have no names here")
def test_every_file_and_folder_is_on_the_disk_before_the_result_has_its_name(done, tmp_path: Path) -> None:
    save(tmp_path / "out")
    moved = done.index(("rename", "out"))
    before = {name for act, name in done[:moved] if act == "fsync"}
    files = {p.name for p in (tmp_path / "out").rglob("*")}
    assert files | {"partial"} == before and "0001.ply" in files and "meshes" in files
    assert done[moved + 1 :] == [("fsync", tmp_path.name)]


def test_what_does_not_reach_the_disk_is_no_result(tmp_path: Path, monkeypatch) -> None:
    def failing(descriptor: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(os, "fsync", failing)
    with pytest.raises(InputError, match="cannot be written .Input/output error."):
        save(tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_folders_that_cannot_be_put_on_the_disk_by_themselves(tmp_path: Path, monkeypatch) -> None:
    fsync = os.fsync

    def files_only(descriptor: int) -> None:
        if os.path.isdir(f"/proc/self/fd/{descriptor}"):
            raise OSError(errno.EINVAL, "Invalid argument")
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", files_only)
    shutil.rmtree(save(tmp_path / "out"))
