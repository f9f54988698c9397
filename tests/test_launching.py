"""Launches run at once or are recorded."""

from __future__ import annotations

import threading

import numpy as np
import pytest
import warp as wp

from warpdef.kernels.launching import recording
from warpdef.kernels.vectors import clear_losses


@pytest.fixture
def ones(device: str) -> wp.array:
    return wp.full(6, 1.0, dtype=wp.float64, device=device)


def test_a_launch_runs_at_once(ones: wp.array) -> None:
    clear_losses(2, 3, ones)
    assert ones.numpy().tolist() == [1, 1, 0, 0, 0, 1]


def test_a_recorded_launch_runs_when_it_is_replayed(ones: wp.array) -> None:
    with recording() as commands:
        clear_losses(0, 2, ones)
        clear_losses(4, 2, ones)
    assert len(commands) == 2
    np.testing.assert_array_equal(ones.numpy(), 1)
    for _ in range(2):
        for command in commands:
            command.launch()
        assert ones.numpy().tolist() == [0, 0, 1, 1, 0, 0]
        ones.fill_(1.0)


def test_after_recording_launches_run_again(ones: wp.array) -> None:
    with pytest.raises(RuntimeError, match="interrupted"), recording():
        raise RuntimeError("interrupted")
    clear_losses(0, 6, ones)
    np.testing.assert_array_equal(ones.numpy(), 0)


def test_recordings_nest_and_belong_to_their_thread(ones: wp.array) -> None:
    with recording() as outer:
        with recording() as inner:
            clear_losses(0, 1, ones)
        clear_losses(1, 1, ones)
        other = threading.Thread(target=clear_losses, args=(5, 1, ones))
        other.start()
        other.join()
    assert (len(outer), len(inner)) == (1, 1)
    assert ones.numpy().tolist() == [1, 1, 1, 1, 1, 0]


def test_an_empty_span_is_no_launch(ones: wp.array) -> None:
    with recording() as commands:
        clear_losses(3, 0, ones)
    assert commands == []
