"""Pictures and movies without a window; skipped where the machine cannot draw."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from present import present
from view_samples import BAR, VERTICES, drawing, save_clouds, save_run, save_truth  # noqa: F401

from warpdef.apps.main import run
from warpdef.apps.viewer import probe as view_probe
from warpdef.apps.viewer.actors import Look
from warpdef.apps.viewer.camera import Stand, pixels_per_length
from warpdef.apps.viewer.camera_file import save_camera
from warpdef.apps.viewer.content import Content, Pane, load_content
from warpdef.apps.viewer.scene import Scene
from warpdef.mesh import MeshSequence

pytestmark = pytest.mark.usefixtures("drawing", "proven")
SIZE = ["--size", "160x120"]


@pytest.fixture
def proven(monkeypatch) -> None:
    """The machine has shown once that it draws; it need not before every picture."""
    monkeypatch.setattr(view_probe, "_PROGRAM", "")


@pytest.fixture
def out(tmp_path) -> Path:
    """A run with its clouds and truth beside it, as a demo leaves it."""
    out = save_run(tmp_path / "out")
    save_clouds(out / "clouds.npz")
    save_truth(out / "truth.npz", 0.05)
    return out


def picture(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path).convert("RGB")).astype(int)


def shot(out: Path, *arguments: str) -> np.ndarray:
    path = out.parent / "a.png"
    assert run(["view", str(out), "--screenshot", str(path), "--overwrite", *SIZE, *arguments]) == 0
    assert sorted(p.name for p in out.parent.iterdir()) == ["a.png", "out"]
    return picture(path)


def differs(a: np.ndarray, b: np.ndarray) -> float:
    """Share of pixels that differ clearly."""
    return float((np.abs(a - b).max(axis=2) > 24).mean())


def test_a_screenshot_says_what_it_is(out, capfd):
    assert shot(out).shape == (120, 160, 3)
    text, err = capfd.readouterr()
    assert text.startswith(f"frame 0: {out.parent / 'a.png'} (") and not err


def test_each_flag_changes_the_picture(out):
    plain = shot(out, "--color", "plain")
    others = {
        "frame": ["--frame", "4"],
        "cloud": ["--cloud"],
        "trajectories": ["--trajectories"],
        "wireframe": ["--wireframe"],
        "panes": ["--side-by-side"],
        "up": ["--up", "z"],
    }
    shots = {name: shot(out, "--color", "plain", *flags) for name, flags in others.items()}
    shots |= {color: shot(out, "--color", color) for color in ("template", "error", "displacement")}
    assert {name: d for name, s in shots.items() if (d := differs(s, plain)) < 0.002} == {}


def test_flat_shading_shows_the_triangles(out):
    smooth, flat = (shot(out, "--color", "plain", *flags) for flags in ([], ["--flat"]))
    assert np.abs(smooth - flat).max() > 10


def test_the_picture_is_of_the_mesh(out):
    seen = np.any(shot(out, "--color", "plain") < 240, axis=2)[30:]
    assert 0.02 < seen.mean() < 0.5
    assert not seen[:, [0, -1]].any() and not seen[-1].any()


def test_chosen_ends_and_colours_change_the_picture(out):
    error = shot(out, "--color", "error")
    assert differs(shot(out, "--color", "error", "--clim", "0", "1"), error) > 0.01
    assert differs(shot(out, "--color", "error", "--cmap", "magma"), error) > 0.01


def test_the_bar_says_its_numbers_and_ends(out):
    made = Scene(load_content(out), off_screen=True, size=(400, 300), look=Look("displacement", clim=(0.0, 2.0)))
    try:
        made.show(2)
        bar = made.captions.bar
        assert bar.labels == ["0", "0.5", "1", "1.5", "2"]
        assert bar.words == ("displacement, input units", "ends as chosen; maximum in this frame 0")
        assert made.captions.titles == ["reconstruction", "frame 2 of 5 (0 to 4): scan2.ply"]
        made.look.color = "plain"
        made.refresh()
        assert bar.labels == [""] * 5 and bar.words == ("", "")
    finally:
        made.close()


@pytest.mark.parametrize("wireframe", [False, True])
def test_the_checker_does_not_need_vertices(wireframe):
    # A square of two triangles: 20 cells along each side, between corners of one colour each.
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    meshes = MeshSequence(square[None], np.array([[0, 1, 2], [0, 2, 3]]))
    content = Content([Pane("a", meshes)], ("0",))
    made = Scene(content, off_screen=True, size=(400, 400), look=Look(wireframe=wireframe), stand=Stand(0.0, 0.0))
    try:
        seen = made.picture().astype(int).sum(axis=2)
        made.look.color = "plain"
        made.refresh()
        plain = made.picture().astype(int).sum(axis=2)
    finally:
        made.close()
    row, column = (np.abs(np.diff(line)) > 25 for line in (seen[230, 40:-40], seen[60:-40, 180]))
    assert row.sum() > 12 and column.sum() > 12
    assert (np.abs(np.diff(plain[230, 40:-40])) > 25).sum() <= 4


def test_colors_of_its_own_are_shown(out):
    with np.load(out / "sequence.npz") as stored:
        arrays = {name: stored[name] for name in stored.files}
    red = np.tile(np.array([255, 0, 0, 255], dtype=np.uint8), (VERTICES.shape[1], 1))
    np.savez(out / "sequence.npz", **arrays, vertex_colors=red)
    seen = shot(out)[30:]
    body = (seen < 240).any(axis=2)
    assert (seen[body][:, 0] > seen[body][:, 1] + 50).mean() > 0.8


def test_a_contact_sheet(out):
    sheet = shot(out, "--sheet", "5", "--color", "plain")
    assert sheet.shape == (177, 320, 3)  # two tiles in a row, as wide as --size says, and as flat as the bar
    tiles = [sheet[y : y + 59, x : x + 160] for y in (0, 59, 118) for x in (0, 160)]
    assert differs(tiles[0], tiles[4]) > 0.01 and (tiles[5] == 255).all()
    bodies = [np.any(tile[20:] < 240, axis=2) for tile in tiles[:5]]
    assert all(body.any() and not body[:, [0, -1]].any() and not body[-1].any() for body in bodies)
    assert max(np.ptp(np.nonzero(body.any(axis=0))[0]) for body in bodies) > 0.6 * 160


def test_a_sheet_has_one_bar(out):
    plain, measured = shot(out, "--sheet", "2", "--color", "plain"), shot(out, "--sheet", "2", "--color", "error")
    assert measured.shape[1:] == plain.shape[1:] and 40 < len(measured) - len(plain) < 100
    foot = measured[len(plain) :]
    # The map's colours from one end to the other, and nowhere else in what is written.
    colored = np.ptp(foot, axis=2).max(axis=0) > 60
    assert 0.4 * foot.shape[1] < colored.sum() < 0.8 * foot.shape[1]


def test_a_movie_after_a_sheet_is_a_movie(out, tmp_path):
    files = ["--screenshot", str(tmp_path / "a.png"), "--movie", str(tmp_path / "a.gif")]
    assert run(["view", str(out), *files, "--sheet", "4", "--color", "error", *SIZE]) == 0
    both = Image.open(tmp_path / "a.gif")
    assert run(["view", str(out), "--movie", str(tmp_path / "b.gif"), "--color", "error", *SIZE]) == 0
    alone = Image.open(tmp_path / "b.gif")
    assert both.size == alone.size and [getattr(image, "n_frames", 1) for image in (both, alone)] == [5, 5]
    assert differs(*(np.asarray(image.convert("RGB")).astype(int) for image in (both, alone))) == 0.0


def test_a_transparent_picture(out, tmp_path):
    for flags in ([], ["--sheet", "3"]):
        opaque = shot(out, "--color", "plain", *flags)
        assert run(["view", str(out), "--screenshot", str(tmp_path / "b.png"), "--transparent", "--color", "plain",
                    *SIZE, *flags]) == 0  # fmt: skip
        with Image.open(tmp_path / "b.png") as image:
            assert image.mode == "RGBA"
            seen = np.asarray(image)
        (tmp_path / "b.png").unlink()
        share = seen[..., 3:] / 255.0
        on_white = seen[..., :3] * share + 255.0 * (1.0 - share)
        assert np.abs(on_white - opaque).max() < 3.0
        assert 0.5 < (share == 0.0).mean() < 0.95 and (share == 1.0).mean() > 0.03


def test_the_scale_bar_is_as_long_as_it_says(out):
    made = Scene(load_content(out, unit="m"), off_screen=True, size=(400, 300), look=Look("plain", scale_bar=True))
    try:
        label = made.captions.scale_bar.label
        dark = np.all(made.picture() < 60, axis=2)
        made.plotter.renderers[0].camera.zoom(1.0)
        camera = made.plotter.renderers[0].camera
        per_length = pixels_per_length(camera.distance, 300)
        camera.position = tuple(np.add(camera.focal_point, 2.0 * np.subtract(camera.position, camera.focal_point)))
        made.picture()
        assert made.captions.scale_bar.label != label  # twice as far away
    finally:
        made.close()
    length, unit = label.split()
    row = dark[200:].sum(axis=1).argmax() + 200
    assert unit == "m" and dark[row].sum() == pytest.approx(float(length) * per_length, abs=3)


def test_a_gif(out, tmp_path):
    assert run(["view", str(out), "--movie", str(tmp_path / "a.gif"), "--fps", "8", *SIZE]) == 0
    with Image.open(tmp_path / "a.gif") as movie:
        assert (movie.n_frames, movie.size, movie.info["loop"]) == (5, (160, 120), 0)
        frames, milliseconds = [], 0
        for t in range(5):
            movie.seek(t)
            milliseconds += movie.info["duration"]
            frames.append(np.asarray(movie.convert("RGB")).astype(int))
    assert milliseconds == 620  # five eighths of a second, in hundredths
    assert differs(frames[0], frames[4]) > 0.01


def test_a_turntable(out, tmp_path, capfd):
    assert run(["view", str(out), "--movie", str(tmp_path / "a.gif"), "--turntable", "--fps", "2", *SIZE]) == 0
    first, second = capfd.readouterr().err.splitlines()
    assert first == "movie: 15 pictures" and second.endswith("s for 15 pictures")
    with Image.open(tmp_path / "a.gif") as movie:
        assert movie.n_frames == 15  # three rounds of five frames, so that the turn takes six seconds
        first, same_frame = [], []
        for t, kept in ((0, first), (5, same_frame)):
            movie.seek(t)
            kept.append(np.asarray(movie.convert("RGB")).astype(int))
    assert differs(first[0], same_frame[0]) > 0.01


def test_an_mp4(out, tmp_path):
    imageio = pytest.importorskip("imageio.v2")
    pytest.importorskip("imageio_ffmpeg")
    assert run(["view", str(out), "--movie", str(tmp_path / "a.mp4"), "--size", "162x122"]) == 0
    frames = [np.asarray(f).astype(int) for f in imageio.get_reader(tmp_path / "a.mp4")]
    assert len(frames) == 5 and frames[0].shape == (122, 162, 3)
    assert differs(frames[0], frames[4]) > 0.01
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.mp4", "out"]


def test_several_outputs_at_once(out, tmp_path):
    paths = [str(tmp_path / name) for name in ("a.png", "a.gif", "a.html")]
    flags = [word for pair in zip(("--screenshot", "--movie", "--html"), paths, strict=True) for word in pair]
    assert run(["view", str(out), *flags, *SIZE]) == 0
    assert all(Path(path).stat().st_size for path in paths)


def scene(out: Path, **look) -> Scene:
    return Scene(load_content(out), off_screen=True, size=(160, 120), look=Look(**look))


def test_a_kept_camera_sees_the_same_again(out, tmp_path):
    made = scene(out, color="plain")
    try:
        made.plotter.renderers[0].camera.azimuth += 60.0
        made.show(0)
        seen = made.picture().astype(int)
        save_camera(tmp_path / "c.json", made.camera, made.content.origin)
    finally:
        made.close()
    assert run(["view", str(out), "--camera", str(tmp_path / "c.json"), "--color", "plain", "--screenshot",
                str(tmp_path / "b.png"), *SIZE]) == 0  # fmt: skip
    assert differs(picture(tmp_path / "b.png"), seen) < 0.001 < differs(shot_usual(tmp_path, out), seen)


def shot_usual(folder: Path, out: Path) -> np.ndarray:
    assert run(["view", str(out), "--color", "plain", "--screenshot", str(folder / "u.png"), *SIZE]) == 0
    return picture(folder / "u.png")


def test_one_actor_is_moved_not_rebuilt(out):
    made = scene(out, cloud=True, trajectories=True)
    try:
        actors = [list(renderer.actors.values()) for renderer in made.plotter.renderers]
        surface = present(made.surfaces[0])
        data = surface.data
        for frame in (3, 1, 4):
            made.show(frame)
            np.testing.assert_array_equal(data.points, VERTICES[frame])
            assert surface.data is data is surface.actor.GetMapper().GetInput()
        assert [list(renderer.actors.values()) for renderer in made.plotter.renderers] == actors
    finally:
        made.close()


def test_the_camera_is_kept_between_frames(out):
    made = scene(out)
    try:
        made.plotter.renderers[0].camera.position = (5.0, 6.0, 7.0)
        made.show(3)
        made.picture()
        assert made.plotter.renderers[0].camera.position == (5.0, 6.0, 7.0)
    finally:
        made.close()


def test_colors_of_every_frame_and_their_trails(out):
    content = load_content(out)
    pane = content.panes[0]
    pane.colors = np.zeros((*VERTICES.shape[:2], 3), dtype=np.uint8)
    pane.colors[pane.keyframe] = [255, 0, 0]
    made = Scene(content, off_screen=True, size=(160, 120), look=Look(trajectories=True))
    try:
        trail = made.trails[0].mapper.dataset
        np.testing.assert_array_equal(trail.point_data["rgb"], np.tile([255, 0, 0], (trail.n_points, 1)))
    finally:
        made.close()


def test_vertices_may_change_while_it_is_shown(out):
    made = scene(out, color="displacement", trajectories=True)
    try:
        made.show(4)
        before, actor = made.picture().astype(int), present(made.surfaces[0]).actor
        moved = VERTICES + np.arange(5, dtype=np.float32)[:, None, None] * [0.05, 0.0, 0.0]
        made.set_vertices(0, MeshSequence(moved, BAR.faces))
        made.refresh()
        assert present(made.surfaces[0]).actor is actor
        np.testing.assert_array_equal(present(made.surfaces[0]).data.points, moved[4].astype(np.float32))
        assert differs(made.picture().astype(int), before) > 0.005
    finally:
        made.close()


def test_triangles_may_change_from_frame_to_frame(out, tmp_path):
    (tmp_path / "truth").mkdir()
    for t in range(5):
        faces = BAR.faces if t != 2 else BAR.faces[::2]
        lines = [f"v {x} {y} {z}" for x, y, z in BAR.vertices[t]] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
        (tmp_path / "truth" / f"{t}.obj").write_text("\n".join(lines))
    content = load_content(out, truth=tmp_path / "truth", side_by_side=True)
    made = Scene(content, off_screen=True, size=(240, 120))
    try:
        for frame in (1, 2, 3):
            made.show(frame)
            made.picture()
            count = len(BAR.faces) if frame != 2 else len(BAR.faces[::2])
            assert present(made.surfaces[2]).data.n_cells == count
    finally:
        made.close()
