"""The gradient assertion must itself be able to fail."""

from __future__ import annotations

import numpy as np
import pytest
from gradients import along, assert_gradients_close, finite_differences


@pytest.fixture
def expected(rng: np.random.Generator) -> np.ndarray:
    return rng.normal(size=(40, 6))


def test_equal_gradients_pass(expected: np.ndarray) -> None:
    assert_gradients_close(expected.astype(np.float32), expected)


def test_a_shape_that_would_broadcast_fails(expected: np.ndarray) -> None:
    with pytest.raises(AssertionError, match="shapes differ"):
        assert_gradients_close(expected[:1], expected)
    with pytest.raises(AssertionError, match="shapes differ"):
        assert_gradients_close(expected[0, 0], expected)


def test_a_zero_reference_fails(expected: np.ndarray) -> None:
    with pytest.raises(AssertionError, match="proves nothing"):
        assert_gradients_close(np.zeros_like(expected), np.zeros_like(expected))


def test_what_is_not_finite_fails(expected: np.ndarray) -> None:
    broken = expected.copy()
    broken[3, 2] = np.nan
    with pytest.raises(AssertionError, match="1 elements of the gradient are not finite"):
        assert_gradients_close(broken, expected)
    with pytest.raises(AssertionError, match="reference gradient is not finite"):
        assert_gradients_close(expected, broken)


def test_one_wrong_element_fails_and_is_named(expected: np.ndarray) -> None:
    broken = expected.copy()
    broken[7, 1] += 0.01
    with pytest.raises(AssertionError, match=r"element \(7, 1\)"):
        assert_gradients_close(broken, expected)


def test_a_turned_gradient_fails_even_if_elements_may_differ(expected: np.ndarray, rng: np.random.Generator) -> None:
    turned = expected + 0.02 * rng.normal(size=expected.shape)
    with pytest.raises(AssertionError, match="cosine"):
        assert_gradients_close(turned, expected, elementwise=1.0, relative=1.0)


def test_a_gradient_of_another_length_fails_even_if_its_direction_is_right(expected: np.ndarray) -> None:
    with pytest.raises(AssertionError, match="relative L2"):
        assert_gradients_close(1.001 * expected, expected, elementwise=1.0)
    with pytest.raises(AssertionError, match="cosine"):
        assert_gradients_close(-expected, expected, elementwise=10.0, relative=10.0)


def test_finite_differences_of_a_cubic(rng: np.random.Generator) -> None:
    x = rng.normal(size=(3, 2))
    tight = {"elementwise": 1e-8, "relative": 1e-8}
    assert_gradients_close(finite_differences(lambda a: float((a**3).sum()), x), 3 * x**2, **tight)
    some = finite_differences(lambda a: float((a**3).sum()), x, np.array([4, 1]))
    assert_gradients_close(some, 3 * x.ravel()[[4, 1]] ** 2, **tight)
    v = rng.normal(size=x.shape)
    assert along(lambda a: float((a**3).sum()), x, v) == pytest.approx(float((3 * x**2 * v).sum()), rel=1e-8)
