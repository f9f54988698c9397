"""Runs an iteration: phases one after the other, the tasks of a phase side by side.

On the CPU a Warp launch is one thread that releases the interpreter lock, so tasks (whole frames, ranges of vertices)
are recorded once and replayed by a fixed team of threads with a barrier between phases. No two tasks of a phase write
the same memory, and each task adds up in its own order: the result is the same bits for any number of threads.
On CUDA each phase is launched whole, and an iteration is captured as one graph, with the tasks of a phase as branches.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import warp as wp

from warpdef.device import Way, is_cuda, tell_once, way_of
from warpdef.fit.branches import Branches
from warpdef.kernels.launching import listing, recording

Task = Callable[[], None]


@dataclass
class Phase:
    """Tasks that may run at the same time. ``direct``: plain Python, run by the caller, never recorded."""

    name: str
    tasks: list[Task] = field(default_factory=list)
    direct: bool = False


class Command(Protocol):
    """What can be replayed, such as a recorded ``wp.Launch``."""

    def launch(self) -> None: ...


class Team:
    """Threads that replay recorded commands; the caller works along. Close it when done."""

    def __init__(self, size: int) -> None:
        self.size = size
        self._start = threading.Barrier(size)
        self._end = threading.Barrier(size)
        self._next: Iterator[Sequence[Command]] = iter(())
        self._failure: BaseException | None = None
        self._threads = [threading.Thread(target=self._serve, daemon=True) for _ in range(size - 1)]
        for thread in self._threads:
            thread.start()

    def run(self, work: Sequence[Sequence[Command]]) -> None:
        """Replay every command list once, in any order, each list by one thread; returns when all are done."""
        if not self._threads or len(work) == 1:
            for commands in work:
                for command in commands:
                    command.launch()
            return
        # One shared iterator hands out the lists: next() is atomic under the interpreter lock.
        self._next = iter(work)
        try:
            self._start.wait()
            self._drain()
            self._end.wait()
        except BaseException:
            # An interrupted wait leaves the barrier one short: the others must not wait for ever.
            self._end.abort()
            raise
        if self._failure is not None:
            failure, self._failure = self._failure, None
            raise failure

    def close(self) -> None:
        """End the threads."""
        self._start.abort()
        for thread in self._threads:
            thread.join()
        self._threads = []

    def _drain(self) -> None:
        try:
            for commands in self._next:
                for command in commands:
                    command.launch()
        except BaseException as failure:  # a worker's failure must reach the caller, and must not stop the barrier
            self._failure = failure

    def _serve(self) -> None:
        try:
            while True:
                self._start.wait()
                self._drain()
                self._end.wait()
        except threading.BrokenBarrierError:
            return  # closed


class Iteration:
    """One iteration, ready to run again and again.

    Args:
        phases: in order. device: where the arrays live. team: the threads (unused on CUDA).
        capture: on CUDA, capture all phases as one graph at the first run; phases with ``direct`` forbid it.
    """

    def __init__(self, phases: Sequence[Phase], device: wp.Device, team: Team, capture: bool = True) -> None:
        self._phases = list(phases)
        self._device = device
        self._team = team
        self._recorded: list[list[list[wp.Launch]] | None] | None = None
        self._graph: wp.Graph | None = None
        self._whole = way_of(device) is Way.WHOLE
        self._capture = capture and is_cuda(device) and not any(p.direct for p in phases)
        self._warm = False

    def kernels(self) -> list[wp.Kernel]:
        """Those that it launches, but for phases that run as they are."""
        with listing() as found:
            for phase in self._phases:
                for task in () if phase.direct else phase.tasks:
                    task()
        return found

    def prepare(self) -> list[list[list[wp.Launch]] | None]:
        """Where work goes in spans: record all commands, which compiles what they need."""
        if self._recorded is None:
            self._recorded = [None if phase.direct else _record(phase) for phase in self._phases]
        return self._recorded

    def run(self) -> None:
        """Run all phases once; returns before CUDA is done."""
        if self._whole:
            self._run_whole()
            return
        for phase, work in zip(self._phases, self.prepare(), strict=True):
            if work is None:
                for task in phase.tasks:
                    task()
            else:
                self._team.run(work)

    def _run_whole(self) -> None:
        # The first run is plain: modules load and scratch memory is allocated, neither of which can be captured.
        if self._capture and self._warm and self._graph is None:
            self._graph = self._captured()
            self._capture = self._graph is not None
        if self._graph is not None:
            wp.capture_launch(self._graph)
            return
        self._run_plain()
        self._warm = True

    def _run_plain(self) -> None:
        for phase in self._phases:
            for task in phase.tasks:
                task()

    def _captured(self) -> wp.Graph | None:
        """All phases as one graph, at best of branches; None where the device cannot, which is said: launches then go
        one by one."""
        why, wide = "", any(len(phase.tasks) > 1 for phase in self._phases)
        for branched in (True, False) if wide else (False,):
            try:
                branches = Branches(self._device, [len(phase.tasks) if branched else 1 for phase in self._phases])
                with wp.ScopedCapture(device=self._device) as captured:
                    for number, phase in enumerate(self._phases):
                        branches.run(number, phase.tasks)
                return captured.graph
            except RuntimeError as error:  # of Warp, or of CUDA by way of it
                why = " ".join(str(error).split())
        tell_once(
            f"iterations on {self._device.alias} are not captured as graphs ({why:.200}): every kernel is launched "
            "by itself, which gives the same result but takes longer"
        )
        return None


def _record(phase: Phase) -> list[list[wp.Launch]]:
    work = []
    for task in phase.tasks:
        with recording() as commands:
            task()
        work.append(commands)
    return work
