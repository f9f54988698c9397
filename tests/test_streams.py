"""Streams that cannot be written to cost words, never a result."""

from __future__ import annotations

import io
import os
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from stand_in_method import StandInMethod

from warpdef.apps.main import run
from warpdef.apps.streams import Guarded, guarded_streams
from warpdef.files.run_folder import write_text
from warpdef.files.saved_run import load_run

needs_full = pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full here")
PROGRAM = """
import sys; sys.path.insert(0, {tests!r})
import pytest
from stand_in_method import StandInMethod
StandInMethod.install(pytest.MonkeyPatch())
from warpdef.apps.main import main
main()
"""


@pytest.fixture
def clouds(tmp_path: Path, rng: np.random.Generator) -> Path:
    np.savez(tmp_path / "clouds.npz", points=rng.normal(size=(3, 30, 3)))
    return tmp_path / "clouds.npz"


@needs_full
@pytest.mark.parametrize("streams", ["2>/dev/full", ">/dev/full", "0<&- >&- 2>&-", "2>&1 | head -1"])
def test_a_run_is_whole_whatever_its_streams(streams: str, clouds: Path, tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    program.write_text(PROGRAM.format(tests=str(Path(__file__).parent)))
    command = shlex.join([sys.executable, str(program), "reconstruct", str(clouds), "-o", str(tmp_path / "out")])
    done = subprocess.run(
        ["bash", "-o", "pipefail", "-c", f"{command} {streams}"], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    assert len(load_run(tmp_path / "out").meshes) == 3
    assert "Traceback" not in done.stderr
    assert ("standard output cannot be written" in done.stderr) == (streams == ">/dev/full")


@needs_full
def test_an_answer_that_is_lost_is_no_success(monkeypatch: pytest.MonkeyPatch, capfd) -> None:
    """A command whose only product is what it prints."""
    with open("/dev/full", "w") as full:
        monkeypatch.setattr(sys, "stdout", full)
        assert run(["--version"]) == 2
    assert "warpdef: standard output cannot be written (No space left on device)" in capfd.readouterr().err


def test_names_that_the_encoding_cannot_say(clouds: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    StandInMethod.install(monkeypatch)
    bytes_shown = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(bytes_shown, encoding="ascii"))
    assert run(["reconstruct", str(clouds), "-o", str(tmp_path / "Zürich")]) == 0
    assert b"Z\\xfcrich" in bytes_shown.getvalue()


def test_after_a_failure_nothing_is_left_to_fail(tmp_path: Path) -> None:
    """The reader of a pipe has left: the descriptor is taken off the pipe, and what was held back goes nowhere."""
    ear, mouth = os.pipe()
    os.close(ear)
    stream = os.fdopen(mouth, "w")
    guard = Guarded(stream)
    guard.write("held back")
    guard.flush()
    assert guard.lost is None  # who leaves has read enough
    stream.write("below the guard")
    stream.close()


@needs_full
def test_a_full_disk_is_remembered() -> None:
    with open("/dev/full", "w") as full:
        guard = Guarded(full)
        guard.write("x")
        guard.flush()
        assert guard.lost is not None and guard.lost.strerror == "No space left on device"
        os.write(full.fileno(), b"what libraries print")


def test_a_closed_stream_is_written_to_in_vain(monkeypatch: pytest.MonkeyPatch) -> None:
    closed = io.StringIO()
    closed.close()
    monkeypatch.setattr(sys, "stderr", closed)
    with guarded_streams():
        print("said to no one", file=sys.stderr)
        assert not sys.stderr.isatty()
    assert sys.stderr is closed


def test_a_name_that_is_no_text_does_not_cost_the_result(tmp_path: Path) -> None:
    """File names are bytes; the configuration and the report are UTF-8."""
    write_text(tmp_path / "config.toml", 'mesh = "\udcff.ply"\n')
    assert (tmp_path / "config.toml").read_text(encoding="utf-8") == 'mesh = "?.ply"\n'
