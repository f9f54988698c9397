"""How many launches an iteration and a round take the way of CUDA: bounds that only ever go down."""

from __future__ import annotations

import pytest
import warp as wp
from launches import count_all, counting, table

# launches, allocations
BOUNDS = {
    "iteration": (31, 1),
    "iteration of the paper's descent": (100, 2),
    "frame settled, a round": (18, 1),
    "round": (21, 1),
}
MORE_WHERE_SOME_IS_UNSEEN = 2


@pytest.mark.parametrize("partial", [False, True])
def test_launches_and_allocations_stay_within_bounds(partial: bool) -> None:
    counts = count_all(partial)
    assert set(counts) == set(BOUNDS)
    for name, (launches, allocations) in BOUNDS.items():
        more = MORE_WHERE_SOME_IS_UNSEEN if partial and "iteration" not in name else 0
        assert counts[name].total <= launches + more, table(counts)
        assert counts[name].allocations <= allocations, table(counts)
    assert all(c.total > 5 for c in counts.values())  # it did count


def test_what_is_asked_of_warp_is_counted() -> None:
    with counting() as counted:
        a = wp.zeros(8, dtype=wp.int32, device="cpu")  # memory, and a fill
        wp.utils.array_scan(a, a)
        wp.copy(wp.empty_like(a), a)
        a.fill_(1)
    assert counted.launches == {"fill": 2, "array_scan": 2, "copy": 1}
    assert counted.allocations == 3
    with counting() as nothing:
        a.flatten()
    assert not nothing.total and not nothing.allocations
