"""Branches of a graph: what they leave open is what may run side by side, and nothing else."""

from __future__ import annotations

import pytest
from descent import chained
from launches import example_problem, small_grids
from logged_streams import LoggedStreams

from warpdef.device import Way, find_device, going
from warpdef.fit.branches import Branches
from warpdef.fit.optimise import Optimiser
from warpdef.fit.workers import Team

PHASES = [["a"], ["b", "c"], ["d", "e", "f"], ["g"], ["h", "i"]]


def test_tasks_of_a_phase_are_open_and_phases_in_order(monkeypatch: pytest.MonkeyPatch) -> None:
    streams = LoggedStreams()
    streams.stand_in(monkeypatch)
    branches = Branches(find_device("cpu"), [len(phase) for phase in PHASES])
    for number, phase in enumerate(PHASES):
        branches.run(number, [streams.task(name) for name in phase])
    earlier: set[str] = set()
    for phase in PHASES:
        for name in phase:
            assert streams.befores()[name] == earlier
        earlier |= set(phase)
    recorded = [event for _, what, event in streams.log if what == "record"]
    assert len(recorded) == len(set(recorded)) == 7  # a fork and its ends each


def test_on_one_branch_tasks_follow_one_another(monkeypatch: pytest.MonkeyPatch) -> None:
    streams = LoggedStreams()
    streams.stand_in(monkeypatch)
    branches = Branches(find_device("cpu"), [1, 1])
    for number, phase in enumerate((["a", "b"], ["c"])):
        branches.run(number, [streams.task(name) for name in phase])
    assert streams.log == [(0, "task", "a"), (0, "task", "b"), (0, "task", "c")]


def test_the_descent_with_vertices_has_two_branches() -> None:
    """Vertices beside clouds, edges beside nearest points, the template beside the grids: what threads share, too."""
    team = Team(1)
    with going(Way.WHOLE):
        optimiser = Optimiser(example_problem(chained(small_grids())), 3, team)
        widths = {p.name: len(p.tasks) for p in optimiser._phases(warmup=False)}
        guide = Optimiser(example_problem(small_grids()), 3, team)
    team.close()
    assert widths == {"advance": 1, "move": 2, "compare": 2, "trust": 1, "return": 1, "descend": 2}
    assert all(len(p.tasks) == 1 for p in guide._guide_phases())
