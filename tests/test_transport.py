"""Shares of points: nobody has more than its own, and what a mesh lacks does not tear at it."""

from __future__ import annotations

import numpy as np
import pytest

from warpdef.fit.transport import partial_transport, transport_cost


def costs(places: np.ndarray, points: np.ndarray) -> np.ndarray:
    up = np.tile([0.0, 0.0, 1.0], (max(len(places), len(points)), 1))
    return transport_cost(places, up[: len(places)], points, up[: len(points)], 8.0)


def line(*x: float) -> np.ndarray:
    return np.column_stack([x, np.zeros((len(x), 2))])


def test_costs_are_distances_and_turns():
    places, points = np.array([[0.0, 0, 0], [1.0, 2, 2]]), np.array([[0.0, 0, 1.0]])
    normals, point_normals = np.array([[0.0, 0, 1], [1.0, 0, 0]]), np.array([[0.0, 0, -1]])
    np.testing.assert_allclose(transport_cost(places, normals, points, point_normals, 8.0), [[1 + 16], [6 + 8]])


def test_no_vertex_has_more_than_its_own_and_no_point_more_than_it_asks(rng: np.random.Generator):
    cost = costs(rng.normal(size=(40, 3)), rng.normal(size=(60, 3)))
    plan = partial_transport(cost, 0.5, 1.0, 0.3, 10.0)
    assert (plan >= 0).all()
    assert plan.sum(axis=1).max() <= 0.5 * (1 + 1e-9)
    assert plan.sum(axis=0).max() <= 1.02
    assert plan.sum() > 0.9 * 40 * 0.5  # 60 points ask: all is given


def test_two_fingers_go_to_two_places_where_the_nearest_is_the_same():
    """Both vertices find the first point nearest; the second has it taken away by the first."""
    places, points = line(0.0, 0.9), line(1.0, 2.2)
    assert np.array_equal(np.argmin(costs(places, points), axis=1), [0, 0])
    plan = partial_transport(costs(places, points), 1.0, 1.0, 0.1, 20.0)
    goal = (plan @ points)[:, 0] / plan.sum(axis=1)
    assert goal == pytest.approx([1.0, 2.2], abs=0.25)


def test_a_vertex_without_points_goes_without():
    plan = partial_transport(costs(line(0.0, 3.0), line(0.1)), 1.0, 1.0, 0.1, 20.0)
    assert plan.sum(axis=1) == pytest.approx([1.0, 0.0], abs=0.05)


def test_a_point_that_nobody_is_near_finds_nobody():
    """Further away than the reach it would rather not be explained."""
    near, far = (partial_transport(costs(line(0.0), line(x)), 1.0, 1.0, 0.1, 4.0).sum() for x in (1.0, 6.0))
    assert near > 0.6 and far < 0.01
