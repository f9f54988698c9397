"""What this machine can do: its copy bandwidth, its arithmetic, its name; and whether its clock can be believed."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from pathlib import Path

import numpy as np
import warp as wp

import warpdef
from warpdef.apps.benchmark.bed import Case, runner
from warpdef.apps.benchmark.kernels import FLOPS_PER_ROUND, multiply_add_rounds, sample_only
from warpdef.apps.benchmark.timing import DeviceTimer, Effort, measure, null_test
from warpdef.device import is_cuda, usable_cores
from warpdef.fit.workers import Team
from warpdef.kernels.adam import adam
from warpdef.kernels.levels import LevelTable, node8
from warpdef.kernels.schedule import SCHEDULE_SIZE

_COPY_EFFORT = Effort(seconds=0.5, least=5, most=15)


def environment(device: wp.Device, threads: int) -> dict:
    """Names and versions of everything a figure depends on."""

    return {
        "device": device.alias,
        "device_name": device.name if is_cuda(device) else _processor(),
        "cores": usable_cores(),
        "threads": threads,
        "load_at_start": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "warp": wp.__version__,
        "numpy": np.__version__,
        "scipy": version("scipy"),
        "warpdef": warpdef.__version__,
    }


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def copy_bandwidth(device: wp.Device, threads: int, megabytes: int) -> float:
    """Bytes read and written a second by a plain copy between two arrays of this size."""
    count = megabytes * 2**18
    if is_cuda(device):
        a, b = (wp.zeros(count, dtype=wp.float32, device=device) for _ in range(2))
        timing = measure(lambda: wp.copy(b, a), DeviceTimer(device).seconds, _COPY_EFFORT)
        return 8.0 * count / timing.median
    a, b = np.ones(count, dtype=np.float32), np.zeros(count, dtype=np.float32)
    parts = [slice(count * k // threads, count * (k + 1) // threads) for k in range(threads)]
    with ThreadPoolExecutor(threads) as pool:
        # NumPy copies without the interpreter lock.
        timing = measure(
            lambda: list(pool.map(lambda part: np.copyto(b[part], a[part]), parts)),
            DeviceTimer(device).seconds,
            _COPY_EFFORT,
        )
    return 8.0 * count / timing.median


def arithmetic_peak(device: wp.Device, team: Team, effort: Effort) -> float:
    """Floating-point operations a second of multiply-adds that touch no memory."""
    entries, rounds, parts = (64, 20_000, 4 * team.size) if not is_cuda(device) else (2**20, 400, 1)
    outs = [wp.zeros(entries, dtype=wp.float32, device=device) for _ in range(parts)]
    case = Case("peak", "", 0, 0, [lambda out=out: multiply_add_rounds(rounds, out) for out in outs])
    timing = measure(runner(case, device, team), DeviceTimer(device).seconds, effort)
    return parts * entries * rounds * FLOPS_PER_ROUND / timing.median


def null_tests(device: wp.Device, quick: bool) -> list[dict]:
    """Four times the work against once, on one thread: a kernel bound by memory, its arrays well beyond any cache, and
    one bound by arithmetic.
    """
    nodes = 2**20 if not is_cuda(device) else 2**22
    points = (1 if quick else 4) * (20_000 if not is_cuda(device) else 1_000_000)
    tests = []
    for name, cost, least in (
        ("Adam, memory", adam_cost(device, 4 * nodes), nodes),
        ("sampling, arithmetic", sampling_cost(device, 4 * points), points),
    ):
        tests.append({"name": name, **null_test(cost, (least, 4 * least), rounds=5 if quick else 9)})
    return tests


def adam_cost(device: wp.Device, most: int) -> Callable[[int], float]:
    """Seconds of Adam on the first so many of ``most`` vertices, 84 bytes each."""
    rate = wp.array([1e-3], dtype=wp.float32, device=device)
    schedule = wp.array(np.ones(SCHEDULE_SIZE), dtype=wp.float32, device=device)
    state = [wp.zeros(most, dtype=wp.vec3, device=device) for _ in range(4)]
    clock = DeviceTimer(device)

    def cost(count: int) -> float:
        return clock.seconds(lambda: adam(0, count, rate, schedule, (0.9, 0.999), 1e-8, *state))

    return cost


def sampling_cost(device: wp.Device, most: int) -> Callable[[int], float]:
    """Seconds of sampling ten levels at the first so many of ``most`` points."""
    table = LevelTable.build(1, 10)
    rng = np.random.default_rng(0)
    nodes = wp.zeros((1, table.node_count), dtype=node8, device=device)
    levels = table.to_device(device)
    points = wp.array(rng.uniform(-1, 1, (most, 3)), dtype=wp.vec3, device=device)
    transition = wp.zeros(most, dtype=wp.int32, device=device)
    out = wp.zeros(most, dtype=node8, device=device)
    clock = DeviceTimer(device)

    def cost(count: int) -> float:
        return clock.seconds(lambda: sample_only(0, count, nodes, levels, points, transition, out))

    return cost
