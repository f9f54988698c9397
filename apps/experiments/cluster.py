"""Runs over a Dask cluster: one run a worker at a time; a run whose worker dies is done again by another one.

The results are those of a single process: a run is seeded by itself, and on the CPU its bits do not depend on threads.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from warpdef.apps.experiments.run import ExperimentRun, execute
from warpdef.apps.experiments.session import Executor
from warpdef.errors import InputError, MissingPackageError

CORES_A_WORKER = 2
DEATHS_ALLOWED = 3
"""Workers that one run may lose before it is given up."""
_CONNECT_S = "20s"
_LOOPBACK = "127.0.0.1"


@dataclass(frozen=True)
class Slot:
    """What a local worker may use: a device, and the cores of its slice.

    visible: CUDA_VISIBLE_DEVICES of its process, which then sees its GPU as ``cuda:0`` and no other; empty on the CPU.
    """

    device: str
    cores: tuple[int, ...]
    visible: str = ""


def local_slots(device: str, threads: int | None, workers: int | None) -> list[Slot]:
    """One slot a worker: every GPU its own, else slices of this process's cores.

    Args:
        device: ``auto`` and ``cuda`` are every GPU there is; ``cpu``, ``cuda:N``.
        threads: cores a slice; 2 if not given.
        workers: how many; as many as there are GPUs or slices if not given.

    Raises:
        DeviceError: no such device. InputError: more slices than cores.
    """
    from warpdef.device import find_device, is_cuda, usable_cores

    target = find_device(device)
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else list(range(usable_cores()))
    if not is_cuda(target):
        size = min(threads or CORES_A_WORKER, len(cores))
        count = workers or max(1, len(cores) // size)
        if count * size > len(cores):
            raise InputError(
                f"--worker-count: {count} workers of {size} threads need {count * size} cores, got {len(cores)}; "
                "ask for fewer, or set --threads"
            )
        return [Slot("cpu", tuple(cores[i * size : (i + 1) * size])) for i in range(count)]
    devices = [target.alias]
    if device in ("auto", "cuda"):
        import warp as wp

        devices = [d.alias for d in wp.get_cuda_devices()]
    count = workers or len(devices)
    size = max(1, len(cores) // count)
    return [
        Slot(devices[i % len(devices)], tuple(cores[i * size : (i + 1) * size]) or tuple(cores), visible)
        for i in range(count)
        for visible in [_visible(devices[i % len(devices)])]
    ]


def _visible(alias: str) -> str:
    """What CUDA_VISIBLE_DEVICES must be for a process that is to see this device of ours alone."""
    number, ours = int(alias.removeprefix("cuda:")), os.environ.get("CUDA_VISIBLE_DEVICES", "")
    names = [name.strip() for name in ours.split(",")] if ours else []
    return names[number] if number < len(names) else str(number)


def on_cluster(
    address: str = "",
    device: str = "auto",
    threads: int | None = None,
    workers: int | None = None,
    keep: Path | None = None,
) -> Executor:
    """Runs over the cluster at ``address``, or over workers started on this machine and ended afterwards.

    Args:
        address: of a Dask scheduler, as ``tcp://host:8786``; its workers need warpdef, the data under the same path,
            and one thread each (``dask worker ADDRESS --nthreads 1``). Empty: local workers.
        device, threads: for every run; local workers take a GPU of their own or a slice of cores each.
        workers: number of local workers.
        keep: as for ``execute``.

    Raises:
        MissingPackageError: distributed cannot be imported.
    """
    try:
        import distributed  # noqa: F401
    except ImportError:
        raise MissingPackageError(
            "--workers dask needs Dask; install it with: pip install 'warpdef[cluster]'"
        ) from None

    def go(runs: Sequence[ExperimentRun]) -> Iterator[tuple[ExperimentRun, dict[str, Any] | Exception]]:
        if not runs:
            return
        from distributed import as_completed

        with ExitStack() as stack:
            slots = [] if address else local_slots(device, threads, workers)
            client = _connect(address, min(len(slots), len(runs)), stack)
            futures = {
                client.submit(_work, run, slots, device, threads, keep, key=run.key, pure=False): run for run in runs
            }
            stack.callback(client.cancel, list(futures))
            for future in as_completed(list(futures)):
                run = futures.pop(future)
                error = future.exception()
                if error is not None and not isinstance(error, Exception):
                    raise error
                yield run, _of_this_code(run, future.result()) if error is None else error
                future.release()

    return go


def _of_this_code(run: ExperimentRun, result: dict[str, Any]) -> dict[str, Any] | Exception:
    """The result, or an error where the worker's code makes another key of the same run."""
    if result["key"] == run.key:
        return result
    return InputError(
        f"--cluster: a worker has {result['run']['code']}, expected {run.describe()['code']}; install the same warpdef"
    )


def _connect(address: str, workers: int, stack: ExitStack) -> Any:
    from distributed import Client

    if not address:
        return stack.enter_context(Client(stack.enter_context(_local_cluster(workers, stack))))
    try:
        client = stack.enter_context(Client(address, timeout=_CONNECT_S))
    except (OSError, TimeoutError, ValueError) as error:
        text = " ".join(str(error).split())
        raise InputError(f"--cluster: {address}: no Dask scheduler answers ({text:.120}); check the address") from None
    crowded = [w for w in client.scheduler_info(n_workers=-1)["workers"].values() if w["nthreads"] != 1]
    if crowded:
        raise InputError(
            f"--cluster: expected workers with one thread each, got {crowded[0]['nthreads']} at {crowded[0]['name']}; "
            f"start them with: dask worker {address} --nthreads 1"
        )
    return client


def _local_cluster(workers: int, stack: ExitStack) -> Any:
    """Workers of this machine, for this user: all listen on loopback only, and ask for a certificate made for this run.

    Whoever reaches a scheduler may run code as its user, so other users of this machine must not.
    """
    from dask import config as dask_config  # pyright: ignore[reportPrivateImportUsage] - the documented way to it
    from distributed import LocalCluster, Security

    try:
        security = Security.temporary()
    except ImportError:
        raise MissingPackageError(
            "--workers dask needs cryptography for certificates; install it with: pip install 'warpdef[cluster]'"
        ) from None
    settings: dict[str, Any] = {
        "distributed.scheduler.allowed-failures": DEATHS_ALLOWED,
        # Without a dashboard Dask still serves pages; without routes they hold nothing.
        "distributed.scheduler.http.routes": [],
        "distributed.worker.http.routes": [],
    }
    stack.enter_context(dask_config.set(settings))  # read by the scheduler when it starts
    return LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        host=_LOOPBACK,
        protocol="tls://",
        security=security,
        # An address, not None: that would be port 8787 of all interfaces. Any free port of loopback.
        dashboard_address=f"{_LOOPBACK}:0",
        worker_dashboard_address=f"{_LOOPBACK}:0",
        # No share of memory a worker: Dask would kill a run that may well use what its neighbours do not.
        memory_limit=0,
    )


def _work(run: ExperimentRun, slots: list[Slot], device: str, threads: int | None, keep: Path | None) -> dict[str, Any]:
    """One run on whatever worker this is; a local one, numbered by its cluster, keeps to its slot."""
    from distributed import get_worker

    name = get_worker().name
    if slots and isinstance(name, int):
        slot = slots[name % len(slots)]
        if hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(0, slot.cores)  # this thread and those it starts
        device, threads = _alone(slot), len(slot.cores)
    return execute(run, device, threads, keep)


def _alone(slot: Slot) -> str:
    """The slot's device, by its name in this process, which from now on sees no other GPU.

    CUDA reads what is visible when it starts, which is with Warp: by then it is too late, but the device is the same.
    """
    from warpdef.device import warp_runs

    if not slot.visible or (warp_runs() and os.environ.get("CUDA_VISIBLE_DEVICES") != slot.visible):
        return slot.device
    os.environ["CUDA_VISIBLE_DEVICES"] = slot.visible
    return "cuda:0"
