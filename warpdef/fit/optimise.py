"""One step of preconditioned Adam on grids and template (paper, sec. Spatial Smoothness and Implementation Details).

    u: what Adam moves     x = (I + lambda L)^-1 u: what the objective sees     g_u = (I + lambda L)^-1 g_x

Grids and template start from x = 0 and the mesh, u = (I + lambda L) x.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import warp as wp

from warpdef.fit.objective import Objective
from warpdef.fit.problem import Problem
from warpdef.fit.sobolev import SolveReport, grid_solver, solver_name, template_solvers
from warpdef.fit.workers import Iteration, Phase, Task, Team
from warpdef.kernels.adam import adam
from warpdef.kernels.finite import flag_not_finite
from warpdef.kernels.levels import node8
from warpdef.kernels.motion import template_gradient
from warpdef.kernels.schedule import SCHEDULE_SIZE, advance
from warpdef.kernels.vectors import clear_nodes, copy_vectors


class Optimiser:
    """State and phases of the descent on one problem.

    Args:
        problem: what to fit. iterations: length of the run, which the schedules refer to. team: CPU threads.
        capture: on CUDA, run an iteration as one graph.
    """

    def __init__(self, problem: Problem, iterations: int, team: Team, capture: bool = True) -> None:
        self.problem, self.iterations = problem, iterations
        self.config = problem.config.optimiser
        self.done = 0
        device = problem.device
        shape = (len(problem.transitions), problem.levels.node_count)

        self._step = wp.zeros(1, dtype=wp.int32, device=device)
        self._schedule = wp.zeros(SCHEDULE_SIZE, dtype=wp.float32, device=device)
        node_arrays = (wp.zeros(shape, dtype=node8, device=device) for _ in range(6))
        self._u, self.nodes, self._adj_nodes, self._adj_u, self._first, self._second = node_arrays
        self._shape_u, self._adj_shape, self._adj_shape_u, self._shape_first, self._shape_second = (
            wp.zeros(problem.vertex_count, dtype=wp.vec3, device=device) for _ in range(5)
        )
        self._shape_u.assign(_unsolve(problem))
        self.objective = Objective(problem, self.nodes, self._adj_nodes, self._schedule)
        # The template apart from the keyframe's row of vertices, which other tasks read while it changes.
        self._shape = problem.vectors(problem.template)

        sobolev = problem.config.sobolev
        factor = 1.0 if sobolev.enabled else sobolev.unpreconditioned_rate
        coarsest_first = self.config.rate * self.config.rate_growth ** np.arange(
            problem.config.grid.coarsest - 1, problem.config.grid.levels
        )
        # What a keyframe does not show of a template given is known from the template alone: it stays.
        shape_rate = self.config.template_rate if problem.measures.complete[problem.transitions.keyframe] else 0.0
        self._rates = factor * coarsest_first[problem.levels.node_level()], np.array([factor * shape_rate])
        self._rate, self._shape_rate = (problem.numbers(rate) for rate in self._rates)
        self.rate_scale = 1.0

        # Two of each: a conjugate-gradient solver starts from its own last solution.
        solvers = [grid_solver(problem.config, problem.levels, problem.kept, device) for _ in range(2)]
        self._pull_grid, self._push_grid = solvers
        self._pull_shape, self._push_shape = template_solvers(problem.config, problem.mesh, device)
        self.solves = SolveReport(solver_name(problem.config))
        self._not_finite = wp.zeros(1, dtype=wp.int32, device=device)
        self._kept: dict[str, wp.array] = {}
        self._kept_done = 0
        checks = [partial(flag_not_finite, a, self._not_finite) for name, a in self._state().items() if name != "step"]
        self._check = Iteration([Phase("check", checks)], device, team, capture=False)
        self._warmup = Iteration(self._phases(warmup=True), device, team, capture)
        self._full = Iteration(self._phases(warmup=False), device, team, capture)

    def prepare(self) -> None:
        """Compile every kernel, so that the first step costs what the others do."""
        self.finite()
        if self.problem.device.is_cpu:
            self._warmup.prepare()
            self._full.prepare()
        else:
            wp.load_module("warpdef.kernels", device=self.problem.device, recursive=True)

    # State: what an iteration leaves for the next. Searches remember more, but only to be quick: they are exact.

    def _state(self) -> dict[str, wp.array]:
        state = {
            **{"step": self._step, "u": self._u, "nodes": self.nodes, "first": self._first, "second": self._second},
            **{"shape_u": self._shape_u, "shape": self._shape},
            **{"shape_first": self._shape_first, "shape_second": self._shape_second},
        }
        solvers = {"pull_grid": self._pull_grid, "push_grid": self._push_grid}
        solvers |= {"pull_shape": self._pull_shape, "push_shape": self._push_shape}
        for name, solver in solvers.items():
            state |= {f"{name}_{i}": a for i, a in enumerate(solver.memory())}
        return state

    def finite(self) -> bool:
        """Whether everything that iterations build on is finite. Waits for the device."""
        self._not_finite.zero_()
        self._check.run()
        return not self._not_finite.numpy()[0]

    def keep(self) -> None:
        """Remember this state, on the device, in place of an earlier one."""
        for name, array in self._state().items():
            if name not in self._kept:
                self._kept[name] = wp.empty_like(array)
            wp.copy(self._kept[name], array)
        self._kept_done = self.done

    def go_back(self) -> None:
        """Undo all iterations since ``keep``."""
        for name, array in self._state().items():
            wp.copy(array, self._kept[name])
        self.done = self._kept_done
        self.objective.forget()

    def slow_down(self, scale: float) -> None:
        """From now on learning rates are ``scale`` times the configured ones."""
        self.rate_scale = scale
        for array, rate in zip((self._rate, self._shape_rate), self._rates, strict=True):
            array.assign((scale * rate).astype(np.float32))

    def kept(self) -> dict[str, np.ndarray]:
        """The state remembered, by name; valid until the next ``keep``."""
        return {name: array.numpy() for name, array in self._kept.items()}

    def restore(self, state: dict[str, np.ndarray], rate_scale: float) -> None:
        """Go on from what ``kept`` gave in another run on the same problem; remembers it, too.

        Raises:
            ValueError: the arrays are not those of this problem.
        """
        mine = self._state()
        shapes = {name: a.numpy().shape for name, a in mine.items()}
        if shapes != {name: a.shape for name, a in state.items()}:
            raise ValueError("expected the state of the same problem")
        for name, array in mine.items():
            array.assign(state[name])
        self.done = int(state["step"][0])
        self.slow_down(rate_scale)
        self.keep()

    def step(self) -> None:
        """One iteration; on CUDA it returns before the device is done."""
        (self._warmup if self.done < self.config.warmup else self._full).run()
        self.done += 1

    def look(self) -> dict[str, float]:
        """Losses of the last iteration; notes what the solves did. Waits for the device."""
        for solver in (self._pull_grid, self._push_grid, self._pull_shape, self._push_shape):
            solver.look(self.solves)
        return self.objective.losses()

    def finish(self) -> None:
        """Move ``objective.vertices`` to where the parameters, as they are now, put them."""
        self._place_template()
        self.objective.move_all()

    def vertices(self) -> np.ndarray:
        """Vertices of all frames for the parameters as they are now, (T, V, 3) float32, cube units, template order."""
        self.finish()
        return self.objective.placed_vertices()

    # Tasks.

    def _advance(self) -> None:
        c = self.config
        advance(self.iterations, c.decay == "cosine", c.beta1, c.beta2, self._step, self._schedule)
        self._place_template()

    def _place_template(self) -> None:
        copy_vectors(self._shape, self.objective.vertices[self.problem.transitions.keyframe])

    def _descend(self, first: int, last: int) -> None:
        """Adam on the grids of transitions ``first .. last``; then their gradient is cleared for the next iteration."""
        nodes = self.problem.levels.node_count
        begin, count = first * nodes, (last - first) * nodes
        c = self.config
        state = [a.flatten() for a in (self._adj_u, self._first, self._second, self._u)]
        adam(begin, count, self._rate, self._schedule, (c.beta1, c.beta2), c.epsilon, *state)
        clear_nodes(begin, count, self._adj_nodes.flatten())

    def _descend_shape(self) -> None:
        c = self.config
        state = [self._adj_shape_u, self._shape_first, self._shape_second, self._shape_u]
        betas = (c.beta1, c.beta2)
        adam(0, self.problem.vertex_count, self._shape_rate, self._schedule, betas, c.epsilon, *state)

    def _gather_shape(self, warmup: bool) -> None:
        o, key = self.objective, self.problem.transitions.keyframe
        follow = self.problem.config.loss.template_follows_all and not warmup
        template_gradient(key, follow, o.sums.weighed, o.sums.plain, o.chain.carry, self._adj_shape)

    # Phases.

    def _phases(self, warmup: bool) -> list[Phase]:
        o = self.objective
        gather = partial(self._gather_shape, warmup)
        grid = [] if warmup else [o.chain.scatter]
        pull = partial(self._pull_grid.solve, self._adj_nodes, self._adj_u)
        push = partial(self._push_grid.solve, self._u, self.nodes)
        pull_shape = partial(self._pull_shape.solve, self._adj_shape, self._adj_shape_u, 0, 1)
        push_shape = partial(self._push_shape.solve, self._shape_u, self._shape, 0, 1)
        spans = self.problem.transition_spans()

        def each(*calls: Callable[[int, int], None]) -> list[Task]:
            return [partial(_span_in_turn, calls, a, b) for a, b in spans]

        if not self._pull_grid.direct:
            shape = _in_turn([gather, pull_shape, self._descend_shape, push_shape])
            last = [Phase("descend", [shape, *each(*grid, pull, self._descend, push)])]
        else:
            everything = (0, len(self.problem.transitions))
            last = [
                Phase("gather", [gather, *each(*grid)]),
                Phase("pull solves", [partial(pull, *everything), pull_shape], direct=True),
                Phase("descend", [self._descend_shape, *each(self._descend)]),
                Phase("push solves", [partial(push, *everything), push_shape], direct=True),
            ]
        return [Phase("advance", [self._advance]), *o.phases(warmup), *last]


def _in_turn(calls: list[Callable[[], None]]) -> Callable[[], None]:
    def run() -> None:
        for call in calls:
            call()

    return run


def _span_in_turn(calls: Sequence[Callable[[int, int], None]], first: int, last: int) -> None:
    for call in calls:
        call(first, last)


def _unsolve(problem: Problem) -> np.ndarray:
    """u = (I + lambda L) x of the template, float32."""
    graph, x = problem.mesh, problem.template
    degree = np.diff(graph.row)
    around = np.zeros_like(x)
    np.add.at(around, np.repeat(np.arange(len(x)), degree), x[graph.column])
    return (x + problem.template_lambda * (degree[:, None] * x - around)).astype(np.float32)
