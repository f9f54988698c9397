"""What a view says of frames and places, and the camera that is kept; nothing is drawn."""

from __future__ import annotations

import json

import numpy as np
import pytest
from present import present
from view_samples import save_run

from warpdef.apps.main import run
from warpdef.apps.viewer.camera import Stand, fit_camera, turned
from warpdef.apps.viewer.camera_file import load_camera, save_camera
from warpdef.apps.viewer.captions import frame_title
from warpdef.apps.viewer.content import Content, Pane, load_content
from warpdef.apps.viewer.judged import Judged, judged_frames
from warpdef.apps.viewer.reading import reading
from warpdef.apps.viewer.timeline import LEFT, RIGHT, strip_boxes
from warpdef.errors import InputError
from warpdef.mesh import MeshSequence
from warpdef.vertex_measures import VertexMeasures

QUALITY = [
    {"residual_mean_percent": 0.03, "reasons": []},
    {"residual_mean_percent": 1.5, "reasons": ["14.0% of the points are not covered", "another"]},
    {"residual_mean_percent": None, "reasons": ["no usable points: interpolated"]},
]
REPORT = {"verdicts": ["good", "lost", "doubtful"], "quality": QUALITY}


def test_verdicts_of_the_frames_that_are_shown():
    frames = present(judged_frames(REPORT, [1, 2], 3))
    assert [frame.verdict for frame in frames] == ["lost", "doubtful"]
    assert [frame.residual for frame in frames] == [1.5, None]
    assert frames[0].words == "lost: 14.0% of the points are not covered"
    assert present(judged_frames(REPORT, [0], 3))[0] == Judged("good", 0.03)


@pytest.mark.parametrize(
    "report", [{}, {"verdicts": ["good"]}, {"verdicts": "good"}, {"verdicts": ["good", "fine", "lost"]}]
)
def test_reports_without_verdicts(report):
    assert judged_frames(report, [0], 3) is None


def test_verdicts_without_numbers():
    assert judged_frames({"verdicts": REPORT["verdicts"]}, [1], 3) == [Judged("lost")]


def test_the_title_ends_with_the_verdict(tmp_path):
    out = save_run(tmp_path / "out")
    assert frame_title(load_content(out), 1) == "frame 1 of 5 (0 to 4): scan1.ply"
    report = {"verdicts": ["good"] * 4 + ["lost"], "quality": [QUALITY[0]] * 4 + [QUALITY[1]]}
    (out / "report.json").write_text(json.dumps(report))
    content = load_content(out, frames=slice(3, None))
    assert frame_title(content, 0) == "frame 0 of 2 (0 to 1): scan3.ply (good)"
    assert frame_title(content, 1).endswith("scan4.ply (lost: 14.0% of the points are not covered)")


def test_the_strip_stands_under_the_slider():
    boxes = strip_boxes([0.02, 0.03, None, 9.0, 0.03], 0.1, 0.3)
    left, bottom, right, top = boxes.T
    np.testing.assert_allclose((left + right) / 2.0, np.linspace(LEFT, RIGHT, 5))
    assert (bottom == 0.1).all() and (right[:-1] < left[1:]).all()
    # By the residual, a lost frame is cut, and what is not known is low, but seen.
    assert top[3] == pytest.approx(0.3) and 0.1 < top[2] < top[0] < top[1] < 0.2
    assert top[1] - 0.1 == pytest.approx((0.3 - 0.1) / 4.0)
    np.testing.assert_allclose(strip_boxes([0.0, 0.0], 0.0, 1.0)[:, 3], 0.15)


def test_a_camera_is_kept_in_the_inputs_units(tmp_path):
    camera = fit_camera(np.array([[0.0, 0, 0], [1, 2, 3]]), "y", 1.5, stand=Stand(70.0, 20.0))
    path, origin = tmp_path / "c.json", np.array([100.0, 0.0, -50.0])
    save_camera(path, camera, origin)
    assert np.array(json.loads(path.read_text())["focus"]) == pytest.approx(camera.focus + origin)
    again = load_camera(path, origin + 1.0)
    for name in ("position", "focus"):
        np.testing.assert_allclose(getattr(again, name), getattr(camera, name) - 1.0)
    np.testing.assert_allclose(again.up, camera.up)
    assert (again.distance, again.lift) == pytest.approx((camera.distance, camera.lift))


@pytest.mark.parametrize(
    "text",
    [
        "no json",
        "[]",
        "{}",
        '{"position": [0, 0, 1], "focus": [0, 0, 1], "up": [0, 1, 0]}',
        '{"position": [0, 0, 1], "focus": [0, 0, 0], "up": [0, 0, 2]}',
        '{"position": [0, 0], "focus": [0, 0, 0], "up": [0, 1, 0]}',
        '{"position": [0, 0, NaN], "focus": [0, 0, 0], "up": [0, 1, 0]}',
        '{"position": [0, 0, 1], "focus": [0, 0, 0], "up": [0, 1, 0], "lift": 3}',
    ],
)
def test_other_files_are_no_cameras(tmp_path, text):
    (tmp_path / "c.json").write_text(text)
    with pytest.raises(InputError, match="c.json: expected a camera as the key k"):
        load_camera(tmp_path / "c.json", np.zeros(3))


@pytest.mark.parametrize("up", ["y", "z"])
def test_a_turn_goes_about_the_up_axis(up):
    points = np.array([[0.0, 0, 0], [1, 2, 3]])
    camera = fit_camera(points, up, 1.0, stand=Stand(20.0, 15.0))
    expected = fit_camera(points, up, 1.0, stand=Stand(110.0, 15.0))
    found = turned(camera, up, 90.0)
    back = [(c.position - c.focus) / c.distance for c in (found, expected)]
    np.testing.assert_allclose(back[0], back[1], atol=1e-9)
    np.testing.assert_allclose(found.up, expected.up, atol=1e-9)
    np.testing.assert_allclose(found.focus, camera.focus)


def test_a_place_is_read():
    rest = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    meshes = MeshSequence(np.stack([rest, rest + [[0, 0, 1.0], [0, 0, 2.0], [0, 0, 4.0]]]), np.array([[0, 1, 2]]))
    pane = Pane("a", meshes, colouring=VertexMeasures(meshes))
    content = Content([pane], ("0", "1"), unit="mm", origin=np.array([10.0, 0.0, 0.0]))
    weights = np.array([0.2, 0.5, 0.3])
    assert reading(content, pane, 1, "displacement", 0, weights) == "2.4 mm, vertex 1 at (11, 0, 2)"
    assert reading(content, pane, 1, "plain", 0, weights) == "vertex 1 at (11, 0, 2)"
    assert reading(content, pane, 1, "stretch", 0, weights).split(",")[0].count(" ") == 0  # has no unit
    assert reading(content, pane, 1, "plain", 7, weights) == "" == reading(content, Pane("b"), 1, "plain", 0, weights)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--screenshot", "a.png"], ["--camera: c.json: nothing is there", "press k"]),
        (["--html", "a.html"], ["--camera", "--html", "--azimuth"]),
        (["--screenshot", "a.png", "--azimuth", "3"], ["--camera", "without --azimuth"]),
    ],
)
def test_cameras_that_cannot_be(tmp_path, monkeypatch, capfd, arguments, expected):
    out = save_run(tmp_path / "out")
    monkeypatch.chdir(tmp_path)
    assert run(["view", str(out), "--camera", "c.json", *arguments]) == 2
    err = capfd.readouterr().err
    assert err.count("\n") == 1 and [part for part in expected if part not in err] == []
