"""Where nodes lie in memory."""

from __future__ import annotations

import numpy as np
import pytest
import reference
import warp as wp

from warpdef.kernels.levels import LevelTable


def test_the_ten_levels_of_the_paper() -> None:
    table = LevelTable.build(1, 10)
    assert table.resolution.tolist() == [1, 3, 5, 7, 9, 11, 13, 15, 17, 19]
    assert table.offset.tolist() == reference.offsets(reference.resolutions(1, 10)).tolist()
    assert (table.count, table.node_count) == (10, 19900)


def test_a_single_level() -> None:
    table = LevelTable.build(4, 4)
    assert (table.count, table.node_count, table.resolution.tolist()) == (1, 343, [7])
    np.testing.assert_array_equal(table.node_level(), np.zeros(343))


def test_every_node_knows_its_level() -> None:
    table = LevelTable.build(2, 4)
    np.testing.assert_array_equal(table.node_level(), np.repeat([0, 1, 2], [27, 125, 343]))


def test_what_the_kernels_read(device: str) -> None:
    pairs = LevelTable.build(1, 3).to_device(wp.get_device(device)).numpy()
    assert pairs.tolist() == [1, 0, 3, 1, 5, 28]


@pytest.mark.parametrize("levels", [(0, 3), (4, 3), (-1, -1)])
def test_levels_that_are_none_are_refused(levels: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match=f"expected 1 <= coarsest <= finest, got {levels[0]} and {levels[1]}"):
        LevelTable.build(*levels)
