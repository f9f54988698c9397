"""What a person sees: the progress bar and messages on standard error, tables and JSON on standard output."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Iterator, Mapping
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeRemainingColumn
from rich.table import Table


def say(text: str) -> None:
    """One plain line on standard error."""
    print(text, file=sys.stderr, flush=True)


def print_json(content: Mapping[str, Any]) -> None:
    """``content`` as indented JSON on standard output."""
    from warpdef.files.json_text import json_text

    print(json_text(content), flush=True)


def print_table(table: Table) -> None:
    """A table on standard output, as wide as it needs where that is not a terminal."""
    Console(width=None if sys.stdout.isatty() else 120).print(table)


@contextlib.contextmanager
def clean_stdout() -> Iterator[None]:
    """Send whatever libraries print meanwhile, from Python or from C, to standard error.

    Standard output carries only our own tables and JSON, so that it can be piped.
    """
    sys.stdout.flush()
    with contextlib.redirect_stdout(sys.stderr):
        try:
            saved = os.dup(1)
        except OSError:  # no descriptor 1 at all
            yield
            return
        try:
            os.dup2(2, 1)
            yield
        finally:
            sys.stderr.flush()
            os.dup2(saved, 1)
            os.close(saved)


_BAR_SPACE = 54  # columns of the terminal that all but the losses take


def _fitting(losses: Mapping[str, float], width: int) -> str:
    """As many losses as fit, the first always."""
    text = ""
    for name, value in losses.items():
        longer = f"{text}  {name} {value:.3g}".strip()
        if text and len(longer) > width:
            break
        text = longer
    return text


class ProgressDisplay:
    """One rich bar on a terminal; elsewhere a plain line a phase. Call it with each ``warpdef.Progress``.

    Args:
        quiet: only what is worth saying aloud, wherever.
    """

    def __init__(self, quiet: bool = False) -> None:
        self._quiet = quiet
        # The console keeps this very stream, whatever is redirected later.
        self._console = Console(file=sys.stderr)
        self._bar: Progress | None = None
        self._task: Any = None
        self._phase = self._message = ""
        if self._console.is_terminal and not quiet:
            self._bar = Progress(
                SpinnerColumn(),
                TextColumn("{task.description}"),
                BarColumn(bar_width=20),
                TextColumn("{task.fields[count]}"),
                TimeRemainingColumn(compact=True),
                TextColumn("{task.fields[losses]}"),
                console=self._console,
                transient=True,
            )

    def __enter__(self) -> ProgressDisplay:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(self, *exception: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def __call__(self, progress: Any) -> None:
        """Show ``progress.phase``, ``.iteration`` of ``.iterations``, ``.losses`` and ``.message``."""
        self.start(progress.phase, progress.iterations)
        if progress.message and progress.message != self._message:
            self._message = progress.message
            self._line(f"{progress.phase}: {progress.message}")
        if self._bar is not None:
            done, total = progress.iteration, progress.iterations
            losses = _fitting(progress.losses, self._console.width - _BAR_SPACE)
            count = f"{done}/{total}" if total else ""
            self._bar.update(self._task, completed=done, total=total or None, count=count, losses=losses)

    def start(self, phase: str, iterations: int = 0, unit: str = "iterations") -> None:
        """Enter a phase; nothing happens when it is the present one."""
        if phase == self._phase:
            return
        self._phase = phase
        if self._bar is None:
            if not self._quiet:
                self._line(f"{phase}: {iterations} {unit}" if iterations else phase)
            return
        # A task of its own for each phase: time left is measured within the phase.
        if self._task is not None:
            self._bar.remove_task(self._task)
        self._task = self._bar.add_task(phase, total=iterations or None, count="", losses="")

    def _line(self, text: str) -> None:
        if self._bar is None:
            print(text, file=self._console.file, flush=True)
        else:
            self._bar.console.print(text, markup=False, highlight=False)


class Stopwatch:
    """Wall time of named phases, seconds."""

    def __init__(self) -> None:
        self._start = time.perf_counter()

    def lap(self) -> float:
        """Seconds since the last lap, or since the start."""
        now = time.perf_counter()
        passed, self._start = now - self._start, now
        return passed


def key_value_table(title: str, rows: Mapping[str, str]) -> Table:
    """Two columns, no frame lines between rows."""
    table = Table(title=title, title_justify="left", show_header=False, box=None, pad_edge=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    for name, value in rows.items():
        table.add_row(name, value)
    return table
