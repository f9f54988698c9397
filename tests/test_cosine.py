"""The exact solve on full grids, both ways it can run, against a direct solve."""

from __future__ import annotations

from typing import cast

import numpy as np
import pytest
import reference
import warp as wp
from scipy.sparse import csr_matrix, identity
from scipy.sparse.csgraph import laplacian
from scipy.sparse.linalg import spsolve

from warpdef.kernels.adam import adam
from warpdef.kernels.cosine import CosineSolver, cosine_matrix
from warpdef.kernels.levels import LevelTable, node8
from warpdef.kernels.schedule import SCHEDULE_SIZE, advance
from warpdef.kernels.ways import Way, going


@pytest.fixture(params=[(Way.SPANS, 1), (Way.WHOLE, 1), (Way.WHOLE, 48)], ids=["spans", "one lane", "48 lanes"])
def way(request: pytest.FixtureRequest, device: str) -> tuple[Way, int]:
    """The CPU's own, and CUDA's with blocks of one lane or many."""
    if device != "cpu" and request.param != (Way.WHOLE, 48):
        pytest.skip("CUDA has one way")
    return request.param


def solve(levels: LevelTable, lambdas: np.ndarray, rhs: np.ndarray, device: str, way: tuple[Way, int]) -> np.ndarray:
    """Solution for rhs (S, M, 8)."""
    b = wp.array(rhs.astype(np.float32), dtype=node8, ndim=2, device=device)
    x = wp.full(rhs.shape[:2], node8(*[np.nan] * 8), dtype=node8, device=device)
    with going(*way):
        CosineSolver(levels, lambdas, len(rhs), wp.get_device(device)).solve(b, x, 0, len(rhs))
    np.testing.assert_array_equal(b.numpy(), rhs.astype(np.float32))
    return x.numpy()


def matrix_of(n: int, weight: float) -> csr_matrix:
    edges = reference.grid_edges(n)
    adjacency = csr_matrix((np.ones(2 * len(edges)), np.concatenate([edges, edges[:, ::-1]]).T), shape=(n**3, n**3))
    return (identity(n**3) + weight * cast(csr_matrix, laplacian(adjacency))).tocsr()


@pytest.mark.parametrize("n", [1, 2, 3, 8, 19])
def test_the_basis_is_orthonormal_and_diagonalises_a_path(n: int) -> None:
    basis = cosine_matrix(n)
    np.testing.assert_allclose(basis @ basis.T, np.eye(n), rtol=0, atol=1e-13)
    path = reference.smoother(np.stack([np.arange(n - 1), np.arange(1, n)], axis=1), n, 1.0) - np.eye(n)
    expected = np.diag(2 - 2 * np.cos(np.pi * np.arange(n) / n))
    np.testing.assert_allclose(basis @ path @ basis.T, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("span", [(1, 4), (3, 3), (10, 10), (7, 8)])
def test_it_is_the_direct_solution(span, device: str, way: tuple[Way, int], rng: np.random.Generator) -> None:
    levels = LevelTable.build(*span)
    lambdas = 0.25 * 1.5 ** np.arange(span[0] - 1, span[1])
    rhs = rng.normal(size=(2, levels.node_count, 8)).astype(np.float32)
    found = solve(levels, lambdas, rhs, device, way)
    for n, begin, weight in zip(levels.resolution, levels.offset[:-1], lambdas, strict=True):
        nodes, matrix = slice(begin, begin + int(n) ** 3), matrix_of(int(n), weight)
        for s in range(2):
            b = rhs[s, nodes].astype(np.float64)
            residual = b - matrix @ found[s, nodes].astype(np.float64)
            assert (np.linalg.norm(residual, axis=0) <= 3e-6 * np.linalg.norm(b, axis=0)).all()
        if n < 15:
            expected = np.asarray(spsolve(matrix.tocsc(), rhs[0, nodes].astype(np.float64))).reshape(-1, 8)
            np.testing.assert_allclose(found[0, nodes], expected, rtol=0, atol=2e-6)


def test_constants_stay_and_details_go(device: str, way: tuple[Way, int]) -> None:
    levels = LevelTable.build(1, 4)
    constant = np.ones((1, levels.node_count, 8))
    np.testing.assert_allclose(solve(levels, np.full(4, 9.0), constant, device, way), 1, rtol=1e-6)
    point = np.zeros((1, levels.node_count, 8))
    point[0, levels.offset[3] + 171] = 1  # the middle node of level 4
    smooth = solve(levels, np.full(4, 9.0), point, device, way)
    assert 0 < smooth.max() < 0.1
    assert smooth.sum() == pytest.approx(8, rel=1e-5)


def test_no_smoothing_is_the_identity(device: str, way: tuple[Way, int], rng: np.random.Generator) -> None:
    levels = LevelTable.build(1, 5)
    rhs = rng.normal(size=(1, levels.node_count, 8))
    np.testing.assert_allclose(solve(levels, np.zeros(5), rhs, device, way), rhs, rtol=0, atol=5e-6)


def test_a_zero_right_hand_side_and_a_zero_component(
    device: str, way: tuple[Way, int], rng: np.random.Generator
) -> None:
    levels = LevelTable.build(1, 3)
    rhs = rng.normal(size=(2, levels.node_count, 8))
    rhs[1], rhs[0, :, 6:] = 0, 0
    found = solve(levels, np.ones(3), rhs, device, way)
    np.testing.assert_array_equal(found[1], 0)
    np.testing.assert_array_equal(found[0, :, 6:], 0)


@pytest.mark.parametrize("asked", [(Way.SPANS, 1), (Way.WHOLE, 1), (Way.WHOLE, 5)])
def test_a_span_of_transitions_leaves_the_others_alone(asked: tuple[Way, int], rng: np.random.Generator) -> None:
    levels = LevelTable.build(1, 3)
    with going(*asked):
        solver = CosineSolver(levels, np.ones(3), 3, wp.get_device("cpu"))
        b = wp.array(rng.normal(size=(3, levels.node_count, 8)).astype(np.float32), dtype=node8, ndim=2, device="cpu")
        x = wp.full(b.shape, node8(*[7.0] * 8), dtype=node8, device="cpu")
        solver.solve(b, x, 1, 2)
        np.testing.assert_array_equal(x.numpy()[[0, 2]], 7)
        whole = wp.zeros_like(b)
        solver.solve(b, whole, 0, 3)
    np.testing.assert_array_equal(x.numpy()[1], whole.numpy()[1])


@pytest.mark.parametrize("lanes", [1, 48])
def test_a_step_at_once_is_solve_adam_solve(lanes: int, device: str, rng: np.random.Generator) -> None:
    """Twice, so that the moments tell; only the transitions asked for; the gradient is left at zero."""
    levels, on = LevelTable.build(1, 4), wp.get_device(device)
    lambdas, shape = 0.25 * 1.5 ** np.arange(4), (3, levels.node_count)
    rate = wp.array(rng.uniform(0.5, 2, levels.node_count).astype(np.float32), dtype=wp.float32, device=on)
    betas, epsilon, steps = (0.9, 0.99), 1e-3, wp.zeros(1, dtype=wp.int32, device=on)
    schedule = wp.zeros(SCHEDULE_SIZE, dtype=wp.float32, device=on)
    start = rng.normal(size=(4, *shape, 8)).astype(np.float32)
    start[2] = start[2] ** 2  # a second moment
    apart, at_once = ([wp.array(a, dtype=node8, ndim=2, device=on) for a in start] for _ in range(2))
    for arrays in (apart, at_once):
        arrays += [wp.zeros(shape, dtype=node8, device=on) for _ in range(2)]
    with going(Way.WHOLE, lanes):
        solver = CosineSolver(levels, lambdas, 3, on)
        for _ in range(2):
            advance(10, True, *betas, steps, schedule)
            gradient = rng.normal(size=(*shape, 8)).astype(np.float32)
            for adj_x, first, second, u, adj_u, x in (apart, at_once):
                adj_x.assign(gradient)
                if u is at_once[3]:
                    solver.descend(1, 3, rate, schedule, betas, epsilon, adj_x, (first, second), u, adj_u, x)
                    assert (adj_x.numpy()[1:] == 0).all() and (adj_x.numpy()[0] == gradient[0]).all()
                    continue
                solver.solve(adj_x, adj_u, 1, 3)
                span = (shape[1], 2 * shape[1])
                adam(*span, rate, schedule, betas, epsilon, *(a.flatten() for a in (adj_u, first, second, u)))
                solver.solve(u, x, 1, 3)
    for one, other, was in zip(apart[1:4], at_once[1:4], start[1:], strict=True):
        np.testing.assert_allclose(other.numpy(), one.numpy(), rtol=2e-6, atol=1e-6)
        assert (other.numpy()[0] == was[0]).all() and (other.numpy()[1:] != was[1:]).any()
    for one, other in zip(apart[4:], at_once[4:], strict=True):
        np.testing.assert_allclose(other.numpy(), one.numpy(), rtol=0, atol=2e-6)
        assert (other.numpy()[0] == 0).all() and (other.numpy()[1:] != 0).any()
