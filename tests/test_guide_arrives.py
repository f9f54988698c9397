"""A guide leaves transitions alone that have arrived, and goes on with the others, the same when taken up again."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import synthetic
import warp as wp

from warpdef.config import Config
from warpdef.fit.optimise import Optimiser
from warpdef.fit.problem import Problem
from warpdef.fit.workers import Team


@pytest.fixture
def team() -> Iterator[Team]:
    team = Team(1)
    yield team
    team.close()


def guide(team: Team, device: str, last: float = 1.0, points: int = 600, frames: int = 4, noise: float = 0.0):
    """Of an ellipsoid that turns; the last cloud ``last`` times as large, all of them with noise."""
    rng = np.random.default_rng(3)
    moving = synthetic.turning_ellipsoid(frames, points, rng, subdivisions=2)
    clouds = [c + noise * rng.normal(size=c.shape) for c in moving.clouds]
    clouds[-1] = last * clouds[-1]
    config = replace(Config(), grid=replace(Config().grid, levels=4))
    problem = Problem(clouds, moving.normals, moving.vertices[0], moving.faces, 0, config, wp.get_device(device))
    return Optimiser(problem, 100, team)


def run(optimiser: Optimiser, until: int) -> list[int]:
    """Iterations until then or the end, with a look and what it leaves remembered every ten; where the looks were."""
    looks = []
    while optimiser.done < until and not optimiser.ended:
        optimiser.iterate()
        if optimiser.done % 10 == 0:
            optimiser.look()
            optimiser.keep()
            looks.append(optimiser.done)
    return looks


def test_two_samplings_of_one_surface_leave_what_is_expected(team: Team, device: str) -> None:
    """Of the same ellipsoid, standing still, at the start: the floor itself, but for the surface's own curves."""
    rng = np.random.default_rng(5)
    vertices, faces = synthetic.icosphere(3)
    clouds, normals = zip(*(synthetic.sample_surface(vertices, faces, 2000, rng) for _ in range(3)), strict=True)
    problem = Problem(list(clouds), list(normals), 0.9 * vertices, faces, 1, Config(), wp.get_device(device))
    optimiser = Optimiser(problem, 100, team)
    optimiser.iterate()
    assert optimiser.objective.input.arrived(1.15).all() and not optimiser.objective.input.arrived(0.85).any()


def test_a_guide_ends_when_all_have_arrived(team: Team, device: str) -> None:
    optimiser = guide(team, device)
    looks = run(optimiser, 100)
    assert 40 <= looks[-1] < 100 and optimiser.ended


def test_noise_goes_on_to_the_end(team: Team, device: str) -> None:
    optimiser = guide(team, device, noise=0.05)
    assert run(optimiser, 100)[-1] == 100


def test_only_what_has_not_arrived_goes_on(team: Team) -> None:
    """CPU: grids of the others keep their bits, and so do their losses."""
    optimiser = guide(team, "cpu", last=1.6)
    run(optimiser, 70)
    before, told = optimiser.nodes.numpy().copy(), optimiser.objective.input.loss.numpy().copy()
    assert not optimiser.ended
    run(optimiser, 90)
    changed = (optimiser.nodes.numpy() != before).any(axis=(1, 2))
    assert changed.tolist() == [False, False, True]
    assert (optimiser.objective.input.loss.numpy() != told).tolist() == [False, False, True]


def test_a_guide_taken_up_again_goes_on_with_the_same(team: Team) -> None:
    """The bits of one unbroken, losses and all, also where it went back to what was remembered."""
    whole, again = guide(team, "cpu", last=1.6), guide(team, "cpu", last=1.6)
    run(whole, 60)
    again.restore({name: a.copy() for name, a in whole.kept().items()}, 1.0)
    assert again.done == 60
    run(whole, 80)
    run(again, 65)
    again.go_back()
    run(again, 80)
    np.testing.assert_array_equal(again.nodes.numpy(), whole.nodes.numpy())
    assert again.look() == whole.look()


def test_frames_that_show_less_than_all_do_not_arrive(team: Team, device: str) -> None:
    """What they leave out leaves no loss, arrived or not."""
    rng = np.random.default_rng(3)
    moving = synthetic.turning_ellipsoid(3, 600, rng, subdivisions=2)
    kept = [np.ones(600, bool), np.ones(600, bool), moving.clouds[2][:, 0] > 0]
    clouds, normals = ([a[k] for a, k in zip(some, kept, strict=True)] for some in (moving.clouds, moving.normals))
    problem = Problem(clouds, normals, moving.vertices[0], moving.faces, 0, Config(), wp.get_device(device))
    assert problem.measures.complete.tolist() == [True, True, False]
    optimiser = Optimiser(problem, 100, team)
    optimiser.iterate()
    assert optimiser.objective.input.arrived(1e6).tolist() == [True, False]
