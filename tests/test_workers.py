"""Tasks are recorded once, replayed by a team of threads with a barrier between phases, and fail loudly."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
import warp as wp

from warpdef import device as device_module
from warpdef.device import Way, device_warnings, going, usable_cores
from warpdef.fit import workers
from warpdef.fit.workers import Iteration, Phase, Team
from warpdef.kernels.levels import node8
from warpdef.kernels.schedule import advance
from warpdef.kernels.vectors import clear_losses


class CountedTask:
    """Stands in for a recorded launch."""

    def __init__(self, seen: list[int], number: int, error: Exception | None = None) -> None:
        self._seen, self._number, self._error = seen, number, error

    def launch(self) -> None:
        if self._error is not None:
            raise self._error
        self._seen.append(self._number)


@pytest.fixture(params=[1, 2, 3])
def team(request: pytest.FixtureRequest):
    team = Team(request.param)
    yield team
    team.close()


def test_every_list_runs_once_and_in_its_own_order(team: Team) -> None:
    seen: list[int] = []
    work = [[CountedTask(seen, 10 * task + k) for k in range(3)] for task in range(7)]
    for _ in range(20):
        seen.clear()
        team.run(work)
        assert sorted(seen) == sorted(10 * task + k for task in range(7) for k in range(3))
        for task in range(7):
            own = [n for n in seen if n // 10 == task]
            assert own == sorted(own)


def test_no_work_is_no_trouble(team: Team) -> None:
    team.run([])
    team.run([[]])


def test_several_threads_take_part() -> None:
    meeting = threading.Barrier(3, timeout=20)

    class Meets:
        def launch(self) -> None:
            meeting.wait()

    team = Team(3)
    team.run([[Meets()] for _ in range(3)])  # would time out if fewer than three were at it
    team.close()


def test_a_failure_reaches_the_caller_and_the_team_goes_on(team: Team) -> None:
    seen: list[int] = []
    work = [[CountedTask(seen, 1)], [CountedTask(seen, 2, ArithmeticError("a launch failed"))], [CountedTask(seen, 3)]]
    with pytest.raises(ArithmeticError, match="a launch failed"):
        team.run(work)
    seen.clear()
    team.run([[CountedTask(seen, n)] for n in range(4)])
    assert sorted(seen) == [0, 1, 2, 3]


def test_closing_ends_the_threads_and_may_be_repeated() -> None:
    before = threading.active_count()
    team = Team(3)
    assert (team.size, threading.active_count()) == (3, before + 2)
    team.close()
    team.close()
    assert threading.active_count() == before


def test_an_interrupt_while_waiting_does_not_hang_the_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C in the caller's wait leaves a barrier one short; closing must still end the threads."""
    team, main, started = Team(3), threading.current_thread(), threading.Event()
    wait = team._end.wait

    def interrupted() -> int:
        if threading.current_thread() is main:
            started.wait(5)
            raise KeyboardInterrupt
        started.set()
        return wait()

    monkeypatch.setattr(team._end, "wait", interrupted)
    with pytest.raises(KeyboardInterrupt):
        team.run([[], [], []])
    closing = threading.Thread(target=team.close, daemon=True)
    closing.start()
    closing.join(10)
    assert not closing.is_alive()


def test_an_iteration_records_once_and_runs_again(device: str) -> None:
    """The tasks are called once; what they launched runs at every iteration."""
    step = wp.zeros(1, dtype=wp.int32, device=device)
    schedule = wp.zeros(4, dtype=wp.float32, device=device)
    losses = wp.full(4, 1.0, dtype=wp.float64, device=device)
    called, direct = [], []

    def forward() -> None:
        called.append("forward")
        advance(10, False, 0.9, 0.999, step, schedule)

    phases = [
        Phase("advance", [forward]),
        Phase("clear", [partial(clear_losses, 0, 2, losses), partial(clear_losses, 2, 2, losses)]),
        Phase("look", [lambda: direct.append(int(step.numpy()[0]))], direct=True),
    ]
    team = Team(2)
    iteration = Iteration(phases, wp.get_device(device), team)
    if device == "cpu":
        iteration.prepare()
        assert step.numpy()[0] == 0 and called == ["forward"] and direct == []
    for _ in range(3):
        losses.fill_(1.0)
        iteration.run()
        np.testing.assert_array_equal(losses.numpy(), 0)
    team.close()
    assert direct == [1, 2, 3]
    assert len(called) == (1 if device == "cpu" else 3)


def test_a_captured_graph_does_what_plain_launches_do() -> None:
    """CUDA: the first run is plain, the second captures, later ones replay."""
    if not wp.is_cuda_available():
        pytest.skip("no CUDA device")
    found = []
    for capture in (False, True):
        step = wp.zeros(1, dtype=wp.int32, device="cuda:0")
        schedule = wp.zeros(4, dtype=wp.float32, device="cuda:0")
        phases = [Phase("advance", [partial(advance, 10, True, 0.9, 0.999, step, schedule)])]
        iteration = Iteration(phases, wp.get_device("cuda:0"), Team(1), capture)
        for _ in range(5):
            iteration.run()
        found.append((int(step.numpy()[0]), schedule.numpy().tolist()))
    assert found[0] == found[1] and found[0][0] == 5


def advanced(runs: int, before: Callable[[], None] = lambda: None) -> tuple[int, int]:
    """Steps counted by a kernel after so many runs of an iteration the CUDA way, and how often its task was called."""
    step, called = wp.zeros(1, dtype=wp.int32, device="cpu"), []
    schedule = wp.zeros(4, dtype=wp.float32, device="cpu")

    def task() -> None:
        called.append(1)
        before()
        advance(10, True, 0.9, 0.999, step, schedule)

    with going(Way.WHOLE):
        iteration = Iteration([Phase("advance", [task])], wp.get_device("cpu"), Team(1))
        for _ in range(runs):
            iteration.run()
    return int(step.numpy()[0]), len(called)


def test_an_iteration_is_captured_once_and_replayed(monkeypatch: pytest.MonkeyPatch) -> None:
    """On the CPU, whose launches Warp captures as well."""
    monkeypatch.setattr(workers, "is_cuda", lambda device: True)
    assert advanced(5) == (5, 2)


@pytest.mark.parametrize("where", ["begin", "end", "inside"])
def test_without_graphs_launches_go_one_by_one(where: str, monkeypatch, caplog: pytest.LogCaptureFixture) -> None:
    """A device that cannot capture, or not this: the same steps, said once, and not tried at every iteration."""
    monkeypatch.setattr(workers, "is_cuda", lambda device: True)
    monkeypatch.setattr(device_module, "_told", [])
    tried, capturing = [], []

    class NoCapture:
        def __init__(self, device: wp.Device) -> None:
            tried.append(device)

        def __enter__(self) -> None:
            if where == "begin":
                raise RuntimeError("no memory\n pool")
            capturing.append(1)

        def __exit__(self, kind: type | None, *_) -> None:
            capturing.clear()
            if where == "end" and kind is None:
                raise RuntimeError("no memory pool")

    def refuse() -> None:
        if capturing and where == "inside":
            raise RuntimeError("no memory pool")

    monkeypatch.setattr(wp, "ScopedCapture", NoCapture)
    steps, _ = advanced(4, refuse)
    # The fake does not keep launches from running while it captures.
    assert steps == 4 + (where == "end") and len(tried) == 1
    (warning,) = device_warnings()
    assert "no memory pool" in warning and warning in caplog.text


def test_there_is_a_core() -> None:
    assert usable_cores() >= 1


def test_a_recorded_solver_keeps_its_arrays_alive() -> None:
    """A recorded launch is replayed long after the call that made it."""
    values = wp.full(6, node8(*[1.0] * 8), dtype=node8, device="cpu")
    from warpdef.kernels.vectors import clear_nodes

    team = Team(1)
    iteration = Iteration([Phase("clear", [lambda: clear_nodes(0, 6, values.flatten())])], wp.get_device("cpu"), team)
    for _ in range(2):
        values.fill_(node8(*[1.0] * 8))
        iteration.run()
        np.testing.assert_array_equal(values.numpy(), 0)
