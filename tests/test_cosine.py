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

from warpdef.kernels.cosine import CosineSolver, cosine_matrix
from warpdef.kernels.levels import LevelTable, node8


@pytest.fixture(params=["whole", "by axis"])
def by_axis(request: pytest.FixtureRequest, device: str) -> bool:
    """The CPU can run both ways; CUDA has the second."""
    if device != "cpu" and request.param == "whole":
        pytest.skip("CUDA solves axis by axis")
    return request.param == "by axis"


def solve(levels: LevelTable, lambdas: np.ndarray, rhs: np.ndarray, device: str, by_axis: bool) -> np.ndarray:
    """Solution for rhs (S, M, 8)."""
    solver = CosineSolver(levels, lambdas, len(rhs), wp.get_device(device))
    b = wp.array(rhs.astype(np.float32), dtype=node8, ndim=2, device=device)
    x = wp.full(rhs.shape[:2], node8(*[np.nan] * 8), dtype=node8, device=device)
    if by_axis:
        solver.solve_by_axis(b, x)
    else:
        solver.solve(b, x, 0, len(rhs))
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
def test_it_is_the_direct_solution(span, device: str, by_axis: bool, rng: np.random.Generator) -> None:
    levels = LevelTable.build(*span)
    lambdas = 0.25 * 1.5 ** np.arange(span[0] - 1, span[1])
    rhs = rng.normal(size=(2, levels.node_count, 8)).astype(np.float32)
    found = solve(levels, lambdas, rhs, device, by_axis)
    for n, begin, weight in zip(levels.resolution, levels.offset[:-1], lambdas, strict=True):
        nodes, matrix = slice(begin, begin + int(n) ** 3), matrix_of(int(n), weight)
        for s in range(2):
            b = rhs[s, nodes].astype(np.float64)
            residual = b - matrix @ found[s, nodes].astype(np.float64)
            assert (np.linalg.norm(residual, axis=0) <= 3e-6 * np.linalg.norm(b, axis=0)).all()
        if n < 15:
            expected = np.asarray(spsolve(matrix.tocsc(), rhs[0, nodes].astype(np.float64))).reshape(-1, 8)
            np.testing.assert_allclose(found[0, nodes], expected, rtol=0, atol=2e-6)


def test_constants_stay_and_details_go(device: str, by_axis: bool) -> None:
    levels = LevelTable.build(1, 4)
    constant = np.ones((1, levels.node_count, 8))
    np.testing.assert_allclose(solve(levels, np.full(4, 9.0), constant, device, by_axis), 1, rtol=1e-6)
    point = np.zeros((1, levels.node_count, 8))
    point[0, levels.offset[3] + 171] = 1  # the middle node of level 4
    smooth = solve(levels, np.full(4, 9.0), point, device, by_axis)
    assert 0 < smooth.max() < 0.1
    assert smooth.sum() == pytest.approx(8, rel=1e-5)


def test_no_smoothing_is_the_identity(device: str, by_axis: bool, rng: np.random.Generator) -> None:
    levels = LevelTable.build(1, 5)
    rhs = rng.normal(size=(1, levels.node_count, 8))
    np.testing.assert_allclose(solve(levels, np.zeros(5), rhs, device, by_axis), rhs, rtol=0, atol=5e-6)


def test_a_zero_right_hand_side_and_a_zero_component(device: str, by_axis: bool, rng: np.random.Generator) -> None:
    levels = LevelTable.build(1, 3)
    rhs = rng.normal(size=(2, levels.node_count, 8))
    rhs[1], rhs[0, :, 6:] = 0, 0
    found = solve(levels, np.ones(3), rhs, device, by_axis)
    np.testing.assert_array_equal(found[1], 0)
    np.testing.assert_array_equal(found[0, :, 6:], 0)


def test_a_span_of_transitions_leaves_the_others_alone(rng: np.random.Generator) -> None:
    levels = LevelTable.build(1, 3)
    solver = CosineSolver(levels, np.ones(3), 3, wp.get_device("cpu"))
    b = wp.array(rng.normal(size=(3, levels.node_count, 8)).astype(np.float32), dtype=node8, ndim=2, device="cpu")
    x = wp.full(b.shape, node8(*[7.0] * 8), dtype=node8, device="cpu")
    solver.solve(b, x, 1, 2)
    np.testing.assert_array_equal(x.numpy()[[0, 2]], 7)
    whole = wp.zeros_like(b)
    solver.solve(b, whole, 0, 3)
    np.testing.assert_array_equal(x.numpy()[1], whole.numpy()[1])
