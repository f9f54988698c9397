"""The Sobolev solve (I + lambda L)^-1 on any graph, by conjugate gradients (paper, sec. Spatial Smoothness).

Every component of a node (six of a grid node, three of a vertex) is its own right-hand side with its own step length,
so a small rotation is solved as well as a large translation. A system stops when |r| <= tolerance |b| holds for each
component; each solve tells its iterations and its worst relative residual. The start is the last solution.

The residual that the recursion carries along drifts from what it stands for as rounding adds up. So b - A x is computed
anew where the recursion ends; it is what is told, and if it asks for more the recursion starts again from there.

The CPU runs a whole system in one thread and stops early. CUDA runs the same recurrence over all systems at once, one
launch a phase, a converged system standing still. The operator is symmetric: its own adjoint.
"""

from typing import Any

import numpy as np
import warp as wp

from warpdef.kernels.cg_functions import check_limits, iterations_between_looks
from warpdef.kernels.cg_kernels import kernels_for
from warpdef.kernels.cg_steps import steps_for
from warpdef.kernels.graphs import Graph
from warpdef.kernels.launching import launch
from warpdef.kernels.levels import node8
from warpdef.kernels.ways import Way, way_of

_KERNELS = {dtype: kernels_for(dtype) | steps_for(dtype) for dtype in (wp.vec3, node8)}


class ConjugateGradients:
    """``(I + lambda L)^-1`` on a ``Graph``; keeps its last solution as the next start.

    Args:
        graph: the systems. dtype: vec3 or node8. tolerance: relative residual to stop at, above 0 and below 1.
        iterations_max: iterations after which a solve gives up and says so in ``iterations`` and ``residual``, the true
            one. A solve also gives up where rounding keeps restarts from halving the residual.
        stepwise: one launch a phase over all systems, the way of CUDA; None: where the device is no CPU.

    Raises:
        ValueError: limits that no solve can keep.
    """

    def __init__(
        self,
        graph: Graph,
        dtype: Any,
        tolerance: float,
        iterations_max: int,
        device: wp.Device,
        stepwise: bool | None = None,
    ) -> None:
        def ints(a: np.ndarray) -> wp.array:
            return wp.array(a, dtype=wp.int32, device=device)

        check_limits(tolerance, iterations_max)
        nodes, systems = len(graph.node), len(graph.weight)
        self._device = device
        self._kernels = _KERNELS[dtype]
        self._tolerance, self._iterations_max = float(tolerance), int(iterations_max)
        self._node, self._system, self._first = ints(graph.node), ints(graph.system), ints(graph.first)
        self._row, self._column = ints(graph.row), ints(graph.column)
        self._weight = wp.array(graph.weight, dtype=wp.float32, device=device)
        self._x, self._r, self._p, self._ap = (wp.zeros(nodes, dtype=dtype, device=device) for _ in range(4))
        self.iterations = wp.zeros(systems, dtype=wp.int32, device=device)
        self.residual = wp.zeros(systems, dtype=wp.float32, device=device)
        self._stepwise = way_of(device) is Way.WHOLE if stepwise is None else stepwise
        # Rows of the recursion, one a step, and where among them the true residuals lie.
        steps = iterations_between_looks(self._iterations_max) if self._stepwise else []
        self._looks = np.cumsum([0, *(n + 1 for n in steps)])
        self._look_rows = ints(self._looks)
        self._b_sq = wp.zeros(systems, dtype=dtype, device=device)
        self._r_sq, self._p_ap = (
            wp.zeros((self._looks[-1] + 1, systems), dtype=dtype, device=device) for _ in range(2)
        )

    @property
    def start(self) -> wp.array:
        """Where the next solve starts: the last solution, compact nodes."""
        return self._x

    def forget(self) -> None:
        """Let the next solve start from zero."""
        self._x.zero_()

    def solve(self, rhs: wp.array, solution_out: wp.array, first: int, last: int) -> None:
        """Solve systems ``first .. last`` (last excluded); stepwise all of them.

        Args:
            rhs, solution_out: flat full arrays of the graph's dtype; nodes that are not kept are left alone.
        """
        if self._stepwise:
            self._solve_stepwise(rhs, solution_out)
            return
        graph = [self._node, self._first, self._row, self._column, self._weight]
        work = [self._x, self._r, self._p, self._ap]
        limits = [self._tolerance, self._iterations_max]
        outputs = [solution_out, self.iterations, self.residual]
        launch(
            self._kernels["solve_systems"], last - first, [first, *graph, *limits, rhs, *work, *outputs], self._device
        )

    def multiply_add(self, x: wp.array, y: wp.array, z: wp.array, alpha: float, beta: float) -> None:
        """``z = alpha (I + lambda L) x + beta y`` on compact arrays: the contract of warp.optim.linear's operators."""
        inputs = [self._system, self._row, self._column, self._weight, x, y, float(alpha), float(beta), z]
        launch(self._kernels["multiply_add"], len(self._node), inputs, self._device)

    def gather(self, full: wp.array, compact_out: wp.array) -> None:
        """Kept nodes of a full, flat array, in compact order."""
        launch(self._kernels["gather"], len(self._node), [self._node, full, compact_out], self._device)

    def scatter(self, compact: wp.array, full_out: wp.array) -> None:
        """The way back; nodes that are not kept are left alone."""
        launch(self._kernels["finish"], len(self._node), [self._node, compact, full_out], self._device)

    def _solve_stepwise(self, rhs: wp.array, solution_out: wp.array) -> None:
        def run(name: str, count: int, *inputs: Any) -> None:
            launch(self._kernels[name], count, inputs, self._device)

        nodes, systems, tolerance = len(self._node), len(self._weight), self._tolerance
        for array in (self._b_sq, self._r_sq.flatten(), self._p_ap.flatten()):
            run("clear", len(array), array)
        matrix = (self._row, self._column, self._weight)
        start = (self._node, self._system, *matrix, rhs, self._x, self._r, self._p, self._b_sq, self._r_sq)
        run("start", nodes, *start)
        run("settle", nodes, self._system, self._first, self._b_sq, self._x, self._r, self._p, self._r_sq)
        norms = (self._b_sq, self._r_sq)
        for first, last in zip(self._looks[:-1], self._looks[1:], strict=True):
            for step in range(int(first), int(last) - 1):
                run("multiply", nodes, step, tolerance, self._system, *matrix, *norms, self._p, self._ap, self._p_ap)
                moved = (self._b_sq, self._p_ap, self._p, self._ap, self._x, self._r, self._r_sq)
                run("update", nodes, step, tolerance, self._system, self._first, *moved)
                run("turn", nodes, step, tolerance, self._system, *norms, self._r, self._p)
            graph = (self._node, self._system, self._first, *matrix)
            final = int(last == self._looks[-1])
            run(
                "look",
                nodes,
                int(last),
                final,
                tolerance,
                *graph,
                rhs,
                self._b_sq,
                self._x,
                self._r,
                self._p,
                self._r_sq,
            )
        self.scatter(self._x, solution_out)
        run("report", systems, tolerance, self._look_rows, *norms, self.iterations, self.residual)
