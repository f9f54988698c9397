"""Devices: which there are, and which way the method goes on one (``kernels.ways``)."""

from __future__ import annotations

import ctypes.util
import logging
import os
from typing import cast

import numpy as np
import warp as wp

from warpdef.errors import DeviceError
from warpdef.kernel_cache import ensure_cache
from warpdef.kernels.ways import Way as Way
from warpdef.kernels.ways import going as going
from warpdef.kernels.ways import way_of as way_of


def start_warp() -> None:
    """Initialise Warp without its greeting, and without its native warning where no CUDA driver is installed."""
    wp.config.log_level = logging.WARNING
    ensure_cache()
    if _has_driver():
        wp.init()
        return
    # The warning is written by native code, past Python's own streams.
    kept = os.dup(2)
    try:
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), 2)
            wp.init()
    finally:
        os.dup2(kept, 2)
        os.close(kept)


def _has_driver() -> bool:
    return ctypes.util.find_library("cuda") is not None


def find_device(name: str) -> wp.Device:
    """``auto`` (the first CUDA device, else the CPU), ``cpu``, ``cuda`` or ``cuda:N``.

    Raises:
        DeviceError: no such device here.
    """
    start_warp()
    if name == "auto":
        return wp.get_device("cuda:0" if wp.is_cuda_available() else "cpu")
    there = [d.alias for d in wp.get_devices()]
    wanted = "cuda:0" if name == "cuda" else name
    if wanted not in there and wanted.startswith("cuda") and not wp.is_cuda_available():
        lacking = "NVIDIA's driver is not installed (no libcuda)" if not _has_driver() else "the driver shows no device"
        raise DeviceError(
            f"--device: expected a CUDA device for {name}, but {lacking}; mend that, or take --device cpu"
        )
    if wanted not in there:
        raise DeviceError(f"--device: expected one of auto, {', '.join(there)}, got {name}; take one that is there")
    return wp.get_device(wanted)


def on_host(array: wp.array) -> np.ndarray:
    """What ``array.numpy()`` gives, under the type that it has for all our arrays; Warp annotates more."""
    return array.numpy()


def frame_of(array: wp.array, frame: int) -> wp.array:
    """One frame of an array whose first axis counts them, as a view; Warp annotates what lists would give as well."""
    return cast(wp.array, array[frame])


def usable_cores() -> int:
    """Cores this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def is_cuda(device: wp.Device) -> bool:
    """Whether it has memory, a clock and graphs of its own. Which way to go on it says ``way_of``, not this."""
    return device.is_cuda


def team_size(device: wp.Device, threads: int | None = None) -> int:
    """CPU threads that a run has a use for: as many as asked for, or all cores; one where launches go whole."""
    return threads or usable_cores() if way_of(device) is Way.SPANS else 1
