"""The Sobolev solve (I + lambda L)^-1 on any graph, by conjugate gradients (paper, sec. Spatial Smoothness).

Every component of a node (six of a grid node, three of a vertex) is its own right-hand side with its own step length,
so a small rotation is solved as well as a large translation. A system stops when |r| <= tolerance |b| holds for each
component; each solve tells its iterations and its worst relative residual. The start is the last solution.

The residual that the recursion carries along drifts from what it stands for as rounding adds up. So b - A x is computed
anew where the recursion ends; it is what is told, and if it asks for more the recursion starts again from there.

All systems are one launch, each a block or a cluster (``clusters``) that stops as soon as it is done: a thread on the
CPU. Sums are added up in a fixed order, so a solve has the same bits in every run on a device. The operator is
symmetric: its own adjoint.
"""

from typing import Any

import numpy as np
import warp as wp

from warpdef.kernels.cg_functions import check_limits
from warpdef.kernels.cg_kernels import kernels_for, team_for
from warpdef.kernels.clusters import PARTIAL
from warpdef.kernels.graphs import Graph
from warpdef.kernels.launching import launch
from warpdef.kernels.levels import node8
from warpdef.kernels.ways import cluster_of, lanes_of

_KERNELS = {dtype: kernels_for(dtype) for dtype in (wp.vec3, node8)}


class ConjugateGradients:
    """``(I + lambda L)^-1`` on a ``Graph``; keeps its last solution as the next start.

    Args:
        graph: the systems. dtype: vec3 or node8. tolerance: relative residual to stop at, above 0 and below 1.
        iterations_max: iterations after which a solve gives up and says so in ``iterations`` and ``residual``, the true
            one. A solve also gives up where rounding keeps restarts from halving the residual.

    Raises:
        ValueError: limits that no solve can keep.
    """

    def __init__(self, graph: Graph, dtype: Any, tolerance: float, iterations_max: int, device: wp.Device) -> None:
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
        lanes, cluster = team_for(dtype)
        self._team = lanes_of(device, lanes), cluster_of(device, cluster)
        self._partial = wp.zeros(systems * PARTIAL, dtype=dtype, device=device)

    @property
    def start(self) -> wp.array:
        """Where the next solve starts: the last solution, compact nodes."""
        return self._x

    def forget(self) -> None:
        """Let the next solve start from zero."""
        self._x.zero_()

    def solve(self, rhs: wp.array, solution_out: wp.array, first: int, last: int) -> None:
        """Solve systems ``first .. last`` (last excluded).

        Args:
            rhs, solution_out: flat full arrays of the graph's dtype; nodes that are not kept are left alone.
        """
        graph = [self._node, self._first, self._row, self._column, self._weight]
        work = [self._x, self._r, self._p, self._ap, self._partial]
        limits = [self._tolerance, self._iterations_max]
        outputs = [solution_out, self.iterations, self.residual]
        inputs = [first, *graph, *limits, rhs, *work, *outputs]
        launch(self._kernels["solve_systems"], last - first, inputs, self._device, *self._team)

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
