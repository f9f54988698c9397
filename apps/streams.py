"""Standard output and error that end no run: a full disk, a closed pipe or a poor encoding costs words, no result."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import sys
from collections.abc import Iterator
from typing import Any


class Guarded(io.TextIOBase):
    """A text stream like ``stream`` whose writing never raises.

    What the encoding cannot say is written with backslashes. After the first failure all that follows goes to the null
    device, below Python as well, so that nothing held back fails at the process's end.

    lost: the first failure; None while all was written. A reader that left a pipe has seen what it wanted, and a
    writer that is asked to wait loses only what it had to say just then.
    """

    def __init__(self, stream: Any) -> None:
        self._stream = stream
        self.lost: OSError | None = None
        # Not every stand-in for a stream can be told.
        with contextlib.suppress(AttributeError, OSError, ValueError):
            stream.reconfigure(errors="backslashreplace")

    def write(self, text: str) -> int:
        self._try(self._stream.write, text)
        return len(text)

    def flush(self) -> None:
        self._try(self._stream.flush)

    def _try(self, act: Any, *arguments: Any) -> None:
        try:
            act(*arguments)
        except BlockingIOError:
            pass
        except OSError as error:
            if error.errno != errno.EPIPE:
                self.lost = self.lost or error
            self._silence()
        except ValueError:  # closed behind our back
            self._stream = open(os.devnull, "w")

    def _silence(self) -> None:
        try:
            descriptor = self._stream.fileno()
        except (OSError, ValueError):
            self._stream = open(os.devnull, "w")
            return
        nowhere = os.open(os.devnull, os.O_WRONLY)
        if nowhere != descriptor:  # else it was closed, and is open again
            os.dup2(nowhere, descriptor)
            os.close(nowhere)
        with contextlib.suppress(OSError, ValueError):
            self._stream.flush()

    def fileno(self) -> int:
        return self._stream.fileno()

    def isatty(self) -> bool:
        try:
            return self._stream.isatty()
        except ValueError:
            return False

    def writable(self) -> bool:
        return True

    @property
    def encoding(self) -> str:  # type: ignore[override]
        return getattr(self._stream, "encoding", None) or "utf-8"

    @property
    def errors(self) -> str | None:  # type: ignore[override]
        return getattr(self._stream, "errors", None)

    @property
    def buffer(self) -> Any:
        """The bytes beneath, as libraries ask for it; these are not guarded."""
        return self._stream.buffer


def open_missing_descriptors() -> None:
    """Give a process that was started with closed streams null ones: else the first files it opens take their places,
    and what libraries print ends up inside them."""
    for descriptor, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        try:
            os.fstat(descriptor)
        except OSError:
            opened = os.open(os.devnull, os.O_RDWR)
            if opened != descriptor:
                os.dup2(opened, descriptor)
                os.close(opened)
        if getattr(sys, name) is None:
            setattr(sys, name, open(descriptor, mode, encoding="utf-8", closefd=False))


@contextlib.contextmanager
def guarded_streams() -> Iterator[Guarded]:
    """Put guards before ``sys.stdout`` and ``sys.stderr`` for the block; yields that of standard output."""
    before = sys.stdout, sys.stderr
    out, err = Guarded(before[0]), Guarded(before[1])
    sys.stdout, sys.stderr = out, err
    try:
        yield out
    finally:
        out.flush()
        err.flush()
        sys.stdout, sys.stderr = before
