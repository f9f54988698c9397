"""The window itself, under a virtual X server; skipped where there is none."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from present import present
from view_samples import drawing, save_clouds, save_run, save_truth  # noqa: F401

from warpdef.apps.viewer.window import HELP, KEYS

XVFB = shutil.which("Xvfb")
needs_screen = pytest.mark.skipif(XVFB is None, reason="no Xvfb on this machine")

DRIVER = """
import json, sys, time
from pathlib import Path
import numpy as np
from warpdef.apps.viewer.content import load_content
from warpdef.apps.viewer.player import Player
from warpdef.apps.viewer.flat import letter_size
from warpdef.apps.viewer.scene import Scene
from warpdef.apps.viewer.timeline import SLIDER_AT
from warpdef.apps.viewer.window import KEYS, Window

out, folder = Path(sys.argv[1]), Path(sys.argv[2])
scene = Scene(load_content(out), off_screen=False, size=(400, 300))
player, told = Player(5, 12.0), []
window = Window(scene, player, folder, told.append)
window.open("a test")
interactor = scene.plotter.iren.interactor

def press(key):
    interactor.SetKeySym(key)
    interactor.InvokeEvent("KeyPressEvent")
    window.spin(time.monotonic())

def state():
    look = scene.look
    return [player.frame, player.playing, player.loop, player.speed, look.color, look.cloud, look.trajectories,
            look.wireframe, look.smooth, look.scale_bar, list(scene.plotter.renderers[0].camera.position),
            scene.frame, window._helping]

window.spin(time.monotonic())
seen = {}
for key, _, _, name in KEYS[:-1]:
    scene.plotter.renderers[0].camera.position = (1.0, 2.0, 9.0)
    before, shown = state(), scene.picture().astype(int)
    press(key)
    after = state()
    seen[name] = [before, after, float((np.abs(scene.picture().astype(int) - shown).max(axis=2) > 24).mean())]
colours = []
for _ in range(6):
    press("c")
    colours.append(scene.look.color)
press("W")
press("F12")
slider = window._slider.GetRepresentation()
slider.SetValue(3.0)
window._slider.InvokeEvent("InteractionEvent")
window.spin(time.monotonic())
slid = [player.frame, scene.frame]
interactor.SetEventInformation(int(0.2 * 400 + 0.6 * 400 * 3 / 4), round(SLIDER_AT * letter_size((400, 300))))
interactor.InvokeEvent("LeftButtonPressEvent")
interactor.SetEventInformation(int(0.2 * 400), round(SLIDER_AT * letter_size((400, 300))))
interactor.InvokeEvent("MouseMoveEvent")
interactor.InvokeEvent("LeftButtonReleaseEvent")
window.spin(time.monotonic())
dragged = [player.frame, scene.frame]
scene.look.color = "displacement"
scene.place_camera()
scene.refresh()
read = []
for at in ((200, 190), (2, 290)):
    interactor.SetEventInformation(*at)
    interactor.InvokeEvent("MouseMoveEvent")
    window.spin(time.monotonic())
    read.append(scene.captions.reading)
player.go(0, time.monotonic())
window.play()
end = time.monotonic() + 1.0
window.run(lambda: time.monotonic() > end)
played = player.frame
press("q")
window.run()
scene.close()
print(json.dumps({"seen": seen, "colours": colours, "slid": slid, "dragged": dragged, "read": read,
                  "number": scene.captions.timeline.words[0], "played": played, "told": told,
                  "open": window.is_open, "window": type(scene).__name__}))
"""


@pytest.fixture
def screen():
    """A virtual screen: its server, and an environment for what is started on it."""
    read, write = os.pipe()
    command = [XVFB, "-displayfd", str(write), "-screen", "0", "800x600x24", "-nolisten", "tcp", "-noreset"]
    server = subprocess.Popen(command, pass_fds=[write], stderr=subprocess.DEVNULL)
    os.close(write)
    with os.fdopen(read) as stream:
        number = stream.readline().strip()
    try:
        yield server, {**os.environ, "DISPLAY": f":{number}"}
    finally:
        server.terminate()
        server.wait(timeout=20)


@pytest.fixture
def display(screen):
    """The environment alone."""
    return screen[1]


@pytest.fixture
def out(tmp_path) -> Path:
    out = save_run(tmp_path / "out")
    save_clouds(out / "clouds.npz")
    save_truth(out / "truth.npz", 0.05)
    return out


def test_every_key_is_in_the_help():
    assert len(HELP.splitlines()) == len(KEYS) + 2
    assert len({key for key, *_ in KEYS}) == len(KEYS) == len({name for *_, name in KEYS})


@needs_screen
@pytest.mark.usefixtures("drawing")
def test_each_key_in_a_real_window(tmp_path, out, display):
    (tmp_path / "pictures").mkdir()
    arguments = [sys.executable, "-c", DRIVER, str(out), str(tmp_path / "pictures")]
    done = subprocess.run(arguments, env=display, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    names = "frame playing loop speed color cloud trajectories wireframe smooth scale camera shown helping".split()
    changes = {
        name: {n: (b, a) for n, b, a in zip(names, before, after, strict=True) if b != a and n != "camera"}
        for name, (before, after, _) in found["seen"].items()
    }
    assert changes["play"] == {"playing": (False, True)}
    assert changes["forward"]["playing"] == (True, False)
    assert changes["back"]["frame"][0] - changes["back"]["frame"][1] in (1, -4)
    assert found["seen"]["first"][1][0] == 0 == found["seen"]["first"][1][11]
    assert found["seen"]["last"][1][0] == 4 == found["seen"]["last"][1][11]
    assert changes["faster"] == {"speed": (1.0, 2.0)} and changes["slower"] == {"speed": (2.0, 1.0)}
    assert changes["loop"] == {"loop": (True, False)}
    assert changes["colour"] == {"color": ("template", "plain")}
    assert changes["cloud"] == {"cloud": (False, True)}
    assert changes["trajectories"] == {"trajectories": (False, True)}
    assert changes["wireframe"] == {"wireframe": (False, True)}
    assert changes["smooth"] == {"smooth": (True, False)}
    assert changes["scale"] == {"scale": (False, True)}
    assert changes["camera"] == {} and found["seen"]["camera"][1][10] != [1.0, 2.0, 9.0]
    assert changes["help"] == {"helping": (False, True)}
    for name in ("last", "colour", "cloud", "wireframe", "help", "camera"):
        assert found["seen"][name][2] > 0.001, name
    kept = ["warpdef-001.png", "warpdef-camera-001.json"]
    assert sorted(p.name for p in (tmp_path / "pictures").iterdir()) == kept
    assert [name in "".join(found["told"]) for name in kept] == [True, True] and len(found["told"]) == 2
    assert json.loads((tmp_path / "pictures" / kept[1]).read_text())["position"] == [1.0, 2.0, 9.0]
    assert found["colours"] == ["error", "stretch", "displacement", "template", "plain", "error"]
    assert found["slid"] == [3, 3]
    assert found["dragged"] == [0, 0]
    there, nowhere = found["read"]
    assert "input units, vertex" in there and nowhere == ""
    assert found["played"] == 4  # a second at 12 frames a second, without loop
    assert found["open"] is False


@needs_screen
@pytest.mark.usefixtures("drawing")
def test_the_command_opens_a_window_and_ends(out, display):
    code = (
        "import sys; from warpdef.apps.viewer import window as w; from warpdef.apps.main import run\n"
        "drawn = []\n"
        "spin = w.Window.spin\n"
        "def once(self, now):\n"
        "    changed = spin(self, now)\n"
        "    drawn.append(self.player.frame)\n"
        "    if max(drawn) >= 3: self.press('q')\n"
        "    return changed\n"
        "w.Window.spin = once\n"
        f"sys.exit(run(['view', {str(out)!r}, '--side-by-side', '--size', '300x200']))"
    )
    done = subprocess.run([sys.executable, "-c", code], env=display, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert done.stderr == "warpdef: h in the window lists the keys\n" and done.stdout == ""


@pytest.mark.usefixtures("drawing")
def test_a_screen_that_is_not_there(out):
    arguments = [sys.executable, "-m", "warpdef.apps.main", "view", str(out)]
    environment = {**os.environ, "DISPLAY": ":54321"}
    done = subprocess.run(arguments, env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert done.stderr.startswith("warpdef: error: the screen DISPLAY=:54321 does not answer")


@needs_screen
@pytest.mark.usefixtures("drawing")
def test_a_screen_that_is_lost_meanwhile(out, screen):
    server, environment = screen
    arguments = [sys.executable, "-m", "warpdef.apps.main", "view", str(out)]
    process = subprocess.Popen(arguments, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    first = present(process.stderr).readline()
    server.kill()
    text, err = process.communicate(timeout=120)
    assert first == "warpdef: h in the window lists the keys\n" and text == ""
    assert process.returncode == 2
    assert err.startswith(f"warpdef: error: the screen DISPLAY={environment['DISPLAY']} ") and err.count("\n") == 1
