"""``reconstruct --live``: the window gets what it can take, and nothing that happens to it touches the run."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from present import present
from test_view_window import display, needs_screen, screen  # noqa: F401
from view_samples import BAR, VERTICES, drawing  # noqa: F401

from warpdef.apps.viewer import live
from warpdef.apps.viewer.live import GIVEN, TAKEN, LiveView
from warpdef.apps.viewer.live_window import Allowance
from warpdef.mesh import MeshSequence
from warpdef.progress import Progress
from warpdef.sequence import PointSequence

SEQUENCE = PointSequence.from_arrays(BAR.clouds)
MESHES = MeshSequence(VERTICES, BAR.faces)

IDLE = "import sys, time; time.sleep(60)"


class CountedHand:
    """Hands out a mesh, and counts how often it was asked."""

    def __init__(self) -> None:
        self.asked = 0

    def __call__(self) -> MeshSequence:
        self.asked += 1
        return MESHES

    def progress(self, iteration: int = 1) -> Progress:
        return Progress("optimise", iteration, 9, meshes=self)


@pytest.fixture
def told(monkeypatch) -> list[str]:
    monkeypatch.setenv("DISPLAY", ":99")
    monkeypatch.setattr(live, "_SECONDS", 0.0)
    monkeypatch.setattr(live, "_SHARE", 1e9)
    monkeypatch.setattr(live, "_PATIENCE", 0.1)
    return []


def start(monkeypatch, told: list[str], program: str) -> LiveView:
    """A view whose window is ``program``."""
    popen = subprocess.Popen
    monkeypatch.setattr(live.subprocess, "Popen", lambda command, **how: popen([sys.executable, "-c", program], **how))
    return LiveView(SEQUENCE, "a test", told.append)


def test_a_mesh_is_asked_for_only_when_the_last_was_taken(monkeypatch, told):
    view, hand = start(monkeypatch, told, IDLE), CountedHand()
    view(Progress("template"))
    for iteration in range(5):
        view(hand.progress(iteration))
    assert hand.asked == 1
    folder = present(view._folder)
    with np.load(folder / "scene.npz") as scene:
        np.testing.assert_array_equal(scene["faces"], BAR.faces)
        np.testing.assert_array_equal(scene["cloud_0003"], BAR.clouds[3].astype(np.float32))
        assert scene["names"].tolist() == list(SEQUENCE.frame_names)
    shared = np.memmap(folder / "vertices", dtype="f4", mode="r", shape=VERTICES.shape)
    np.testing.assert_array_equal(shared, VERTICES)
    view._control[TAKEN] = view._control[GIVEN]
    view(hand.progress())
    assert hand.asked == 2
    monkeypatch.setattr(live, "_SECONDS", 60.0)
    for _ in range(3):
        view._control[TAKEN] = view._control[GIVEN]
        view(hand.progress())
    assert hand.asked == 3
    view.close()
    assert told == [] and not folder.exists()


def test_handing_out_keeps_to_its_share(monkeypatch, told):
    now, spent = [0.0], [0.0]
    monkeypatch.setattr(live.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(live, "_SECONDS", 0.25)
    monkeypatch.setattr(live, "_SHARE", 0.02)
    view = start(monkeypatch, told, IDLE)

    def slow() -> MeshSequence:
        now[0], spent[0] = now[0] + 0.1, spent[0] + 0.1
        return MESHES

    while now[0] < 60.0:
        view(Progress("optimise", 1, 9, meshes=slow))
        if view._control is not None:
            view._control[TAKEN] = view._control[GIVEN]
        now[0] += 0.05
    view.close()
    assert 0.01 < spent[0] / now[0] < 0.022


def test_a_window_that_is_closed_ends_quietly(monkeypatch, told):
    view, hand = start(monkeypatch, told, ""), CountedHand()
    present(view._process).wait()
    view(hand.progress())
    view(hand.progress())
    view.close()
    assert (hand.asked, told) == (0, [])


def test_a_window_that_crashes_is_told_once(monkeypatch, told):
    crash = "import os, sys; print('libGL.so: Failed to load', file=sys.stderr, flush=True); os.kill(os.getpid(), 11)"
    view, hand = start(monkeypatch, told, crash), CountedHand()
    present(view._process).wait()
    for _ in range(3):
        view(hand.progress())
    view.close()
    assert hand.asked == 0 and len(told) == 1
    for part in ("SIGSEGV", "Failed to load", "apt-get install", "libgl1", "goes on without a window"):
        assert part in told[0]


def test_a_screen_that_goes_away_is_named(monkeypatch, told):
    lost = "import sys; sys.exit('X connection to :99 broken (explicit kill or server shutdown).')"
    view, hand = start(monkeypatch, told, lost), CountedHand()
    present(view._process).wait()
    view(hand.progress())
    view.close()
    (line,) = told
    assert "the screen DISPLAY=:99" in line and "apt-get" not in line and "goes on without a window" in line


def test_without_a_screen_nothing_is_started(monkeypatch, told):
    monkeypatch.delenv("DISPLAY")
    monkeypatch.setattr(live.subprocess, "Popen", None)
    view, hand = LiveView(SEQUENCE, "a test", told.append), CountedHand()
    view(hand.progress())
    view.close()
    assert hand.asked == 0 and "no screen" in told[0] and "goes on without a window" in told[0]


def test_a_full_disk_ends_the_window(monkeypatch, told):
    view, hand = start(monkeypatch, told, IDLE), CountedHand()

    def full(*_arguments, **_how):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    view(hand.progress())
    view(hand.progress())
    view.close()
    assert hand.asked == 1 and len(told) == 1 and "No space left" in told[0]


def test_drawing_keeps_to_its_share():
    allowance, now, used = Allowance(0.1, 0.0, 0.0), 0.0, 0.0
    while now < 100.0:
        rest = allowance.wait(now, used)
        now, used = (now + rest, used) if rest else (now + 0.05, used + 0.05)
    assert 0.09 < used / now < 0.101
    # After a long rest there is no burst: the second draw waits.
    assert allowance.wait(now + 1000.0, used) == 0.0
    assert allowance.wait(now + 1000.1, used + 0.1) == pytest.approx(0.9)


DRIVER = """
import sys, time
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from test_view_live import MESHES, SEQUENCE, TAKEN, Progress, LiveView
view = LiveView(SEQUENCE, "a test", lambda text: print(text, flush=True))
end, shown = time.monotonic() + 60.0, 0
while time.monotonic() < end and shown < 3:
    view(Progress("optimise", shown, 3, meshes=lambda: MESHES))
    shown = 0 if view._control is None else int(view._control[TAKEN])
    time.sleep(0.05)
process = view._process
view.close()
print("shown", shown, "ended", process.returncode, flush=True)
"""


@needs_screen
@pytest.mark.usefixtures("drawing")
def test_a_real_window_takes_meshes_and_closes(display):  # noqa: F811
    command = [sys.executable, "-c", DRIVER, str(Path(__file__).parent)]
    done = subprocess.run(command, env=display, capture_output=True, text=True, timeout=150)
    assert done.stdout.splitlines() == ["shown 3 ended 0"], done.stdout + done.stderr


def test_the_window_ends_with_its_run(tmp_path):
    """A run that was killed leaves no window behind."""
    command = [sys.executable, "-m", "warpdef.apps.viewer.live_window", str(tmp_path), "a test", "1"]
    pytest.importorskip("pyvista")
    assert subprocess.run(command, timeout=60).returncode == 0
