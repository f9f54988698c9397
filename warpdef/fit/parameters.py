"""Parameters under the Sobolev preconditioner, as Adam moves them (paper, sec. Spatial Smoothness).

u: what Adam moves     x = (I + lambda L)^-1 u: what the objective sees     adj u = (I + lambda L)^-1 adj x
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from warpdef.config import OptimiserConfig
from warpdef.fit.pool import Pool
from warpdef.fit.sobolev import Solver
from warpdef.kernels.adam import adam
from warpdef.kernels.vectors import clear_nodes


class Parameters:
    """Values of one kind, zero at the start: x, u, their gradients and Adam's moments, all of one shape.

    Args:
        pool, name: where their arrays come from and under which name these are counted.
        dtype, shape: of the arrays. rates: learning rates, repeated over the flat arrays.
        solvers: for the gradient and for the values; those that start from their own last solution are two.
        schedule: see ``kernels.schedule``.
    """

    def __init__(
        self,
        pool: Pool,
        name: str,
        dtype: Any,
        shape: tuple[int, ...],
        rates: np.ndarray,
        solvers: tuple[Solver, Solver],
        config: OptimiserConfig,
        schedule: wp.array,
    ) -> None:
        arrays = pool.own(name, dtype, *[shape] * 6)
        self.u, self.x, self.adj_x, self.adj_u, self.first_moment, self.second_moment = arrays
        self.gradient_solver, self.value_solver = solvers
        self._config, self._schedule = config, schedule
        self._rates = rates
        self._rate = wp.array(rates.astype(np.float32), dtype=wp.float32, device=pool.device)

    @property
    def direct(self) -> bool:
        """Whether the solvers run on the host and cannot be recorded."""
        return self.gradient_solver.direct

    def slow_down(self, scale: float) -> None:
        """From now on learning rates are ``scale`` times those given."""
        self._rate.assign((scale * self._rates).astype(np.float32))

    # Tasks. The first two numbers say which systems, or which of the flat values.

    def solve_gradient(self, first: int, last: int) -> None:
        """adj u from adj x."""
        self.gradient_solver.solve(self.adj_x, self.adj_u, first, last)

    def descend(self, begin: int, count: int) -> None:
        """Adam on u."""
        c = self._config
        state = [a.flatten() for a in (self.adj_u, self.first_moment, self.second_moment, self.u)]
        adam(begin, count, self._rate, self._schedule, (c.beta1, c.beta2), c.epsilon, *state)

    def solve_values(self, first: int, last: int) -> None:
        """x from u."""
        self.value_solver.solve(self.u, self.x, first, last)

    def step(self, first: int, last: int, moving: wp.array | None = None) -> None:
        """All three for the grids of transitions ``first .. last``, in one launch where the solver can.

        There those of them stay that ``moving``, (S,) int32, has 0 for; else the caller leaves them out.
        """
        at_once = getattr(self.gradient_solver, "descend", None)
        if at_once is not None:
            c, moments = self._config, (self.first_moment, self.second_moment)
            how = (self._rate, self._schedule, (c.beta1, c.beta2), c.epsilon)
            at_once(first, last, *how, self.adj_x, moments, self.u, self.adj_u, self.x, moving)
            return
        self.solve_gradient(first, last)
        self.descend_grids(first, last)
        self.solve_values(first, last)

    def descend_grids(self, first: int, last: int) -> None:
        """Adam on the grids of transitions ``first .. last``; then their gradient is cleared for the next iteration."""
        nodes = self.u.shape[1]
        span = (first * nodes, (last - first) * nodes)
        self.descend(*span)
        clear_nodes(*span, self.adj_x.flatten())
