"""Checkpoints as another warpdef might have written them: whole, with a right checksum, and with other content."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np

from warpdef.files.checkpoint import read_checkpoint, write_checkpoint

_VALUES: list[Any] = [None, True, -1, 0, 10**9, 10**30, 0.5, float("nan"), "", "text", [], [1], {}, {"a": 1}, [[None]]]


def make_foreign(path: Path, rng: np.random.Generator) -> str:
    """Change one thing in the checkpoint at ``path``, drawn at random; returns what was done."""
    saved = read_checkpoint(path)
    facts, arrays = copy.deepcopy(saved.facts), dict(saved.arrays)
    if rng.random() < 0.3:
        done = _change_array(arrays, rng)
    else:
        holder, key = _place(facts, rng)
        act = rng.integers(4)
        if act == 0:
            del holder[key]
            done = f"without {key!r}"
        elif act == 1 and isinstance(holder, dict):
            holder[f"{key}_too"] = holder[key]
            done = f"with a second {key!r}"
        elif act == 2 and isinstance(holder, dict):
            holder[f"{key}_renamed"] = holder.pop(key)
            done = f"{key!r} renamed"
        else:
            holder[key] = _VALUES[rng.integers(len(_VALUES))]
            done = f"{key!r}: {holder[key]!r}"
    write_checkpoint(path, facts, arrays)
    return done


def _place(facts: Any, rng: np.random.Generator) -> tuple[Any, Any]:
    """A container somewhere in the facts and a key or index of it; rather near the top."""
    keys = list(facts) if isinstance(facts, dict) else list(range(len(facts)))
    key = keys[rng.integers(len(keys))]
    inner = facts[key]
    return _place(inner, rng) if isinstance(inner, dict | list) and inner and rng.random() < 0.7 else (facts, key)


def _change_array(arrays: dict[str, np.ndarray], rng: np.random.Generator) -> str:
    name = list(arrays)[rng.integers(len(arrays))]
    kind = ["gone", "renamed", "cut", "longer", "flat", "of another type", "of large numbers"][rng.integers(7)]
    array = arrays.pop(name)
    changed = {
        "cut": lambda: array[:-1],
        "longer": lambda: np.concatenate([array, array]),
        "flat": lambda: array.reshape(-1, 1, 1),
        "of another type": lambda: array.astype(np.int64 if array.dtype.kind == "f" else np.float64),
        "of large numbers": lambda: np.full_like(array, 2**30),
    }
    if kind in changed:
        with np.errstate(invalid="ignore"):
            arrays[name] = changed[kind]()
    elif kind == "renamed":
        arrays[f"{name}_too"] = array
    return f"array {name!r} {kind}"
