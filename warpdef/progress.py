"""What a running reconstruction tells its caller, and when it lets itself be interrupted."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from warpdef.mesh import MeshSequence


@dataclass(frozen=True)
class Progress:
    """One message of a running reconstruction.

    phase: "template", "compile", "optimise" or "refine". iteration: done so far, of iterations. losses: weighted terms.
    message: something worth saying aloud, or empty.
    meshes: returns the mesh as it is now, in input units, float32; only while the callback runs. Nothing is computed
    until it is called, and little then. None before there is a mesh, and in a second fit of sparse frames, which has
    another.
    """

    phase: str
    iteration: int = 0
    iterations: int = 0
    losses: dict[str, float] = field(default_factory=dict)
    message: str = ""
    meshes: Callable[[], MeshSequence] | None = None


Callback = Callable[[Progress], None]


class Clock:
    """Seconds by phase; ``begun`` is when it was made, on the performance counter.

    cpu_seconds: processor time of all threads by phase, of this process alone: not of a run that this one goes on from.
    """

    def __init__(self, seconds: Mapping[str, float] | None = None) -> None:
        self.begun = time.perf_counter()
        self.seconds: dict[str, float] = dict(seconds or {})
        self.cpu_seconds: dict[str, float] = {}
        self._running: tuple[str, float] | None = None

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """Add the time of the block to ``name``."""
        self._running, processor = (name, time.perf_counter()), time.process_time()
        try:
            yield
        finally:
            self.cpu_seconds[name] = self.cpu_seconds.get(name, 0.0) + time.process_time() - processor
            self.seconds = self.so_far()
            self._running = None

    def so_far(self) -> dict[str, float]:
        """Seconds by phase, the present one until now."""
        if self._running is None:
            return dict(self.seconds)
        name, start = self._running
        return {**self.seconds, name: self.seconds.get(name, 0.0) + time.perf_counter() - start}


ENDING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Signals that ask a run to end: Ctrl-C, a batch system's, and a closing terminal's."""


@dataclass
class Interruption:
    """Whether a run was asked to end since ``held_interrupts`` began, and by the signal of which name."""

    asked: bool = False
    signal: str = "SIGINT"


@dataclass(frozen=True)
class Limits:
    """When a run has to end early: by Ctrl-C or another signal, or ``seconds_max`` after its clock began."""

    interruption: Interruption
    clock: Clock
    seconds_max: float | None = None

    @property
    def seconds(self) -> float:
        """Since the clock began."""
        return time.perf_counter() - self.clock.begun

    def reason(self, reserve: float = 0.0) -> str:
        """Why to stop now, ``reserve`` seconds before the time is up; empty if there is no reason."""
        if self.interruption.asked:
            name = self.interruption.signal
            return "interrupted" if name == "SIGINT" else f"interrupted by {name}"
        if self.seconds_max is not None and self.seconds + reserve >= self.seconds_max:
            return f"time limit of {self.seconds_max:g} s"
        return ""


@contextmanager
def held_interrupts() -> Iterator[Interruption]:
    """Turn Ctrl-C into a flag for the block, so that no iteration is torn; a second one acts at once.

    SIGTERM and SIGHUP are held where the program has a handler of its own for them, as the command line has.
    Outside the main thread signals are not ours to hold: there the flag stays down.
    """
    state = Interruption()
    if threading.current_thread() is not threading.main_thread():
        yield state
        return
    before = {n: signal.getsignal(n) for n in ENDING}
    before = {n: handler for n, handler in before.items() if n == signal.SIGINT or callable(handler)}

    def note(number: int, frame: FrameType | None) -> None:
        if state.asked:
            for n, handler in before.items():
                signal.signal(n, handler)
            handler = before[number]
            if callable(handler):
                handler(number, frame)
            raise KeyboardInterrupt
        state.asked, state.signal = True, signal.Signals(number).name

    for n in before:
        signal.signal(n, note)
    try:
        yield state
    finally:
        for n, handler in before.items():
            signal.signal(n, handler)


def peak_memory_mb() -> float:
    """Most resident memory of this process so far, in MiB; 0 where the system does not tell."""
    try:
        # Linux: ru_maxrss would begin at the peak of the process that started this one.
        status = Path("/proc/self/status").read_text()
        return int(status.split("VmHWM:")[1].split()[0]) / 2**10
    except (OSError, IndexError, ValueError):
        pass
    try:
        import resource
    except ImportError:
        return 0.0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 2**20 if sys.platform == "darwin" else peak / 2**10
