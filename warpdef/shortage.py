"""When memory runs out all the same: which flags help, and one thing that a run can do about it by itself.

Grids can be fitted to fewer points (``optimiser.points``): little is lost, for vertices are fitted to all of them.
Where that would free enough, the run begins again so, and says it. Everything else stays as asked for.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import TypeVar

import warp as wp

from warpdef.config import Config
from warpdef.device import is_cuda
from warpdef.errors import OutOfMemory
from warpdef.memory import GIB, MemoryEstimate

T = TypeVar("T")
SAMPLED_POINT = 112
"""Bytes on the device of a point that grids are fitted to, beyond those of the cloud; measured."""
FEWEST = 2_500
"""Points a frame below which grids are not fitted without having been asked to."""
_WORTH = 0.03  # of the estimate: what is to be freed, for another try


@contextmanager
def explained_shortage(estimate: MemoryEstimate, device: wp.Device) -> Iterator[None]:
    """Turn running out of memory inside the block into a sentence that names the flags that help.

    Raises:
        OutOfMemory: memory ran out.
    """
    try:
        yield
    except (MemoryError, RuntimeError) as error:
        if not isinstance(error, MemoryError) and not _is_shortage(error):
            raise
        cuda = is_cuda(device)
        place = f"{device.name} ({device.alias})" if cuda else "this machine"
        size = estimate.device if cuda else estimate.total
        free, other = (
            (f", of which {device.free_memory / GIB:.1f} are free now", ", or --device cpu") if cuda else ("", "")
        )
        raise OutOfMemory(
            f"out of memory on {place}: the run needs about {size / GIB:.1f} GiB{free}. Lower --points, "
            f"--optimiser.points, --template.faces-max or --grid.levels, or take fewer --frames{other}"
        ) from error


def _is_shortage(error: RuntimeError) -> bool:
    text = str(error).lower()
    return "failed to allocate" in text or "out of memory" in text


def with_fewer_points(sizes: Sequence[int], config: Config, estimate: MemoryEstimate) -> Config | None:
    """The configuration with which a run that ran out of a device's memory may fit; None where that frees too little.

    Args:
        sizes: points of each frame. estimate: of the run as it was.
    """
    most = config.optimiser.points or max(sizes)
    fewer = max(FEWEST, min(most, max(sizes)) // 4)
    freed = SAMPLED_POINT * sum(max(min(n, most) - fewer, 0) for n in sizes)
    if freed < _WORTH * estimate.device:
        return None
    return replace(config, optimiser=replace(config.optimiser, points=fewer))


def retried(
    run: Callable[[Config, list[str]], T],
    config: Config,
    sizes: Sequence[int],
    estimate: MemoryEstimate,
    device: wp.Device,
) -> T:
    """``run(config, told)``, and again with fewer points for the grids where a device's memory runs out.

    ``told`` says what was changed: one sentence a try, none at first.

    Raises:
        OutOfMemory: memory ran out, and nothing more can be done about it here.
    """
    told: list[str] = []
    while True:
        try:
            return run(config, told)
        except OutOfMemory as error:
            fewer = with_fewer_points(sizes, config, estimate) if is_cuda(device) else None
            if fewer is None:
                raise
            before, config = config.optimiser.points or max(sizes), fewer
            told.append(
                f"memory of {device.name} ran out ({error.__cause__}): begun again with --optimiser.points "
                f"{config.optimiser.points} instead of {before}, the points a frame that grids are fitted to"
            )
        gc.collect()  # now that the error is gone, which held on to the arrays of that try


def device_memory(device: wp.Device) -> dict[str, float | bool | None] | None:
    """For reports: MiB of a CUDA device; None on the CPU, whose memory is the process's.

    ``peak_mb``: high-water mark of Warp's memory pool in this process, null where the device has none; ``used_mb``: of
    the whole device now, other programs' included.
    """
    if not is_cuda(device):
        return None
    pool = bool(device.is_mempool_enabled)
    return {
        "peak_mb": round(wp.get_mempool_used_mem_high(device) / 2**20, 1) if pool else None,
        "pool": pool,
        "used_mb": round((device.total_memory - device.free_memory) / 2**20, 1),
        "total_mb": round(device.total_memory / 2**20, 1),
    }
