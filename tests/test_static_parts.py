"""What stands still beside what moves is told, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from warpdef.cleaning.static_parts import find_static_parts, tell_static_parts
from warpdef.sequence import PointSequence


def ball(count: int, rng: np.random.Generator) -> np.ndarray:
    places = rng.normal(size=(count, 3))
    return places / np.linalg.norm(places, axis=1, keepdims=True)


def corner(count: int, rng: np.random.Generator) -> np.ndarray:
    """Three walls that meet, one by one unit, beside the origin."""
    places = rng.random((count, 3))
    places[np.arange(count), rng.integers(0, 3, count)] = 0.0
    return places + [4.0, 0.0, 0.0]


def scenes(kind: str) -> list[np.ndarray]:
    rng = np.random.default_rng(3)
    found = []
    for t in range(6):
        moving = ball(800, rng) * [1.0, 1.0 + 0.1 * t, 1.0] + [0.0, 0.3 * t, 0.0]
        parts = {
            "alone": [moving],
            "corner": [moving, corner(400, rng) + 0.002 * rng.normal(size=(400, 3))],
            "two that move": [moving, ball(400, rng) + [4.0, 0.0, 0.3 * t]],
            "two at rest": [ball(800, rng), corner(400, rng)],
            "foot": [moving, 0.05 * ball(20, rng) + [0.0, -1.5, 0.0]],
        }
        found.append(np.concatenate(parts[kind]))
    return found


def test_a_corner_beside_what_moves_is_told_with_its_box_and_kept():
    clouds = scenes("corner")
    ((low, high, share),) = find_static_parts(clouds)
    np.testing.assert_allclose(low, [4, 0, 0], atol=0.02)
    np.testing.assert_allclose(high, [5, 1, 1], atol=0.02)
    assert 0.3 < share < 0.36
    sequence = PointSequence.from_arrays(clouds)
    told = tell_static_parts(sequence)
    assert "stands still in all frames" in told.warnings[0] and "--crop" in told.warnings[0]
    assert told.points == sequence.points


@pytest.mark.parametrize("kind", ["alone", "two that move", "two at rest", "foot"])
def test_nothing_else_is_told(kind):
    assert find_static_parts(scenes(kind)) == []
