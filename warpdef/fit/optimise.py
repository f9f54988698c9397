"""The descent on grids and template: preconditioned Adam (paper, sec. Spatial Smoothness, Implementation Details).

Grids and template start from x = 0 and the mesh, u = (I + lambda L) x.

As a guide, cloud to cloud, a transition is left alone once it has arrived: when its loss is about what two samplings of
one surface leave. Clouds that are noisy or show only part of a surface leave more, and take all iterations.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import warp as wp

from warpdef.device import Way, frame_of, load_kernels
from warpdef.fit.objective import Objective
from warpdef.fit.parameters import Parameters
from warpdef.fit.problem import Problem
from warpdef.fit.sobolev import Solver, SolveReport, grid_solver, solver_name, template_solvers
from warpdef.fit.workers import Iteration, Phase, Task, Team
from warpdef.kernels.finite import flag_not_finite
from warpdef.kernels.launching import listing
from warpdef.kernels.levels import node8
from warpdef.kernels.motion import template_gradient
from warpdef.kernels.schedule import SCHEDULE_SIZE, advance
from warpdef.kernels.vectors import copy_vectors

_ARRIVED = 1.9  # times the loss that two samplings of one surface leave; no transition stays above it once it fits
_FIRST_LOOK = 40  # iterations before which rates are too high to stop at
_SOLVES = ("grid_gradient", "grid_value", "shape_gradient", "shape_value")  # whose last solutions are state
_COUNTS = ("iteration", "moving", "loss")  # of the state, what is no parameter


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
        device, config = problem.device, problem.config
        self._iteration = wp.zeros(1, dtype=wp.int32, device=device)
        self._schedule = wp.zeros(SCHEDULE_SIZE, dtype=wp.float32, device=device)
        grid_rates, shape_rates = _rates(problem)
        # Two of each: a conjugate-gradient solver starts from its own last solution.
        on_grids = [grid_solver(config, problem.levels, problem.kept, device) for _ in range(2)]
        how = (self.config, self._schedule)
        shape, count = (len(problem.transitions), problem.levels.node_count), problem.vertex_count
        self.grids = Parameters(problem.pool, "grids", node8, shape, grid_rates, (on_grids[0], on_grids[1]), *how)
        on_shape = template_solvers(config, problem.mesh, device)
        self.shape = Parameters(problem.pool, "shape", wp.vec3, (count,), shape_rates, on_shape, *how)
        # The template apart from the keyframe's row of vertices, which other tasks read while it changes.
        self.shape.x.assign(problem.template.astype(np.float32))
        self.shape.u.assign(_unsolve(problem))
        self.objective = Objective(problem, self.grids.x, self.grids.adj_x, self._schedule)
        self.rate_scale = 1.0
        self.solves = SolveReport(solver_name(problem.config))
        # Which transitions still move: part of the state, hence on the device, and what is known of it here.
        self._moving = problem.integers(np.ones(len(problem.transitions)))
        self._guides = self._moving.numpy().astype(bool)
        self._not_finite = wp.zeros(1, dtype=wp.int32, device=device)
        self._kept: dict[str, wp.array] = {}
        self._kept_done = 0
        checks = [
            partial(flag_not_finite, a, self._not_finite) for name, a in self._state().items() if name not in _COUNTS
        ]
        self._check = Iteration([Phase("check", checks)], device, team, capture=False)
        self._warmup = Iteration(self._phases(warmup=True), device, team, capture)
        self._full = Iteration(self._phases(warmup=False), device, team, capture)
        self._fewer: Iteration | None = None  # of the transitions that still move, where some do not
        self._how = device, team, capture

    def kernels(self) -> list[wp.Kernel]:
        """All that iterations, looks and ``finish`` launch."""
        with listing() as last:
            self.finish()
        return [*last, *(kernel for i in (self._check, self._warmup, self._full) for kernel in i.kernels())]

    def prepare(self) -> None:
        """Compile every kernel, so that the first iteration costs what the others do."""
        load_kernels(self.kernels(), self.problem.device)
        self.finite()
        if self.problem.way is Way.SPANS:
            self._warmup.prepare()
            self._full.prepare()

    @property
    def nodes(self) -> wp.array:
        """The deformation grids, shape (S, M) node8."""
        return self.grids.x

    # State: what an iteration leaves for the next. Searches remember more, but only to be quick: they are exact.

    def _state(self) -> dict[str, wp.array]:
        g, s = self.grids, self.shape
        state = {"iteration": self._iteration, "u": g.u, "nodes": g.x, "shape_u": s.u, "shape": s.x}
        state |= {"first_moment": g.first_moment, "second_moment": g.second_moment}
        state |= {"shape_first_moment": s.first_moment, "shape_second_moment": s.second_moment}
        if not self.config.chain:
            state |= {"moving": self._moving, "loss": self.objective.input.loss}
        for name, solver in zip(_SOLVES, self._solvers(), strict=True):
            state |= {f"{name}_{i}": a for i, a in enumerate(solver.memory())}
        return state

    def _solvers(self) -> list[Solver]:
        return [solver for p in (self.grids, self.shape) for solver in (p.gradient_solver, p.value_solver)]

    def finite(self) -> bool:
        """Whether everything that iterations build on is finite. Waits for the device."""
        self._not_finite.zero_()
        self._check.run()
        return not self._not_finite.numpy()[0]

    def keep(self) -> None:
        """Remember this state, on the device, in place of an earlier one."""
        for name, array in self._state().items():
            if self._kept.get(name, array) is array:
                self._kept[name] = wp.empty_like(array)
            wp.copy(self._kept[name], array)
        self._kept_done = self.done

    def go_back(self) -> None:
        """Undo all iterations since ``keep``."""
        for name, array in self._state().items():
            wp.copy(array, self._kept[name])
        self.done = self._kept_done
        self._read_moving()
        self.objective.forget()

    def slow_down(self, scale: float) -> None:
        """From now on learning rates are ``scale`` times the configured ones."""
        self.rate_scale = scale
        self.grids.slow_down(scale)
        self.shape.slow_down(scale)

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
        self.done = int(state["iteration"][0])
        self._read_moving()
        self.slow_down(rate_scale)
        self.keep()

    def iterate(self) -> None:
        """One iteration; on CUDA it returns before the device is done."""
        (self._fewer or (self._warmup if self.done < self.config.warmup else self._full)).run()
        self.done += 1

    @property
    def ended(self) -> bool:
        """Whether all iterations are done, or no transition moves any more."""
        return self.done >= self.iterations or not self._guides.any()

    def look(self) -> dict[str, float]:
        """Losses of the last iteration; notes what the solves did, and which transitions arrived. Waits for the device.

        A transition that arrived keeps the loss that it had then.
        """
        for solver in self._solvers() if self.config.chain else self._solvers()[:2]:  # a guide's template stays
            solver.look(self.solves)
        if not self.config.chain and self.done >= _FIRST_LOOK:
            self._moving.assign((self._guides & ~self.objective.input.arrived(_ARRIVED)).astype(np.int32))
            self._read_moving()
        return self.objective.losses()

    def _read_moving(self) -> None:
        """Go on with the transitions that the state says."""
        moving = self._moving.numpy().astype(bool)
        if (moving != self._guides).any():
            self._guides, self._fewer = moving, None
            if moving.any() and not moving.all() and self.problem.way is Way.SPANS:
                self._fewer = Iteration(self._guide_phases(), *self._how)

    def finish(self) -> None:
        """Move ``objective.vertices`` to where the parameters, as they are now, put them."""
        self._place_template()
        self.objective.move_all()

    def rest(self) -> None:
        """No iteration follows, or only after ``restore``: what is remembered is the state itself, not a copy of it."""
        if self._kept and self._kept_done == self.done:
            self._kept = self._state()

    def vertices(self) -> np.ndarray:
        """Vertices of all frames for the parameters as they are now, (T, V, 3) float32, cube units, template order."""
        self.finish()
        return self.objective.placed_vertices()

    # Tasks.

    def _advance(self) -> None:
        c = self.config
        advance(self.iterations, c.decay == "cosine", c.beta1, c.beta2, self._iteration, self._schedule)
        self._place_template()

    def _place_template(self) -> None:
        copy_vectors(self.shape.x, frame_of(self.objective.vertices, self.problem.transitions.keyframe))

    def _gather_shape(self, warmup: bool) -> None:
        o, key = self.objective, self.problem.transitions.keyframe
        follow = self.problem.config.loss.template_follows_all and not warmup
        template_gradient(key, follow, o.sums.weighed, o.sums.plain, o.chain.carry, self.shape.adj_x)

    # Phases.

    def _guide_phases(self) -> list[Phase]:
        """Grids alone, of transitions that still move: no vertex is moved, and the template stays as it is."""
        grids, everything = self.grids, (0, len(self.problem.transitions))
        spans = [span for span in self.problem.transition_spans() if self._guides[slice(*span)].any()]
        if not grids.direct:
            last = [Phase("descend", [partial(grids.step, a, b, self._moving) for a, b in spans])]
        else:
            last = [
                Phase("gradient solves", [partial(grids.solve_gradient, *everything)], direct=True),
                Phase("descend", [partial(grids.descend_grids, a, b) for a, b in spans]),
                Phase("value solves", [partial(grids.solve_values, *everything)], direct=True),
            ]
        return [Phase("advance", [self._advance]), *self.objective.phases(warmup=True, guided=spans), *last]

    def _phases(self, warmup: bool) -> list[Phase]:
        if not self.config.chain:
            return self._guide_phases()
        o, grids, shape, spans = self.objective, self.grids, self.shape, self.problem.transition_spans()
        gather = partial(self._gather_shape, warmup)
        scatter = [] if warmup else [o.chain.scatter]
        of_shape = [partial(shape.solve_gradient, 0, 1), partial(shape.descend, 0, self.problem.vertex_count)]
        place_shape = partial(shape.solve_values, 0, 1)

        def each(*calls: Callable[[int, int], None]) -> list[Task]:
            return [partial(_span_in_turn, calls, a, b) for a, b in spans]

        if not grids.direct:
            on_grids = each(*scatter, grids.step)
            last = [Phase("descend", [_in_turn([gather, *of_shape, place_shape]), *on_grids])]
        else:
            everything = (0, len(self.problem.transitions))
            last = [
                Phase("gather", [gather, *each(*scatter)]),
                Phase("gradient solves", [partial(grids.solve_gradient, *everything), of_shape[0]], direct=True),
                Phase("descend", [of_shape[1], *each(grids.descend_grids)]),
                Phase("value solves", [partial(grids.solve_values, *everything), place_shape], direct=True),
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


def _rates(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Learning rates of a transition's nodes, coarsest level first, (M,), and of the template, (1,)."""
    config, grid, sobolev = problem.config.optimiser, problem.config.grid, problem.config.sobolev
    factor = 1.0 if sobolev.enabled else sobolev.unpreconditioned_rate
    by_level = config.rate * config.rate_growth ** np.arange(grid.coarsest - 1, grid.levels)
    # What a keyframe does not show of a template given is known from the template alone: it stays.
    shape_rate = config.template_rate if problem.measures.complete[problem.transitions.keyframe] else 0.0
    return factor * by_level[problem.levels.node_level()], np.array([factor * shape_rate])


def _unsolve(problem: Problem) -> np.ndarray:
    """u = (I + lambda L) x of the template, float32."""
    graph, x = problem.mesh, problem.template
    degree = np.diff(graph.row)
    around = np.zeros_like(x)
    np.add.at(around, np.repeat(np.arange(len(x)), degree), x[graph.column])
    return (x + problem.template_lambda * (degree[:, None] * x - around)).astype(np.float32)
