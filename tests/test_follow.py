"""Frames are fitted one after the other from their inner neighbours: all, or those that a long chain has lost."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
import synthetic
from descent import chained

from warpdef.config import Config
from warpdef.device import find_device
from warpdef.fit.follow import follow
from warpdef.fit.optimise import Optimiser
from warpdef.fit.problem import Problem
from warpdef.fit.recover import Cloud, Matches, Surface
from warpdef.fit.refine import Refinement
from warpdef.fit.workers import Team

FRAMES, KEYFRAME = 13, 6
BODY = synthetic.turning_ellipsoid(FRAMES, 1500, np.random.default_rng(0), subdivisions=3)
GRID = replace(Config().grid, levels=3)


def lost_chain(team: Team, oriented: bool = True, chain: bool = True) -> tuple[Optimiser, Refinement]:
    """Grids that were never fitted: the template stands still while the clouds turn away from it."""
    normals = BODY.normals
    if not oriented:
        rng = np.random.default_rng(1)
        normals = [n * rng.choice([-1.0, 1.0], size=(len(n), 1)) for n in normals]
    config = replace(Config(), grid=GRID)
    problem = Problem(
        BODY.clouds, normals, BODY.vertices[KEYFRAME], BODY.faces, KEYFRAME,
        chained(config) if chain else config,
        find_device("cpu"), [oriented or t == KEYFRAME for t in range(FRAMES)],
    )  # fmt: skip
    optimiser = Optimiser(problem, 1, team)
    optimiser.finish()
    return optimiser, Refinement(optimiser.objective, team)


def uncovered(optimiser: Optimiser) -> list[float]:
    p, vertices = optimiser.problem, optimiser.objective.vertices.numpy().astype(np.float64)
    surface = Surface.of(p.faces, p.edges.numpy())
    clouds = [Cloud(c, n, True, True) for c, n in zip(BODY.clouds, BODY.normals, strict=True)]
    return [Matches(c, surface).uncovered(v) for c, v in zip(clouds, vertices, strict=True)]


@pytest.mark.parametrize("oriented", [True, False])
def test_a_lost_chain_is_followed_outwards(oriented):
    with closing(Team(1)) as team:
        optimiser, refinement = lost_chain(team, oriented)
        before = optimiser.objective.vertices.numpy().copy()
        given = optimiser.problem.normals.numpy().copy()
        lost = np.array(uncovered(optimiser))
        assert lost[[0, -1]].min() > 0.2
        followed, bent = follow(optimiser.objective, refinement)
        after = optimiser.objective.vertices.numpy()
    kept = [t for t in range(FRAMES) if t not in followed]
    assert KEYFRAME in kept and followed == [t for t in range(FRAMES) if t < kept[0] or t > kept[-1]]
    assert {0, 1, FRAMES - 2, FRAMES - 1} <= set(followed)
    np.testing.assert_array_equal(after[kept], before[kept])
    np.testing.assert_array_equal(optimiser.problem.normals.numpy(), given)
    assert np.array(uncovered(optimiser))[followed].max() < 0.02
    # On the surface, and turned with it, as far as planes alone tell: no step of the grids helped.
    error = np.linalg.norm(optimiser.objective.placed_vertices() - BODY.vertices, axis=2).mean(axis=1)
    stood = np.linalg.norm(BODY.vertices[KEYFRAME] - BODY.vertices, axis=2).mean(axis=1)
    assert (error[[0, -1]] < 0.6 * stood[[0, -1]]).all()


def test_two_threads_give_the_same_bits():
    found = []
    for threads in (1, 2):
        with closing(Team(threads)) as team:
            optimiser, refinement = lost_chain(team)
            follow(optimiser.objective, refinement, threads)
            found.append(optimiser.objective.vertices.numpy().copy())
    np.testing.assert_array_equal(*found)


def test_told_to_stop_it_leaves_the_rest_alone():
    with closing(Team(1)) as team:
        optimiser, refinement = lost_chain(team)
        before = optimiser.objective.vertices.numpy().copy()
        assert follow(optimiser.objective, refinement, stopped=lambda: "interrupted") == ([], [])
        np.testing.assert_array_equal(optimiser.objective.vertices.numpy(), before)
        asked = iter([False, False, True, True])
        assert len(follow(optimiser.objective, refinement, stopped=lambda: next(asked))[0]) == 2


def test_frames_that_are_covered_stay_bit_for_bit():
    with closing(Team(1)) as team:
        optimiser, refinement = lost_chain(team)
        optimiser.objective.vertices.assign(BODY.vertices[:, np.argsort(optimiser.problem.place)].astype(np.float32))
        before = optimiser.objective.vertices.numpy().copy()
        assert follow(optimiser.objective, refinement) == ([], [])
        np.testing.assert_array_equal(optimiser.objective.vertices.numpy(), before)


@pytest.mark.parametrize("oriented", [True, False])
def test_without_a_chain_every_frame_is_followed(oriented: bool) -> None:
    with closing(Team(1)) as team:
        optimiser, refinement = lost_chain(team, oriented, chain=False)
        stood = optimiser.objective.vertices.numpy().copy()
        followed, bent = follow(optimiser.objective, refinement)
        after = optimiser.objective.vertices.numpy()
    assert followed == [t for t in range(FRAMES) if t != KEYFRAME] and set(bent) <= set(followed)
    np.testing.assert_array_equal(after[KEYFRAME], stood[KEYFRAME])
    assert (np.abs(after - stood).max(axis=(1, 2))[followed] > 0).all()
    assert np.array(uncovered(optimiser)).max() < 0.02


def test_a_guide_moves_no_vertex_and_leaves_the_template() -> None:
    with closing(Team(1)) as team:
        optimiser, _ = lost_chain(team, chain=False)
        before, shape = optimiser.objective.vertices.numpy().copy(), optimiser.shape.x.numpy().copy()
        optimiser.iterate()
        assert np.abs(optimiser.nodes.numpy()).max() > 0
        np.testing.assert_array_equal(optimiser.objective.vertices.numpy(), before)
        np.testing.assert_array_equal(optimiser.shape.x.numpy(), shape)
