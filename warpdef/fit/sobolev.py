"""The Sobolev preconditioner (I + lambda L)^-1 for grids and template (paper, sec. Spatial Smoothness).

Parameters x are optimised as u = (I + lambda L) x: x = (I + lambda L)^-1 u forwards, grad_u = (I + lambda L)^-1 grad_x
backwards. Ways to solve: exact cosine transforms on full grids, an exact factorisation for the template on the CPU, our
conjugate gradients on any graph, and Warp's own as the reference.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import warp as wp

from warpdef.config import Config
from warpdef.device import Way, way_of
from warpdef.kernels.cg import ConjugateGradients
from warpdef.kernels.cholesky import CholeskySolver, Factor
from warpdef.kernels.cosine import CosineSolver
from warpdef.kernels.graphs import Graph, grid_graph
from warpdef.kernels.levels import LevelTable, node8


@dataclass
class SolveReport:
    """What the solves of a run did, worst case over all that were looked at.

    iterations: most iterations of one solve. residual: largest relative residual. stalled: solves that gave up.
    """

    solver: str
    iterations: int = 0
    residual: float = 0.0
    stalled: int = 0

    def as_dict(self) -> dict:
        """Plain values for ``report.json``."""
        return {
            "name": self.solver,
            "iterations_most": self.iterations,
            "residual_worst": self.residual,
            "not_converged": self.stalled,
        }

    def warning(self, flag: str) -> list[str]:
        """One sentence if anything stalled; ``flag`` is what to raise."""
        if not self.stalled:
            return []
        return [
            f"{self.stalled} of the {self.solver} solves looked at did not converge (worst relative residual "
            f"{self.residual:.1e} after {self.iterations} iterations); raise {flag}"
        ]


class Solver(Protocol):
    """Solves for transitions ``first .. last``; ``direct`` solvers run on the host and cannot be recorded."""

    direct: bool

    def solve(self, rhs: wp.array, solution_out: wp.array, first: int, last: int) -> None: ...

    def look(self, report: SolveReport) -> None: ...

    def memory(self) -> list[wp.array]:
        """What one solve leaves for the next: where iterations start."""
        ...


class _Cosine:
    direct = False

    def __init__(self, levels: LevelTable, lambdas: np.ndarray, transitions: int, device: wp.Device) -> None:
        solver = CosineSolver(levels, lambdas, transitions, device)
        self.solve = solver.solve
        self.descend = solver.descend if solver.descends else None

    def look(self, report: SolveReport) -> None:
        """Exact: nothing to tell."""

    def memory(self) -> list[wp.array]:
        return []


class _Cholesky:
    """Factorised at the first solve: where no vertex is moved by the descent there is none."""

    direct = False

    def __init__(self, graph: Graph, device: wp.Device) -> None:
        self._graph, self._device = graph, device

    @cached_property
    def _solver(self) -> CholeskySolver:
        return CholeskySolver(factorise(self._graph), self._device)

    def solve(self, rhs: wp.array, solution_out: wp.array, first: int, last: int) -> None:
        self._solver.solve(rhs, solution_out)

    def look(self, report: SolveReport) -> None:
        """Exact: nothing to tell."""

    def memory(self) -> list[wp.array]:
        return []


class _Conjugate:
    direct = False

    def __init__(self, graph: Graph, dtype: Any, systems_each: int, config: Config, device: wp.Device) -> None:
        limits = config.sobolev
        self._solver = ConjugateGradients(graph, dtype, limits.tolerance, limits.iterations_max, device)
        self._tolerance = limits.tolerance
        self._systems_each = systems_each

    def solve(self, rhs: wp.array, solution_out: wp.array, first: int, last: int) -> None:
        each = self._systems_each
        self._solver.solve(rhs.flatten(), solution_out.flatten(), first * each, last * each)

    def look(self, report: SolveReport) -> None:
        note_solve(report, int(self._solver.iterations.numpy().max()), self._solver.residual.numpy(), self._tolerance)

    def memory(self) -> list[wp.array]:
        return [self._solver.start]


class _Reference:
    """warp.optim.linear.cg: one call over all systems, whatever span is asked for. Slow on the CPU; tests lean on it.

    It stops by the norm over all components of a system, where ours looks at each component.
    """

    direct = True

    def __init__(self, graph: Graph, dtype: Any, config: Config, device: wp.Device) -> None:
        import warp.optim.linear as linear

        width = 3 if dtype is wp.vec3 else 8
        ours = ConjugateGradients(graph, dtype, config.sobolev.tolerance, 1, device)
        offsets = wp.array(graph.first * width, dtype=wp.int32, device=device)
        nodes = len(graph.node)
        self._cg: Any = linear.cg  # a function, or a solver to be called again; its annotation says both at once
        self._limits = config.sobolev
        self._b, self._x, self._r = (wp.zeros(nodes, dtype=dtype, device=device) for _ in range(3))
        self._gather, self._scatter, self._multiply_add = ours.gather, ours.scatter, ours.multiply_add
        self._system, self._systems = graph.system, len(graph.weight)
        self._operator = linear.LinearOperator(
            (nodes * width, nodes * width), dtype, device, ours.multiply_add, batch_offsets=offsets
        )
        self._iterations = 0

    def solve(self, rhs: wp.array, solution_out: wp.array, first: int, last: int) -> None:
        self._gather(rhs.flatten(), self._b)
        limits = self._limits
        # Without atol it would take tol for an absolute tolerance too, and leave small gradients unsolved.
        until = {"tol": limits.tolerance, "atol": 0.0, "maxiter": limits.iterations_max, "check_every": 5}
        done, _, _ = self._cg(self._operator, self._b, self._x, **until)
        self._iterations = int(done)
        self._scatter(self._x, solution_out.flatten())

    def look(self, report: SolveReport) -> None:
        self._multiply_add(self._x, self._b, self._r, -1.0, 1.0)
        r, b = (self._norms(a) for a in (self._r, self._b))
        # A zero right-hand side asks for a zero residual.
        relative = np.divide(r, b, out=(r > 0).astype(float), where=b > 0)
        note_solve(report, self._iterations, relative, self._limits.tolerance)

    def memory(self) -> list[wp.array]:
        return [self._x]

    def _norms(self, a: wp.array) -> np.ndarray:
        """Length of each system's vector, over all nodes and components, shape (systems,)."""
        sq = (a.numpy().astype(np.float64) ** 2).sum(axis=1)
        return np.sqrt(np.bincount(self._system, sq, minlength=self._systems))


def note_solve(report: SolveReport, iterations: int, residuals: np.ndarray, tolerance: float) -> None:
    """Add solves to a report: the iterations of the longest, the relative residual of each, what was asked for."""
    report.iterations = max(report.iterations, iterations)
    report.residual = max(report.residual, float(residuals.max()))
    # float32 rounding of the recursion: a hair above the tolerance is not a stall. NaN is one.
    report.stalled += int((~(residuals <= 1.01 * tolerance)).sum())


def solver_name(config: Config) -> str:
    """What ``auto`` means for this configuration."""
    if config.sobolev.solver != "auto":
        return config.sobolev.solver
    return "cg" if config.grid.prune else "cosine"


def level_lambdas(config: Config) -> np.ndarray:
    """Smoothing weight of each level in use; all 0 without preconditioning, which makes every solve the identity."""
    if not config.sobolev.enabled:
        return np.zeros(config.grid.levels - config.grid.coarsest + 1)
    index = np.arange(config.grid.coarsest - 1, config.grid.levels)
    return config.sobolev.lambda_base * config.sobolev.lambda_growth**index


def grid_solver(config: Config, levels: LevelTable, kept: np.ndarray, device: wp.Device) -> Solver:
    """A solver for the grids of all transitions; ``kept`` is (S, M) bool."""
    name = solver_name(config)
    lambdas = level_lambdas(config)
    if name == "cosine":
        return _Cosine(levels, lambdas, len(kept), device)
    graph = grid_graph(levels, kept, lambdas)
    if name == "warp":
        return _Reference(graph, node8, config, device)
    return _Conjugate(graph, node8, levels.count, config, device)


def template_solvers(config: Config, graph: Graph, device: wp.Device) -> tuple[Solver, Solver]:
    """Two solvers for the template's vertices, not to be used at the same time.

    Conjugate gradients start from their own last solution and so are two; a factorisation remembers nothing.
    """
    name = config.sobolev.solver
    if name in ("auto", "cosine") and way_of(device) is Way.SPANS:
        exact = _Cholesky(graph, device)
        return exact, exact
    if name == "warp":
        return _Reference(graph, wp.vec3, config, device), _Reference(graph, wp.vec3, config, device)
    return _Conjugate(graph, wp.vec3, 1, config, device), _Conjugate(graph, wp.vec3, 1, config, device)


def factorise(graph: Graph) -> Factor:
    """``(I + lambda L)`` of a graph as triangular factors, in the order of least degree, float64."""
    from scipy.sparse import csc_array, diags_array, tril
    from scipy.sparse.linalg import splu

    nodes, weight = len(graph.node), graph.weight[graph.system].astype(float)
    degree = np.diff(graph.row)
    around = csc_array((np.repeat(weight, degree), graph.column, graph.row), shape=(nodes, nodes))
    matrix = (diags_array(1.0 + weight * degree) - around).tocsc()
    # No pivoting: the matrix is diagonally dominant, and rows must go in the order of columns for F D F^T.
    lu = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    below = tril(lu.L, -1).tocsr()
    below.sort_indices()
    return Factor(np.argsort(lu.perm_r), below.indptr, below.indices, below.data, lu.U.diagonal())
