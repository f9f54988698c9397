"""Streams and events that write down what is asked of them, for a machine without CUDA; and what they put in order."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import pytest

from warpdef.fit import branches


class LoggedStreams:
    """log: (stream, what, with) in order; *what* is ``record``, ``wait`` or ``task``, *with* an event or a task's name.

    Work goes to the stream ``current``; 0 is the main one.
    """

    def __init__(self) -> None:
        self.log: list[tuple[int, str, Any]] = []
        self.current, self._streams, self._events = 0, 1, 0

    def stand_in(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """In place of Warp's, where branches are made."""
        names = ("Stream", "Event", "get_stream", "ScopedStream")
        monkeypatch.setattr(branches, "wp", SimpleNamespace(**{name: getattr(self, f"_{name}") for name in names}))

    def task(self, name: str) -> Callable[[], None]:
        """One that is noted where it runs."""
        return lambda: self.log.append((self.current, "task", name))

    def befores(self) -> dict[str, set[str]]:
        """Tasks that must be done before each begins: by the order within streams, and by events."""
        of_stream: dict[int, set[str]] = {}
        of_event: dict[int, set[str]] = {}
        found: dict[str, set[str]] = {}
        for stream, what, other in self.log:
            done = of_stream.setdefault(stream, set())
            if what == "record":
                of_event[other] = set(done)
            elif what == "wait":
                done |= of_event[other]
            else:
                found[other] = set(done)
                done.add(other)
        return found

    def _Stream(self, device: Any) -> Stream:
        self._streams += 1
        return Stream(self, self._streams - 1)

    def _Event(self, device: Any) -> int:
        self._events += 1
        return self._events

    def _get_stream(self, device: Any) -> Stream:
        return Stream(self, 0)

    @contextmanager
    def _ScopedStream(self, stream: Stream, sync_enter: bool = True) -> Iterator[None]:
        assert not sync_enter  # that would be an event of Warp's own
        outer, self.current = self.current, stream.number
        yield
        self.current = outer


class Stream:
    """One of them."""

    def __init__(self, book: LoggedStreams, number: int) -> None:
        self._book, self.number = book, number

    def record_event(self, event: int) -> None:
        self._book.log.append((self.number, "record", event))

    def wait_event(self, event: int) -> None:
        self._book.log.append((self.number, "wait", event))
