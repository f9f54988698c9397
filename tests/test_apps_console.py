"""Progress on a terminal, and a standard output that stays clean."""

from __future__ import annotations

import io
import os
import sys

import pytest

from warpdef.apps.console import ProgressDisplay, clean_stdout
from warpdef.progress import Progress


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_bar_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "80")
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    losses = {"total": 1.5, "mesh": 0.25, **{f"another {i}": 1.0 for i in range(9)}}
    with ProgressDisplay() as display:
        display(Progress("template", message="the first try failed"))
        display(Progress("optimise", 3, 10, losses))
    shown = terminal.getvalue()
    assert "template: the first try failed" in shown
    assert "optimise" in shown
    assert "3/10" in shown
    assert "total 1.5" in shown
    assert "another 8" not in shown  # would not fit


def test_one_line_a_phase_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = io.StringIO()
    monkeypatch.setattr(sys, "stderr", stream)
    with ProgressDisplay() as display:
        for iteration in range(5):
            display(Progress("optimise", iteration, 5, {"total": 1.0}, "slow" if iteration > 2 else ""))
        display.start("write")
    assert stream.getvalue().splitlines() == ["optimise: 5 iterations", "optimise: slow", "write"]


def test_what_libraries_print_goes_to_standard_error(capfd: pytest.CaptureFixture[str]) -> None:
    with clean_stdout():
        print("from Python")
        os.write(1, b"from C\n")
    print("ours")
    shown, told = capfd.readouterr()
    assert shown == "ours\n"
    assert sorted(told.splitlines()) == ["from C", "from Python"]


def test_standard_output_comes_back_after_an_error(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ZeroDivisionError), clean_stdout():
        raise ZeroDivisionError
    os.write(1, b"ours\n")
    assert capfd.readouterr().out == "ours\n"
