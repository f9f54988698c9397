"""The web page holds the motion, needs nothing from outside, and moves in a real browser."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
import zlib
from pathlib import Path

import numpy as np
import pytest
from present import present
from view_samples import BAR, VERTICES, save_clouds, save_run, save_truth

from warpdef.apps.main import run
from warpdef.apps.viewer.page_data import lower_neighbours, pack_moving

BROWSER = next((p for name in ("chromium", "chromium-browser", "google-chrome") if (p := shutil.which(name))), None)


def scene_of(page: Path) -> dict:
    text = page.read_text(encoding="utf-8")
    (scene,) = re.findall(r'<script id="scene" type="application/json">(.*?)</script>', text)
    return json.loads(scene)


def inflated(text: str, kind: str = "<u1") -> np.ndarray:
    """Numbers that lie byte by byte, the lowest first, deflated."""
    size = np.dtype(kind).itemsize
    planes = np.frombuffer(zlib.decompress(base64.b64decode(text)), "u1").reshape(size, -1)
    return np.ascontiguousarray(planes.T).view(kind).reshape(-1)


def unfolded(text: str, kind: str) -> np.ndarray:
    folded = inflated(text, kind).astype(np.int64)
    return np.where(folded % 2, -(folded + 1) // 2, folded // 2)


def undone(text: str, kind: str, frames: int, parents: list[int]) -> np.ndarray:
    """What moves, (frames, V, columns): sums over the parents, then over the frames."""
    change = unfolded(text, kind).reshape(frames, -1, len(parents))
    for v, parent in enumerate(parents[1:], 1):
        change[:, :, v] += change[:, :, parent]
    return (np.cumsum(change, axis=0) % 2 ** (8 * np.dtype(kind).itemsize)).transpose(0, 2, 1)


def parents_of(faces: np.ndarray, count: int) -> list[int]:
    """Of each vertex the neighbour with the largest index below its own."""
    near: list[set[int]] = [set() for _ in range(count)]
    for face in faces.tolist():
        for v in face:
            near[v] |= {u for u in face if u < v}
    return [max(lower, default=v - 1) for v, lower in enumerate(near)]


PARENTS = parents_of(BAR.faces, VERTICES.shape[1])


def write(tmp_path: Path, *arguments: str, vertices: np.ndarray = VERTICES) -> Path:
    out = tmp_path / "out" if (tmp_path / "out").is_dir() else save_run(tmp_path / "out", vertices)
    save_clouds(out / "clouds.npz")
    save_truth(out / "truth.npz", 0.05)
    assert run(["view", str(out), "--html", str(tmp_path / "a.html"), *arguments]) == 0
    return tmp_path / "a.html"


def test_the_motion_is_in_the_page(tmp_path):
    scene = scene_of(write(tmp_path))
    (pane,) = scene["panes"]
    low, size = np.array(scene["low"]), np.array(scene["size"])
    stored = undone(pane["positions"], "<u2", 5, PARENTS) / 65535
    np.testing.assert_allclose(low + size * stored, VERTICES, rtol=0, atol=size.max() / 65535)
    np.testing.assert_array_equal(np.cumsum(unfolded(pane["faces"], "<u4")).reshape(-1, 3), BAR.faces)
    assert len(inflated(pane["colors"])) == VERTICES.shape[1] * 4
    checker, rest = pane["checker"], VERTICES[2]
    assert (checker["frame"], checker["low"]) == (2, rest.min(axis=0).tolist())
    assert checker["scale"] == pytest.approx(20 / np.ptp(rest, axis=0).max())
    cloud = low + size * undone(pane["cloud"], "<u2", 1, list(range(-1, 299)))[0] / 65535
    assert pane["cloudCounts"] == [60] * 5
    np.testing.assert_allclose(np.sort(cloud[:60], 0), np.sort(BAR.clouds[0], 0), rtol=0, atol=size.max() / 65535)
    assert (scene["frames"], scene["fps"], scene["names"][4]) == (5, 12.0, "scan4.ply")


def test_the_page_says_what_it_is(tmp_path):
    text = write(tmp_path).read_text(encoding="utf-8")
    about = f"one moving mesh, 5 frames, {VERTICES.shape[1]:,} vertices, {len(BAR.faces):,} triangles"
    assert f"<title>out: {about}</title>" in text and f"<b>out</b> {about}" in text
    assert run(["view", str(tmp_path / "out"), "--html", str(tmp_path / "b.html"), "--frames", ":1"]) == 0
    assert "<title>out: one moving mesh, 1 frame, " in (tmp_path / "b.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_differences_of_any_size_come_back(kind):
    """Those that wrap around, too; and vertices without neighbours, or twice in a face."""
    faces = np.array([[0, 3, 2], [4, 4, 1], [6, 4, 2]])
    parents = lower_neighbours(faces, 8)
    assert parents.tolist() == [-1, 0, 0, 2, 2, 4, 4, 6]
    values = np.random.default_rng(0).integers(0, np.iinfo(kind).max, (4, 8, 2), dtype=kind, endpoint=True)
    stored = pack_moving(values, parents)
    np.testing.assert_array_equal(undone(stored, np.dtype(kind).newbyteorder("<").str, 4, parents.tolist()), values)


def test_what_moves_smoothly_is_small():
    wave = 20000.0 + 10000.0 * np.sin(np.arange(40)[:, None, None] / 10.0 + BAR.vertices[0])
    stored = pack_moving(wave.astype(np.uint16), np.array(PARENTS))
    assert len(stored) < 0.7 * 2 * wave.size


def test_flags_reach_the_page(tmp_path):
    flags = ["--side-by-side", "--color", "error", "--cloud", "--wireframe", "--flat", "--fps", "7", "--up", "z"]
    scene = scene_of(write(tmp_path, *flags, "--frame", "3", "--frames", "1:", "--unit", "mm"))
    assert [pane["title"] for pane in scene["panes"]] == ["input", "reconstruction", "truth"]
    assert (scene["fps"], scene["up"], scene["frame"], scene["frames"]) == (7.0, "z", 3, 4)
    assert (scene["cloud"], scene["wireframe"], scene["smooth"]) == (True, True, False)
    pane = scene["panes"][1]
    assert pane["label"] == "distance to surface, mm"
    values = undone(pane["values"], "<u1", 4, PARENTS)
    low, high = pane["limits"]
    assert low == 0.0 and 0.03 < high <= 0.05  # the truth was moved by 0.05 along z
    assert values.max() == 254 and len(inflated(pane["table"])) == 256 * 3
    largest = re.fullmatch("ends at the 99th percentile; largest (.*)", pane["ends"])
    assert largest and high <= float(largest[1]) <= 0.0501
    assert scene["panes"][2]["limits"] == [low, high] and "values" in scene["panes"][2]
    assert "colors" not in scene["panes"][0]


def test_chosen_ends_and_colours_reach_the_page(tmp_path):
    usual = scene_of(write(tmp_path, "--color", "error"))["panes"][0]
    chosen = scene_of(write(tmp_path, "--color", "error", "--clim", "-1", "2", "--cmap", "magma", "--overwrite"))
    pane = chosen["panes"][0]
    assert pane["limits"] == [-1.0, 2.0] and pane["table"] != usual["table"]


def test_plain_pages_and_single_frames(tmp_path):
    scene = scene_of(write(tmp_path, "--color", "plain", "--frames", ":1"))
    assert not {"colors", "checker"} & set(scene["panes"][0]) and scene["frames"] == 1


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


def state_in_browser(page: Path, window: str = "800,600") -> dict[str, str]:
    """What a page's root element says of it after two seconds of its own time, without a word of complaint."""
    flags = "--headless --no-sandbox --disable-quic --no-first-run --disable-background-networking --disable-sync"
    flags += " --disable-component-update --use-angle=swiftshader --enable-unsafe-swiftshader"
    flags += f" --user-data-dir={page.parent / 'profile'} --enable-logging=stderr --dump-dom --window-size={window}"
    assert BROWSER is not None
    command = [BROWSER, *flags.split(), "--virtual-time-budget=2000", page.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert re.findall(r".*CONSOLE.*", done.stderr) == []
    return dict(re.findall(r'data-(\w+)="([^"]*)"', present(re.search("<html[^>]*>", done.stdout))[0]))


@pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")
@pytest.mark.parametrize("side_by_side", [False, True])
def test_it_moves_in_chromium(tmp_path, side_by_side):
    page = write(tmp_path, *(["--side-by-side", "--color", "error", "--cloud", "--flat"] if side_by_side else []))
    # The browser under load may draw a single picture in any time given: turn the page's own clock by hand.
    turn = "const seen = new Set(); for (let i = 1; i <= 30; ++i) { tick(last + 50); seen.add(root.frame); }"
    unpack = """const pane = S.panes.find(pane => pane.faces), n = pane.count, rows = new Uint16Array(S.frames * n * 4);
    const near = lowerNeighbours(await indices(pane.faces), n);
    await moving(pane.positions, S.frames, n, 3, 2, near, rows, 0);
    root.sum = rows.reduce((sum, row, i) => sum + row * (i % 97 + 1), 0);"""
    after = f"started.then(async () => {{ {turn} root.seen = seen.size; {unpack} root.done = 1; }})"
    turned = tmp_path / "turned.html"
    turned.write_text(page.read_text().replace("</body>", f"<script>{after}</script></body>"))

    state = state_in_browser(turned)
    assert state["ready"] == "1" and int(state["drawn"]) > 1 and "error" not in state
    assert int(state["seen"]) == 5 and state["done"] == "1"
    scene = scene_of(page)
    low, size = np.array(scene["low"]), np.array(scene["size"])
    rows = np.zeros((*VERTICES.shape[:2], 4), dtype=int)
    rows[..., :3] = np.rint((VERTICES - low) / size * 65535)
    assert int(state["sum"]) == (rows.reshape(-1) * (np.arange(rows.size) % 97 + 1)).sum()


@pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")
def test_panes_stack_in_a_narrow_window(tmp_path):
    page = write(tmp_path, "--side-by-side")
    columns = [int(state_in_browser(page, window)["columns"]) for window in ("1600,500", "500,1200")]
    assert columns[0] == 3 and columns[1] < 3
