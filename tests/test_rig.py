"""The rig: weights on the simplex, bones by Procrustes, and a tree that says the same as they do."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from warpdef.errors import InputError
from warpdef.rig.bones import fit_rigid, skin, update_bones, update_rest
from warpdef.rig.decompose import MEAN_ERROR, fit_rig
from warpdef.rig.skeleton import build_skeleton
from warpdef.rig.weights import bone_errors, simplex_least_squares, solve_weights


def arm(frames: int = 9) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Three links that bend in different ways; rest (V, 3), joints, weights (V, 2), bones (T, 3, 3, 4), moved."""
    rng = np.random.default_rng(3)
    rest = rng.uniform([-0.1, 0.0, -0.1], [0.1, 3.0, 0.1], (240, 3))
    link = np.clip((rest[:, 1, None] - [0.8, 1.8]) / 0.4, 0.0, 1.0).sum(axis=1)
    first = np.minimum(link.astype(int), 1)
    joints = np.column_stack([first, first + 1])
    weights = np.column_stack([1.0 - (link - first), link - first])
    bones = np.zeros((frames, 3, 3, 4))
    for t in range(frames):
        turn, shift = np.eye(3), np.array([0.1 * t, 0.0, -0.02 * t])
        for b, angles in enumerate(([4, 0, 5], [0, 4, -9], [5, 3, 8])):
            hinge = np.array([0.0, b, 0.0])
            local = Rotation.from_euler("xyz", np.multiply(angles, t), degrees=True).as_matrix()
            turn, shift = turn @ local, turn @ (hinge - local @ hinge) + shift
            bones[t, b] = np.column_stack([turn, shift])
    return rest, joints, weights, bones, skin(rest, joints, weights, bones)


def test_simplex_against_a_general_solver():
    rng = np.random.default_rng(0)
    tall = rng.normal(size=(40, 7, 5))
    gram = tall.transpose(0, 2, 1) @ tall
    gram[3] = gram[3, :1, :1]  # all alike: any weights will do
    found = simplex_least_squares(gram)
    assert (found >= 0.0).all()
    np.testing.assert_allclose(found.sum(axis=1), 1.0, atol=1e-12)
    for one, weights in zip(gram, found, strict=True):
        best = minimize(
            lambda w, one=one: w @ one @ w,
            np.full(5, 0.2),
            jac=lambda w, one=one: 2 * one @ w,
            bounds=[(0, 1)] * 5,
            constraints={"type": "eq", "fun": lambda w: w.sum() - 1.0},
            options={"ftol": 1e-13},
        )
        assert weights @ one @ weights <= best.fun * (1.0 + 1e-6)


def test_bone_errors_by_their_definition():
    rest, _, _, bones, moved = arm()
    each = np.einsum("tbij,vj->tbvi", bones[..., :3], rest) + bones[:, :, None, :, 3]
    expected = ((each - moved[:, None]) ** 2).sum(axis=(0, 3)).T
    np.testing.assert_allclose(bone_errors(rest, moved, bones), expected, atol=1e-9)


def test_weights_are_found_again():
    rest, joints, weights, bones, moved = arm()
    found_joints, found = solve_weights(rest, moved, bones)
    table = np.zeros((2, len(rest), 3))
    for into, j, w in ((table[0], joints, weights), (table[1], found_joints, found)):
        np.add.at(into, (np.arange(len(rest))[:, None], j), w)
    np.testing.assert_allclose(table[1], table[0], atol=1e-4)
    assert (np.diff(found, axis=1) <= 0.0).all()


def test_a_rigid_motion_is_found_again():
    rest, _, _, bones, _ = arm()
    moved = np.einsum("tij,vj->tvi", bones[:, 2, :, :3], rest) + bones[:, 2, None, :, 3]
    weights = np.random.default_rng(1).random(len(rest))
    moved[:, 0] += 100.0  # counts for nothing
    weights[0] = 0.0
    np.testing.assert_allclose(fit_rigid(rest, moved, weights), bones[:, 2], atol=1e-9)


def test_no_round_makes_it_worse():
    rest, joints, weights, bones, moved = arm()
    rng = np.random.default_rng(2)
    shaken = bones.copy()
    turns = Rotation.from_rotvec(0.2 * rng.normal(size=(bones.shape[0] * 3, 3))).as_matrix()
    shaken[..., :3] = turns.reshape(*bones.shape[:2], 3, 3) @ shaken[..., :3]
    shape = rest + 0.05 * rng.normal(size=rest.shape)

    def error(shape, bones) -> float:
        return ((skin(shape, joints, weights, bones) - moved) ** 2).sum()

    before = error(shape, shaken)
    better = update_bones(shape, moved, joints, weights, shaken)
    between = error(shape, better)
    after = error(update_rest(shape, moved, joints, weights, better, hold=0.0), better)
    assert after < between < 0.5 * before
    # What is right stays right, and exactly so.
    np.testing.assert_allclose(update_bones(rest, moved, joints, weights, bones), bones, atol=1e-9)
    np.testing.assert_allclose(update_rest(rest, moved, joints, weights, bones), rest, atol=1e-9)


def test_a_skinned_arm_is_explained():
    moved = arm()[4] + [1000.0, 0.0, 50.0]
    rig = fit_rig(moved)
    assert rig.mean_error <= MEAN_ERROR * rig.extent and 2 <= rig.bone_count <= 6
    distance = np.linalg.norm(rig.vertices() - moved, axis=2)
    assert (distance.mean(), distance.max()) == pytest.approx((rig.mean_error, rig.max_error), rel=1e-6)
    assert fit_rig(moved, 6).mean_error < 0.5 * fit_rig(moved, 2).mean_error
    turns = rig.bones[..., :3]
    np.testing.assert_allclose(turns @ turns.swapaxes(2, 3), np.broadcast_to(np.eye(3), turns.shape), atol=1e-9)
    np.testing.assert_allclose(rig.weights.sum(axis=1), 1.0)


def test_frames_beyond_the_sample_take_part():
    rest, joints, weights, bones, _ = arm(9)
    moved = skin(rest, joints, weights, bones[np.linspace(0, 8, 120).round().astype(int)])
    rig = fit_rig(moved, 6)
    assert np.linalg.norm(rig.vertices() - moved, axis=2).mean(axis=1).max() < 3 * MEAN_ERROR * rig.extent


def test_the_tree_says_what_the_bones_say():
    rig = fit_rig(arm()[4], 5)
    skeleton = build_skeleton(rig)
    assert (skeleton.parents < np.arange(len(skeleton.parents))).all() and (skeleton.parents == -1).sum() == 1
    turns = (
        Rotation.from_quat(skeleton.rotations.reshape(-1, 4)).as_matrix().reshape(*skeleton.rotations.shape[:2], 3, 3)
    )
    for t in range(len(rig.bones)):
        worlds = []
        for joint, parent in enumerate(skeleton.parents):
            local = np.eye(4)
            local[:3, :3], local[:3, 3] = turns[t, joint], skeleton.translations[t, joint]
            worlds.append(local if parent < 0 else worlds[parent] @ local)
            back = np.eye(4)
            back[:3, 3] = -skeleton.places[joint]
            np.testing.assert_allclose((worlds[-1] @ back)[:3], rig.bones[t, skeleton.order[joint]], atol=1e-9)
    nearness = (skeleton.rotations[1:] * skeleton.rotations[:-1]).sum(axis=2)
    assert (nearness >= 0.0).all()


@pytest.mark.parametrize("count", [0, 81, 300])
def test_impossible_numbers_of_bones(count):
    with pytest.raises(InputError, match="--bones: expected 1 to 80"):
        fit_rig(arm()[4], count)


def test_one_frame_and_one_bone():
    moved = arm()[4]
    assert fit_rig(moved[:1]).max_error < 1e-9
    assert fit_rig(moved, 1).bone_count == 1
