"""Where a run folder stands: never half there, nothing foreign ever deleted, leftovers of dead processes cleared."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from run_folder_samples import VERTICES, drop_report, entries, full_disk, save

from warpdef.errors import InputError
from warpdef.files import run_folder
from warpdef.files.disk import sibling
from warpdef.files.run_folder import RunFolder
from warpdef.files.saved_run import load_run, write_metrics

pytest.importorskip("tomli_w")


def test_prepare_leaves_nothing(tmp_path):
    place = RunFolder.prepare(tmp_path / "a" / "b" / "out")
    assert place.path == tmp_path / "a" / "b" / "out"
    assert entries(tmp_path) == []


def test_existing_places_are_refused(tmp_path):
    out = save(RunFolder.prepare(tmp_path / "out"))
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").write_text("x")
    for place in (out, tmp_path / "empty", tmp_path / "file", tmp_path, Path(".")):
        with pytest.raises(InputError, match="already exists; choose another place, or replace it with --overwrite"):
            RunFolder.prepare(place)


def test_overwrite_replaces_a_result(tmp_path):
    out = save(RunFolder.prepare(tmp_path / "out"))
    write_metrics(out, {"mean": 1})
    (out / "meshes" / "0099.ply").unlink(missing_ok=True)
    (out / ".DS_Store").write_text("left by a file browser")
    save(RunFolder.prepare(out, overwrite=True), vertices=VERTICES[:3], names=["a", "b", "c"], keyframe=1)
    assert load_run(out).names == ("a", "b", "c")
    assert entries(out / "meshes") == ["0000.ply", "0001.ply", "0002.ply"]
    assert not (out / "metrics.json").exists()
    assert entries(tmp_path) == ["out"]
    (tmp_path / "empty").mkdir()
    assert load_run(save(RunFolder.prepare(tmp_path / "empty", overwrite=True))).keyframe == 5
    assert load_run(save(RunFolder.prepare(tmp_path / "fresh", overwrite=True))).keyframe == 5


def test_overwrite_follows_a_link(tmp_path):
    out = save(RunFolder.prepare(tmp_path / "out"))
    (tmp_path / "link").symlink_to(out)
    save(RunFolder.prepare(tmp_path / "link", overwrite=True), keyframe=2)
    assert (tmp_path / "link").is_symlink()
    assert load_run(out).keyframe == 2


def foreign_home(out: Path) -> None:
    shutil.rmtree(out)
    out.mkdir()
    (out / "thesis.tex").write_text("mine")


def foreign_file(out: Path) -> None:
    (out / "notes.txt").write_text("mine")


def foreign_folder(out: Path) -> None:
    (out / "figures").mkdir()


def foreign_mesh(out: Path) -> None:
    (out / "meshes" / "head.blend").write_text("mine")


def foreign_link(out: Path) -> None:
    shutil.rmtree(out / "meshes")
    (out / "meshes").symlink_to(out.parent)


def only_a_file(out: Path) -> None:
    shutil.rmtree(out)
    out.write_text("mine")


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (foreign_home, "it has no sequence.npz"),
        (foreign_file, "it holds 'notes.txt'"),
        (foreign_folder, "it holds 'figures'"),
        (foreign_mesh, "it holds 'meshes/head.blend'"),
        (foreign_link, "its meshes are elsewhere"),
        (drop_report, "it has no report.json"),
        (only_a_file, "it is a file"),
    ],
)
def test_foreign_things_are_never_overwritten(tmp_path, spoil, message):
    out = save(RunFolder.prepare(tmp_path / "out"))
    place = RunFolder.prepare(out, overwrite=True)
    spoil(out)
    before = sorted(str(p) for p in tmp_path.rglob("*"))
    with pytest.raises(InputError, match=f"replaces only warpdef results, but {message}"):
        RunFolder.prepare(out, overwrite=True)
    assert sorted(str(p) for p in tmp_path.rglob("*")) == before
    # Spoilt only during the computation: the foreign thing and the new result are both kept.
    with pytest.raises(InputError, match=f"{message}.* The finished result is in .*out-1"):
        save(place, keyframe=9)
    assert load_run(tmp_path / "out-1").keyframe == 9
    shutil.rmtree(tmp_path / "out-1")
    assert sorted(str(p) for p in tmp_path.rglob("*")) == before


def test_a_place_taken_meanwhile(tmp_path):
    first, second = RunFolder.prepare(tmp_path / "out"), RunFolder.prepare(tmp_path / "out")
    save(first, keyframe=1)
    with pytest.raises(InputError, match=r"already exists.*The finished result is in .*out-1"):
        save(second, keyframe=2)
    assert load_run(tmp_path / "out").keyframe == 1
    assert load_run(tmp_path / "out-1").keyframe == 2


@pytest.mark.parametrize("name", ["file/out", "a\0b", "x" * 300])
def test_impossible_places(tmp_path, name):
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="cannot be created"):
        RunFolder.prepare(f"{tmp_path}/{name}")
    assert entries(tmp_path) == ["file"]


def test_a_place_without_permission(tmp_path):
    (tmp_path / "locked").mkdir(mode=0o500)
    if os.access(tmp_path / "locked", os.W_OK):
        pytest.skip("this user may write everywhere")
    with pytest.raises(InputError, match="cannot be created .*Permission denied"):
        RunFolder.prepare(tmp_path / "locked" / "out")


def interrupted(*_args, **_kwargs):
    raise KeyboardInterrupt


@pytest.mark.parametrize("failing", ["write_npz", "write_ply", "write_text", "json_text"])
@pytest.mark.parametrize(("failure", "error"), [(full_disk, InputError), (interrupted, KeyboardInterrupt)])
def test_failure_leaves_the_old_result(tmp_path, monkeypatch, failing, failure, error):
    out = save(RunFolder.prepare(tmp_path / "out"))
    fresh, again = RunFolder.prepare(tmp_path / "fresh"), RunFolder.prepare(out, overwrite=True)
    monkeypatch.setattr(run_folder, failing, failure)
    for place in (fresh, again):
        with pytest.raises(error, match="No space left" if error is InputError else None):
            save(place, keyframe=1)
    assert entries(tmp_path) == ["out"]
    assert load_run(out).keyframe == 5


def test_a_result_whose_place_is_full_is_kept_elsewhere(tmp_path, monkeypatch):
    """Among the temporary files, and whole; its own place is left as it was."""
    spare, place = tmp_path / "spare", tmp_path / "place"
    spare.mkdir()
    place.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(spare))
    write_ply = run_folder.write_ply
    monkeypatch.setattr(
        run_folder, "write_ply", lambda path, *a: full_disk() if path.is_relative_to(place) else write_ply(path, *a)
    )
    with pytest.raises(InputError, match=rf"No space left.*The finished result is in {spare}") as told:
        save(RunFolder.prepare(place / "out"))
    assert entries(place) == []
    (kept,) = spare.glob("*/out")
    assert str(told.value).endswith(str(kept)) and load_run(kept).vertices.shape == VERTICES.shape
    monkeypatch.setattr(run_folder, "write_ply", full_disk)
    with pytest.raises(InputError, match="or free space$"):
        save(RunFolder.prepare(place / "out"))
    assert len(entries(spare)) == 1


def test_a_real_limit_on_file_size(tmp_path):
    resource = pytest.importorskip("resource")
    place = RunFolder.prepare(tmp_path / "out")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))
    try:
        with pytest.raises(InputError, match=r"sequence\.npz: cannot be written \(File too large\)"):
            save(place)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert entries(tmp_path) == []


@pytest.mark.parametrize("step", [1, 2])
def test_failing_renames(tmp_path, monkeypatch, step):
    out = save(RunFolder.prepare(tmp_path / "out"))
    place = RunFolder.prepare(out, overwrite=True)
    rename, calls = os.rename, []

    def failing(source, target):
        calls.append(source)
        if len(calls) == step:
            raise OSError(5, "Input/output error")
        rename(source, target)

    monkeypatch.setattr(run_folder.os, "rename", failing)
    with pytest.raises(InputError, match="Input/output error"):
        save(place, keyframe=1)
    assert load_run(out).keyframe == 5
    assert entries(tmp_path) == ["out"]


def dead_process() -> int:
    """The number of a process that is no more."""
    child = subprocess.Popen([sys.executable, "-c", "pass"])
    child.wait()
    return child.pid


def left_by(process: int, path: Path, ending: str) -> Path:
    """What that process of this machine would have called a sibling."""
    return path.with_name(sibling(path, ending).name.replace(f"-{os.getpid():x}-", f"-{process:x}-"))


@pytest.mark.skipif(os.name != "posix", reason="processes cannot be asked after")
def test_leftovers_of_dead_processes_are_cleared(tmp_path):
    out, dead = tmp_path / "out", dead_process()
    checkpoint = RunFolder(out, False).checkpoint
    for process in (dead, os.getpid()):
        (left_by(process, out, "partial") / "meshes").mkdir(parents=True)
        left_by(process, checkpoint, "partial").write_text("half")
        left_by(process, tmp_path / "other", "partial").write_text("not of this run")
    RunFolder.prepare(out)
    assert not [name for name in entries(tmp_path) if f"-{dead:x}-" in name and "other" not in name]
    assert len(entries(tmp_path)) == 4


@pytest.mark.skipif(os.name != "posix", reason="processes cannot be asked after")
def test_killed_between_two_renames(tmp_path):
    out = save(RunFolder.prepare(tmp_path / "out"))
    old = left_by(dead_process(), out, "old")
    out.rename(old)
    with pytest.raises(InputError, match="already exists"):
        RunFolder.prepare(out)
    assert load_run(out).keyframe == 5 and entries(tmp_path) == ["out"]
    out.rename(old)
    save(RunFolder(out, False), keyframe=2)  # and after both
    RunFolder.prepare(out, overwrite=True)
    assert load_run(out).keyframe == 2 and entries(tmp_path) == ["out"]


def test_a_checkpoint_marks_an_unfinished_run(tmp_path):
    place = RunFolder.prepare(tmp_path / "out")
    assert place.checkpoint == tmp_path / ".out.checkpoint"
    place.checkpoint.write_text("state")
    with pytest.raises(InputError, match="an unfinished run is kept beside it; go on with --resume .*out, or begin"):
        RunFolder.prepare(tmp_path / "out")
    assert RunFolder.prepare(tmp_path / "out", overwrite=True).overwrite
    assert RunFolder.prepare(tmp_path / "out", resume=True).overwrite
    assert entries(tmp_path) == [".out.checkpoint"]
