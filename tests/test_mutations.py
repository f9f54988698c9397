"""Five hundred damaged inputs through the real commands; ``python tests/mutate.py --count 10000`` tries many more."""

from __future__ import annotations

import os
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from mutate import MEMORY_CONSTANT, Trial, mutated, run_tries
from mutation_samples import TRAP, Sample

COUNT = 500


def test_five_hundred_damaged_inputs():
    shares = [range(first, COUNT, 2) for first in range(2)]
    with ThreadPoolExecutor(2) as pool:  # each share has a process of its own
        outcomes = [o for share in pool.map(lambda indices: list(run_tries(1, indices)), shares) for o in share]
    assert [(index, o.sample, o.how, o.problem) for index, o in outcomes if o.problem] == []
    assert len(outcomes) == COUNT
    codes = [o.code for _, o in outcomes]
    # Most damage is found, and some is none.
    assert codes.count(2) > COUNT / 2 and codes.count(0) > COUNT / 20


@pytest.fixture
def trial(tmp_path) -> Trial:
    trial = Trial.__new__(Trial)
    trial.folder, trial.samples = tmp_path, []
    return trial


def broken_promise(trial: Trial, monkeypatch, command) -> str:
    """What the judge says of a command that does as told."""
    monkeypatch.setattr("warpdef.apps.main.run", command)
    return trial.attempt(Sample("a", {"a.txt": b"x"}, "a.txt", ("{in}", "{out}")), "none", b"x").problem


def test_every_promise_can_be_broken(trial, monkeypatch):
    """The judge finds what it is there to find."""

    def raises(arguments):
        raise KeyError("a defect")

    def hangs(arguments):
        while True:
            pass

    def writes(name):
        return lambda arguments: (trial.folder / name).write_text("x") and 0

    def says(line, code):
        return lambda arguments: os.write(2, line.encode() + b"\n") and code

    def takes_memory(arguments):
        np.ones(MEMORY_CONSTANT // 4)
        return 0

    monkeypatch.setattr("mutate.SECONDS_MAX", 0.2)
    error = "warpdef: error: so it is"
    for command, problem in {
        raises: "KeyError: 'a defect'",
        hangs: "no end after 0.2 s",
        takes_memory: "512 MiB for an input of 1 bytes",
        writes("elsewhere"): "wrote ['elsewhere']",
        writes(TRAP): f"executed what the file contains: ['{TRAP}']",
        writes("out"): "",
        says("", 1): "exit code 1",
        says("", 2): "not one line 'warpdef: error: ...'",
        says(f"{error}\n{error}", 2): "not one line 'warpdef: error: ...'",
        says(error, 2): "",
        says(f"Traceback (most recent call last)\n{error}", 2): "a traceback",
        (lambda arguments: writes("out")(arguments) or says(error, 2)(arguments)): "exit code 2, but left ['out']",
    }.items():
        monkeypatch.setattr("mutate.SECONDS_MAX", 0.2 if command is hangs else 30.0)
        found = broken_promise(trial, monkeypatch, command)
        assert found == problem or (command is takes_memory and "MiB for an input of 1 bytes" in found)


def test_a_busy_machine_breaks_no_promise_and_waiting_for_ever_does(trial, monkeypatch):
    monkeypatch.setattr("mutate.SECONDS_MAX", 0.2)
    assert broken_promise(trial, monkeypatch, lambda arguments: time.sleep(0.5) or 0) == ""
    monkeypatch.setattr("mutate.PATIENCE_MAX", 0.3)
    waits = broken_promise(trial, monkeypatch, lambda arguments: time.sleep(60) or 0)
    assert waits == "no end after 0.3 s of the clock"


def test_the_same_try_is_the_same_damage(rng):
    data = rng.bytes(500)
    made = [mutated(data, np.random.default_rng([0, 7])) for _ in range(2)]
    assert made[0] == made[1]
    kinds = {mutated(data, np.random.default_rng([0, i]))[0] for i in range(200)}
    assert len(kinds) == 12
