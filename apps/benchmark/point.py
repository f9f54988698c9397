"""One problem in a process of its own: seconds to the first iteration, seconds of the next ones, and memory.

Run by the bench as ``python -m warpdef.apps.benchmark.point REQUEST``, REQUEST being JSON; one line of JSON comes last.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from warpdef.apps.benchmark.sizes import WORK, Size
from warpdef.errors import WarpdefError

_DISCARDED = 0.5  # share of the full iterations that are not counted: after the warm-up far vertices still catch up


def run_point(
    work: Path, size: Size, device: str, threads: int, iterations: int, warmup: int = 0, cache: Path | None = None
) -> dict[str, Any]:
    """Measure a saved problem in a fresh process.

    Args:
        work: file of ``Work.save``. iterations: full iterations to run; at least 1. warmup: iterations of the input
            term alone before them. cache: folder of compiled kernels instead of the user's own.

    Returns:
        ``first_s``: process start to the end of the first iteration, in ``import_s``, ``build_s``, ``compile_s`` and
        ``step_s``; ``ms`` of the later full ones, and ``cpu_ms``, least processor time of one of them, all threads
        together, which other programs on the machine disturb least (null if there are none; ``cpu_ms`` also on CUDA);
        ``arrays_mb``: capacity of all arrays of the run; ``peak_mb``: most resident memory of the process;
        ``device_mb``: the same on a CUDA device, else null; ``modules``: seconds to load a kernel module, by name,
        where they could be read.

    Raises:
        WarpdefError: the process failed.
    """
    request = {
        "started": time.time(),
        "work": str(work),
        "size": asdict(size),
        "device": device,
        "threads": threads,
        "iterations": iterations,
        "warmup": warmup,
        "cache": str(cache) if cache else None,
    }
    command = [sys.executable, "-m", "warpdef.apps.benchmark.point", json.dumps(request)]
    done = subprocess.run(command, capture_output=True, text=True, env={**os.environ, "PYTHONUNBUFFERED": "1"})
    lines = done.stdout.strip().splitlines()
    if done.returncode != 0 or not lines:
        last = (done.stderr.strip().splitlines() or ["it said nothing"])[-1]
        raise WarpdefError(f"bench: the process for {size} ended with code {done.returncode}: {last}")
    return {**json.loads(lines[-1]), "modules": module_seconds(lines)}


def module_seconds(lines: Iterable[str]) -> dict[str, float]:
    """Seconds that Warp says each module took to load; those of one kernel in several types are summed."""
    seconds: dict[str, float] = {}
    for line in lines:
        found = re.search(r"Module (\S+) \w+ load on device '[^']*' took ([0-9.]+) ms", line)
        if found:
            # warpdef.kernels.motion, or for a kernel with a module of its own _kernels__locals__solve_systems_1a2b3c4d.
            name = re.sub(r"_[0-9a-f]{8}$", "", found[1].split("__locals__")[-1].split(".")[-1])
            seconds[name] = seconds.get(name, 0.0) + 1e-3 * float(found[2])
    return seconds


def peak_resident_mb() -> float:
    """Most resident memory of this program, MB.

    Linux hands a process's own figure (getrusage) down to the programs it starts; that of the address space is fresh.
    """
    status = Path("/proc/self/status")
    if status.exists():
        for line in status.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024e-6
    from warpdef.progress import peak_memory_mb

    return peak_memory_mb() * 2**20 * 1e-6


def array_bytes(root: Any) -> int:
    """Capacity of every Warp and NumPy array that can be reached from an object, each memory counted once."""
    import numpy as np
    import warp as wp

    sizes: dict[int, int] = {}
    seen: set[int] = set()
    waiting = [root]
    while waiting:
        item = waiting.pop()
        if id(item) in seen:
            continue
        seen.add(id(item))
        if isinstance(item, wp.array):
            # A view starts where its owner does, or has it behind `_ref`.
            owner = item if item._ref is None else item._ref
            waiting.append(owner)
            if isinstance(owner, wp.array) and owner.ptr:
                sizes[owner.ptr] = max(sizes.get(owner.ptr, 0), owner.capacity)
        elif isinstance(item, np.ndarray):
            while isinstance(item.base, np.ndarray):
                item = item.base
            sizes[item.__array_interface__["data"][0]] = item.nbytes
        elif isinstance(item, dict):
            waiting.extend(item.values())
        elif isinstance(item, (list, tuple, set)):
            waiting.extend(item)
        elif type(item).__module__.startswith("warpdef."):
            waiting.extend(vars(item).values() if hasattr(item, "__dict__") else ())
    return sum(sizes.values())


def _measure(request: dict[str, Any]) -> dict[str, Any]:
    import warp as wp

    if request["cache"]:
        wp.config.kernel_cache_dir = request["cache"]
    from contextlib import closing
    from dataclasses import replace

    import numpy as np

    from warpdef.apps.benchmark.bed import bench_config, bench_problem
    from warpdef.apps.benchmark.data import Work
    from warpdef.apps.benchmark.timing import DeviceTimer
    from warpdef.device import find_device, is_cuda
    from warpdef.fit.optimise import Optimiser
    from warpdef.fit.workers import Team

    device = find_device(request["device"])
    wp.config.log_level = wp.LOG_INFO  # the loading of modules is read from what Warp says
    marks = [request["started"], time.time()]

    def mark() -> float:
        marks.append(time.time())
        return marks[-1] - marks[-2]

    size = Size(**request["size"])
    work = Work.load(Path(request["work"]))
    config = bench_config(replace(size, iterations=WORK.iterations))
    config = replace(config, optimiser=replace(config.optimiser, warmup=request["warmup"]))
    with closing(Team(request["threads"])) as team:
        optimiser = Optimiser(bench_problem(work, config, device), WORK.iterations, team)
        build = mark()
        optimiser.prepare()
        compiled = mark()
        optimiser.iterate()
        wp.synchronize_device(device)
        step = mark()
        clock = DeviceTimer(device)
        while optimiser.done < request["warmup"]:
            optimiser.iterate()
        times, work_times = [], []
        for _ in range(request["iterations"] - (request["warmup"] == 0)):
            before = time.process_time()
            times.append(clock.seconds(optimiser.iterate))
            work_times.append(time.process_time() - before)
        losses = optimiser.look()
        first = int(_DISCARDED * len(times))
        return {
            "first_s": marks[-1] - marks[0],
            "import_s": marks[1] - marks[0],
            "build_s": build,
            "compile_s": compiled,
            "step_s": step,
            "ms": 1e3 * float(np.median(times[first:])) if times else None,
            "cpu_ms": 1e3 * float(np.min(work_times[first:])) if times and not is_cuda(device) else None,
            "arrays_mb": array_bytes(optimiser) / 1e6,
            "peak_mb": peak_resident_mb(),
            "device_mb": wp.get_mempool_used_mem_high(device) / 1e6 if is_cuda(device) else None,
            "vertices": len(work.vertices),
            "loss": losses["total"],
        }


if __name__ == "__main__":
    print(json.dumps(_measure(json.loads(sys.argv[1]))))
