"""Frames are fitted one after the other from their inner neighbours: all, or those that a long chain has lost."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
import synthetic
from descent import chained
from leg_samples import DEGREE, body, cloud_of
from refine_samples import MovingEllipsoid

from warpdef.config import Config
from warpdef.device import Way, find_device, going
from warpdef.fit.follow import follow
from warpdef.fit.optimise import Optimiser
from warpdef.fit.problem import Problem
from warpdef.fit.recover import Cloud, ConnectedSurface, Matches
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
    surface = ConnectedSurface.of(p.faces, p.edges.numpy())
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


@pytest.mark.parametrize("chain", [True, False])
def test_two_threads_give_the_same_bits(chain: bool) -> None:
    found = []
    for threads in (1, 2):
        with closing(Team(threads)) as team:
            optimiser, refinement = lost_chain(team, oriented=chain, chain=chain)
            follow(optimiser.objective, refinement, threads)
            found.append(optimiser.objective.vertices.numpy().copy())
    np.testing.assert_array_equal(*found)


@pytest.mark.parametrize("chain", [True, False])
def test_told_to_stop_it_leaves_the_rest_alone(chain: bool) -> None:
    with closing(Team(1)) as team:
        optimiser, refinement = lost_chain(team, chain=chain)
        before = optimiser.objective.vertices.numpy().copy()
        assert follow(optimiser.objective, refinement, stopped=lambda: "interrupted") == ([], [])
        np.testing.assert_array_equal(optimiser.objective.vertices.numpy(), before)
        asked = iter([False, False, True, True])
        fitted, _ = follow(optimiser.objective, refinement, stopped=lambda: next(asked))
        assert len(fitted) == 2
        left = [t for t in range(FRAMES) if t not in fitted]
        np.testing.assert_array_equal(optimiser.objective.vertices.numpy()[left], before[left])


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


@pytest.mark.parametrize("recover", [True, False])
def test_a_limb_lost_on_the_way_is_bent_back_and_named(recover: bool) -> None:
    """The first leg comes to where the second was, and stays; the grids know nothing of it."""
    poses = [body((0.0, 0.0))[0], *[body((-24 * DEGREE, -26 * DEGREE))[0]] * 2]
    faces = body((0.0, 0.0))[1]
    clouds = [cloud_of(v, faces, seed) for seed, v in enumerate(poses)]
    config = replace(Config(), grid=GRID, refine=replace(Config().refine, recover=recover))
    problem = Problem(
        [c.points for c in clouds], [c.normals for c in clouds], poses[0], faces, 0, config, find_device("cpu")
    )
    with closing(Team(1)) as team:
        optimiser = Optimiser(problem, 1, team)
        optimiser.finish()
        found = follow(optimiser.objective, Refinement(optimiser.objective, team))
    surface = ConnectedSurface.of(problem.faces, problem.edges.numpy())
    vertices = optimiser.objective.vertices.numpy().astype(np.float64)
    left = [Matches(cloud, surface).uncovered(v) for cloud, v in zip(clouds, vertices, strict=True)]
    if recover:
        # The frame behind it starts from what was found.
        assert found == ([1, 2], [1]) and max(left) < 0.02
        error = np.linalg.norm(optimiser.objective.placed_vertices() - np.stack(poses), axis=2).mean(axis=1)
        assert error.max() < 0.05 * np.linalg.norm(poses[1] - poses[0], axis=1).max()
    else:
        assert found == ([1, 2], []) and left[1] > 0.05


GUIDES = {"exact": {}, "pruned": {"grid": {"prune": True}}, "some points": {"optimiser": {"points": 200}}}


@pytest.mark.parametrize("way", Way)
@pytest.mark.parametrize("groups", GUIDES.values(), ids=GUIDES)
def test_a_guide_moves_no_vertex_and_leaves_the_template(groups: dict, way: Way) -> None:
    """Of all that an iteration keeps, what belongs to the template stays; and there is no warm-up."""
    config = replace(Config(), grid=GRID)
    config = replace(config, **{name: replace(getattr(config, name), **v) for name, v in groups.items()})
    losses = []
    with going(way), closing(Team(1)) as team:
        problem = Problem(
            BODY.clouds, BODY.normals, BODY.vertices[KEYFRAME], BODY.faces, KEYFRAME, config, find_device("cpu")
        )
        optimiser = Optimiser(problem, 12, team)
        before, shape = optimiser.objective.vertices.numpy().copy(), optimiser.shape.x.numpy().copy()
        for _ in range(12):
            optimiser.iterate()
            losses.append(optimiser.look())
        optimiser.finish()
        assert optimiser.solves.stalled == 0
    assert problem.sample.sizes.max() == (200 if groups == GUIDES["some points"] else 1500)
    assert losses[-1]["input"] < 0.7 * losses[0]["input"] and set(losses[0]) == {"input", "total"}
    np.testing.assert_array_equal(optimiser.shape.x.numpy(), shape)
    np.testing.assert_array_equal(before, np.tile(shape, (FRAMES, 1, 1)))
    assert not optimiser.shape.first_moment.numpy().any()


def test_a_guide_has_no_warm_up_and_any_threads_give_the_same_bits() -> None:
    found = []
    for threads, warmup in ((1, 0), (3, 50)):
        config = replace(Config(), grid=GRID, optimiser=replace(Config().optimiser, warmup=warmup))
        problem = Problem(
            BODY.clouds, BODY.normals, BODY.vertices[KEYFRAME], BODY.faces, KEYFRAME, config, find_device("cpu")
        )
        with closing(Team(threads)) as team:
            optimiser = Optimiser(problem, 6, team)
            for _ in range(6):
                optimiser.iterate()
            found.append(optimiser.nodes.numpy().copy())
    np.testing.assert_array_equal(*found)
    assert np.abs(found[0]).max() > 0


def test_what_a_frame_does_not_show_goes_with_its_neighbour() -> None:
    """Every other frame shows half; of it alone, nothing is known yet of where the frames around it are."""
    scene = MovingEllipsoid.make(5, 800, np.random.default_rng(3), seen=lambda t, p: (p[:, 0] < 0.1) | (t % 2 == 0))
    config = replace(Config(), grid=replace(GRID, levels=2))
    problem = Problem(scene.clouds, scene.normals, scene.vertices[2], scene.faces, 2, config, find_device("cpu"))
    with closing(Team(1)) as team:
        optimiser = Optimiser(problem, 1, team)
        optimiser.finish()
        refinement = Refinement(optimiser.objective, team)
        assert refinement.unseen.frames.tolist() == [1, 3]
        assert follow(optimiser.objective, refinement)[0] == [0, 1, 3, 4]
    assert scene.off_surface(optimiser.objective.placed_vertices()).max() < 0.1
