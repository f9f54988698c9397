"""The template of all frames: a body that turns before one camera becomes whole; one that does not stays a sheet."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import synthetic

import warpdef
from warpdef.config import Config, KeyframeConfig
from warpdef.fit.embedded import Pose
from warpdef.fit.growing import ONE_SIDE, measure_turn, template_of_all
from warpdef.fit.surfels import SeenFrame, Surfels
from warpdef.geometry.triangles import is_watertight, signed_volume
from warpdef.template.build import TemplateReport, sheet_note

EYE = np.array([0.0, 0.0, 1.0])
AXES = np.array([0.6, 0.5, 0.4])
STEP = np.deg2rad(25.0)
FRAMES = 13


BUMPS = np.array([[0.6, 0.0, 0.8], [-0.8, 0.5, 0.3], [0.3, -0.6, -0.7], [-0.4, 0.5, -0.8], [0.9, 0.4, -0.2]])


def shape(d: np.ndarray) -> np.ndarray:
    """An ellipsoid with bumps, which tell how it is turned: its place in directions (N, 3)."""
    d = d / np.linalg.norm(d, axis=1, keepdims=True)
    height = np.exp(-8.0 * ((d[:, None] - BUMPS) ** 2).sum(axis=2)).sum(axis=1)
    return AXES * d * (1.0 + 0.5 * height)[:, None]


def body(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Points of that and their outward normals."""
    d = np.random.default_rng(seed).normal(size=(count, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    points = shape(d)
    first, second = (shape(d + 1e-5 * np.cross(d, np.eye(3)[i])) - points for i in (0, 1))
    normals = np.cross(first, second)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return points, normals * np.sign((normals * d).sum(axis=1))[:, None]


def film(step: float, frames: int = FRAMES, count: int = 2400) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """What a camera at +z sees of the body, turned by ``step`` radians from frame to frame, and its normals."""
    points, normals = [], []
    for t in range(frames):
        p, n = body(count, t)
        turn = synthetic.turn_about([0.0, 1.0, 0.0], step * t)
        p, n = p @ turn.T, n @ turn.T
        shown = n @ EYE > 0.05 + 0.3 * np.random.default_rng(t).random(len(n))
        points.append(p[shown])
        normals.append(n[shown])
    return points, normals


def seen_frames(step: float, frames: int = FRAMES) -> dict[int, SeenFrame]:
    points, normals = film(step, frames)
    return {t: SeenFrame(p, n, EYE) for t, (p, n) in enumerate(zip(points, normals, strict=True))}


def test_the_turn_before_the_camera_is_measured():
    assert measure_turn(seen_frames(STEP, 4)) == pytest.approx(75.0, abs=5.0)
    assert measure_turn(seen_frames(0.0, 4)) < 5.0


@pytest.fixture(scope="module")
def grown():
    points, normals = film(STEP)
    points[0] = points[0][:0]
    normals[0] = normals[0][:0]
    return template_of_all(points, normals, Config(), EYE)


def test_a_body_that_turns_becomes_whole(grown):
    from scipy.spatial import cKDTree

    chosen, note = grown
    assert chosen is not None and not note
    assert chosen.keyframe == FRAMES // 2 and is_watertight(chosen.mesh.faces)
    truth = body(6000, 99)[0] @ synthetic.turn_about([0.0, 1.0, 0.0], STEP * chosen.keyframe).T
    away, off = cKDTree(chosen.mesh.vertices).query(truth)[0], cKDTree(truth).query(chosen.mesh.vertices)[0]
    assert np.quantile(away, 0.95) < 0.06 and np.quantile(off, 0.95) < 0.06  # of a body 1.2 wide
    assert "made of all frames" in chosen.warnings[0]


def test_every_frame_is_told_where_the_mesh_is(grown):
    chosen, _ = grown
    assert chosen is not None and chosen.placed is not None
    placed = chosen.placed
    assert placed.shape == (FRAMES, len(chosen.mesh.vertices), 3) and placed.dtype == np.float32
    np.testing.assert_allclose(placed[chosen.keyframe], chosen.mesh.vertices, atol=1e-5)
    np.testing.assert_array_equal(placed[0], placed[1])  # without points, as the nearest that has some
    for t in (1, FRAMES - 1):
        turn = synthetic.turn_about([0.0, 1.0, 0.0], STEP * (t - chosen.keyframe))
        assert np.median(np.linalg.norm(placed[t] - chosen.mesh.vertices @ turn.T, axis=1)) < 0.1
        assert signed_volume(placed[t], chosen.mesh.faces) > 0


def test_one_side_alone_is_told_and_left_to_the_keyframe():
    for step, told in ((0.05, "only one side is ever seen"), (0.4, "too little")):
        assert (np.rad2deg(3 * step) < ONE_SIDE) == (step == 0.05)
        chosen, note = template_of_all(*film(step, 4), Config(), EYE)
        assert chosen is None and told in note


def test_a_body_that_is_lost_on_the_way_is_told():
    points, normals = film(STEP, 6)
    points[5] = 3.0 * points[5]
    chosen, note = template_of_all(points, normals, Config(keyframe=KeyframeConfig(choice="0")), EYE)
    assert chosen is None and "it is lost in frame 5" in note


def test_nodes_go_on_as_they_went_and_what_no_frame_shows_goes_with_the_rest():
    points, normals = body(800, 0)
    surfels = Surfels(points, normals, 0.05)
    node = points[surfels.graph.node]
    turn = synthetic.turn_about([0.0, 1.0, 0.0], 0.1)
    turned = Pose(np.tile(turn, (len(node), 1, 1)), node @ turn.T - node)
    hidden = node[:, 0] > 0.5
    astray = Pose(turned.rotation.copy(), turned.shift + hidden[:, None] * [0.0, 0.4, 0.0])
    twice = node @ (turn @ turn).T
    there = node + surfels.going_on(turned, surfels.still(), np.ones(len(node), dtype=bool)).shift
    np.testing.assert_allclose(there, twice, atol=1e-12)
    next_pose = surfels.going_on(astray, surfels.still(), ~hidden)
    np.testing.assert_allclose((node + next_pose.shift)[~hidden], twice[~hidden], atol=1e-12)
    np.testing.assert_allclose((node + next_pose.shift)[hidden], (twice + [0.0, 0.4, 0.0])[hidden], atol=1e-12)


def test_a_run_on_it_goes_on_from_its_checkpoint_with_the_same_bits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    config, at = Config(), tmp_path / "checkpoint"
    config = replace(
        config,
        grid=replace(config.grid, levels=3),
        optimiser=replace(config.optimiser, iterations=20, warmup=20),
        refine=replace(config.refine, iterations=2),
        template=replace(config.template, faces_max=1000),
    )
    clouds, cut = film(STEP, 5, 1600)[0], KeyboardInterrupt("cut")

    def run(**how) -> warpdef.Reconstruction:
        callback = how.pop("callback", None)
        asked = None if "resume" in how else config
        return warpdef.reconstruct(
            clouds, asked, device="cpu", threads=1, callback=callback, safeguards=warpdef.Safeguards(**how)
        )

    def die(progress) -> None:
        if progress.phase == "optimise" and progress.iteration == 20:
            raise cut

    whole = run()
    assert any("made of all frames" in warning for warning in whole.report["warnings"])
    with pytest.raises(KeyboardInterrupt):
        run(checkpoint=at, checkpoint_seconds=0.0, callback=die)
    monkeypatch.setattr("warpdef.starting_template.template_of_all", None)  # it is not grown again
    again = run(resume=at)
    np.testing.assert_array_equal(again.vertices, whole.vertices)
    assert again.report["warnings"] == whole.report["warnings"]


def test_a_sheet_is_called_one():
    half = TemplateReport("gpytoolbox", surface="open", trimmed=1.1)
    assert "a sheet of what is seen there: closed, it would have 110% more surface" in sheet_note(half)
    assert not sheet_note(replace(half, trimmed=0.1)) and not sheet_note(replace(half, surface="closed"))
