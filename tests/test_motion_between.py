"""Times between frames: arcs stay arcs, whole times stay as they are."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic import bending_bar, icosphere, turn_about

from warpdef.errors import InputError
from warpdef.motion.between import between, check_times, mesh_between, steps_of, turns_between
from warpdef.motion.rotations import about, inverse, local_rotations, multiply, smoothed, turn, unwind

VERTICES, FACES = icosphere(2)
AXIS = np.array([1.0, 2.0, 2.0]) / 3.0


def screw(angle: float) -> np.ndarray:
    """The sphere beside an axis, turned about it and moved along it."""
    return (VERTICES + [3.0, 0.0, 0.0]) @ turn_about(AXIS, angle).T + 0.2 * angle * AXIS


def quaternions(angle: float, count: int = len(VERTICES)) -> np.ndarray:
    return about(np.tile(AXIS, (count, 1)), np.full(count, angle))


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 1.0, 3.1])
def test_a_screw_motion_is_followed_exactly(angle):
    meshes = np.stack([screw(0.0), screw(angle), screw(2 * angle)])
    times = np.array([0.0, 0.25, 0.9, 1.0, 1.5, 2.0])
    found = mesh_between(meshes, FACES, times)
    np.testing.assert_allclose(found, np.stack([screw(t * angle) for t in times]), atol=1e-7)
    for t in (0, 1, 2):
        np.testing.assert_array_equal(mesh_between(meshes, FACES, [t])[0], meshes[t])
        np.testing.assert_array_equal(found[[0, 3, 5][t]], meshes[t])


def test_the_type_stays():
    meshes = np.stack([screw(0.0), screw(0.4)]).astype(np.float32)
    assert mesh_between(meshes, FACES, [0.5]).dtype == np.float32
    assert mesh_between(meshes, FACES, [1]).dtype == np.float32


def test_points_that_do_not_turn_go_straight():
    points = np.random.default_rng(0).normal(size=(2, 7, 3))
    steps = quaternions(0.0, 7)[None]
    np.testing.assert_allclose(between(points, steps, [0.3])[0], 0.7 * points[0] + 0.3 * points[1], atol=1e-12)


def test_lengths_are_kept_better_than_on_straight_ways():
    bar = bending_bar(9, 20, np.random.default_rng(0), subdivisions=3)
    coarse, true, times = bar.vertices[::4], bar.vertices[2::4], [0.5, 1.5]
    arc, straight = mesh_between(coarse, bar.faces, times), (coarse[:-1] + coarse[1:]) / 2

    def change(meshes: np.ndarray) -> float:
        a, b = (m[:, bar.faces[:, 0]] - m[:, bar.faces[:, 1]] for m in (meshes, true))
        return float(np.abs(np.linalg.norm(a, axis=2) / np.linalg.norm(b, axis=2) - 1).mean())

    assert change(arc) < 0.5 * change(straight)


def test_rotations_of_a_mesh_are_found():
    turned = np.stack([screw(a) for a in (0.0, 0.7, -2.0)])
    found = local_rotations(screw(0.0), turned, FACES)
    for quaternion, angle in zip(found, (0.0, 0.7, -2.0), strict=True):
        expected = quaternions(angle)
        np.testing.assert_allclose(quaternion, expected * np.sign(expected[:, 3:]), atol=1e-7)
    one_each = local_rotations(turned[:2], turned[1:], FACES)
    np.testing.assert_allclose(one_each[0], quaternions(0.7), atol=1e-7)


def test_degenerate_neighbourhoods_get_some_rotation():
    flat = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [5, 5, 5]])
    faces = np.array([[0, 1, 2]])
    for moved in (flat, flat @ turn_about(AXIS, 0.8).T, 0.0 * flat, -flat):
        found = local_rotations(flat, moved[None], faces)[0]
        np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, atol=1e-9)
        np.testing.assert_allclose(found[3], [0, 0, 0, 1], atol=1e-9)
    # A straight line says nothing of the turn about itself: the least one is taken.
    np.testing.assert_allclose(local_rotations(flat, flat[None], faces)[0], np.tile([0, 0, 0, 1.0], (4, 1)), atol=1e-9)


def test_quaternions_do_what_matrices_do():
    rng = np.random.default_rng(1)
    axes = rng.normal(size=(2, 5, 3))
    axes /= np.linalg.norm(axes, axis=2, keepdims=True)
    angles, vectors = rng.uniform(-3, 3, (2, 5)), rng.normal(size=(5, 3))
    a, b = (about(axes[i], angles[i]) for i in (0, 1))
    for k in range(5):
        first, second = (turn_about(axes[i, k], angles[i, k]) for i in (0, 1))
        np.testing.assert_allclose(turn(a, vectors)[k], first @ vectors[k], atol=1e-12)
        np.testing.assert_allclose(turn(multiply(b, a), vectors)[k], second @ first @ vectors[k], atol=1e-12)
        np.testing.assert_allclose(turn(inverse(a), vectors)[k], first.T @ vectors[k], atol=1e-12)


def test_turns_beyond_half_a_turn_stay_together():
    angles = np.array([-5.0, -2.5, 0.0, 2.5, 5.0, 7.5])
    apart = np.stack([quaternions(a) for a in angles])
    signs = np.sign(apart[..., 3:])
    together = unwind(apart * signs, 2)
    np.testing.assert_allclose(together, apart, atol=1e-12)
    found = turns_between(together, [0.5, 4.2, 5.0])
    expected = np.stack([quaternions(a) for a in (-3.75, 5.5, 7.5)])
    np.testing.assert_allclose(np.abs((found * expected).sum(axis=-1)), 1.0, atol=1e-12)


def test_smoothing_averages_over_the_surface():
    rng = np.random.default_rng(2)
    noisy = quaternions(0.5) + rng.normal(scale=0.05, size=(len(VERTICES), 4))
    noisy = (noisy / np.linalg.norm(noisy, axis=1, keepdims=True))[None]
    even = smoothed(noisy, FACES, 5.0)
    np.testing.assert_allclose(np.linalg.norm(even, axis=2), 1.0, atol=1e-12)
    assert np.abs(even[0] - quaternions(0.5)).mean() < 0.2 * np.abs(noisy[0] - quaternions(0.5)).mean()
    np.testing.assert_allclose(smoothed(noisy, FACES, 0.0), noisy, atol=1e-12)


def test_a_mesh_of_one_point_has_steps():
    assert np.isfinite(steps_of(np.zeros((2, 3, 3)), np.array([[0, 1, 2]]))).all()


@pytest.mark.parametrize("times", [[], [-0.1], [2.1], [np.nan], [[0.5]], ["soon"], None])
def test_times_out_of_range(times):
    with pytest.raises(InputError, match="the times: expected numbers"):
        check_times(times, 3)
