"""Adam against its twin over several steps."""

from __future__ import annotations

import numpy as np
import pytest
import reference
import warp as wp

from warpdef.kernels.adam import adam
from warpdef.kernels.levels import LevelTable, node8
from warpdef.kernels.schedule import SCHEDULE_SIZE, advance

BETAS, EPSILON = (0.9, 0.999), 1e-8


class Descent:
    """Adam's state for ``count`` parameters of one dtype."""

    def __init__(self, dtype, start: np.ndarray, rate: np.ndarray, device: str) -> None:
        self.dtype, self.device = dtype, device
        self.parameter = wp.array(start.astype(np.float32), dtype=dtype, device=device)
        self.first, self.second = wp.zeros_like(self.parameter), wp.zeros_like(self.parameter)
        self.rate = wp.array(rate.astype(np.float32), dtype=wp.float32, device=device)
        self.step_count = wp.zeros(1, dtype=wp.int32, device=device)
        self.schedule = wp.zeros(SCHEDULE_SIZE, dtype=wp.float32, device=device)

    def step(self, gradient: np.ndarray, begin: int = 0, count: int | None = None) -> None:
        advance(100, False, *BETAS, self.step_count, self.schedule)
        g = wp.array(gradient.astype(np.float32), dtype=self.dtype, device=self.device)
        count = len(self.parameter) if count is None else count
        adam(begin, count, self.rate, self.schedule, BETAS, EPSILON, g, self.first, self.second, self.parameter)


@pytest.mark.parametrize("dtype", [node8, wp.vec3], ids=["node8", "vec3"])
def test_eight_steps_match_the_twin(dtype, device: str, rng: np.random.Generator) -> None:
    width = {node8: 8, wp.vec3: 3}[dtype]
    start = rng.normal(size=(6, width))
    gradients = rng.normal(size=(8, 6, width)) * np.geomspace(1e-4, 1e3, 6)[:, None]
    descent = Descent(dtype, start, np.array([0.01]), device)
    for gradient in gradients:
        descent.step(gradient)
    expected = reference.adam(start, gradients, 0.01, np.ones(8), *BETAS, EPSILON)
    np.testing.assert_allclose(descent.parameter.numpy(), expected, rtol=0, atol=2e-6)
    assert np.abs(expected - start).max() > 0.01


def test_rates_repeat_for_every_transition(device: str, rng: np.random.Generator) -> None:
    """Per-level rates, as the optimiser gives them: one a node, the same for all transitions."""
    levels = LevelTable.build(1, 2)
    rate = (5e-3 * 1.1 ** np.arange(2))[levels.node_level()]
    start = rng.normal(size=(3 * levels.node_count, 8))
    gradients = rng.normal(size=(3, *start.shape))
    descent = Descent(node8, start, rate, device)
    for gradient in gradients:
        descent.step(gradient)
    expected = reference.adam(start, gradients, np.tile(rate, 3)[:, None], np.ones(3), *BETAS, EPSILON)
    np.testing.assert_allclose(descent.parameter.numpy(), expected, rtol=0, atol=2e-6)


def test_the_decay_scales_the_rate(device: str) -> None:
    descent = Descent(wp.vec3, np.zeros((1, 3)), np.array([0.01]), device)
    scales = []
    for _ in range(4):
        advance(4, True, *BETAS, descent.step_count, descent.schedule)
        scales.append(float(descent.schedule.numpy()[0]))
        g = wp.array(np.array([[1.0, -2.0, 0.5]], np.float32), dtype=wp.vec3, device=device)
        adam(0, 1, descent.rate, descent.schedule, BETAS, EPSILON, g, descent.first, descent.second, descent.parameter)
    expected = reference.adam(np.zeros((1, 3)), [np.array([[1.0, -2.0, 0.5]])] * 4, 0.01, scales, *BETAS, EPSILON)
    np.testing.assert_allclose(descent.parameter.numpy(), expected, rtol=0, atol=1e-6)
    assert scales == pytest.approx([1, 0.5 + 0.5**1.5, 0.5, 0.5 - 0.5**1.5], abs=1e-6)


def test_a_span_leaves_the_rest_alone(device: str, rng: np.random.Generator) -> None:
    start = rng.normal(size=(5, 3)).astype(np.float32)
    descent = Descent(wp.vec3, start, np.array([0.1]), device)
    descent.step(np.ones((5, 3)), begin=1, count=3)
    moved = (descent.parameter.numpy() != start).any(axis=1)
    assert moved.tolist() == [False, True, True, True, False]


def test_no_gradient_no_step(device: str) -> None:
    descent = Descent(node8, np.ones((2, 8)), np.array([0.1]), device)
    for _ in range(3):
        descent.step(np.zeros((2, 8)))
    np.testing.assert_array_equal(descent.parameter.numpy(), 1)
