"""Which times of a motion the frames of a file show."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from warpdef.errors import InputError

_FRAMES_MAX = 1_000_000


def pace(frames: Sequence[int], fps: float, slow: float = 1.0, recorded_fps: float | None = None) -> np.ndarray:
    """Times in the motion, counted in its frames, one for every frame of the file.

    Args:
        frames: the motion's frames to go through, in order.
        fps: frames a second of the file.
        slow: how many times slower it shall play than it was recorded; 0.5 is twice as fast.
        recorded_fps: frames a second of the motion; those of the file if not given.

    Returns:
        Shape (n,) float64: the frames themselves where nothing changes, else times that may lie between them.

    Raises:
        InputError: a number that is not above 0, or over a million frames.
    """
    for name, value in (("--fps", fps), ("--slow", slow), ("--recorded-fps", recorded_fps)):
        if value is not None and not (np.isfinite(value) and value > 0.0):
            raise InputError(f"{name}: expected a number above 0, got {value}")
    step = (fps if recorded_fps is None else recorded_fps) / (fps * slow)
    last = len(frames) - 1
    if last / step >= _FRAMES_MAX:
        raise InputError(f"--slow: expected at most {_FRAMES_MAX} frames in the file, got {last / step:.3g}")
    # Rounding must neither lose the last frame nor leave a frame a hair beside its whole number.
    places = np.arange(int(last / step + 1e-6) + 1) * step
    near = np.rint(places)
    places = np.where(np.abs(places - near) < 1e-6, near, places)
    return np.interp(places, np.arange(len(frames)), np.asarray(frames, dtype=np.float64))


def frame_names(names: Sequence[str], times: np.ndarray) -> tuple[str, ...]:
    """Names of frames, and for times between ``name + 0.25``."""
    shares = ((int(time), time - int(time)) for time in times)
    return tuple(names[t] if share == 0.0 else f"{names[t]} + {share:.3g}" for t, share in shares)
