"""The preconditioner's three solvers give the same answer, and report what they did."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import reference
import synthetic
import warp as wp

from warpdef.config import Config
from warpdef.fit.sobolev import SolveReport, grid_solver, level_lambdas, solver_name, template_solvers
from warpdef.geometry.triangles import unique_edges
from warpdef.kernels.graphs import mesh_graph
from warpdef.kernels.levels import LevelTable, node8


def configured(solver: str = "auto", prune: bool = False, levels: int = 3, **sobolev) -> Config:
    config = Config()
    grid = replace(config.grid, levels=levels, prune=prune)
    return replace(config, grid=grid, sobolev=replace(config.sobolev, solver=solver, **sobolev))


@pytest.mark.parametrize(
    ("solver", "prune", "expected"),
    [("auto", False, "cosine"), ("auto", True, "cg"), ("cg", False, "cg"), ("warp", True, "warp")],
)
def test_auto_is_the_fastest_that_fits(solver: str, prune: bool, expected: str) -> None:
    assert solver_name(configured(solver, prune)) == expected


def test_lambda_grows_by_level() -> None:
    np.testing.assert_allclose(level_lambdas(configured(levels=4)), 0.25 * 1.5 ** np.arange(4))
    config = configured(levels=4)
    single = replace(config, grid=replace(config.grid, coarsest=4))
    np.testing.assert_allclose(level_lambdas(single), [0.25 * 1.5**3])
    np.testing.assert_array_equal(level_lambdas(configured(levels=4, enabled=False)), 0)


def expected_grids(rhs: np.ndarray, kept: np.ndarray, config: Config) -> np.ndarray:
    """The solution by dense matrices, (S, M, 8); 0 where nothing is kept."""
    levels, found = reference.resolutions(1, config.grid.levels), np.zeros_like(rhs, dtype=np.float64)
    for n, begin, weight in zip(levels, reference.offsets(levels)[:-1], level_lambdas(config), strict=True):
        for s in range(len(rhs)):
            keep = kept[s, begin : begin + n**3]
            edges = reference.grid_edges(n)
            matrix = reference.smoother(edges[keep[edges].all(axis=1)], n**3, weight)
            solution = np.linalg.solve(matrix, rhs[s, begin : begin + n**3].astype(np.float64))
            found[s, begin : begin + n**3] = np.where(keep[:, None], solution, 0)
    return found


@pytest.mark.parametrize("share", [1.0, 0.6], ids=["full", "pruned"])
@pytest.mark.parametrize("solver", ["cosine", "cg", "warp"])
def test_grid_solvers_agree_with_dense_matrices(
    solver: str, share: float, device: str, rng: np.random.Generator
) -> None:
    if solver == "cosine" and share < 1:
        pytest.skip("cosine transforms need full grids")
    config = configured(solver, prune=share < 1, tolerance=1e-6)
    levels = LevelTable.build(1, 3)
    kept = rng.random((2, levels.node_count)) < share
    rhs = rng.normal(size=(*kept.shape, 8)).astype(np.float32)
    b = wp.array(rhs, dtype=node8, ndim=2, device=device)
    x = wp.zeros_like(b)
    solve = grid_solver(config, levels, kept, wp.get_device(device))
    report = SolveReport(solver)
    # A gradient far below 1 must be solved as well as any; and each solve starts from the one before.
    expected = expected_grids(rhs, kept, config)
    for scale in (1e-7, 1.0, -2.0):
        b.assign(scale * rhs)
        solve.solve(b, x, 0, 2)
        np.testing.assert_allclose(x.numpy(), scale * expected, rtol=0, atol=5e-6 * abs(scale))
        solve.look(report)
    assert report.stalled == 0 and report.residual <= 1e-6
    assert (report.iterations > 3) == (solver != "cosine")


@pytest.mark.parametrize("solver", ["auto", "cosine", "cg", "warp"])
def test_template_solvers_agree_with_dense_matrices(solver: str, device: str, rng: np.random.Generator) -> None:
    vertices, faces = synthetic.icosphere(1)
    edges = unique_edges(faces)
    config = configured(solver, tolerance=1e-6)
    both = template_solvers(config, mesh_graph(edges, len(vertices), 16.0), wp.get_device(device))
    for solve in both:
        rhs = rng.normal(size=vertices.shape).astype(np.float32)
        b = wp.array(rhs, dtype=wp.vec3, device=device)
        x = wp.zeros_like(b)
        solve.solve(b, x, 0, 1)
        expected = np.linalg.solve(reference.smoother(edges, len(vertices), 16.0), rhs.astype(np.float64))
        np.testing.assert_allclose(x.numpy(), expected, rtol=0, atol=5e-6)
        report = SolveReport(solver)
        solve.look(report)
        iterates = solver in ("cg", "warp") or device != "cpu"
        assert (report.iterations > 3) == iterates == (len(solve.memory()) == 1)


@pytest.mark.parametrize("solver", ["cg", "warp"])
def test_a_solve_that_gave_up_is_counted(solver: str, device: str, rng: np.random.Generator) -> None:
    config = configured(solver, tolerance=1e-6, iterations_max=5, lambda_base=50.0)
    levels = LevelTable.build(1, 3)
    b = wp.array(rng.normal(size=(1, levels.node_count, 8)).astype(np.float32), dtype=node8, ndim=2, device=device)
    solve = grid_solver(config, levels, np.ones((1, levels.node_count), bool), wp.get_device(device))
    solve.solve(b, wp.zeros_like(b), 0, 1)
    report = SolveReport(solver)
    solve.look(report)
    assert report.stalled >= 1 and report.iterations == 5
    assert report.residual > 1e-6


def test_without_smoothing_every_solve_is_the_identity(device: str, rng: np.random.Generator) -> None:
    levels = LevelTable.build(1, 3)
    rhs = rng.normal(size=(1, levels.node_count, 8)).astype(np.float32)
    for solver in ("cosine", "cg"):
        solve = grid_solver(
            configured(solver, enabled=False), levels, np.ones((1, levels.node_count), bool), wp.get_device(device)
        )
        b = wp.array(rhs, dtype=node8, ndim=2, device=device)
        x = wp.zeros_like(b)
        solve.solve(b, x, 0, 1)
        np.testing.assert_allclose(x.numpy(), rhs, rtol=0, atol=5e-6)
