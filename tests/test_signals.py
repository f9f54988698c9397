"""What ends a process from outside: the best state is written, and the exit code says which signal it was."""

from __future__ import annotations

import os
import pickle
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import synthetic

from warpdef.apps.console import ProgressDisplay
from warpdef.apps.main import run
from warpdef.apps.signals import Ended, ending_signals, exit_code, interruption
from warpdef.files import run_folder, write_ply
from warpdef.files.saved_run import load_run
from warpdef.progress import Progress, held_interrupts

CODES = {"SIGINT": 130, "SIGTERM": 143, "SIGHUP": 129}


@pytest.fixture(autouse=True)
def handlers() -> Iterator[None]:
    """As a shell starts a program; put back afterwards."""
    # A shell lets jobs in the background ignore Ctrl-C, these tests perhaps among them.
    fresh = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL, signal.SIGHUP: signal.SIG_DFL}
    before = {n: signal.signal(n, handler) for n, handler in fresh.items()}
    yield
    for n, handler in before.items():
        assert signal.getsignal(n) == fresh[n], "a handler was left behind"
        signal.signal(n, handler)


@pytest.fixture
def command(tmp_path: Path) -> list[str]:
    moving = synthetic.turning_ellipsoid(3, 200, np.random.default_rng(0), subdivisions=1)
    np.savez(tmp_path / "clouds.npz", points=np.stack(moving.clouds), normals=np.stack(moving.normals))
    write_ply(tmp_path / "mesh.ply", moving.vertices[1], moving.faces)
    small = ["--keyframe", "1", "--grid.levels", "2", "--iterations", "40", "--optimiser.warmup", "10"]
    small += ["--refine.iterations", "2", "--template", str(tmp_path / "mesh.ply"), "--device", "cpu", "--threads", "1"]
    return ["reconstruct", str(tmp_path / "clouds.npz"), "-o", str(tmp_path / "out"), *small]


def send_in(phase: str, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Send this process a signal when a run tells of the phase."""
    show, left = ProgressDisplay.__call__, [1]

    def shown(self: ProgressDisplay, progress: Progress) -> None:
        show(self, progress)
        if progress.phase == phase and left:
            left.pop()
            os.kill(os.getpid(), signal.Signals[name])

    monkeypatch.setattr(ProgressDisplay, "__call__", shown)


@pytest.mark.parametrize("name", CODES)
def test_the_best_state_is_written_and_can_go_on(name: str, command, tmp_path: Path, monkeypatch, capfd) -> None:
    send_in("optimise", name, monkeypatch)
    assert run(command) == CODES[name]
    report = load_run(tmp_path / "out").report
    assert report["interrupted"] and report["signal"] == name and report["iterations"] < 40
    by = "" if name == "SIGINT" else f" by {name}"
    assert report["stopped"] == f"interrupted{by}"
    told = capfd.readouterr().err.splitlines()[-1]
    assert told.startswith(f"warpdef: interrupted{by} after ") and told.endswith(f"--resume {tmp_path / 'out'}")
    assert run(["reconstruct", "--resume", str(tmp_path / "out"), "--device", "cpu"]) == 0
    assert load_run(tmp_path / "out").report["iterations"] == 40


@pytest.mark.parametrize("name", CODES)
def test_before_there_is_anything_to_keep(name: str, command, tmp_path: Path, monkeypatch, capfd) -> None:
    send_in("template", name, monkeypatch)
    assert run(command) == CODES[name]
    assert capfd.readouterr().err.splitlines()[-1].endswith(": nothing was written")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["clouds.npz", "mesh.ply"]


def test_a_result_that_is_being_written_is_written(command, tmp_path: Path, monkeypatch) -> None:
    write = run_folder.write_npz

    def write_and_end(*arguments: Any) -> None:
        monkeypatch.setattr(run_folder, "write_npz", write)  # a second signal would act at once
        os.kill(os.getpid(), signal.SIGTERM)
        write(*arguments)

    monkeypatch.setattr(run_folder, "write_npz", write_and_end)
    assert run(command) == 0
    report = load_run(tmp_path / "out").report
    assert not report["interrupted"] and report["stopped"] is None and report["iterations"] == 40


def test_a_second_signal_acts_at_once() -> None:
    with ending_signals(), pytest.raises(Ended, match="SIGHUP"), held_interrupts() as asked:
        os.kill(os.getpid(), signal.SIGTERM)
        assert asked.asked and asked.signal == "SIGTERM"
        os.kill(os.getpid(), signal.SIGHUP)


def test_what_the_caller_ignores_stays_ignored() -> None:
    """As ``nohup`` does."""
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    with ending_signals(), held_interrupts() as asked:
        os.kill(os.getpid(), signal.SIGHUP)
        assert not asked.asked
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def test_in_a_program_that_does_not_handle_them_they_keep_their_meaning() -> None:
    with held_interrupts():
        assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL
        assert signal.getsignal(signal.SIGINT) != signal.default_int_handler


def test_the_exit_code_survives_workers_and_reports() -> None:
    assert exit_code(pickle.loads(pickle.dumps(Ended(signal.SIGTERM)))) == 143
    assert [exit_code(interruption({"signal": name})) for name in (*CODES, None)] == [130, 143, 129, 130]
