"""What ``warpdef view`` decides before anything is drawn."""

from __future__ import annotations

import numpy as np
import pytest
from present import present
from synthetic import icosphere
from view_samples import BAR, FRAMES, VERTICES, save_clouds, save_run, save_truth

from warpdef.apps.main import run
from warpdef.apps.view import parse_size
from warpdef.apps.viewer.actors import edge_length, point_spacing
from warpdef.apps.viewer.checker import checker_places
from warpdef.apps.viewer.colouring import material_colors, spread_out_vertices
from warpdef.apps.viewer.content import Pane, load_content
from warpdef.apps.viewer.movie import duration, movie_forecast, movie_steps
from warpdef.apps.viewer.player import SPEEDS, Player
from warpdef.errors import InputError
from warpdef.export.vertex_normals import vertex_normals
from warpdef.geometry.triangles import unique_edges
from warpdef.mesh import MeshSequence, TriMesh
from warpdef.vertex_measures import VertexMeasures, edge_stretch, spread_over_vertices

SPHERE, SPHERE_FACES = icosphere(2)


def test_playing_follows_the_clock():
    player = Player(10, 20.0)
    assert not player.tick(5.0)
    player.toggle(100.0)
    assert not player.tick(100.04)
    assert player.tick(100.06) and player.frame == 1
    assert player.tick(100.44) and player.frame == 8
    assert player.tick(100.51) and player.frame == 0  # around
    player.toggle(100.6)
    assert not player.tick(200.0) and player.frame == 0


def test_without_loop_it_ends_at_the_last_frame():
    player = Player(10, 20.0, loop=False)
    player.toggle(0.0)
    assert player.tick(60.0) and player.frame == 9 and not player.playing
    player.step(1, 60.0)
    assert player.frame == 9
    player.toggle(61.0)
    assert player.frame == 0 and player.playing
    player.tick(61.11)
    assert player.frame == 2


def test_speed_changes_keep_the_place():
    player = Player(1000, 10.0)
    player.toggle(0.0)
    player.tick(1.01)
    for _ in range(20):
        player.faster(1, 1.01)
    assert player.speed == SPEEDS[-1]
    player.tick(2.02)
    assert player.frame == 10 + round(10 * SPEEDS[-1])
    for _ in range(20):
        player.faster(-1, 2.02)
    assert player.speed == SPEEDS[0]


def test_steps_go_around_and_pause():
    player = Player(4, 10.0, frame=3)
    player.toggle(0.0)
    player.step(1, 0.0)
    assert (player.frame, player.playing) == (0, False)
    player.step(-1, 0.0)
    assert player.frame == 3
    player.go(77, 0.0)
    assert player.frame == 3


def test_movies():
    assert movie_steps(3, 10.0, False) == [(0, 0.0), (1, 0.0), (2, 0.0)]
    steps = movie_steps(17, 12.0, True)
    assert len(steps) == 85 and [f for f, _ in steps] == list(range(17)) * 5
    np.testing.assert_allclose([turn for _, turn in steps], np.arange(85) * 360 / 85)


def test_a_forecast_is_made_from_the_first_pictures():
    # The first takes 5 s to set up, the others 2 s each: 5 + 84 * 2 s.
    begun = [0.0, 5.0, 7.0, 9.0, 11.0, 13.0]
    said = [movie_forecast(begun[: k + 1], 85) for k in range(len(begun))]
    assert said == ["", "", "", "", "about 3 min for 85 pictures", ""]
    assert movie_forecast(begun[:5], 5) == ""  # nearly done
    assert [duration(s) for s in (0.2, 12.4, 200.0, 9000.0)] == ["1 s", "12 s", "3 min", "2.5 h"]


@pytest.mark.parametrize(("text", "size"), [("", (1280, 720)), ("640x480", (640, 480)), ("100X64", (100, 64))])
def test_sizes(text, size):
    assert parse_size(text) == size


@pytest.mark.parametrize("text", ["640", "x", "0x0", "63x100", "640x9000", "640x480x3", "-1x5"])
def test_wrong_sizes(text):
    with pytest.raises(InputError, match="--size: expected width x height"):
        parse_size(text)


def test_the_spacing_of_points_is_that_of_their_grid():
    grid = np.stack(np.meshgrid(*[np.arange(6) * 0.25] * 3), axis=-1).reshape(-1, 3)
    assert point_spacing(grid) == 0.25 and point_spacing(grid[:1]) == 0.0


def test_the_length_of_edges():
    assert edge_length(SPHERE * 2.0, SPHERE_FACES) == pytest.approx(2.0 * edge_length(SPHERE, SPHERE_FACES))
    assert edge_length(np.array([[0.0, 0, 0], [0, 3, 0], [0, 0, 4]]), np.array([[0, 1, 2]])) == 3.0
    assert edge_length(np.zeros((3, 3)), np.zeros((0, 3), dtype=int)) == 0.0


def test_nothing_at_the_place_is_said(tmp_path, capsys):
    assert run(["view", str(tmp_path / "nosuch")]) == 2
    assert "nosuch: nothing is there" in capsys.readouterr().err


def test_vertex_normals_of_a_sphere_point_outwards():
    normals = vertex_normals(SPHERE * 3.0 + 100.0, SPHERE_FACES)
    assert normals.dtype == np.float32
    np.testing.assert_allclose(np.einsum("vi,vi->v", normals, SPHERE), 1.0, atol=2e-3)
    flat = vertex_normals(np.zeros((4, 3)), np.array([[0, 1, 2]]))
    np.testing.assert_array_equal(flat, [[0, 0, 1]] * 4)


def test_stretch_and_displacement_of_a_growing_sphere():
    meshes = MeshSequence(np.stack([SPHERE, SPHERE * 1.25]), SPHERE_FACES)
    colouring = VertexMeasures(meshes, keyframe=0)
    np.testing.assert_allclose(colouring.values("stretch", 1), 0.25)
    np.testing.assert_allclose(colouring.values("displacement", 1), 0.25)
    assert colouring.limits("stretch") == pytest.approx((-0.25, 0.25))
    assert colouring.limits("displacement") == pytest.approx((0.0, 0.25))
    assert colouring.measures == ["stretch", "displacement"]
    still = VertexMeasures(MeshSequence(np.stack([SPHERE, SPHERE]), SPHERE_FACES))
    assert still.limits("displacement") == (0.0, 1.0)  # a bar of some length all the same


def test_stretch_leaves_out_edges_of_no_length():
    key = np.array([[0.0, 0, 0], [0, 0, 0], [1, 0, 0], [9, 9, 9]])
    now = np.array([[0.0, 0, 0], [0, 1, 0], [2, 0, 0], [9, 9, 9]])
    stretch = edge_stretch(now, key, unique_edges(np.array([[0, 1, 2]])))
    np.testing.assert_allclose(stretch, [1.0, 5**0.5 - 1, (1 + 5**0.5 - 1) / 2, 0.0])


def test_error_against_a_truth_is_the_exact_distance():
    pytest.importorskip("gpytoolbox")
    meshes = MeshSequence(SPHERE[None] * 1.5, SPHERE_FACES)
    colouring = VertexMeasures(meshes, truth=MeshSequence(SPHERE[None], SPHERE_FACES))
    # The truth is convex, and each vertex stands straight above one of its own.
    np.testing.assert_allclose(colouring.values("error", 0), 0.5, rtol=1e-9)


def test_error_of_a_cloud_is_measured_at_its_points():
    pytest.importorskip("gpytoolbox")
    # Straight above the middle of each face of a convex mesh, at a height of its own.
    a, b, c = (SPHERE[SPHERE_FACES[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    expected = np.linspace(0.1, 0.2, len(SPHERE_FACES))
    outside = (a + b + c) / 3 + expected[:, None] * normals / np.linalg.norm(normals, axis=1, keepdims=True)
    meshes = MeshSequence(SPHERE[None], SPHERE_FACES)
    colouring = VertexMeasures(meshes, clouds=[outside])
    np.testing.assert_allclose(colouring.point_errors(0), expected, rtol=1e-9)
    assert expected.min() <= colouring.values("error", 0).min() <= colouring.values("error", 0).max() <= expected.max()
    colouring.forget(MeshSequence(SPHERE[None] * 1.1, SPHERE_FACES))
    np.testing.assert_array_less(colouring.point_errors(0), expected)


def test_values_are_spread_so_far_and_no_further():
    # A strip of triangles along x: vertices 2k and 2k + 1 at x = k.
    faces = np.array(
        [[2 * k, 2 * k + 2, 2 * k + 1] for k in range(9)] + [[2 * k + 1, 2 * k + 2, 2 * k + 3] for k in range(9)]
    )
    one = spread_over_vertices(np.array([4.0]), np.array([0]), np.array([[1.0, 0, 0]]), faces, 20, rings=3)
    assert set(one[np.isfinite(one)]) == {4.0}
    assert np.isfinite(one).nonzero()[0].max() <= 7 and np.isnan(one[8:]).all()
    two = spread_over_vertices(np.array([1.0, 3.0]), np.array([0, 0]), np.full((2, 3), 1 / 3), faces, 20, rings=0)
    np.testing.assert_allclose(two[[0, 1, 2]], 2.0)


def test_material_colors_show_place_and_checker():
    colors = material_colors(SPHERE)
    assert colors.shape == SPHERE.shape and colors.dtype == np.uint8
    assert len(np.unique(colors, axis=0)) > 100
    np.testing.assert_array_equal(material_colors(SPHERE * 1000.0), colors)
    assert material_colors(np.zeros((3, 3))).shape == (3, 3)


def test_the_checker_has_as_many_cells_as_it_says():
    places = checker_places(SPHERE * [1.0, 0.5, 0.25], cells=20)
    assert places.dtype == np.float32
    np.testing.assert_allclose(np.ptp(places, axis=0), [20.0, 10.0, 5.0], rtol=1e-5)
    np.testing.assert_allclose(places.min(axis=0), 0.5)  # no wall of cells along the lowest side
    np.testing.assert_allclose(checker_places(np.ones((3, 3))), 0.5)


def test_spread_out_vertices():
    chosen = spread_out_vertices(SPHERE, 12)
    assert len(set(chosen)) == 12
    apart = np.linalg.norm(SPHERE[chosen][:, None] - SPHERE[chosen], axis=2) + 9 * np.eye(12)
    assert apart.min() > 0.6
    assert len(spread_out_vertices(SPHERE, 10**6)) == len(SPHERE)
    assert list(spread_out_vertices(np.ones((5, 3)), 3)) == [0]


def test_content_of_a_run(tmp_path):
    out = save_run(tmp_path / "out")
    content = load_content(out)
    (pane,) = content.panes
    assert (len(content), pane.keyframe, pane.clouds, content.measures) == (5, 2, None, ["stretch", "displacement"])
    np.testing.assert_allclose(content.bounds, [VERTICES.min(axis=(0, 1)), VERTICES.max(axis=(0, 1))])


def test_a_demo_brings_its_own_clouds_and_truth(tmp_path):
    out = save_run(tmp_path / "out")
    save_clouds(out / "clouds.npz")
    save_truth(out / "truth.npz")
    content = load_content(out, side_by_side=True, frames=slice(1, None, 2))
    assert [pane.title for pane in content.panes] == ["input", "reconstruction", "truth"]
    assert [pane.keyframe for pane in load_content(out, side_by_side=True).panes[1:]] == [2, 2]
    assert content.names == ("scan1.ply", "scan3.ply") and content.measures == ["error", "stretch", "displacement"]
    np.testing.assert_array_equal(present(content.panes[1].moving).vertices, VERTICES[1::2])
    np.testing.assert_array_equal(present(content.panes[2].moving).vertices, BAR.vertices[1::2])
    np.testing.assert_array_equal(np.sort(present(content.panes[0].clouds)[1], 0), np.sort(BAR.clouds[3], 0))


def test_the_truths_error_is_the_way_back(tmp_path):
    pytest.importorskip("gpytoolbox")
    # The result lacks half of the bar: what it has lies on the truth, what it lacks is far from it.
    out = save_run(tmp_path / "out", VERTICES * np.array([0.5, 1.0, 1.0], dtype=np.float32))
    content = load_content(out, truth=save_truth(tmp_path / "t.npz"), side_by_side=True)
    result, truth = content.panes
    assert (result.against, truth.against) == ("the truth", "the reconstruction")
    there, back = (present(pane.colouring).values("error", 2) for pane in (result, truth))
    length = np.ptp(VERTICES[2][:, 0])
    assert back.max() > 0.2 * length and back.max() > 3.0 * there.max()


def test_the_truth_may_change_its_triangles(tmp_path):
    pytest.importorskip("gpytoolbox")
    faces = [BAR.faces, BAR.faces[::2]]
    meshes = [TriMesh(BAR.vertices[0], f) for f in faces]
    measures = VertexMeasures(meshes, truth=MeshSequence(np.stack([BAR.vertices[0]] * 2), BAR.faces))
    assert measures.measures == ["error"]
    np.testing.assert_allclose(measures.values("error", 1), 0.0, atol=1e-9)


def test_the_runs_own_frames_of_the_input_are_taken(tmp_path):
    out = save_run(tmp_path / "out", VERTICES[1:4], frames="1:4")
    content = load_content(out, clouds=save_clouds(tmp_path / "c.npz"))
    np.testing.assert_array_equal(np.sort(present(content.panes[0].clouds)[0], 0), np.sort(BAR.clouds[1], 0))


def test_two_runs_beside_each_other(tmp_path):
    a, b = save_run(tmp_path / "a"), save_run(tmp_path / "b", VERTICES * 1.1)
    content = load_content(a, compare=b)
    assert [pane.title for pane in content.panes] == [str(a), str(b)]


def test_content_that_does_not_fit(tmp_path):
    out, short = save_run(tmp_path / "out"), save_run(tmp_path / "short", VERTICES[:3])
    with pytest.raises(InputError, match="expected the 5 frames.*got 3; compare runs of the same frames"):
        load_content(out, compare=short)
    with pytest.raises(InputError, match="got 5; pick the frames.*--truth-frames"):
        load_content(short, truth=save_truth(tmp_path / "t.npz"))
    with pytest.raises(InputError, match="got 5; choose the clouds.*--input"):
        load_content(short, clouds=save_clouds(tmp_path / "c.npz"))
    with pytest.raises(InputError, match="--side-by-side: expected something"):
        load_content(out, side_by_side=True)
    with pytest.raises(InputError, match="--frames"):
        load_content(out, frames=slice(9, None))


def test_an_empty_pane_has_no_surface():
    assert Pane("input", clouds=BAR.clouds).surface(0) is None


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--screenshot", "a.bmp"], ["a.bmp", "unknown suffix '.bmp'", ".png"]),
        (["--movie", "a.avi"], ["unknown suffix '.avi'", ".mp4", ".gif"]),
        (["--html", "a.txt"], ["unknown suffix '.txt'", ".html"]),
        (["--screenshot", "absent/a.png"], ["absent", "make it first"]),
        (["--html", "there.html"], ["there.html", "already exists", "--overwrite"]),
        (["--sheet", "4"], ["--sheet", "--screenshot"]),
        (["--transparent"], ["--transparent", "--screenshot FILE.png"]),
        (["--transparent", "--screenshot", "a.jpg"], ["--transparent", "no transparency"]),
        (["--scale-bar", "--html", "a.html"], ["--scale-bar", "a page has none"]),
        (["--turntable"], ["--turntable", "--movie"]),
        (["--html", "a.html", "--frame", "5"], ["--frame", "0..4", "got 5"]),
        (["--html", "a.html", "--color", "error"], ["--color error", "--truth or --input"]),
        (["--html", "a.html", "--cloud"], ["--cloud", "--input"]),
        (["--html", "a.html", "--color", "red"], ["red"]),
        (["--html", "a.html", "--clim", "0", "1"], ["--clim", "a measure", "--color template"]),
        (["--html", "a.html", "--color", "stretch", "--clim", "1", "-1"], ["--clim", "lower first", "1 -1"]),
        (["--html", "a.html", "--color", "stretch", "--clim", "0", "nan"], ["--clim", "0 nan"]),
        (["--html", "a.html", "--color", "stretch", "--cmap", "blues"], ["--cmap", "viridis", "got blues"]),
        (["--html", "a.html", "--fps", "0"], ["--fps"]),
        (["--html", "a.html", "--size", "big"], ["--size", "big"]),
        (["--html", "a.html", "--input", "absent.npz"], ["absent.npz"]),
    ],
)
def test_bad_arguments(tmp_path, monkeypatch, capfd, arguments, expected):
    out = save_run(tmp_path / "out")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.html").write_text("mine")
    assert run(["view", str(out), *arguments]) == 2
    err = capfd.readouterr().err
    assert err.startswith("warpdef: error: ") and err.count("\n") == 1
    assert [part for part in expected if part not in err] == []
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out", "there.html"]
    assert (tmp_path / "there.html").read_text() == "mine"


def test_mp4_without_its_package(monkeypatch, tmp_path, capfd):
    import sys

    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    assert run(["view", str(save_run(tmp_path / "out")), "--movie", str(tmp_path / "a.mp4")]) == 2
    assert "pip install 'warpdef[movie]'" in capfd.readouterr().err


def test_frames_count():
    assert len(VERTICES) == FRAMES == len(BAR.clouds)
