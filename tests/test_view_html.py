"""The web page holds the motion, needs nothing from outside, and moves in a real browser."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from present import present
from view_samples import BAR, VERTICES, save_clouds, save_run, save_truth

from warpdef.apps.main import run

BROWSER = next((p for name in ("chromium", "chromium-browser", "google-chrome") if (p := shutil.which(name))), None)


def scene_of(page: Path) -> dict:
    text = page.read_text(encoding="utf-8")
    (scene,) = re.findall(r'<script id="scene" type="application/json">(.*?)</script>', text)
    return json.loads(scene)


def decoded(text: str, kind: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), kind)


def write(tmp_path: Path, *arguments: str, vertices: np.ndarray = VERTICES) -> Path:
    out = save_run(tmp_path / "out", vertices)
    save_clouds(out / "clouds.npz")
    save_truth(out / "truth.npz", 0.05)
    assert run(["view", str(out), "--html", str(tmp_path / "a.html"), *arguments]) == 0
    return tmp_path / "a.html"


def test_the_motion_is_in_the_page(tmp_path):
    scene = scene_of(write(tmp_path))
    (pane,) = scene["panes"]
    low, size = np.array(scene["low"]), np.array(scene["size"])
    stored = decoded(pane["positions"], "<u2").reshape(VERTICES.shape) / 65535
    np.testing.assert_allclose(low + size * stored, VERTICES, rtol=0, atol=size.max() / 65535)
    np.testing.assert_array_equal(decoded(pane["faces"], "<u4").reshape(-1, 3), BAR.faces)
    assert len(decoded(pane["colors"], "u1")) == VERTICES.shape[1] * 3
    cloud = low + size * decoded(pane["cloud"], "<u2").reshape(-1, 3) / 65535
    assert pane["cloudCounts"] == [60] * 5
    np.testing.assert_allclose(np.sort(cloud[:60], 0), np.sort(BAR.clouds[0], 0), rtol=0, atol=size.max() / 65535)
    assert (scene["frames"], scene["fps"], scene["names"][4]) == (5, 12.0, "scan4.ply")


def test_flags_reach_the_page(tmp_path):
    flags = ["--side-by-side", "--color", "error", "--cloud", "--wireframe", "--flat", "--fps", "7", "--up", "z"]
    scene = scene_of(write(tmp_path, *flags, "--frame", "3", "--frames", "1:", "--unit", "mm"))
    assert [pane["title"] for pane in scene["panes"]] == ["input", "reconstruction", "truth"]
    assert (scene["fps"], scene["up"], scene["frame"], scene["frames"]) == (7.0, "z", 3, 4)
    assert (scene["cloud"], scene["wireframe"], scene["smooth"]) == (True, True, False)
    pane = scene["panes"][1]
    assert pane["label"] == "distance to surface, mm"
    values = decoded(pane["values"], "u1").reshape(4, -1)
    low, high = pane["limits"]
    assert low == 0.0 and 0.03 < high <= 0.05  # the truth was moved by 0.05 along z
    assert values.max() == 254 and len(decoded(pane["table"], "u1")) == 256 * 3
    assert "colors" not in scene["panes"][2]


def test_plain_pages_and_single_frames(tmp_path):
    scene = scene_of(write(tmp_path, "--color", "plain", "--frames", ":1"))
    assert "colors" not in scene["panes"][0] and scene["frames"] == 1


def test_nothing_is_fetched_and_no_text_breaks_out(tmp_path):
    out = save_run(tmp_path / "out")
    with np.load(out / "sequence.npz") as stored:
        arrays = {name: stored[name] for name in stored.files}
    arrays["names"] = np.array(["</script><script>alert(1)</script>", "b", "c", "d", "@SCRIPT@ @TITLE@"])
    np.savez(out / "sequence.npz", **arrays)
    assert run(["view", str(out), "--html", str(tmp_path / "a.html")]) == 0
    text = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert "<script>alert" not in text and text.count("</script>") == 2
    assert scene_of(tmp_path / "a.html")["names"] == arrays["names"].tolist()
    assert re.findall(r"https?://|src=|@import|url\(|fetch\(|XMLHttpRequest", text) == []


def test_changing_triangles_are_refused(tmp_path, capfd):
    out = save_run(tmp_path / "out")
    (tmp_path / "truth").mkdir()
    for t in range(5):
        faces = BAR.faces if t else BAR.faces[1:]
        lines = [f"v {x} {y} {z}" for x, y, z in BAR.vertices[t]] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
        (tmp_path / "truth" / f"{t}.obj").write_text("\n".join(lines))
    arguments = ["--truth", str(tmp_path / "truth"), "--side-by-side", "--html", str(tmp_path / "a.html")]
    assert run(["view", str(out), *arguments]) == 2
    assert "same triangles in all frames" in capfd.readouterr().err
    assert not (tmp_path / "a.html").exists()


@pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")
@pytest.mark.parametrize("side_by_side", [False, True])
def test_it_moves_in_chromium(tmp_path, side_by_side):
    page = write(tmp_path, *(["--side-by-side", "--color", "error", "--cloud", "--flat"] if side_by_side else []))
    flags = "--headless --no-sandbox --disable-quic --no-first-run --disable-background-networking --disable-sync"
    flags += " --disable-component-update --use-angle=swiftshader --enable-unsafe-swiftshader"
    flags += f" --user-data-dir={tmp_path / 'profile'} --enable-logging=stderr --dump-dom"

    # The browser under load may draw a single picture in any time given: turn the page's own clock by hand.
    turn = "const seen = new Set(); for (let i = 1; i <= 30; ++i) { tick(last + 50); seen.add(root.frame); }"
    turned = tmp_path / "turned.html"
    turned.write_text(page.read_text().replace("</body>", f"<script>{turn} root.seen = seen.size;</script></body>"))

    command = [BROWSER, *flags.split(), "--virtual-time-budget=2000", turned.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert re.findall(r".*CONSOLE.*", done.stderr) == []
    state = dict(re.findall(r'data-(\w+)="([^"]*)"', present(re.search("<html[^>]*>", done.stdout))[0]))
    assert state["ready"] == "1" and int(state["drawn"]) > 1 and "error" not in state
    assert int(state["seen"]) == 5
