"""The template made again of sparse frames: their points taken back, what is taken of it, and what is told."""

from __future__ import annotations

import os
import signal
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import synthetic

import warpdef
from warpdef.config import Config
from warpdef.fit.gathering import (
    gathered_points,
    gathers,
    keep_doubts,
    may_gather,
    nearness,
    told_of_few_points,
    why_worse,
)
from warpdef.geometry.closest import closest_on_surface
from warpdef.presets import preset
from warpdef.progress import Progress
from warpdef.quality.verdict import DOUBTFUL, GOOD
from warpdef.template.build import TemplateReport

FRAMES = 4
AXES = np.array([0.7, 0.5, 0.35])
TRUTH = synthetic.turning_ellipsoid(FRAMES, 300, np.random.default_rng(3))


class Shift:
    """Grids that know the motion: so much a frame along x, from the keyframe on."""

    def __init__(self, keyframe: int, step: float) -> None:
        self.keyframe, self.step = keyframe, step

    def carry(self, points: np.ndarray) -> np.ndarray:
        along = self.step * (np.arange(FRAMES) - self.keyframe)
        return points + along[:, None, None] * [1.0, 0.0, 0.0]


def moved(vertices: np.ndarray, faces: np.ndarray, motion: Any = None, keyframe: int = 1) -> Any:
    return SimpleNamespace(vertices=vertices, faces=faces, keyframe=keyframe, motion=motion)


def test_points_go_back_to_the_surface_of_the_keyframe() -> None:
    result = moved(TRUTH.vertices.astype(np.float32), TRUTH.faces)
    points, known = gathered_points(result, TRUTH.clouds)
    assert known > 0.98 and len(points) == 300 + round(known * (FRAMES - 1) * 300)
    assert np.array_equal(points[:300], TRUTH.clouds[1])
    assert closest_on_surface(points, TRUTH.vertices[1], TRUTH.faces)[0].max() < 2e-3
    # The others are no copies of the keyframe's: they lie between them.
    assert np.ptp(TRUTH.vertices[0] - TRUTH.vertices[1], axis=0).max() > 0.05


def balls(count: int) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """A ball and, apart, a small one that the mesh has lost: its meshes (T, V, 3), faces, and clouds of both."""
    vertices, faces = synthetic.icosphere(3)
    rng = np.random.default_rng(0)
    steps = 0.3 * (np.arange(FRAMES) - 1)
    clouds = []
    for step in steps:
        d = rng.normal(size=(count, 3))
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        d[: count // 5] = 0.3 * d[: count // 5] + [0.0, 2.0, 0.0]
        clouds.append(d + [step, 0.0, 0.0])
    return vertices + steps[:, None, None] * [1.0, 0.0, 0.0], faces, clouds


def test_what_the_mesh_has_lost_goes_back_with_the_grids() -> None:
    vertices, faces, clouds = balls(500)
    still = np.broadcast_to(vertices[1], vertices.shape)  # a mesh that has not moved leaves all to the grids
    points, known = gathered_points(moved(still, faces, Shift(1, 0.3)), clouds)
    small = points[points[:, 1] > 1.4]
    assert known > 0.9 and len(small) >= 0.95 * FRAMES * 100
    assert np.abs(np.linalg.norm(small - [0.0, 2.0, 0.0], axis=1) - 0.3).max() < 1e-6
    # Without them it comes back where it was in its own frame, and most of that is where the keyframe has no points.
    lost = gathered_points(moved(still, faces), clouds)[1]
    assert lost < known


def test_frames_nearest_to_the_keyframe_are_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    from warpdef.fit import gathering

    monkeypatch.setattr(gathering, "GATHERED", 600)
    clouds = [cloud + [0.0, 0.0, 10.0] if t == 3 else cloud for t, cloud in enumerate(TRUTH.clouds)]
    points, _ = gathered_points(moved(TRUTH.vertices, TRUTH.faces), clouds)
    assert 590 <= len(points) <= 600  # none of frame 3, which would lie elsewhere
    assert points[:, 2].max() < 1.0
    empty = [np.empty((0, 3)) if t == 0 else cloud for t, cloud in enumerate(TRUTH.clouds)]
    assert 590 <= len(gathered_points(moved(TRUTH.vertices, TRUTH.faces), empty)[0]) <= 600


def test_only_sparse_frames_are_gathered() -> None:
    config = Config()
    assert may_gather([600] * 5, config) and may_gather([600, 0, 900, 0, 700], config)
    assert not may_gather([5000] * 5, config) and not may_gather([600] * 2, config) and not may_gather([0, 0], config)
    assert not may_gather([600] * 5, replace(config, template=replace(config.template, gather=False)))
    assert not may_gather([600] * 5, preset("paper"))


@pytest.mark.parametrize(
    ("normals", "surface", "asked", "expected"),
    [
        ("estimated", "closed", "auto", True),
        ("given", "closed", "auto", False),
        ("given", "open", "auto", True),
        ("estimated", "open", "open", False),
    ],
)
def test_what_leaves_something_to_gain(normals: str, surface: str, asked: Any, expected: bool) -> None:
    report = TemplateReport(backend="gpytoolbox", normals=normals, surface=surface)
    config = replace(Config(), template=replace(Config().template, surface=asked))
    chosen = cast(Any, SimpleNamespace(report=report, placed=None))
    assert gathers(chosen, config) == expected
    assert not gathers(cast(Any, SimpleNamespace(report=replace(report, backend="user"), placed=None)), config)


def result_of(vertices: np.ndarray, verdicts: list[str], **template: Any) -> Any:
    told = {"surface": "open", "trimmed": 0.2, "normals": "estimated", **template}
    report = {
        "verdicts": list(verdicts),
        "template": told,
        "warnings": [],
        "quality": [{"reasons": []} for _ in verdicts],
    }
    return SimpleNamespace(vertices=vertices, faces=TRUTH.faces, config=Config(), report=report)


def test_the_nearer_mesh_is_taken_unless_more_frames_are_in_doubt() -> None:
    near, far = TRUTH.vertices, TRUTH.vertices * 1.05
    good = [GOOD] * FRAMES
    assert nearness(result_of(near, good), TRUTH.clouds, 0) < nearness(result_of(far, good), TRUTH.clouds, 0)
    assert why_worse(result_of(far, good), result_of(near, good), TRUTH.clouds) == ""
    assert "farther" in why_worse(result_of(near, good), result_of(far, good), TRUTH.clouds)
    doubted = [DOUBTFUL, *good[1:]]
    assert "1 frames" in why_worse(result_of(far, good), result_of(near, doubted), TRUTH.clouds)


def test_openings_that_may_be_want_of_points_are_doubted() -> None:
    told = told_of_few_points(result_of(TRUTH.vertices, [GOOD, "lost"]), "it is open").report
    assert told["verdicts"] == [DOUBTFUL, "lost"] and told["gathered"] == "it is open"
    assert "20%" in told["warnings"][0] and "--template.surface closed" in told["warnings"][0]
    assert told["quality"][0]["reasons"] and not told["quality"][1]["reasons"]
    for right in ({"surface": "closed"}, {"trimmed": 2.0}, {"normals": "given"}):
        told = told_of_few_points(result_of(TRUTH.vertices, [GOOD], **right), "").report
        assert told["verdicts"] == [GOOD] and not told["warnings"] and told["gathered"] == "taken"


@pytest.mark.parametrize(("handles", "expected"), [(1, [DOUBTFUL, GOOD, DOUBTFUL]), (0, [GOOD, GOOD, DOUBTFUL])])
def test_where_there_are_handles_what_was_doubtful_stays_so(handles: int, expected: list[str]) -> None:
    first = result_of(TRUTH.vertices, [DOUBTFUL, GOOD, DOUBTFUL], gate={"handles": 1})
    second = result_of(TRUTH.vertices, [GOOD, GOOD, DOUBTFUL], gate={"handles": handles})
    keep_doubts(first, second)
    assert second.report["verdicts"] == expected
    assert len(second.report["warnings"]) == len(second.report["quality"][0]["reasons"]) == (handles > 0)


def quick() -> Config:
    base = Config()
    return replace(
        base,
        grid=replace(base.grid, levels=3),
        optimiser=replace(base.optimiser, iterations=30),
        refine=replace(base.refine, iterations=4),
    )


def fitted(**how: Any) -> warpdef.Reconstruction:
    callback, config = how.pop("callback", None), None if "resume" in how else quick()
    safeguards = warpdef.Safeguards(**how)
    return warpdef.reconstruct(TRUTH.clouds, config, device="cpu", threads=1, callback=callback, safeguards=safeguards)


def test_a_sparse_body_is_fitted_twice_and_goes_on_when_cut_short(tmp_path: Path) -> None:
    phases, shown = [], set()

    def note(progress: Progress) -> None:
        phases.append((progress.phase, progress.message))
        if progress.meshes is not None:
            shown.add(len(progress.meshes().faces))

    whole = fitted(callback=note)
    assert len(shown) == 1  # a window shows one mesh
    assert sum(phase == "compile" for phase, _ in phases) == 2
    assert any("made again" in message for _, message in phases)
    assert whole.report["gathered"] and whole.report["stopped"] is None
    once = warpdef.reconstruct(
        TRUTH.clouds, replace(quick(), template=replace(quick().template, gather=False)), device="cpu", threads=1
    )
    assert "gathered" not in once.report
    taken = whole.report["gathered"] == "taken"
    assert taken == ("made again" in whole.report["keyframe_why"])

    seen = []

    def interrupt(progress: Progress) -> None:
        seen.append(progress.phase)
        if seen.count("compile") == 2 and progress.phase == "optimise" and progress.iteration == 10:
            os.kill(os.getpid(), signal.SIGINT)

    cut = fitted(checkpoint=tmp_path / "c", checkpoint_seconds=1e6, callback=interrupt)
    assert cut.report["interrupted"] and cut.report["stopped"] == "interrupted"
    assert np.array_equal(cut.vertices, once.vertices)  # the first fit, whole
    gone_on = fitted(resume=tmp_path / "c")
    assert np.array_equal(gone_on.vertices, whole.vertices) and np.array_equal(gone_on.faces, whole.faces)
    assert gone_on.report["gathered"] == whole.report["gathered"] and gone_on.report["resumed"]
