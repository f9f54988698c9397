"""What a running reconstruction tells its caller, and when it lets itself be interrupted."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path


@dataclass(frozen=True)
class Progress:
    """One message of a running reconstruction.

    phase: "template", "compile", "optimise" or "refine". iteration: done so far, of iterations. losses: weighted terms.
    message: something worth saying aloud, or empty.
    """

    phase: str
    iteration: int = 0
    iterations: int = 0
    losses: dict[str, float] = field(default_factory=dict)
    message: str = ""


Callback = Callable[[Progress], None]


class Clock:
    """Seconds by phase."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """Add the time of the block to ``name``."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start


class Interruption:
    """Whether Ctrl-C was pressed since ``held_interrupts`` began."""

    asked = False


@contextmanager
def held_interrupts() -> Iterator[Interruption]:
    """Turn Ctrl-C into a flag for the block, so that no iteration is torn; a second Ctrl-C acts at once.

    Outside the main thread signals are not ours to hold: there the flag stays down.
    """
    state = Interruption()
    if threading.current_thread() is not threading.main_thread():
        yield state
        return
    before = signal.getsignal(signal.SIGINT)

    def note(number: int, frame: object) -> None:
        if state.asked:
            signal.signal(signal.SIGINT, before)
            raise KeyboardInterrupt
        state.asked = True

    signal.signal(signal.SIGINT, note)
    try:
        yield state
    finally:
        signal.signal(signal.SIGINT, before)


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
