"""Where the camera stands and what is written where, before anything is drawn."""

from __future__ import annotations

import numpy as np
import pytest

from warpdef.apps.viewer.bars import round_length
from warpdef.apps.viewer.camera import VIEW_ANGLE, Room, Stand, camera_axes, fit_camera, seen_aspect
from warpdef.apps.viewer.captions import room_for
from warpdef.apps.viewer.content import Content, Pane
from warpdef.apps.viewer.flat import CHARACTER, letter_size, shortened
from warpdef.apps.viewer.scales import Scales, color_map
from warpdef.apps.viewer.sheet import sheet_columns, sheet_frames, tile_size
from warpdef.mesh import MeshSequence
from warpdef.vertex_measures import VertexMeasures


@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("aspect", [0.4, 1.0, 2.5])
@pytest.mark.parametrize("all_round", [False, True])
def test_the_camera_sees_the_whole_box(up, aspect, all_round):
    corners = np.array([[x, y, z] for x in (10.0, 12.0) for y in (-3.0, 4.0) for z in (5.0, 5.5)])
    for turn in (0.0, 137.0) if all_round else (0.0,):
        camera = fit_camera(corners, up, aspect, turn=turn, all_round=all_round)
        back = (camera.position - camera.focus) / camera.distance
        right = np.cross(camera.up, back)
        depth = (camera.position - corners) @ back
        opening = np.tan(np.radians(VIEW_ANGLE / 2))
        assert (depth > 0).all()
        seen = np.abs((corners - camera.position) @ camera.up) / depth / opening
        across = np.abs((corners - camera.position) @ right) / depth / opening / aspect
        assert max(seen.max(), across.max()) < 1.0
        if not all_round:
            assert max(seen.max(), across.max()) > 0.75  # and fills the picture


def test_zoom_brings_the_camera_nearer():
    corners = np.array([[x, y, z] for x in (0.0, 2.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    usual = fit_camera(corners, "y", 1.0)
    near = fit_camera(corners, "y", 1.0, stand=Stand(zoom=2.0))
    np.testing.assert_allclose(near.distance, usual.distance / 2.0)
    np.testing.assert_allclose(near.focus, usual.focus)
    side = fit_camera(corners, "y", 1.0, stand=Stand(azimuth=90.0, elevation=0.0))
    np.testing.assert_allclose((side.position - side.focus) / side.distance, [1.0, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize(("up", "axis"), [("y", [0, 1, 0]), ("z", [0, 0, 1])])
def test_up_is_up(up, axis):
    for azimuth in (0.0, 25.0, 250.0):
        right, above, back = camera_axes(up, azimuth)
        assert above @ axis > 0.9 and abs(right @ axis) < 1e-12 and back @ axis > 0
        np.testing.assert_allclose(np.cross(right, above), back, atol=1e-12)


def test_the_narrowest_pane_shows_the_motion_as_large():
    rng, room = np.random.default_rng(0), Room()
    points = rng.uniform(-1.0, 1.0, (500, 3)) * [0.3, 1.0, 0.2]
    aspect = seen_aspect(points, "y", Stand(), room)
    wide, narrow, narrower = (fit_camera(points, "y", a, room=room).distance for a in (50.0, aspect, 0.9 * aspect))
    assert narrow == pytest.approx(wide, rel=2e-3) and narrower > 1.03 * wide


@pytest.mark.parametrize(
    ("most", "length"), [(1.0, 1.0), (0.999, 0.5), (4.9, 2.0), (730.0, 500.0), (1e-4, 1e-4), (2.3e-7, 2e-7)]
)
def test_the_scale_bar_has_a_round_length(most, length):
    assert round_length(most) == pytest.approx(length)


@pytest.mark.parametrize("height", [64, 120, 400, 2000])
def test_what_is_written_leaves_room(height):
    size = 2 * height, height
    tile, plain, bar = room_for(size, tile=True), room_for(size), room_for(size, bar=True)
    window = room_for(size, bar=True, slider=True)
    assert plain.bottom < bar.bottom <= window.bottom <= 0.3
    assert plain.top <= 0.3 and tile.top <= 0.3 and 1.0 - bar.top - bar.bottom > 0.39


def test_sheets_take_frames_evenly():
    assert sheet_frames(17, 5) == [0, 4, 8, 12, 16]
    assert sheet_frames(3, 9) == [0, 1, 2]
    assert sheet_frames(9, 1) == [0]


def test_tiles_are_as_narrow_as_the_motion_and_within_the_size():
    assert tile_size(0.5, (400, 400)) == (200, 400)
    assert tile_size(2.0, (400, 400)) == (400, 200)
    assert tile_size(0.01, (400, 400)) == (100, 400)  # no strip
    assert tile_size(3.0, (1280, 720)) == (1280, 427)


@pytest.mark.parametrize(
    ("count", "aspect", "columns"), [(6, 0.5, 6), (8, 0.5, 4), (17, 0.5, 9), (4, 1.6, 2), (1, 1, 1)]
)
def test_rows_of_a_sheet(count, aspect, columns):
    assert sheet_columns(count, aspect) == columns


def test_letters_fit_tall_pictures_too():
    assert letter_size((1280, 720)) == 15.0
    assert letter_size((600, 2000)) == letter_size((600, 450)) < letter_size((2000, 2000))
    assert letter_size((64, 64)) == 11.0


def test_long_lines_lose_their_middle():
    assert shortened("short", 1000.0, 10.0) == "short"
    text = shortened("a very long name of a scan that nobody reads.ply", 130.0, 10.0)
    assert len(text) <= 130.0 / (10.0 * CHARACTER) and text.startswith("a very") and text.endswith(".ply")


def moved(*shifts: float) -> Pane:
    """Two frames of a triangle; in the second its corners are displaced by ``shifts``."""
    rest = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    meshes = MeshSequence(np.stack([rest, rest + np.array(shifts)[:, None] * [0, 0, 1]]), np.array([[0, 1, 2]]))
    return Pane("a", meshes, colouring=VertexMeasures(meshes))


def test_panes_share_a_scale():
    content = Content([moved(1.0, 1.0, 1.0), moved(2.0, 2.0, 2.0)], ("0", "1"))
    scales = Scales(content, "displacement")
    assert scales.limits("displacement") == (0.0, 2.0)
    assert scales.note("displacement", [1]) == "ends at the 99th percentile; maximum in this frame 2"
    assert scales.note("displacement", [0, 1]) == "ends at the 99th percentile; maximum in these frames 2"
    assert scales.note("stretch", [0]) == "ends at ±the 99th percentile; 0 to 0 in this frame"


def test_chosen_ends_are_of_the_measure_they_were_chosen_for():
    scales = Scales(Content([moved(1.0, 2.0, 4.0)], ("0", "1")), "displacement", (0.5, 3.0))
    assert scales.limits("displacement") == (0.5, 3.0) and scales.limits("stretch") != (0.5, 3.0)
    assert scales.note("displacement", [1]) == "ends as chosen; maximum in this frame 4"


def test_colour_maps():
    assert [color_map("error"), color_map("stretch"), color_map("stretch", "magma")] == ["viridis", "coolwarm", "magma"]
