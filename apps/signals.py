"""Signals by which batch systems and closing terminals end a process: they act like Ctrl-C."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from typing import Any

from warpdef.progress import ENDING


class Ended(KeyboardInterrupt):
    """Raised where a signal other than Ctrl-C arrives, so that all that cleans up after Ctrl-C does so here, too."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number

    def __reduce__(self) -> tuple[type[Ended], tuple[int]]:
        return Ended, (self.number,)


@contextlib.contextmanager
def ending_signals() -> Iterator[None]:
    """Raise ``Ended`` at SIGTERM and SIGHUP within the block, unless the caller had them ignored (as nohup does)."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(number: int, frame: object) -> None:
        raise Ended(number)

    taken = [n for n in ENDING if n != signal.SIGINT and signal.getsignal(n) == signal.SIG_DFL]
    for number in taken:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in taken:
            signal.signal(number, signal.SIG_DFL)


def exit_code(ended: KeyboardInterrupt) -> int:
    """128 and the number of the signal: 130 for Ctrl-C, 143 for SIGTERM, 129 for SIGHUP."""
    return 128 + getattr(ended, "number", signal.SIGINT)


def interruption(report: dict[str, Any]) -> KeyboardInterrupt:
    """What ended the run of this report."""
    name = report.get("signal") or "SIGINT"
    return KeyboardInterrupt() if name == "SIGINT" else Ended(signal.Signals[name])
