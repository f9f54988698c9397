"""Sheets of cloth judged by their clouds: drawn out, slid along themselves, of two layers, across gaps."""

from __future__ import annotations

import numpy as np
import pytest
from judged import assess, frames, names

from warpdef.geometry.sampling import sample_surface
from warpdef.quality.layers import two_classes

pytest.importorskip("gpytoolbox")
FRAMES, POINTS, KEYFRAME = 5, 1500, 2


def waving_sheet() -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """A sheet 4 long and 2 wide that looks upwards, with points on all of it."""
    x, y = np.meshgrid(np.linspace(0.0, 4.0, 60), np.linspace(0.0, 2.0, 30), indexing="ij")
    i = np.arange(60 * 30).reshape(60, 30)
    a, b, c, d = (j.ravel() for j in (i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)
    sheets = np.stack([np.stack([x, y, 0.1 * np.sin(2.0 * x + t)], -1).reshape(-1, 3) for t in range(FRAMES)])
    return sheets, faces, [sample_surface(v, faces, POINTS, np.random.default_rng(t))[0] for t, v in enumerate(sheets)]


def test_a_sheet_larger_than_all_that_its_cloud_shows_is_told() -> None:
    """In frame 3 the mesh is longer than the sheet, in frame 1 the sheet was not seen to its end."""
    sheets, faces, clouds = waving_sheet()
    clouds[1] = clouds[1][clouds[1][:, 0] < 3.5]
    sheets[3, :, 0] *= 1.12
    found = assess(clouds, sheets, faces, KEYFRAME)
    assert names(found) == ["good", "good", "good", "doubtful", "good"]
    assert 0.03 < frames(found)[3].surplus < 0.12 and frames(found)[1].far > 0.05 and frames(found)[1].surplus < 0.02


def test_a_sheet_drawn_out_over_its_border_is_told() -> None:
    """By less than is told by area; what was not seen, and has not grown, is no fault."""
    sheets, faces, clouds = waving_sheet()
    clouds[1] = clouds[1][clouds[1][:, 0] < 3.5]
    sheets[3, :, 0] *= 1.06
    found = assess(clouds, sheets, faces, KEYFRAME)
    assert names(found) == ["good", "good", "good", "doubtful", "good"]
    assert 0.02 < frames(found)[3].outgrown < 0.05 and frames(found)[3].surplus < 0.03
    assert "drawn out" in found.verdicts[3].reasons[0] and frames(found)[1].outgrown < 0.002


def test_a_sheet_that_stretches_and_is_not_seen_to_its_end_is_no_fault() -> None:
    """Seen as a whole it stretches as much in another frame."""
    sheets, faces, clouds = waving_sheet()
    for t, longer in ((1, 1.05), (4, 1.06)):
        sheets[t, :, 0] *= longer
        clouds[t] = sample_surface(sheets[t], faces, POINTS, np.random.default_rng(t))[0]
    clouds[1] = clouds[1][clouds[1][:, 0] < 3.5]
    found = assess(clouds, sheets, faces, KEYFRAME)
    assert frames(found)[1].outgrown == 0.0 and frames(found)[1].far > 0.05
    assert names(found) == ["good"] * FRAMES


@pytest.mark.parametrize(("slid", "verdict"), [(0.1, "good"), (0.2, "doubtful"), (0.6, "lost")])
def test_a_sheet_that_slid_along_itself_is_told_by_the_points_that_it_left(slid: float, verdict: str) -> None:
    """As soon as it is wrong by more than three spacings, 0.11, and a hundredth of its length."""
    sheets, faces, clouds = waving_sheet()
    x = sheets[3, :, 0] + slid
    sheets[3] = np.column_stack([x, sheets[3, :, 1], 0.1 * np.sin(2.0 * x + 3.0)])
    found = assess(clouds, sheets, faces, KEYFRAME)
    assert names(found) == ["good", "good", "good", verdict, "good"] and frames(found)[3].outgrown < 0.002


def test_two_layers_of_points_on_one_of_the_mesh_are_told() -> None:
    """Noise as wide is no fault: it lies around the surface, they lie on either side of it."""
    sheets, faces, clouds = waving_sheet()
    rng = np.random.default_rng(0)
    clouds[1][:, 2] += rng.normal(scale=0.04, size=POINTS)
    clouds[3][:, 2] += rng.choice([-0.04, 0.04], POINTS)
    found = assess(clouds, sheets, faces, KEYFRAME)
    assert names(found) == ["good", "good", "good", "doubtful", "good"]
    assert frames(found)[3].merged > 0.9 and max(frames(found)[t].merged for t in (0, 1, 2, 4)) < 0.01
    assert "two layers" in found.verdicts[3].reasons[0]
    # A mesh that has both of them.
    both = np.concatenate([sheets + [0.0, 0.0, side] for side in (-0.04, 0.04)], axis=1)
    twice = [c + rng.choice([-0.04, 0.04], POINTS)[:, None] * [0.0, 0.0, 1.0] for c in waving_sheet()[2]]
    apart = assess(twice, both, np.concatenate([faces, faces + sheets.shape[1]]), KEYFRAME)
    assert max(frame.merged for frame in frames(apart)) < 0.01


def test_a_web_across_a_gap_that_the_camera_saw_through_is_told() -> None:
    """From above: the points of two sheets, and a mesh that joins them; what is missing at an end is no fault."""
    sheets, faces, clouds = waving_sheet()
    clouds[3] = clouds[3][np.abs(clouds[3][:, 0] - 2.0) > 0.25]
    clouds[1] = clouds[1][clouds[1][:, 0] < 3.6]
    found = assess(clouds, sheets, faces, KEYFRAME, eye=np.array([2.0, 1.0, 20.0]))
    assert names(found) == ["good", "good", "good", "doubtful", "good"]
    assert 0.015 < frames(found)[3].spanning < 0.05 and frames(found)[1].spanning < 0.002
    assert any("camera saw" in reason for reason in found.verdicts[3].reasons)
    under = assess(clouds, sheets, faces, KEYFRAME, eye=np.array([2.0, 1.0, -20.0]))
    assert max(frame.spanning for frame in frames(under)) == 0.0  # its back


def test_heights_in_two_classes() -> None:
    rng = np.random.default_rng(0)
    normal, even = rng.normal(size=(2000, 24)), rng.random((2000, 24))
    layers = rng.choice([-1.0, 1.0], (2000, 24)) + rng.normal(scale=0.2, size=(2000, 24))
    for rows, share in ((normal, 1.0 - 2.0 / np.pi), (even, 0.25), (layers, 0.2**2 / (1.0 + 0.2**2))):
        assert np.median(two_classes(rows, 6)[0]) == pytest.approx(share, abs=0.06)
    np.testing.assert_allclose(np.median(two_classes(layers, 6)[1]), 2.0, atol=0.05)
