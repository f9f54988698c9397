"""Devices: which there are, and which way the method goes on one (``kernels.ways``)."""

from __future__ import annotations

import ctypes
import logging
import os
import re
from collections.abc import Iterable
from typing import cast

import numpy as np
import warp as wp

from warpdef.errors import DeviceError
from warpdef.kernel_cache import ensure_cache
from warpdef.kernels.ways import Way as Way
from warpdef.kernels.ways import going as going
from warpdef.kernels.ways import way_of as way_of

DRIVER_RELEASES = {13: "R580"}
"""First release of NVIDIA's driver for Linux that serves a major version of CUDA."""
_told: list[str] = []
_runs = False


def start_warp() -> None:
    """Initialise Warp without its greeting, and without its native warning where no CUDA driver is installed."""
    global _runs
    _runs = True
    wp.config.log_level = logging.WARNING
    # For every device as it is: code for the oldest of several would know no clusters (``kernels.clusters``).
    wp.config.cuda_output = "cubin"
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


def warp_runs() -> bool:
    """Whether Warp, and with it CUDA, was started in this process: what is visible is settled then."""
    return _runs


def _has_driver() -> bool:
    for name in ("libcuda.so.1", "libcuda.so", "nvcuda.dll"):
        try:
            ctypes.CDLL(name)
            return True
        except OSError:
            continue
    return False


def find_device(name: str) -> wp.Device:
    """``auto`` (the first CUDA device, else the CPU), ``cpu``, ``cuda`` or ``cuda:N``.

    Where ``auto`` takes the CPU although there is a driver, the logger ``warpdef`` says why, once.

    Raises:
        DeviceError: no such device here; it says which there are, or what the driver lacks.
    """
    start_warp()
    there = [d.alias for d in wp.get_devices()]
    devices = [alias for alias in there if alias != "cpu"]
    if name == "auto":
        if not devices and _has_driver():
            tell_once(f"--device auto takes the CPU: {why_no_cuda()}")
        return wp.get_device(devices[0] if devices else "cpu")
    wanted = "cuda:0" if name == "cuda" else name
    if wanted in there:
        return wp.get_device(wanted)
    if not re.fullmatch(r"cuda(:\d+)?", name):
        raise DeviceError(
            f"--device: expected one of auto, {', '.join(there)}, got {name or 'nothing'}; take one that is there"
        )
    if not devices:
        raise DeviceError(
            f"--device: expected a CUDA device for {name}, but {why_no_cuda()}; mend that, or take --device cpu"
        )
    count = "1 CUDA device" if len(devices) == 1 else f"{len(devices)} CUDA devices"
    raise DeviceError(
        f"--device: expected one of {', '.join(devices)}, got {name}: {count} here, counted from 0{_hidden()}"
    )


def why_no_cuda() -> str:
    """Why Warp shows no CUDA device, with the versions that matter. Call it where it shows none."""
    built, driver = wp.get_cuda_toolkit_version(), wp.get_cuda_driver_version()
    if built is None:
        return f"Warp {wp.__version__} as installed here is built without CUDA"
    # Within a major version any driver serves (CUDA's minor-version compatibility).
    release = DRIVER_RELEASES.get(built[0])
    needed = f"a driver for CUDA {built[0]}.0 or later" + (f" ({release} or later)" if release else "")
    if not _has_driver():
        return f"NVIDIA's driver is not installed (no libcuda); Warp {wp.__version__} needs {needed}"
    if driver is None:
        return f"NVIDIA's driver is installed but does not start: see what nvidia-smi says{_hidden()}"
    if driver < (built[0], 0):
        return f"NVIDIA's driver is for CUDA {driver[0]}.{driver[1]}, and Warp {wp.__version__} needs {needed}"
    return f"the driver (CUDA {driver[0]}.{driver[1]}) shows no device{_hidden()}"


def _hidden() -> str:
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    return "" if visible is None else f" (CUDA_VISIBLE_DEVICES is {visible!r})"


def tell_once(message: str) -> None:
    """To the logger ``warpdef``, and to whoever asks for ``device_warnings``."""
    if message not in _told:
        _told.append(message)
        logging.getLogger("warpdef").warning("warpdef: warning: %s", message)


def device_warnings() -> list[str]:
    """What there was to say of devices in this process, for reports."""
    return list(_told)


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


def load_kernels(kernels: Iterable[wp.Kernel], device: wp.Device) -> None:
    """Compile for a CUDA device the modules of these kernels, and load them: on all cores, as a compiler takes one.

    For the CPU nothing is done before a kernel is recorded: there every thread of the compiler would read Warp's
    headers anew, which is most of the work (7.2 against 4.0 s of processor time for the modules of a run on two
    threads; for CUDA it is 6.9 against 6.3 s).
    """
    modules = list({id(kernel.module): kernel.module for kernel in kernels}.values())
    if modules and is_cuda(device):
        wp.force_load(device, modules, max_workers=min(len(modules), usable_cores()))


def team_size(device: wp.Device, threads: int | None = None) -> int:
    """CPU threads that a run has a use for: as many as asked for, or all cores; one where launches go whole."""
    return threads or usable_cores() if way_of(device) is Way.SPANS else 1
