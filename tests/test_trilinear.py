"""Sampling of six-vectors and its adjoints, against the twin, finite differences and autodiff."""

from __future__ import annotations

import numpy as np
import pytest
import reference
import warp as wp
import witness
from gradients import assert_gradients_close, finite_differences, gradient_of
from witness_functions import sample_points, scatter_points

from warpdef.kernels.levels import LevelTable, node8
from warpdef.kernels.trilinear import sample_jacobian


class Field:
    """Three transitions; the middle one is looked at, NaN stands on both sides of it."""

    def __init__(self, coarsest: int, finest: int, device: str, rng: np.random.Generator) -> None:
        self.table, self.resolution = LevelTable.build(coarsest, finest), reference.resolutions(coarsest, finest)
        self.device = device
        self.values = rng.normal(size=(self.table.node_count, 6)).astype(np.float32)
        everything = np.full((3, self.table.node_count, 8), np.nan, dtype=np.float32)
        everything[1] = witness.pad(self.values)
        self._nodes = wp.array(everything, dtype=node8, device=device)
        self._levels = self.table.to_device(wp.get_device(device))

    def sample(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values (N, 6) and derivatives (N, 3, 6)."""
        value = wp.zeros(len(points), dtype=node8, device=self.device)
        jacobian = wp.zeros(len(points), dtype=sample_jacobian, device=self.device)
        inputs = [self._nodes, 1, self._levels, self._vectors(points), value, jacobian]
        wp.launch(sample_points, len(points), inputs=inputs, device=self.device)
        value, jacobian = value.numpy(), jacobian.numpy()
        np.testing.assert_array_equal(value[:, 6:], 0)
        np.testing.assert_allclose(jacobian[:, 0], value, rtol=0, atol=2e-6)
        return value[:, :6], jacobian[:, 1:, :6]

    def scatter(self, points: np.ndarray, adj: np.ndarray) -> np.ndarray:
        """Gradient of the nodes, (M, 6)."""
        adj_nodes = wp.zeros((3, self.table.node_count), dtype=node8, device=self.device)
        adj_value = wp.array(witness.pad(adj), dtype=node8, device=self.device)
        inputs = [1, self._levels, self._vectors(points), adj_value, adj_nodes]
        wp.launch(scatter_points, len(points), inputs=inputs, device=self.device)
        found = adj_nodes.numpy()
        np.testing.assert_array_equal(found[[0, 2]], 0)
        np.testing.assert_array_equal(found[..., 6:], 0)
        return found[1, :, :6]

    def _vectors(self, points: np.ndarray) -> wp.array:
        return wp.array(np.ascontiguousarray(points, np.float32), dtype=wp.vec3, device=self.device)


def points_in(low: float, high: float, count: int, rng: np.random.Generator) -> np.ndarray:
    """float32 values in float64, so that twin and kernel see the same positions."""
    return rng.uniform(low, high, (count, 3)).astype(np.float32).astype(np.float64)


LEVELS = [(1, 1), (1, 4), (3, 3), (2, 10)]


@pytest.mark.parametrize("levels", LEVELS)
def test_value_and_derivative_match_the_twin(levels, device: str, rng: np.random.Generator) -> None:
    field, points = Field(levels[0], levels[1], device, rng), points_in(-1.3, 1.3, 300, rng)
    value, derivative = field.sample(points)
    np.testing.assert_allclose(value, reference.sample(field.values, field.resolution, points), rtol=0, atol=5e-6)
    expected = reference.sample_derivative(field.values, field.resolution, points)
    np.testing.assert_allclose(derivative, expected, rtol=0, atol=5e-6 * field.resolution[-1])


@pytest.mark.parametrize("levels", LEVELS)
def test_gradient_of_the_nodes_matches_the_twin(levels, device: str, rng: np.random.Generator) -> None:
    field, points = Field(levels[0], levels[1], device, rng), points_in(-1.3, 1.3, 300, rng)
    adj = rng.normal(size=(len(points), 6))
    assert_gradients_close(field.scatter(points, adj), reference.adj_sample(field.resolution, points, adj))


def test_the_twin_agrees_with_its_finite_differences(rng: np.random.Generator) -> None:
    levels, points = reference.resolutions(1, 3), points_in(-1.2, 1.2, 12, rng)
    nodes, adj = rng.normal(size=(reference.offsets(levels)[-1], 6)), rng.normal(size=(12, 6))
    by_nodes = finite_differences(lambda n: float((reference.sample(n, levels, points) * adj).sum()), nodes)
    assert_gradients_close(reference.adj_sample(levels, points, adj), by_nodes, elementwise=1e-8, relative=1e-8)
    by_points = finite_differences(lambda p: float((reference.sample(nodes, levels, p) * adj).sum()), points)
    found = np.einsum("nac,nc->na", reference.sample_derivative(nodes, levels, points), adj)
    assert_gradients_close(found, by_points, elementwise=1e-8, relative=1e-8)


def test_derivative_matches_finite_differences_of_the_kernel(device: str, rng: np.random.Generator) -> None:
    field, step = Field(1, 3, device, rng), 1e-3
    points = points_in(-0.95, 0.95, 400, rng)
    # Away from the planes between cells, where the derivative jumps.
    spacing = 2 / (field.resolution[-1] - 1)
    points = points[(np.abs((points + 1 + spacing / 2) % spacing - spacing / 2) > 0.01).all(axis=1)]
    assert len(points) > 100
    differences = [
        (field.sample(points + step * e)[0] - field.sample(points - step * e)[0]) / (2 * step) for e in np.eye(3)
    ]
    # float32 values of order 1 differ by 1e-7 at random: divided by the step, 1e-4.
    expected = np.stack(differences, axis=1)
    assert_gradients_close(field.sample(points)[1], expected, elementwise=1e-3, relative=1e-3)


@pytest.mark.parametrize("levels", [(1, 4), (3, 3)])
def test_both_adjoints_match_autodiff(levels, device: str, rng: np.random.Generator) -> None:
    field, points = Field(levels[0], levels[1], device, rng), points_in(-1.2, 1.2, 200, rng)
    adj = rng.normal(size=(len(points), 6))
    nodes = witness.variable(witness.pad(field.values), node8, device)
    positions = witness.variable(points, wp.vec3, device)
    with wp.Tape() as tape:
        value = witness.sample_all(field.resolution, nodes, positions)
    np.testing.assert_allclose(field.sample(points)[0], value.numpy()[:, :6], rtol=0, atol=5e-6)
    tape.backward(grads={value: wp.array(witness.pad(adj), dtype=node8, device=device)})
    assert_gradients_close(field.scatter(points, adj), gradient_of(nodes)[:, :6])
    assert_gradients_close(np.einsum("nac,nc->na", field.sample(points)[1], adj), gradient_of(positions))


@pytest.mark.parametrize("finest", [1, 2, 5])
def test_on_a_node_the_value_is_the_nodes(finest: int, device: str, rng: np.random.Generator) -> None:
    """All nodes, the outermost at +1 among them, whose upper neighbours are not there (NaN beyond)."""
    field, n = Field(finest, finest, device, rng), 2 * finest - 1
    axis = np.linspace(-1, 1, n) if n > 1 else np.zeros(1)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    value, derivative = field.sample(points)
    np.testing.assert_allclose(value, field.values, rtol=0, atol=2e-6)
    assert np.isfinite(derivative).all()
    adj = rng.normal(size=(n**3, 6))
    np.testing.assert_allclose(field.scatter(points, adj), adj, rtol=0, atol=2e-6)


def test_outside_the_cube_nothing_changes_along_a_clamped_axis(device: str, rng: np.random.Generator) -> None:
    field = Field(1, 4, device, rng)
    points = np.array([[1.5, 0.2, -0.3], [-7.0, 0.2, -0.3], [0.1, 2.0, -30.0], [1e30, -1e30, 1e30]])
    value, derivative = field.sample(points)
    np.testing.assert_allclose(value, field.sample(points.clip(-1, 1))[0], rtol=0, atol=1e-6)
    clamped = np.abs(points) > 1
    np.testing.assert_array_equal(derivative[clamped], 0)
    assert (np.abs(derivative[~clamped]).max(axis=1) > 0.01).all()
    assert not derivative[3].any()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_positions_that_are_no_numbers_go_to_the_border(bad: float, device: str, rng: np.random.Generator) -> None:
    field = Field(1, 4, device, rng)
    points = np.array([[bad, 0.3, 0.1], [bad, bad, bad]])
    border = np.nan_to_num(points, nan=-1.0, posinf=1.0, neginf=-1.0)
    value, derivative = field.sample(points)
    np.testing.assert_allclose(value, field.sample(border)[0], rtol=0, atol=1e-6)
    np.testing.assert_array_equal(derivative[np.isclose(np.abs(border), 1)], 0)
    adj = rng.normal(size=(2, 6))
    np.testing.assert_allclose(field.scatter(points, adj), field.scatter(border, adj), rtol=0, atol=1e-6)


def test_one_node_is_one_motion_everywhere(device: str, rng: np.random.Generator) -> None:
    field, points = Field(1, 1, device, rng), points_in(-2, 2, 5, rng)
    value, derivative = field.sample(points)
    np.testing.assert_array_equal(value, np.tile(field.values, (5, 1)))
    np.testing.assert_array_equal(derivative, 0)
    adj = rng.normal(size=(5, 6))
    np.testing.assert_allclose(field.scatter(points, adj), adj.sum(axis=0, keepdims=True), rtol=1e-5)


def test_coincident_points_add_up(device: str, rng: np.random.Generator) -> None:
    """Many threads on the same eight nodes; cells that hold no point get nothing."""
    field = Field(3, 3, device, rng)
    points = np.tile(points_in(0.1, 0.4, 1, rng), (500, 1))
    adj = np.ones((500, 6))
    found = field.scatter(points, adj)
    np.testing.assert_allclose(found, 500 * field.scatter(points[:1], adj[:1]), rtol=1e-4)
    assert (found != 0).all(axis=1).sum() == 8
