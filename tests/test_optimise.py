"""The descent: same bits for any number of threads, every ablation, and motion that is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import reference
import synthetic
import warp as wp
from descent import chained

from warpdef.config import Config
from warpdef.fit.optimise import Optimiser
from warpdef.fit.problem import Problem
from warpdef.fit.workers import Team


def configured(**groups: dict) -> Config:
    """The paper's descent on small grids, else the default configuration, with these fields of these groups."""
    config = chained(replace(Config(), grid=replace(Config().grid, levels=4)))
    return replace(config, **{name: replace(getattr(config, name), **values) for name, values in groups.items()})


class DescendedRun:
    """A descent on a synthetic sequence; ``losses`` after every iteration, Chamfer terms unweighted."""

    def __init__(
        self,
        moving: synthetic.Synthetic,
        config: Config,
        device: str,
        iterations: int,
        keyframe: int = 1,
        threads: int = 1,
    ) -> None:
        template, normals = moving.vertices[keyframe], moving.normals
        problem = Problem(moving.clouds, normals, template, moving.faces, keyframe, config, wp.get_device(device))
        team = Team(threads)
        try:
            self.optimiser = Optimiser(problem, iterations, team)
            self.losses, self.chamfer = [], []
            for _ in range(iterations):
                self.optimiser.iterate()
                self.losses.append(self.optimiser.look())
                objective = self.optimiser.objective
                self.chamfer.append(float(objective.input.loss.numpy().sum() + objective.transform.loss.numpy().sum()))
            self.vertices = self.optimiser.vertices()
        finally:
            team.close()


def assert_same_way(found: np.ndarray, expected: np.ndarray, tolerance: float, device: str) -> None:
    """CUDA adds up in any order, and Adam's first steps go by the sign of a gradient, however small."""
    np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance if device == "cpu" else 1e-3)


@pytest.fixture
def ellipsoid(rng: np.random.Generator) -> synthetic.Synthetic:
    return synthetic.turning_ellipsoid(4, 150, rng, subdivisions=1)


def test_any_number_of_threads_gives_the_same_bits(ellipsoid, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("warpdef.kernels.ways.VERTICES_PER_TASK", 10)  # several tasks for a small template
    config = configured(optimiser={"warmup": 4})
    runs = [DescendedRun(ellipsoid, config, "cpu", 12, threads=n) for n in (1, 2, 3)]
    for run in runs[1:]:
        np.testing.assert_array_equal(run.vertices, runs[0].vertices)
        assert run.losses == runs[0].losses
    assert np.abs(runs[0].vertices[3] - ellipsoid.vertices[1]).max() > 0.01


def test_spans_of_vertices_and_single_tasks_agree(ellipsoid, monkeypatch: pytest.MonkeyPatch) -> None:
    config = configured(optimiser={"warmup": 2})
    whole = DescendedRun(ellipsoid, config, "cpu", 6)
    monkeypatch.setattr("warpdef.kernels.ways.VERTICES_PER_TASK", 7)
    np.testing.assert_array_equal(DescendedRun(ellipsoid, config, "cpu", 6).vertices, whole.vertices)


VARIANTS = {
    "default": {},
    "single resolution": {"grid": {"coarsest": 4}},
    "no preconditioning": {"sobolev": {"enabled": False}},
    "no isometry": {"loss": {"isometry_weight": 0.0}},
    "one level": {"grid": {"levels": 1}},
    "twelve levels": {"grid": {"levels": 12}},
    "pruned": {"grid": {"prune": True, "prune_cells": 1, "levels": 6}},
    "conjugate gradients on full grids": {"sobolev": {"solver": "cg"}},
    "means": {"loss": {"reduction": "mean", "isometry_weight": 1.0}},
    "fourth power": {"loss": {"robust_power": 4}},
    "plain distances": {"loss": {"tangential": 1.0}},
    "template follows all": {"loss": {"template_follows_all": True}},
    "no confidence, constant rate": {"loss": {"confidence": False}, "optimiser": {"decay": "constant"}},
}


@pytest.mark.parametrize("groups", VARIANTS.values(), ids=VARIANTS)
def test_every_variant_descends(groups: dict, ellipsoid, device: str) -> None:
    groups = {**groups, "optimiser": {"warmup": 0, **groups.get("optimiser", {})}}
    run = DescendedRun(ellipsoid, configured(**groups), device, 20)
    assert np.isfinite(run.vertices).all()
    # What is left are the clouds' own gaps, most with plain distances; and without preconditioning steps are small.
    assert run.chamfer[-1] < 0.95 * run.chamfer[0]
    assert all(np.isfinite(list(told.values())).all() for told in run.losses)
    assert run.optimiser.solves.stalled == 0


@pytest.mark.parametrize("keyframe", [0, 3])
def test_a_keyframe_at_an_end(keyframe: int, ellipsoid, device: str) -> None:
    run = DescendedRun(ellipsoid, configured(optimiser={"warmup": 0}), device, 20, keyframe)
    assert run.chamfer[-1] < 0.8 * run.chamfer[0]


def off_surface(found: np.ndarray, moving: synthetic.Synthetic, rng: np.random.Generator) -> np.ndarray:
    """Mean distance of each frame's vertices to the true surface: to the plane of the nearest of many samples."""
    distances = []
    for vertices, truth in zip(found, moving.vertices, strict=True):
        points, normals = synthetic.sample_surface(truth, moving.faces, 4000, rng)
        nearest = reference.nearest(vertices, points)
        distances.append(np.abs(((vertices - points[nearest]) * normals[nearest]).sum(axis=1)).mean())
    return np.array(distances)


@pytest.mark.parametrize(
    ("kind", "points", "share"), [(synthetic.turning_ellipsoid, 400, 0.1), (synthetic.bending_bar, 1500, 0.35)]
)
def test_known_motion_is_recovered(kind, points: int, share: float, device: str, rng: np.random.Generator) -> None:
    """Vertices end near where they truly went. What slides along a smooth surface is seen by the isometry term only."""
    moving = kind(5, points, rng, subdivisions=2)
    run = DescendedRun(moving, configured(optimiser={"warmup": 10}), device, 120, keyframe=2)
    still = np.tile(moving.vertices[2], (5, 1, 1))
    motion, error = (np.linalg.norm(v - moving.vertices, axis=2).mean(axis=1) for v in (still, run.vertices))
    before, after = (off_surface(v, moving, rng) for v in (still, run.vertices))
    away = [0, 1, 3, 4]
    assert (error[away] < share * motion[away]).all(), f"errors {error}, motions {motion}"
    assert (after[away] < 0.2 * before[away]).all(), f"off the surface by {after}, before by {before}"
    assert error[2] < 0.005


def test_before_the_first_step_every_frame_is_the_template(ellipsoid, device: str) -> None:
    run = DescendedRun(ellipsoid, configured(), device, 0)
    expected = np.tile(ellipsoid.vertices[1].astype(np.float32), (4, 1, 1))
    np.testing.assert_array_equal(run.vertices, expected)


def test_a_template_that_does_not_descend_stays(ellipsoid, device: str) -> None:
    """What Adam moves is (I + lambda L) x: left alone, it must solve back to the template, as far as the solve goes."""
    config = configured(optimiser={"template_rate": 0.0, "warmup": 2}, sobolev={"tolerance": 1e-6})
    run = DescendedRun(ellipsoid, config, device, 6)
    np.testing.assert_allclose(run.vertices[1], ellipsoid.vertices[1], rtol=0, atol=2e-6)


@pytest.mark.parametrize("seen", [0.0, 9.0])
def test_a_keyframe_that_shows_a_part_moves_no_template(seen: float, device: str) -> None:
    """Of a mesh given, what the keyframe does not show is known from the mesh alone."""
    moving = synthetic.turning_ellipsoid(4, 900, np.random.default_rng(0), subdivisions=1)
    kept = moving.clouds[1][:, 0] < seen
    clouds, normals = list(moving.clouds), list(moving.normals)
    clouds[1], normals[1] = clouds[1][kept], normals[1][kept]
    config = configured(sobolev={"tolerance": 1e-6})
    run = DescendedRun(replace(moving, clouds=clouds, normals=normals), config, device, 12)
    assert run.optimiser.problem.measures.complete[1] == (seen > 1)
    moved = np.abs(run.vertices[1] - moving.vertices[1]).max()
    # Where conjugate gradients take the template's offsets u back to it, M x = u is left with a residual |r| below the
    # tolerance times |u| (a hair above, for it is added up in float32), and as no eigenvalue of M = I + lambda L is
    # smaller than 1, |x - M^-1 u| <= |r|. The factorisation that a CPU has is exact but for rounding.
    by_gradients = 1.01e-6 * float(np.linalg.norm(run.optimiser.shape.u.numpy()))
    still = 1e-6 if device == "cpu" else by_gradients
    assert still < 5e-5 < 1e-4
    assert moved > 1e-4 if seen > 1 else moved < still


def test_during_warm_up_the_template_descends_and_isometry_waits(ellipsoid, device: str) -> None:
    run = DescendedRun(ellipsoid, configured(optimiser={"warmup": 3}), device, 5)
    assert [told["isometry"] > 0 for told in run.losses] == [False, False, False, True, True]
    assert [told["transform"] > 0 for told in run.losses] == [False, False, False, True, True]
    assert run.losses[2]["mesh"] != run.losses[0]["mesh"]


def test_frames_far_from_the_keyframe_are_trusted_less(ellipsoid, device: str) -> None:
    """In the first iteration the template stands still: the farther a frame has turned, the more it is off."""
    run, blind = (
        DescendedRun(ellipsoid, configured(optimiser={"warmup": 0}, loss={"confidence": c}), device, 1, keyframe=0)
        for c in (True, False)
    )
    o = run.optimiser.objective
    expected = reference.confidence(o.input.loss.numpy(), o.transform.loss.numpy(), 0, 1.0, False)
    np.testing.assert_allclose(o.confidence.numpy(), expected, rtol=1e-5)
    assert expected[-1] < 0.9
    np.testing.assert_array_equal(blind.optimiser.objective.confidence.numpy(), 1)
    assert run.losses[0]["transform"] < 0.97 * blind.losses[0]["transform"]


def test_preparing_changes_nothing(ellipsoid, device: str) -> None:
    config = configured()
    problem = Problem(
        ellipsoid.clouds, ellipsoid.normals, ellipsoid.vertices[1], ellipsoid.faces, 1, config, wp.get_device(device)
    )
    prepared = Optimiser(problem, 5, Team(1))
    prepared.prepare()
    assert prepared.done == 0
    np.testing.assert_array_equal(prepared.vertices(), np.tile(ellipsoid.vertices[1].astype(np.float32), (4, 1, 1)))
    for _ in range(5):
        prepared.iterate()
    assert_same_way(prepared.vertices(), DescendedRun(ellipsoid, config, device, 5).vertices, 0.0, device)


def test_warps_own_solver_takes_the_same_way(device: str, rng: np.random.Generator) -> None:
    moving = synthetic.turning_ellipsoid(3, 80, rng, subdivisions=1)
    vertices = []
    for solver in ("cg", "warp"):
        config = configured(grid={"levels": 3}, sobolev={"solver": solver, "tolerance": 1e-6}, optimiser={"warmup": 2})
        vertices.append(DescendedRun(moving, config, device, 6).vertices)
    assert np.abs(vertices[0][2] - moving.vertices[1]).max() > 0.01
    assert_same_way(vertices[1], vertices[0], 1e-4, device)


def test_the_first_step_is_adam_on_the_preconditioned_gradient(ellipsoid, device: str) -> None:
    """u moves by the rate against the sign of (I + lambda L)^-1 g, and x is (I + lambda L)^-1 u."""
    config = configured(grid={"levels": 2}, optimiser={"warmup": 0, "rate": 5e-3, "decay": "constant"})
    run = DescendedRun(ellipsoid, config, device, 1)
    found = run.optimiser.nodes.numpy()[..., :6].astype(np.float64)
    rates, lambdas = [5e-3, 5e-3 * 1.1], [0.25, 0.375]
    for n, begin, rate, weight in zip([1, 3], [0, 1], rates, lambdas, strict=True):
        matrix = reference.smoother(reference.grid_edges(n), n**3, weight)
        u = np.einsum("ij,sjc->sic", matrix, found[:, begin : begin + n**3])
        np.testing.assert_allclose(np.abs(u), rate, rtol=1e-3)
