"""What ``warpdef view`` says of a machine that cannot draw, or has lost its screen."""

from __future__ import annotations

import subprocess

import pytest
from view_samples import save_run

from warpdef.apps.main import run
from warpdef.apps.viewer import probe as view_probe
from warpdef.apps.viewer.probe import RenderingProbe, explained
from warpdef.apps.viewer.screen import screen_lost
from warpdef.errors import MissingPackageError


@pytest.mark.parametrize(
    "text",
    [
        "2026 vtkXOpenGLRenderWindow.:1452 WARN| bad X server connection. DISPLAY=:7",
        "X connection to :7 broken (explicit kill or server shutdown).",
        'XIO:  fatal IO error 11 (Resource temporarily unavailable) on X server ":7"',
        "Error: Can't open display: :7",
        "could not connect to display :7",
    ],
)
def test_a_lost_screen_is_no_missing_library(monkeypatch, text):
    monkeypatch.setenv("DISPLAY", ":7")
    assert screen_lost(text)
    said = explained(1, text, window=True)
    assert "the screen DISPLAY=:7" in said and "apt-get" not in said
    # Pictures need no screen: there VTK only remarks that it found none.
    assert "apt-get install" in explained(1, text, window=False)


def test_a_missing_library_is_no_lost_screen():
    text = "bad X server connection. DISPLAY=\nFailed to load EGL!"
    assert "apt-get install" in explained(1, text, window=True)
    assert not screen_lost("libGL.so: Failed to load") and not screen_lost("Segmentation fault")


class Machine:
    """A pretended machine on which the trial of rendering ends as a test wants it."""

    def __init__(self, monkeypatch, program: str) -> None:
        monkeypatch.setattr(view_probe, "_PROGRAM", program)


@pytest.mark.parametrize(
    ("program", "expected"),
    [
        (
            "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)",
            ["SIGSEGV", "apt-get install libegl1 libgl1-mesa-dri;"],
        ),
        ("raise ImportError('libXrender.so.1: cannot open')", ["libXrender.so.1", "libgl1-mesa-dri libxrender1;"]),
        ("raise SystemExit('nothing was drawn')", ["nothing was drawn"]),
        (
            "raise SystemExit('\\x1b[33m2026 [7F] window.c:6 WARN| Failed to load EGL!\\x1b[0m\\nthe last line')",
            ["(it ended with 1: Failed to load EGL!)"],
        ),
        ("import os, signal; os.kill(os.getpid(), 40)", ["signal 40"]),
    ],
)
def test_a_machine_that_cannot_draw(monkeypatch, tmp_path, capfd, program, expected):
    Machine(monkeypatch, program)
    out = save_run(tmp_path / "out")
    assert run(["view", str(out), "--screenshot", str(tmp_path / "a.png")]) == 2
    err = capfd.readouterr().err
    assert err.startswith("warpdef: error: this machine cannot draw") and err.count("\n") == 1
    assert [part for part in [*expected, "--html FILE.html` and `warpdef export` work"] if part not in err] == []
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out"]


def test_a_page_needs_no_drawing(monkeypatch, tmp_path):
    Machine(monkeypatch, "import os; os.abort()")
    monkeypatch.delenv("DISPLAY", raising=False)
    assert run(["view", str(save_run(tmp_path / "out")), "--html", str(tmp_path / "a.html")]) == 0
    assert (tmp_path / "a.html").stat().st_size > 10_000


def test_a_trial_that_hangs_is_ended(monkeypatch):
    Machine(monkeypatch, "import time; time.sleep(600)")
    monkeypatch.setattr(view_probe, "_SECONDS", 0.2)
    probe = RenderingProbe(window=False)
    with pytest.raises(MissingPackageError, match="no picture after"):
        probe.require()
    assert probe._process.poll() is not None


def test_no_screen_no_window(monkeypatch, tmp_path, capfd):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setattr(subprocess, "Popen", None)
    assert run(["view", str(save_run(tmp_path / "out"))]) == 2
    assert "no screen for a window (DISPLAY is not set); use --screenshot" in capfd.readouterr().err
