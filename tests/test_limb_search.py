"""Limbs as chains of links; what a pose of them covers; and fingers found where no bending finds them."""

from __future__ import annotations

import numpy as np
import pytest
import synthetic
from hand_samples import EDGES, FACES, VERTICES, finger

from warpdef.fit.bending import Bending, SeenCloud, worth
from warpdef.fit.embedded import Pose
from warpdef.fit.limb_chains import LimbChain, LimbChains
from warpdef.fit.limb_search import CLEAR, COVER, TILTED, LimbField, LimbSearch, closest_sq, tried_turns
from warpdef.geometry.triangles import vertex_normals

CAMERA = np.array([1.0, 0.0, 30.0])
BENDING = Bending(VERTICES, FACES, EDGES)
LIMBS = LimbChains(VERTICES, FACES, EDGES, BENDING.graph, BENDING.matched)


def chain_of(which: int) -> LimbChain:
    (found,) = (chain for chain in LIMBS.chains if finger(which)[chain.vertex].mean() > 0.5)
    return found


def turned(**of_fingers: list[list[float]]) -> list[np.ndarray]:
    """Turns of all limbs: of some fingers, ``first`` to ``fourth``, those told, none of all others."""
    names = {id(chain_of(k)): name for k, name in enumerate(("first", "second", "third", "fourth"))}
    return [np.array(of_fingers.get(names.get(id(chain), ""), np.zeros((3, 3)))) for chain in LIMBS.chains]


def seen(vertices: np.ndarray) -> SeenCloud:
    """Vertices that face the camera, and none before them."""
    normals = vertex_normals(vertices, FACES)
    facing = (normals * (CAMERA - vertices)).sum(axis=1) > 0.0
    return SeenCloud.of(vertices[facing], normals[facing], CAMERA)


def test_a_finger_is_a_chain_that_begins_in_the_palm() -> None:
    chain = chain_of(1)
    assert -0.3 < chain.joints[0, 1] < -0.05 < 0.3 < chain.joints[1, 1] < 0.7 < chain.joints[2, 1] < 1.0
    assert chain.axis[1] > 0.95 and abs(chain.normal[2]) > 0.99
    height = [VERTICES[chain.vertex[chain.link == k], 1] for k in range(3)]
    assert height[0].max() < height[1].max() < height[2].max()
    assert not any(finger(k)[LIMBS.body[VERTICES[LIMBS.body, 1] > 0.1]].any() for k in range(4))
    assert set(chain.node) & set(chain.around) == set()


def test_links_are_rigid_and_hang_together(rng: np.random.Generator) -> None:
    chain, turns = chain_of(2), rng.normal(size=(5, 3, 3))
    base = synthetic.turn_about([1.0, 2.0, 0.5], 0.7), np.array([0.3, -2.0, 1.0])
    turn, shift = LIMBS.links(chain, turns, base)
    np.testing.assert_allclose(turn @ np.swapaxes(turn, 2, 3), np.broadcast_to(np.eye(3), turn.shape), atol=1e-12)
    for k in range(3):
        before = base if k == 0 else (turn[:, k - 1], shift[:, k - 1])
        ends = [r @ chain.joints[k] + t for r, t in (before, (turn[:, k], shift[:, k]))]
        np.testing.assert_allclose(ends[1], np.broadcast_to(ends[0], ends[1].shape), atol=1e-12)
    places, normals = LIMBS.place(chain, np.zeros((1, 3, 3)), (np.eye(3), np.zeros(3)))
    np.testing.assert_allclose(places[0], VERTICES[chain.vertex], atol=1e-12)
    np.testing.assert_allclose(normals[0], LIMBS.normals[chain.vertex], atol=1e-12)


def test_turns_are_told_as_they_were_put(rng: np.random.Generator) -> None:
    count = len(BENDING.graph.node)
    turn = synthetic.turn_about([0.2, -1.0, 0.4], 1.2)
    whole = Pose(np.tile(turn, (count, 1, 1)), VERTICES[BENDING.graph.node] @ (turn.T - np.eye(3)) + 3.0)
    for k, chain in enumerate(LIMBS.chains):
        turns = [np.zeros((3, 3)) for _ in LIMBS.chains]
        turns[k] = 0.5 * rng.normal(size=(3, 3))
        told = LIMBS.turns_of(chain, LIMBS.put(whole, turns))
        assert {0, 1, 2} == set(chain.node_link)
        np.testing.assert_allclose(told, turns[k], atol=1e-8)
    turns = [np.zeros((3, 3)) for _ in LIMBS.chains]
    as_it_was = LIMBS.put(whole, turns)
    np.testing.assert_allclose(BENDING.place(as_it_was), VERTICES @ turn.T + 3.0, atol=1e-9)


def test_the_poses_that_are_tried_go_all_around_the_way_a_limb_stands() -> None:
    chain = chain_of(0)
    turns = tried_turns(chain)
    assert turns.shape[1:] == (3, 3) and not turns[0].any() and 300 < len(turns) < 1500
    tilt = np.degrees(np.linalg.norm(turns[:, 0], axis=1))
    assert tilt.max() <= TILTED and np.abs(turns[:, 0] @ chain.axis).max() < 1e-9
    ends = np.array([synthetic.turn_about(t, float(np.linalg.norm(t))) @ chain.axis for t in turns[:, 0] if t.any()])
    assert np.abs(ends.mean(axis=0) @ np.cross(chain.normal, chain.axis)) < 0.02
    np.testing.assert_allclose(turns[:, 2], 0.6 * turns[:, 1], atol=1e-12)


@pytest.mark.parametrize("away", [0.0, 500.0])
@pytest.mark.parametrize(("poses", "samples", "points"), [(70, 9, 40), (1, 1, 1), (0, 3, 2)])
def test_how_close_poses_come_to_points(rng: np.random.Generator, away: float, poses: int, samples: int, points: int):
    x, y = rng.normal(size=(poses, samples, 6)) + away, rng.normal(size=(points, 6)) + away
    x[:1, 0] = y[0]
    expected = ((x[:, :, None] - y) ** 2).sum(axis=3).min(axis=1) if poses else np.zeros((0, points))
    np.testing.assert_allclose(closest_sq(x, y), expected, rtol=1e-4, atol=1e-4)


def test_points_that_the_body_leaves_and_what_the_camera_did_not_see(rng: np.random.Generator) -> None:
    cloud = seen(VERTICES)
    chosen = LIMBS.body
    body = np.concatenate([VERTICES[chosen], 3.0 * cloud.spacing * LIMBS.normals[chosen]], axis=1)
    field = LimbField(cloud, body)
    assert 0 < field.points <= 300 and field.standing >= 1.0 and field.by_body(COVER).max() < 0.6
    assert LimbField(cloud, np.concatenate([cloud.points, 3.0 * cloud.spacing * cloud.normals], axis=1)).points == 0
    chain = chain_of(1)
    places, normals = LIMBS.place(chain, np.zeros((1, 3, 3)), (np.eye(3), np.zeros(3)))
    covered = field.covered(places, normals, COVER)
    assert 0.1 < np.mean(covered > 0.5) < 0.5 and field.covered(places + 9.0, normals, COVER).max() < 1e-6
    # Beside the points, before them, behind them.
    places = np.array([1.0, 0.0, 0.0]) + rng.uniform(-3.0, 3.0, (4, 500, 3))
    facing = np.broadcast_to([0.0, 0.0, 1.0], places.shape)
    told = field.alone(places, facing).ravel()
    expected = np.zeros(len(told), dtype=bool)
    assert cloud.picture is not None
    expected[cloud.picture.contradicts(places.reshape(-1, 3), CLEAR * cloud.spacing)[0]] = True
    assert 0.3 < expected.mean() < 0.95 and np.mean(told == expected) > 0.97
    assert not field.alone(places, -facing).any()


def test_fingers_that_fold_and_that_bending_leaves_on_one_another_are_found() -> None:
    """The first folds by a right angle and swings away, the second and the fourth curl: from rest none is found."""
    truth = LIMBS.put(
        BENDING.still(),
        turned(
            first=[[1.5, 0.0, -0.5], [0.0, 0.0, 0.0], [0.3, 0.0, 0.0]],
            second=[[0.0, 0.0, -0.1], [1.2, 0.0, 0.0], [0.3, 0.0, 0.0]],
            third=[[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.3, 0.0, 0.0]],
            fourth=[[1.0, 0.0, -0.05], [0.6, 0.0, 0.0], [0.3, 0.0, 0.0]],
        ),
    )
    there = BENDING.place(truth)
    cloud = seen(there)
    found, fault = BENDING.best(cloud, BENDING.still())
    better, left = LimbSearch(BENDING).better(cloud, found, fault)
    before, after = (np.linalg.norm(BENDING.place(pose) - there, axis=1) for pose in (found, better))
    assert left == BENDING.fault(cloud, better) < worth(fault) and fault > 0.03
    assert max(before[finger(k)].mean() for k in range(4)) > 0.4
    assert max(after[finger(k)].mean() for k in range(4)) < 0.15


def test_without_a_camera_or_a_limb_nothing_is_looked_for() -> None:
    still = BENDING.still()
    cloud = SeenCloud.of(VERTICES, LIMBS.normals)
    assert LimbSearch(BENDING).better(cloud, still, 0.5) == (still, 0.5)
    ball, faces = synthetic.icosphere(2)
    round_one = Bending(ball, faces, np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), 1), axis=0))
    rest = round_one.still()
    at = SeenCloud.of(ball, ball, CAMERA)
    assert LimbSearch(round_one).better(at, rest, 0.5) == (rest, 0.5)
