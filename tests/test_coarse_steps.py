"""Coordinates rounded before they came are told; what is fine, flat or on a fine lattice is not."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic import icosphere, sample_surface

from warpdef.cleaning.coarse_steps import find_steps, tell_coarse_steps
from warpdef.sequence import PointSequence

RNG = np.random.default_rng(0)
CLOUDS = [sample_surface(*icosphere(3), 900, RNG)[0] + 0.1 * t for t in range(4)]


@pytest.mark.parametrize(
    ("made", "axes"),
    [
        (lambda p: (p + [5e6, 0, 0]).astype(np.float32), "x"),
        (lambda p: (p + [0, 100, 0]).astype(np.float16), "y"),
        (lambda p: np.round(p, 1), "xyz"),
        (lambda p: np.rint(p / 0.1), "xyz"),
    ],
)
def test_coarse_steps_are_told(made, axes):
    sequence = tell_coarse_steps(PointSequence.from_arrays([made(p) for p in CLOUDS]))
    assert "".join(a for a, step in zip("xyz", find_steps(sequence.points)[0], strict=True) if step) == axes
    assert sequence.notes[0].startswith(f"coordinates were rounded before they came, {axes[0]} in steps of ")


@pytest.mark.parametrize(
    "made",
    [
        lambda p: p,
        lambda p: p.astype(np.float16),
        lambda p: np.round(p, 3),
        lambda p: np.rint(1000 * p),
        lambda p: np.where(np.arange(3) == 2, 0.0, p),
        lambda p: np.where(np.arange(3) == 2, np.sign(p), p),
    ],
)
def test_fine_ones_are_not(made):
    sequence = PointSequence.from_arrays([made(p) for p in CLOUDS])
    assert tell_coarse_steps(sequence) is sequence
