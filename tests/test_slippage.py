"""Rigid motions that a whole body makes along itself."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from synthetic import icosphere

from warpdef.apps.quality_tables import print_quality
from warpdef.apps.run_summary import summary_rows
from warpdef.config import Config
from warpdef.quality.assess import assess
from warpdef.quality.slippage import SLIDES, UNSEEN, slip_note, slippable_motions, slippable_parts
from warpdef.result import Reconstruction

BALL, FACES = icosphere(4)
TURN, PLACE = Rotation.from_rotvec([0.3, -0.4, 0.9]).as_matrix(), np.array([70.0, -30.0, 11.0])


def disc(squareness: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A flat sheet of 30 x 30 squares in z = 0, bent into a disc, or not if ``squareness`` is 1."""
    side = np.linspace(-1.0, 1.0, 31)
    square = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    round_ = square * (np.abs(square).max(axis=1) / np.maximum(np.linalg.norm(square, axis=1), 1e-9))[:, None]
    at = np.arange(31 * 31).reshape(31, 31)
    a, b, c, d = at[:-1, :-1].ravel(), at[1:, :-1].ravel(), at[1:, 1:].ravel(), at[:-1, 1:].ravel()
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    return np.column_stack([squareness * square + (1.0 - squareness) * round_, np.zeros(31 * 31)]), faces


def test_a_ball_turns_unseen_about_its_centre():
    found = slippable_motions(3.0 * BALL + PLACE, FACES)
    assert [m.motion for m in found] == ["turn"] * 3 and max(m.seen for m in found) < 1e-3
    np.testing.assert_allclose(np.array([m.through for m in found]), np.stack([PLACE] * 3), atol=0.02)
    axes = np.array([m.axis for m in found])
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-3)
    assert slip_note(found).startswith("any turn about (70, -30, 11) cannot be seen in this shape: ")


@pytest.mark.parametrize("stretch", [2.0, 0.5])
def test_a_body_of_revolution_turns_unseen_about_its_axis(stretch):
    spun = BALL * [1.0, stretch, 1.0] * 0.2
    (found,) = slippable_motions(spun @ TURN.T + PLACE, FACES)
    assert found.motion == "turn" and found.through is not None
    axis, away = TURN[:, 1], np.array(found.through) - PLACE
    assert found.seen < UNSEEN and abs(axis @ found.axis) == pytest.approx(1.0, abs=1e-4)
    assert np.linalg.norm(away - (away @ axis) * axis) < 0.01
    assert slip_note([found]).startswith("a turn about the axis (") and "cannot be seen" in slip_note([found])


def test_a_long_needle_shifts_along_itself():
    turn, shift = slippable_motions(BALL * [20.0, 1.0, 1.0], FACES)
    assert (turn.motion, shift.motion) == ("turn", "shift") and turn.axis == shift.axis == (1.0, 0.0, 0.0)
    assert shift.through is None and turn.seen < shift.seen < UNSEEN
    assert " and a shift along (1, 0, 0) cannot" in slip_note([turn, shift])


def test_what_breaks_the_symmetry_is_seen():
    cube = BALL / np.abs(BALL).max(axis=1, keepdims=True)
    assert slippable_motions(cube * [1.0, 1.5, 2.0] @ TURN.T + PLACE, FACES) == []
    # A lug on one side, as a cup's handle: its turn is hardly seen, and by a larger one it is.
    for size, told in ((0.4, 1), (1.6, 0)):
        lug = np.where((BALL[:, :1] > 0.9) & (np.abs(BALL[:, 1:2]) < 0.3), [[1.0 + size, 1.0, 1.0]], 1.0)
        found = slippable_motions(BALL * [1.0, 2.0, 1.0] * lug, FACES)
        assert len(found) == told
        for motion in found:
            assert UNSEEN < motion.seen < SLIDES and "can hardly be seen" in slip_note([motion])


def test_the_border_of_a_sheet_holds_it():
    vertices, faces = disc()
    (found,) = slippable_motions(vertices @ TURN.T + PLACE, faces)
    assert found.motion == "turn" and found.seen < 1e-3 and abs(TURN[:, 2] @ found.axis) == pytest.approx(1.0, abs=1e-4)
    square, _ = disc(1.0)
    assert slippable_motions(square, faces) == [] and slip_note([]) == ""


def test_a_mesh_of_few_faces_is_what_it_is():
    """A box of two faces a side is as seen as one of thousands."""
    cube = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([face for a, b, c, d in sides for face in ((a, b, c), (a, c, d))])
    assert slippable_motions(cube, faces) == []


def test_a_ball_beside_a_body_turns_unseen():
    """Both together are seen to turn; an open part says nothing, as its border may be where a camera saw no further."""
    cube = BALL / np.abs(BALL).max(axis=1, keepdims=True) * [1.0, 1.5, 2.0]
    both = np.concatenate([cube, 0.5 * BALL + [3.0, 0.0, 0.0], BALL + [0.0, 6.0, 0.0]])
    faces = np.concatenate([FACES, FACES + len(BALL), FACES[5:] + 2 * len(BALL)])
    assert slippable_motions(both, faces) == []
    found = slippable_parts(both, faces)
    assert [(m.motion, m.part) for m in found] == [("turn", 1)] * 3
    assert slip_note(found).startswith("any turn about (3, 0, 0) cannot be seen in a part of this shape: ")
    assert slippable_parts(BALL, FACES) == slippable_motions(BALL, FACES)
    two = slippable_parts(
        np.concatenate([BALL, 0.5 * BALL + [3.0, 0.0, 0.0], cube + 9.0]),
        np.concatenate([faces[: 2 * len(FACES)], FACES + 2 * len(BALL)]),
    )
    assert slip_note(two).startswith("any turn about (0, 0, 0) and any turn about (3, 0, 0) cannot be seen in a part")


def test_nothing_is_told_of_no_surface():
    assert slippable_motions(np.zeros((3, 3)), np.array([[0, 1, 2]])) == []


def test_a_report_tells_it_before_the_verdict(capsys, rng):
    """But of a sheet that one camera saw of a body nothing is told: its border is not the body's."""
    half, faces = disc()
    clouds, meshes = [half + 1e-3 * rng.normal(size=half.shape) for _ in range(3)], np.stack([half] * 3)
    seen = assess(clouds, meshes, faces, 1, eye=np.array([0.0, 0.0, 9.0])).as_dict()
    told = json.loads(json.dumps(assess(clouds, meshes, faces, 1).as_dict()))
    assert seen["slippable"] == [] and [m["motion"] for m in told["slippable"]] == ["turn"]
    print_quality(told, "a disc")
    lines = capsys.readouterr().out.splitlines()
    assert lines[-2].startswith("a turn about the axis (0, 0, 1)") and lines[-1] == "3 good"
    report = {**told, "keyframe_why": "", "iterations": 1, "seconds": {}, "losses": {}, "warnings": []}
    result = Reconstruction(meshes, faces, 1, Config(), report=report)
    assert summary_rows(result, Path("out"))["note"] == lines[-2]
    result.report["slippable"] = []
    assert "note" not in summary_rows(result, Path("out"))
