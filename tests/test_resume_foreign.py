"""Checkpoints of another warpdef, whole and with a right checksum: gone on with, or refused in one sentence."""

from __future__ import annotations

import shutil
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from foreign_headers import make_foreign
from test_resume import cut_at, fit, quick

from warpdef.errors import WarpdefError
from warpdef.files.checkpoint import read_checkpoint, write_checkpoint
from warpdef.files.plain import from_plain
from warpdef.fit import saving


@pytest.fixture(autouse=True)
def a_checkpoint_at_every_look(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(saving, "_SHARE", 1e9)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    cut_at("refine", 2, quick(iterations=20, rounds=3), tmp_path / "kept")
    return Path(shutil.copy(tmp_path / "kept", tmp_path / "c"))


def test_eighty_foreign_headers(path: Path) -> None:
    outcomes, wrong = Counter(), []
    for number in range(80):
        shutil.copy(path.with_name("kept"), path)
        done = make_foreign(path, np.random.default_rng(number))
        try:
            fit(resume=path)
            outcomes["went on"] += 1
        except WarpdefError as error:
            outcomes["refused"] += 1
            if "\n" in str(error) or str(path) not in str(error):
                wrong.append((number, done, str(error)))
        except Exception as error:  # what a user would get a traceback of
            wrong.append((number, done, repr(error)))
    assert wrong == []
    assert outcomes["refused"] > 40 and outcomes["went on"] > 5


def test_a_state_of_fewer_stages_is_refused(path: Path) -> None:
    saved = read_checkpoint(path)
    write_checkpoint(path, saved.facts | {"solves": saved.facts["solves"][:1]}, saved.arrays)
    with pytest.raises(WarpdefError, match="a checkpoint of another warpdef"):
        fit(resume=path)


@pytest.mark.parametrize(
    ("kind", "value"),
    [
        (int, True),
        (int, 1.0),
        (float, "1"),
        (list[int], [1, "2"]),
        (dict[str, float], {"a": None}),
        (int | None, "x"),
        (saving.SolveReport, {"solver": "cg"}),
    ],
)
def test_plain_values_of_another_type(kind, value) -> None:
    with pytest.raises(TypeError):
        from_plain(kind, value)


def test_plain_values_come_back_as_they_are() -> None:
    assert from_plain(list[dict[str, float]], [{"iteration": 10, "total": 0.5}]) == [{"iteration": 10, "total": 0.5}]
    assert type(from_plain(float, 10)) is int  # so that it is written as it was
    assert from_plain(tuple[str, ...], ["a"]) == ("a",)
    assert from_plain(int | None, None) is None
