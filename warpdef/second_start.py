"""A second start for steps that settled on wrong neighbours (beyond the paper).

A limb that moves by more than the gap to its fellow finds the wrong one, and no descent leaves that minimum. Such a
step shows after warm-up: its input term stands out among the others. It is then fitted again from the motion of the
step before it, and from that of the step after it, as if the velocity had not changed; the best of the three stays.
"""

from __future__ import annotations

from functools import partial

import numpy as np
import warp as wp

from warpdef.kernels.chamfer import moving_to_fixed
from warpdef.kernels.motion import adj_move_points, move_points
from warpdef.kernels.schedule import SCHEDULE_SIZE, clear_losses
from warpdef.optimise import Optimiser
from warpdef.workers import Iteration, Phase, Team

_FOLLOW_ITERATIONS = 40  # towards the guessed motion
_FIT_ITERATIONS = 60  # then to the clouds
_BETTER = 0.9  # a new start must lower the loss to this share of the old one


class SecondStart:
    """Tries again where the input term stands out.

    Args:
        optimiser: warm-up done. team: CPU threads.
    """

    def __init__(self, optimiser: Optimiser, team: Team) -> None:
        self.optimiser, self._team = optimiser, team
        problem = self._problem = optimiser.problem
        self._step = wp.zeros(1, dtype=wp.int32, device=problem.device)
        self._schedule = wp.zeros(SCHEDULE_SIZE, dtype=wp.float32, device=problem.device)
        self._goal = wp.zeros_like(problem.origin)
        self._self = problem.integers(np.arange(len(problem.origin)))
        self._ones = problem.numbers(np.ones(len(problem.transitions)))
        self._unused = wp.zeros(len(problem.transitions), dtype=wp.float64, device=problem.device)

    def run(self) -> list[int]:
        """Fit outstanding steps again; returns those that got better by it."""
        before = self._losses()
        bad = np.flatnonzero(before > self._problem.config.optimiser.second_start * np.median(before))
        if len(bad) == 0:
            return []
        best, state, improved = before.copy(), self._save(), set()
        for neighbour in (-1, 1):
            tried = [int(s) for s in bad if 0 <= s + neighbour < len(before)]
            if not tried:
                continue
            # Neighbours lend the motion that they have by now: a repaired one lends its new motion.
            self._guess(tried, neighbour)
            self._forget(tried)
            self._descend(tried, self._follow, _FOLLOW_ITERATIONS)
            self._descend(tried, self.optimiser.objective.input_term, _FIT_ITERATIONS)
            after = self._losses()
            keep = [s for s in tried if after[s] < _BETTER * best[s]]
            best[keep] = after[keep]
            improved.update(keep)
            state = self._merge(state, keep)
        return sorted(improved)

    def _losses(self) -> np.ndarray:
        """Input term of every step, a pair."""
        p, objective = self._problem, self.optimiser.objective
        objective.measure_input()
        pairs = p.moved_sizes + p.cloud_sizes[p.transitions.target]
        scale = 1.0 if p.config.loss.reduction == "sum" else 0.5 * pairs
        return objective.loss_input.numpy() * scale / pairs

    def _guess(self, steps: list[int], neighbour: int) -> None:
        """Where the points of each step would go with the velocity of the step before (-1) or after (1) it."""
        from scipy.spatial import cKDTree

        p = self._problem
        origin, moved, goal = p.origin.numpy(), self.optimiser.objective.moved.numpy(), self._goal.numpy()
        ahead = p.transitions.source < p.transitions.target
        for s in steps:
            other = slice(*p.moved_first[[s + neighbour, s + neighbour + 1]])
            early, late = (origin[other], moved[other]) if ahead[s + neighbour] else (moved[other], origin[other])
            velocity = late - early
            # Places and velocities at frame s if lent from before, at frame s + 1 if from after; taken to the source.
            place = late if neighbour < 0 else early
            frame = s if neighbour < 0 else s + 1
            place = place + (p.transitions.source[s] - frame) * velocity
            own = slice(*p.moved_first[[s, s + 1]])
            nearest = cKDTree(place).query(origin[own])[1]
            goal[own] = origin[own] + (1.0 if ahead[s] else -1.0) * velocity[nearest]
        self._goal.assign(goal)

    def _follow(self, first: int, last: int) -> None:
        """Loss and gradient of the squared distance to the guessed places."""
        p, o = self._problem, self.optimiser.objective
        begin, count = int(p.moved_first[first]), int(p.moved_first[last] - p.moved_first[first])
        clear_losses(first, last - first, self._unused)
        move_points(begin, count, o.nodes, o.levels, p.origin, p.moved_transition, o.moved_rotation, o.moved)
        plain = (0.0, 2, 1.0)
        moving_to_fixed(
            begin, count, o.moved, p.moved_transition, self._self, self._goal, self._goal,
            self._ones, self._ones, plain, self._unused, o.adj_moved,
        )  # fmt: skip
        adj_move_points(begin, count, o.levels, p.origin, p.moved_transition, o.moved_rotation, o.adj_moved, o.adj_nodes)

    def _descend(self, steps: list[int], term, iterations: int) -> None:
        optimiser = self.optimiser
        self._step.zero_()
        schedule = partial(optimiser.advance, iterations, self._step, self._schedule)
        tasks = [partial(self._one, term, s) for s in steps]
        iteration = Iteration([Phase("advance", [schedule]), Phase("fit", tasks)], self._problem.device, self._team)
        for _ in range(iterations):
            iteration.run()

    def _one(self, term, s: int) -> None:
        term(s, s + 1)
        self.optimiser.descend_grids(s, s + 1, self._schedule)

    # State of the grids, all steps, on the host.

    def _save(self) -> list[np.ndarray]:
        return [array.numpy().copy() for array in self.optimiser.grid_state]

    def _forget(self, steps: list[int]) -> None:
        self._write(self._save(), [np.zeros_like(a) for a in self._save()], steps)

    def _merge(self, state: list[np.ndarray], keep: list[int]) -> list[np.ndarray]:
        """Keep the present rows of ``keep``, take all others back to ``state``; returns the new state."""
        return self._write(state, self._save(), keep)

    def _write(self, state: list[np.ndarray], rows_from: list[np.ndarray], steps: list[int]) -> list[np.ndarray]:
        for old, new, array in zip(state, rows_from, self.optimiser.grid_state, strict=True):
            old[steps] = new[steps]
            array.assign(old)
        self.optimiser.push_grids()
        return state
