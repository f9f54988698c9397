"""The one way the tests compare a gradient with its reference, and central finite differences."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import warp as wp


def gradient_of(variable: wp.array) -> np.ndarray:
    """What Warp's automatic differentiation has left in a variable made with ``requires_grad``."""
    assert variable.grad is not None
    return variable.grad.numpy()


def assert_gradients_close(
    got: np.ndarray, expected: np.ndarray, *, elementwise: float = 1e-4, direction: float = 1e-6, relative: float = 1e-4
) -> None:
    """Fail unless shapes agree and the gradient does: every element, the direction, and the whole.

    Args:
        got, expected: any shape, the same for both. A reference that is zero everywhere proves nothing and fails.
        elementwise: largest difference of one element, in units of the largest expected element.
        direction: largest 1 - cosine of the two. relative: largest |got - expected| / |expected|.

    Raises:
        AssertionError: one of these does not hold.
    """
    got, expected = np.asarray(got), np.asarray(expected)
    assert got.shape == expected.shape, f"shapes differ: got {got.shape}, expected {expected.shape}"
    got, expected = got.astype(np.float64), expected.astype(np.float64)
    assert np.isfinite(expected).all(), "the reference gradient is not finite"
    assert np.isfinite(got).all(), f"{int((~np.isfinite(got)).sum())} elements of the gradient are not finite"
    norm, largest = np.linalg.norm(expected), np.abs(expected).max(initial=0.0)
    assert norm > 0, "the reference gradient is zero everywhere: it proves nothing"
    error = np.abs(got - expected) / largest
    worst = np.unravel_index(error.argmax(), error.shape)
    assert error.max() <= elementwise, (
        f"element {tuple(map(int, worst))}: got {got[worst]:.9g}, expected {expected[worst]:.9g}; "
        f"{error.max():.2e} of the largest element, at most {elementwise:.0e} allowed"
    )
    cosine = (got * expected).sum() / max(norm * np.linalg.norm(got), np.finfo(float).tiny)
    assert 1 - cosine <= direction, f"1 - cosine is {1 - cosine:.2e}, at most {direction:.0e} allowed"
    off = np.linalg.norm(got - expected) / norm
    assert off <= relative, f"relative L2 error is {off:.2e}, at most {relative:.0e} allowed"


def finite_differences(
    function: Callable[[np.ndarray], float], at: np.ndarray, elements: np.ndarray | None = None, step: float = 1e-6
) -> np.ndarray:
    """Central differences of a scalar function, in float64.

    Args:
        elements: flat indices into ``at``; None: all of them.

    Returns:
        shape of ``at``, or (len(elements),).
    """
    at = np.array(at, dtype=np.float64)
    flat = at.ravel()
    chosen = np.arange(at.size) if elements is None else elements
    result = np.zeros(len(chosen))
    for place, index in enumerate(chosen):
        kept = flat[index]
        flat[index] = kept + step
        above = function(at)
        flat[index] = kept - step
        result[place] = (above - function(at)) / (2 * step)
        flat[index] = kept
    return result.reshape(at.shape) if elements is None else result


def along(function: Callable[[np.ndarray], float], at: np.ndarray, direction: np.ndarray, step: float = 1e-6) -> float:
    """Central difference of a scalar function along ``direction``."""
    return (function(at + step * direction) - function(at - step * direction)) / (2 * step)
