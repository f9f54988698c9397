"""How often a fit waits for a device, and what stands around its iterations and rounds: bounds that only go down.

What the host reads it waits for, so that nothing is queued behind. Counted the way of CUDA, on the CPU; launches that
are replayed as one graph there count one by one.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from launches import FRAMES, Counted, count_rounds, counting, example_problem, noisy_problem, small_grids

from warpdef.device import Way, going
from warpdef.fit.follow import follow
from warpdef.fit.optimise import Optimiser
from warpdef.fit.problem import Problem
from warpdef.fit.refine import Refinement
from warpdef.fit.run import LOOK_EVERY, FitRun
from warpdef.fit.workers import Team
from warpdef.progress import Clock, Interruption, Limits

CAMERA = np.array([0.0, 0.0, 5.0])
KINDS: dict[str, tuple[Callable[[], Problem], tuple[int, int, int]]] = {
    "whole": (lambda: example_problem(small_grids()), (14, 23, 30)),
    "one frame in part": (lambda: example_problem(small_grids(), partial=True), (16, 25, 32)),
    "one camera": (lambda: example_problem(small_grids(), eye=CAMERA), (15, 18, 24)),
    "wide noise": (lambda: noisy_problem(small_grids()), (12, 34, 41)),
}
"""Problems, and launches of a frame settled by one round, of a round, and of one that smooths in time."""
FOLLOWED = {"whole": (133, 11, 54), "one camera": (103, 7, 23)}
"""Of a frame followed with all its rounds: launches, what is read, allocations."""


@pytest.mark.parametrize("kind", KINDS)
def test_rounds_of_every_kind_stay_within_bounds_and_wait_for_nothing(kind: str) -> None:
    make, bounds = KINDS[kind]
    with going(Way.WHOLE), closing(Team(1)) as team:
        problem = make()
        assert problem.measures.complete.all() == (kind in ("whole", "wide noise"))
        counts = count_rounds(problem, team)
    for (name, counted), most in zip(counts.items(), bounds, strict=True):
        assert counted.total <= most, (name, counted.launches)
        assert (counted.allocations, counted.reads, counted.writes) == (0, 0, 0), name


def run(iterations: int, rounds: int) -> tuple[Counted, Counted]:
    """Both stages of a fit from beginning to end, no frame followed."""
    config = small_grids()
    config = replace(config, refine=replace(config.refine, iterations=rounds, follow=0))
    saver: Any = SimpleNamespace(due=lambda: False, end=lambda: None)
    with going(Way.WHOLE), closing(Team(1)) as team:
        # A transition that shows a part does not arrive before its time.
        optimiser = Optimiser(example_problem(config, partial=True), iterations, team)
        refinement = Refinement(optimiser.objective, team)
        limits = Limits(Interruption(), Clock())
        fit = FitRun(optimiser, refinement, 1, limits, saver, lambda progress: None)
        with counting() as descent:
            fit.descend()
        with counting() as rounds_of:
            fit.refine()
    assert (optimiser.done, refinement.done) == (iterations, rounds)
    return descent, rounds_of


def test_what_stands_around_iterations_and_rounds() -> None:
    """A look and a copy every ten iterations; after a round a look, a check, and a copy to go back to."""
    few, more = run(5 * LOOK_EVERY, 10), run(6 * LOOK_EVERY, 11)
    (iterations, rounds) = zip(few, more, strict=True)
    for (a, b), (launches, reads, writes) in ((iterations, (12 * LOOK_EVERY + 25, 5, 1)), (rounds, (34, 5, 0))):
        assert 10 < b.total - a.total <= launches, b.launches - a.launches
        assert 0 < b.reads - a.reads <= reads and b.writes - a.writes <= writes
        assert b.allocations == a.allocations


@pytest.mark.parametrize("kind", FOLLOWED)
def test_a_frame_followed_waits_a_few_times(kind: str) -> None:
    """Where its vertices went is measured on the host, and decides what is tried."""
    with going(Way.WHOLE), closing(Team(1)) as team:
        problem = KINDS[kind][0]()
        optimiser = Optimiser(problem, 9, team)
        optimiser.finish()
        refinement = Refinement(optimiser.objective, team)
        refinement.prepare()
        starts = None if kind == "whole" else np.tile(problem.template[problem.place], (FRAMES, 1, 1))
        with counting() as counted:
            followed, bent = follow(optimiser.objective, refinement, starts=starts)
    assert len(followed) == FRAMES - 1 and not bent
    launches, reads, allocations = (n * len(followed) for n in FOLLOWED[kind])
    assert counted.total <= launches and counted.reads <= reads and counted.allocations <= allocations, counted
