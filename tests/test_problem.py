"""What a problem lays out before a fit: which nodes of the grids are kept."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic

from warpdef.config import Config
from warpdef.device import find_device
from warpdef.fit.problem import Problem


def around(points: np.ndarray, resolution: int) -> np.ndarray:
    """Nodes of a level that are corners of a cell with a point in it, by looking at each; the flat level, bool."""
    axis = np.linspace(-1, 1, resolution)
    nodes = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    apart = np.abs(nodes[:, None] - points).max(axis=2)
    return (apart < axis[1] - axis[0]).any(axis=1)


@pytest.mark.parametrize("keyframe", [0, 1, 2])
def test_pruning_keeps_what_is_around_both_ends_of_a_transition(keyframe: int) -> None:
    """Three frames far apart: each transition keeps its own two, and not the third."""
    sphere, faces = synthetic.icosphere(1)
    clouds = [0.11 * sphere + [0.7 * (t - 1), 0.3 * t - 0.3, 0.013] for t in range(3)]
    config = replace(Config(), grid=replace(Config().grid, levels=6, coarsest=6, prune=True, prune_cells=0))
    problem = Problem(clouds, None, clouds[keyframe], faces, keyframe, config, find_device("cpu"))
    for s in range(2):
        expected = around(np.concatenate(clouds[s : s + 2]), 11)
        np.testing.assert_array_equal(problem.kept[s], expected)
        assert (around(clouds[2 - 2 * s], 11) & ~expected).any()
