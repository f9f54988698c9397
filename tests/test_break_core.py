"""The table of breaks fits the code: ``break_core.py`` itself takes minutes and is run by hand."""

from __future__ import annotations

import break_core
import pytest


@pytest.mark.parametrize("entry", break_core.BREAKS, ids=lambda b: f"{b.file}: {b.reason}")
def test_every_break_changes_one_line(entry: break_core.Break) -> None:
    assert entry.found == 1
    assert entry.old != entry.new and "\n" not in entry.old + entry.new
    assert entry.tests and all((break_core.ROOT / path).is_file() for path in entry.paths)


def test_no_break_stands_twice() -> None:
    lines = {(b.file, b.old) for b in break_core.BREAKS}
    assert len(lines) == len(break_core.BREAKS) >= 20
