"""The rotation really is one, and its adjoint is alive at zero."""

from __future__ import annotations

import numpy as np
import pytest
import reference
import warp as wp
import witness
from gradients import assert_gradients_close, finite_differences, gradient_of
from witness_functions import turn

from warpdef.device import on_host
from warpdef.kernels.levels import node8


def run(z: np.ndarray, x: np.ndarray, other: np.ndarray, device: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """R(z) x, its derivative along ``other``, and the adjoint of ``other`` to z, each (N, 3)."""
    arrays = [wp.array(a.astype(np.float32), dtype=wp.vec3, device=device) for a in (z, x, other)]
    outputs = [wp.zeros(len(z), dtype=wp.vec3, device=device) for _ in range(3)]
    wp.launch(turn, len(z), inputs=[*arrays, *outputs], device=device)
    turned, along, pulled = (on_host(a) for a in outputs)
    return turned, along, pulled


def matrices(z: np.ndarray, device: str) -> np.ndarray:
    """R(z) as the kernel sees it, column by column, (N, 3, 3)."""
    columns = [run(z, np.tile(e, (len(z), 1)), np.zeros_like(z), device)[0] for e in np.eye(3)]
    return np.stack(columns, axis=2)


@pytest.fixture
def z(rng: np.random.Generator) -> np.ndarray:
    """From no rotation at all to nearly half a turn."""
    direction = rng.normal(size=(60, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return direction * np.concatenate([[0.0], np.geomspace(1e-6, 30, 59)])[:, None]


def test_it_is_a_rotation(z: np.ndarray, device: str) -> None:
    found = matrices(z, device).astype(np.float64)
    np.testing.assert_allclose(found.transpose(0, 2, 1) @ found, np.tile(np.eye(3), (len(z), 1, 1)), rtol=0, atol=2e-6)
    np.testing.assert_allclose(np.linalg.det(found), 1, rtol=0, atol=2e-6)
    np.testing.assert_array_equal(found[0], np.eye(3))


def test_the_negative_is_the_transpose(z: np.ndarray, device: str) -> None:
    np.testing.assert_allclose(matrices(-z, device), matrices(z, device).transpose(0, 2, 1), rtol=0, atol=1e-6)


def test_axis_and_angle(z: np.ndarray, device: str) -> None:
    """The axis stays, and what stands across it turns by 2 atan |z|, right-handed."""
    length = np.linalg.norm(z[1:], axis=1)
    axis = z[1:] / length[:, None]
    found = matrices(z[1:], device).astype(np.float64)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", found, axis), axis, rtol=0, atol=2e-6)
    across = np.cross(axis, [0.3, 0.4, 0.5])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    turned = np.einsum("nij,nj->ni", found, across)
    angle = np.arctan2((np.cross(across, turned) * axis).sum(axis=1), (across * turned).sum(axis=1))
    np.testing.assert_allclose(angle, 2 * np.arctan(length), rtol=1e-5, atol=1e-6)


def test_it_is_the_cayley_map(z: np.ndarray, device: str) -> None:
    np.testing.assert_allclose(matrices(z, device), reference.rotation(z), rtol=0, atol=2e-6)


def test_derivative_and_adjoint_match_the_twin(device: str, rng: np.random.Generator) -> None:
    z, x, other = rng.normal(size=(3, 50, 3)).astype(np.float32).astype(np.float64)
    z[0] = 0
    _, along, adj = run(z, x, other, device)
    derivative = reference.rotation_derivative(z)
    assert_gradients_close(along, np.einsum("ncij,nj,nc->ni", derivative, x, other))
    assert_gradients_close(adj, np.einsum("ncij,nj,ni->nc", derivative, x, other))


def test_the_twin_agrees_with_its_finite_differences(rng: np.random.Generator) -> None:
    z, x, adj = rng.normal(size=(3, 6, 3))
    expected = finite_differences(lambda a: float((np.einsum("nij,nj->ni", reference.rotation(a), x) * adj).sum()), z)
    found = np.einsum("ncij,nj,ni->nc", reference.rotation_derivative(z), x, adj)
    assert_gradients_close(found, expected, elementwise=1e-8, relative=1e-8)


def test_adjoint_matches_finite_differences_of_the_kernel(device: str, rng: np.random.Generator) -> None:
    z, x, adj = rng.normal(size=(3, 20, 3)) * 0.5
    step = 1e-3
    columns = [run(z + step * e, x, adj, device)[0] - run(z - step * e, x, adj, device)[0] for e in np.eye(3)]
    expected = np.stack([(c * adj).sum(axis=1) / (2 * step) for c in columns], axis=1)
    assert_gradients_close(run(z, x, adj, device)[2], expected, elementwise=1e-3, direction=1e-5, relative=1e-3)


def test_adjoint_matches_autodiff(device: str, rng: np.random.Generator) -> None:
    z, x, adj = rng.normal(size=(3, 50, 3))
    z[0] = 0
    value = witness.variable(witness.pad(np.concatenate([z, np.zeros_like(z)], axis=1)), node8, device)
    points = witness.variable(x, wp.vec3, device)
    moved = wp.zeros(50, dtype=wp.vec3, device=device, requires_grad=True)
    with wp.Tape() as tape:
        wp.launch(witness.apply_motion, 50, inputs=[value, points, moved], device=device)
    tape.backward(grads={moved: wp.array(adj.astype(np.float32), dtype=wp.vec3, device=device)})
    assert_gradients_close(run(z, x, adj, device)[2], gradient_of(value)[:, :3])


def test_the_gradient_at_zero_is_not_zero(device: str, rng: np.random.Generator) -> None:
    x, adj = rng.normal(size=(2, 10, 3))
    found = run(np.zeros((10, 3)), x, adj, device)[2]
    assert_gradients_close(found, 2 * np.cross(x, adj))
    assert np.linalg.norm(found, axis=1).min() > 0.1
