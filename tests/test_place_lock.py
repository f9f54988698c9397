"""One run at a time into one place, whoever else is dead, elsewhere, or on a file system without locks."""

from __future__ import annotations

import errno
import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from stand_in_method import StandInMethod

from warpdef.apps.main import run
from warpdef.errors import InputError
from warpdef.files import place_lock
from warpdef.files.place_lock import claimed

HOLD = (
    "import sys; from warpdef.files.place_lock import claimed\nwith claimed(sys.argv[1]): print('held', flush=True); {}"
)


def sign(lock: Path, process: int, host: str) -> None:
    lock.write_text(json.dumps({"process": process, "host": host, "since": "2026-01-01 00:00:00"}))


def dead_process() -> int:
    with subprocess.Popen(["true"]) as ended:
        ended.wait()
    return ended.pid


def test_a_held_place_names_its_holder_and_a_killed_one_is_taken_over(tmp_path: Path) -> None:
    command = [sys.executable, "-c", HOLD.format("sys.stdin.read()"), str(tmp_path / "out")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None and other.stdout.readline() == "held\n"
        with pytest.raises(InputError, match=f"process {other.pid} on {socket.gethostname()}, since .*; wait for it"):
            with claimed(tmp_path / "out"):
                pass
        with claimed(tmp_path / "another"):
            pass
        other.kill()
    assert (tmp_path / ".out.lock").exists()
    with claimed(tmp_path / "out"):
        assert json.loads((tmp_path / ".out.lock").read_text())["process"] == os.getpid()
    assert list(tmp_path.iterdir()) == []


def test_another_machine_is_believed_until_its_file_is_deleted(tmp_path: Path) -> None:
    lock = tmp_path / ".out.lock"
    sign(lock, dead_process(), "elsewhere")
    with pytest.raises(InputError, match=rf"on elsewhere, since .*if it is no more, delete {lock}"):
        with claimed(tmp_path / "out"):
            pass
    lock.unlink()
    with claimed(tmp_path / "out"):
        pass


def test_without_locks_of_the_system_the_process_is_looked_for(tmp_path: Path, monkeypatch) -> None:
    def unsupported(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(place_lock.fcntl, "flock", unsupported)
    sign(tmp_path / ".out.lock", os.getppid(), socket.gethostname())
    with pytest.raises(InputError, match=f"process {os.getppid()} on "), claimed(tmp_path / "out"):
        pass
    sign(tmp_path / ".out.lock", dead_process(), socket.gethostname())
    with claimed(tmp_path / "out"):
        pass


@pytest.mark.parametrize("content", ["", "x" * 9000, "[]", '{"process": "?", "host": 1}'])
def test_a_file_that_names_no_one_is_taken_over(content: str, tmp_path: Path) -> None:
    (tmp_path / ".out.lock").write_text(content)
    with claimed(tmp_path / "out"):
        assert json.loads((tmp_path / ".out.lock").read_text())["process"] == os.getpid()
    assert list(tmp_path.iterdir()) == []


def test_folders_above_come_and_go(tmp_path: Path) -> None:
    with claimed(tmp_path / "a" / "b" / "out"):
        assert (tmp_path / "a" / "b" / ".out.lock").exists()
    assert list(tmp_path.iterdir()) == []
    with claimed(tmp_path / "a" / "b" / "out"):
        (tmp_path / "a" / "b" / "out").mkdir()
    assert (tmp_path / "a" / "b" / "out").exists()


@pytest.mark.parametrize("name", ["file/out", "a\0b", "x" * 300])
def test_where_nothing_can_be_written_there_is_no_lock(name: str, tmp_path: Path) -> None:
    """The place itself is refused in its own words."""
    (tmp_path / "file").write_text("x")
    with claimed(f"{tmp_path}/{name}"):
        assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_two_runs_into_one_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rng, capfd) -> None:
    method = StandInMethod.install(monkeypatch)
    np.savez(tmp_path / "clouds.npz", points=rng.normal(size=(3, 30, 3)))
    command = ["reconstruct", str(tmp_path / "clouds.npz"), "-o", str(tmp_path / "out")]
    with claimed(tmp_path / "out"):
        for more in ([], ["--overwrite"]):
            assert run([*command, *more]) == 2
            assert f"process {os.getpid()} on " in capfd.readouterr().err
        assert run(["reconstruct", "--resume", str(tmp_path / "out")]) == 2
        assert f"process {os.getpid()} on " in capfd.readouterr().err
    assert not method.calls
    assert run(command) == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["clouds.npz", "out"]
