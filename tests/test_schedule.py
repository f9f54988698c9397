"""Decay, bias corrections and confidence, from the paper's formulas."""

from __future__ import annotations

import numpy as np
import pytest
import reference
import warp as wp

from warpdef.kernels.confidence import confidence
from warpdef.kernels.levels import node8
from warpdef.kernels.motion import template_gradient
from warpdef.kernels.schedule import BIAS_1, BIAS_2, DELTA, RATE_SCALE, SCHEDULE_SIZE, advance
from warpdef.kernels.vectors import add_scaled, blend, clear_losses, clear_nodes, clear_vectors, copy_vectors, go_on


@pytest.mark.parametrize("cosine", [False, True])
def test_a_run_of_ten_iterations(cosine: bool, device: str) -> None:
    step = wp.zeros(1, dtype=wp.int32, device=device)
    schedule = wp.zeros(SCHEDULE_SIZE, dtype=wp.float32, device=device)
    for e in range(10):
        advance(10, cosine, 0.9, 0.999, step, schedule)
        found = schedule.numpy()
        assert found[RATE_SCALE] == pytest.approx(0.5 * (1 + np.cos(np.pi * e / 10)) if cosine else 1, abs=1e-6)
        assert found[BIAS_1] == pytest.approx(1 / (1 - 0.9 ** (e + 1)), rel=1e-5)
        assert found[BIAS_2] == pytest.approx(1 / (1 - 0.999 ** (e + 1)), rel=1e-3)
        assert found[DELTA] == pytest.approx(1 - np.sqrt(e / 10), abs=1e-6)
    assert step.numpy()[0] == 10


def run_confidence(loss_input, loss_transform, keyframe, delta, device, enabled=True, mean=False) -> np.ndarray:
    schedule = np.zeros(SCHEDULE_SIZE, dtype=np.float32)
    schedule[DELTA] = delta
    of_input, of_transform = (
        wp.array(np.asarray(a, np.float64), dtype=wp.float64, device=device) for a in (loss_input, loss_transform)
    )
    now = wp.array(schedule, dtype=wp.float32, device=device)
    found = wp.full(len(loss_transform), np.nan, dtype=wp.float32, device=device)
    confidence(enabled, mean, keyframe, now, of_input, of_transform, found)
    return found.numpy()


@pytest.mark.parametrize("mean", [False, True])
@pytest.mark.parametrize("keyframe", [0, 2, 5])
def test_confidence_is_the_papers_product(keyframe: int, mean: bool, device: str, rng: np.random.Generator) -> None:
    loss_input, loss_transform = rng.random(5), 2 * rng.random(6)
    found = run_confidence(loss_input, loss_transform, keyframe, 0.7, device, mean=mean)
    expected = reference.confidence(loss_input, loss_transform, keyframe, 0.7, mean)
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    assert found[keyframe] == 1 and found.min() < 0.9
    # It only ever falls on the way out.
    assert (np.diff(found[keyframe:]) <= 0).all() and (np.diff(found[: keyframe + 1]) >= 0).all()


def test_by_hand(device: str) -> None:
    """Keyframe 1 of four; cd_max is 1. Frame 2 exceeds it by 3, frame 3 by 1, frame 0 not at all."""
    found = run_confidence([0.5, 1.0, 0.2], [0.9, 50.0, 4.0, 2.0], 1, 0.5, device)
    np.testing.assert_allclose(found, [1, 1, 4**-0.5, 8**-0.5], rtol=1e-6)


def test_off_or_at_the_end_of_the_run_all_frames_count_alike(device: str) -> None:
    np.testing.assert_array_equal(run_confidence([0.1], [9.0, 1.0], 1, 1.0, device, enabled=False), 1)
    np.testing.assert_array_equal(run_confidence([0.1], [9.0, 1.0], 1, 0.0, device), 1)


@pytest.mark.parametrize("follow", [False, True])
def test_template_gradient(follow: bool, device: str, rng: np.random.Generator) -> None:
    chamfer, isometry = rng.normal(size=(2, 3, 4, 3)).astype(np.float32)
    carry = rng.normal(size=(4, 4, 3)).astype(np.float32)
    by_frame = (wp.array(a, dtype=wp.vec3, ndim=2, device=device) for a in (chamfer, isometry, carry))
    of_chamfer, of_isometry, carried = by_frame
    found = wp.zeros(4, dtype=wp.vec3, device=device)
    template_gradient(1, follow, of_chamfer, of_isometry, carried, found)
    expected = chamfer[1] + (isometry[1] + carry[1] + carry[3] if follow else 0)
    np.testing.assert_allclose(found.numpy(), expected, rtol=1e-6)


def test_copying(device: str, rng: np.random.Generator) -> None:
    source = wp.array(rng.normal(size=(5, 3)).astype(np.float32), dtype=wp.vec3, device=device)
    target = wp.zeros(5, dtype=wp.vec3, device=device)
    copy_vectors(source, target)
    np.testing.assert_array_equal(target.numpy(), source.numpy())


def test_adding_and_blending(device: str, rng: np.random.Generator) -> None:
    start, change = rng.normal(size=(2, 5, 3)).astype(np.float32)
    source = wp.array(change, dtype=wp.vec3, device=device)
    target = wp.array(start, dtype=wp.vec3, device=device)
    add_scaled(1, 3, -0.5, source, target)
    expected = start - 0.5 * change * np.array([[0], [1], [1], [1], [0]])
    np.testing.assert_allclose(target.numpy(), expected, rtol=1e-6, atol=1e-6)
    blend(1.5, source, target)
    np.testing.assert_allclose(target.numpy(), expected + 1.5 * (change - expected), rtol=1e-6, atol=2e-6)


def test_going_on(device: str, rng: np.random.Generator) -> None:
    """By a share of the way since the last time, which is then remembered; outside the span nothing moves."""
    first, second = rng.normal(size=(2, 5, 3)).astype(np.float32)
    earlier, places = (wp.array(a, dtype=wp.vec3, device=device) for a in (first, second))
    go_on(1, 3, 0.75, earlier, places)
    inside = np.array([[0], [1], [1], [1], [0]], dtype=bool)
    expected = np.where(inside, second + 0.75 * (second - first.astype(np.float64)), second)
    np.testing.assert_allclose(places.numpy(), expected, rtol=1e-6, atol=1e-6)
    np.testing.assert_array_equal(earlier.numpy(), np.where(inside, second, first))


def test_clearing_spans(device: str) -> None:
    losses = wp.full(5, 2.0, dtype=wp.float64, device=device)
    vectors = wp.full(5, wp.vec3(2.0, 2.0, 2.0), dtype=wp.vec3, device=device)
    nodes = wp.full(5, node8(*[2.0] * 8), dtype=node8, device=device)
    clear_losses(1, 3, losses)
    clear_vectors(1, 3, vectors)
    clear_nodes(1, 3, nodes)
    for array in (losses, vectors, nodes):
        found = array.numpy().reshape(5, -1)
        np.testing.assert_array_equal(found, np.repeat([[2.0], [0], [0], [0], [2]], found.shape[1], axis=1))
