"""Morton order."""

from __future__ import annotations

import numpy as np
import pytest

from warpdef.fit.morton import morton_order


def test_the_eight_octants_in_order() -> None:
    """x is the lowest bit, z the highest."""
    octants = np.array([[x, y, z] for z in (-0.5, 0.5) for y in (-0.5, 0.5) for x in (-0.5, 0.5)])
    shuffled = np.random.default_rng(0).permutation(8)
    np.testing.assert_array_equal(octants[shuffled][morton_order(octants[shuffled])], octants)


def test_a_permutation_that_keeps_neighbours_together(rng: np.random.Generator) -> None:
    points = rng.uniform(-1, 1, (2000, 3))
    order = morton_order(points)
    np.testing.assert_array_equal(np.sort(order), np.arange(2000))
    steps = np.linalg.norm(np.diff(points[order], axis=0), axis=1).mean()
    assert steps < 0.25 * np.linalg.norm(np.diff(points, axis=0), axis=1).mean()


def test_ties_keep_their_order() -> None:
    points = np.repeat([[0.5, 0.5, 0.5], [-0.5, -0.5, -0.5]], 4, axis=0)
    assert morton_order(points).tolist() == [4, 5, 6, 7, 0, 1, 2, 3]


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.zeros((1, 3))])
def test_none_and_one(points: np.ndarray) -> None:
    assert morton_order(points).tolist() == list(range(len(points)))


def test_outside_the_cube_counts_as_its_border() -> None:
    order = morton_order(np.array([[9.0, 9, 9], [0.999, 0.999, 0.999], [-9.0, -9, -9], [-0.9999, -1, -1]]))
    assert order.tolist() == [2, 3, 0, 1] or order.tolist() == [2, 3, 1, 0]
