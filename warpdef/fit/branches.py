"""Tasks of a phase side by side on a CUDA device: branches of the graph that a capture makes of an iteration.

    main    ... before | fork | first task                  | join | after ...
    beside                  \\ second task, on its own stream /

Streams are told apart by events, which a capture turns into edges of its graph: the fork waits for all that came
before, what follows for all tasks. Tasks of a phase write apart, as they do for threads on the CPU.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import warp as wp


class Branches:
    """Streams and events for phases of so many tasks; made before a capture, in which nothing is to be made.

    Args:
        device: whose current stream is the main one. phases: branches of each phase, in order; one: its tasks follow
            one another.
    """

    def __init__(self, device: wp.Device, phases: Sequence[int]) -> None:
        self._device = device
        self._streams = [wp.Stream(device) for _ in range(max(phases, default=1) - 1)]
        # An event of its own for every fork and end: none is recorded twice in a graph.
        self._events = [[wp.Event(device) for _ in range(count)] if count > 1 else [] for count in phases]

    def run(self, phase: int, tasks: Sequence[Callable[[], None]]) -> None:
        """All tasks of a phase, on as many branches; the main stream then waits for all of them."""
        if len(self._events[phase]) < 2:
            for task in tasks:
                task()
            return
        main, (fork, *ends) = wp.get_stream(self._device), self._events[phase]
        main.record_event(fork)
        beside = list(zip(self._streams[: len(ends)], ends, tasks[1:], strict=True))
        for stream, end, task in beside:
            stream.wait_event(fork)
            with wp.ScopedStream(stream, sync_enter=False):
                task()
            stream.record_event(end)
        tasks[0]()
        for _, end, _ in beside:
            main.wait_event(end)
