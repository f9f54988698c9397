"""Runs over a Dask cluster: the same results as here, even when a worker is killed midway."""

from __future__ import annotations

import os
import signal
import socket
import ssl
import sys
import threading
import time
from contextlib import ExitStack
from typing import Any

import pytest
from experiment_samples import tiny_plan, write_ball

from warpdef.apps.experiments.cluster import Slot, _alone, _connect, _of_this_code, local_slots, on_cluster
from warpdef.apps.experiments.run import ExperimentRun, with_values
from warpdef.apps.experiments.session import here
from warpdef.datasets import find_sequences
from warpdef.device import find_device
from warpdef.errors import DeviceError, InputError, MissingPackageError

distributed = pytest.importorskip("distributed")
psutil = pytest.importorskip("psutil")  # comes with it


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[ExperimentRun]:
    """Four short runs, long enough for a worker to be met at work."""
    (source,) = find_sequences(write_ball(tmp_path_factory.mktemp("data")))
    plan = tiny_plan([source])
    return [plan.run(source, {"seed": seed, "optimiser.iterations": 20}) for seed in range(4)]


@pytest.fixture(scope="module")
def expected(runs: list[ExperimentRun]) -> dict[str, Any]:
    return {run.key: result["frames"] for run, result in here("cpu", 1)(runs) if not isinstance(result, Exception)}


def kill_a_busy_worker(address: str, killed: list[str]) -> None:
    """Wait until a worker is at a run, and kill its process as the kernel would when memory ends."""
    with distributed.Client(address) as client:
        pids = client.run(os.getpid)
        for _ in range(2000):
            busy = {worker: keys for worker, keys in client.processing().items() if keys}
            if busy:
                worker, keys = next(iter(busy.items()))
                killed += keys
                os.kill(pids[worker], signal.SIGKILL)
                return
            time.sleep(0.01)


def test_a_killed_worker_changes_no_result(runs: list[ExperimentRun], expected: dict[str, Any]) -> None:
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        address, killed = cluster.scheduler_address, []
        killer = threading.Thread(target=kill_a_busy_worker, args=(address, killed))
        killer.start()
        found = {run.key: result for run, result in on_cluster(address, "cpu", 1)(runs)}
        killer.join()
    assert killed and set(killed) <= set(expected), "no run was lost, so nothing was tested"
    assert set(found) == set(expected)
    for key, result in found.items():
        assert not isinstance(result, Exception), result
        assert result["frames"] == expected[key]


def test_workers_of_our_own_keep_to_their_slices(runs: list[ExperimentRun], expected: dict[str, Any]) -> None:
    (slot, *_) = local_slots("cpu", 1, 1)
    ((run, result),) = on_cluster("", "cpu", 1, 1)(runs[:1])
    assert not isinstance(result, Exception), result
    assert result["frames"] == expected[run.key] and result["threads"] == len(slot.cores) == 1


def test_an_error_of_a_run_comes_back(runs: list[ExperimentRun]) -> None:
    bad = ExperimentRun(runs[0].source, (0, 1, 99), 200, with_values(runs[0].config, {}))
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        ((_, error),) = on_cluster(cluster.scheduler_address, "cpu", 1)([bad])
    assert isinstance(error, InputError) and "frames up to 5, got 99" in str(error)


def test_a_worker_with_other_code_is_refused(runs: list[ExperimentRun]) -> None:
    result = {"key": "other", "run": {"code": "0.0.0+old"}}
    error = _of_this_code(runs[0], result)
    assert isinstance(error, InputError) and "0.0.0+old" in str(error)
    result["key"] = runs[0].key
    assert _of_this_code(runs[0], result) is result


def test_crowded_workers_are_refused(runs: list[ExperimentRun]) -> None:
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=3, processes=False, dashboard_address=None
    ) as cluster:
        with pytest.raises(InputError, match="one thread each, got 3"):
            list(on_cluster(cluster.scheduler_address)(runs))


def test_no_scheduler_at_an_address(runs: list[ExperimentRun], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("warpdef.apps.experiments.cluster._CONNECT_S", "200ms")
    for address in ("tcp://127.0.0.1:1", "not an address"):
        with pytest.raises(InputError, match="no Dask scheduler answers"):
            list(on_cluster(address)(runs))


def test_nothing_to_do_starts_nothing() -> None:
    assert list(on_cluster("tcp://127.0.0.1:1")([])) == []


def test_without_dask_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingPackageError, match=r"pip install 'warpdef\[cluster\]'"):
        on_cluster()


def test_slices_do_not_overlap(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(8)), raising=False)
    slots = local_slots("cpu", None, None)
    assert [slot.cores for slot in slots] == [(0, 1), (2, 3), (4, 5), (6, 7)]
    assert [slot.cores for slot in local_slots("cpu", 4, None)] == [(0, 1, 2, 3), (4, 5, 6, 7)]
    assert [slot.cores for slot in local_slots("cpu", 16, None)] == [tuple(range(8))]
    assert len(local_slots("cpu", None, 3)) == 3
    with pytest.raises(InputError, match="5 workers of 2 threads need 10 cores, got 8"):
        local_slots("cpu", None, 5)
    with pytest.raises(DeviceError):
        local_slots("cuda:99", None, None)


@pytest.fixture
def two_gpus(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine of eight cores and two GPUs, as Warp tells of it."""
    from types import SimpleNamespace

    import warp as wp

    gpus = {f"cuda:{i}": SimpleNamespace(alias=f"cuda:{i}", is_cuda=True) for i in range(2)}
    monkeypatch.setattr("warpdef.device.find_device", lambda name: gpus.get(name, gpus["cuda:0"]))
    monkeypatch.setattr(wp, "get_cuda_devices", lambda: list(gpus.values()))
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(8)), raising=False)
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)


@pytest.mark.parametrize("device", ["auto", "cuda"])
def test_one_worker_a_gpu(device: str, two_gpus: None, monkeypatch: pytest.MonkeyPatch) -> None:
    slots = local_slots(device, None, None)
    assert [(slot.device, slot.visible) for slot in slots] == [("cuda:0", "0"), ("cuda:1", "1")]
    assert [slot.cores for slot in slots] == [(0, 1, 2, 3), (4, 5, 6, 7)]
    assert [slot.device for slot in local_slots(device, None, 3)] == ["cuda:0", "cuda:1", "cuda:0"]
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "5, GPU-7a")  # ours are two of that machine's
    assert [slot.visible for slot in local_slots(device, None, None)] == ["5", "GPU-7a"]


def test_a_gpu_by_its_number_is_the_only_one(two_gpus: None) -> None:
    assert [(slot.device, slot.visible) for slot in local_slots("cuda:1", None, None)] == [("cuda:1", "1")]


def test_cpu_workers_see_what_they_saw() -> None:
    assert local_slots("cpu", 1, 1)[0].visible == ""


def test_a_worker_sees_its_gpu_alone() -> None:
    """Two processes, each with a device of its own, set before anything there could start CUDA; and it stays so."""
    core = min(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 0
    slots = [Slot(f"cuda:{i}", (core,), str(i)) for i in range(2)]
    with ExitStack() as stack:
        client = _connect("", len(slots), stack)
        workers = client.scheduler_info(n_workers=-1)["workers"]
        for address, worker in workers.items():
            for _ in range(2):
                told = client.submit(_on_a_slot, slots, workers=[address], pure=False).result()
                assert told == ("cuda:0", str(worker["name"]), 1)


def _tell_device(run: Any, device: str, threads: int | None, keep: Any) -> tuple[str, str, int | None]:
    return device, os.environ.get("CUDA_VISIBLE_DEVICES", ""), threads


def _on_a_slot(slots: list[Any]) -> Any:
    """In a worker: what a run there would be given."""
    from unittest import mock

    from warpdef.apps.experiments import cluster

    with mock.patch.object(cluster, "execute", _tell_device):
        return cluster._work(None, slots, "cuda", None, None)  # type: ignore[arg-type]


def test_where_warp_runs_already_the_device_keeps_its_number(monkeypatch: pytest.MonkeyPatch) -> None:
    find_device("cpu")
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    assert _alone(Slot("cuda:1", (0,), "1")) == "cuda:1" and "CUDA_VISIBLE_DEVICES" not in os.environ


def test_our_own_cluster_is_for_this_user_alone() -> None:
    """All of it listens on loopback, none on the dashboard's usual port, and who has no certificate is turned away."""
    with ExitStack() as stack:
        client = _connect("", 1, stack)
        address = client.scheduler.address
        family = [psutil.Process(), *psutil.Process().children(recursive=True)]
        listening = [c.laddr for p in family for c in p.net_connections("tcp") if c.status == psutil.CONN_LISTEN]
        assert len(listening) >= 4 and {at.ip for at in listening} == {"127.0.0.1"}
        assert 8787 not in {at.port for at in listening}
        assert address.startswith("tls://127.0.0.1:")
        context = ssl.create_default_context()
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        host, port = address.removeprefix("tls://").split(":")
        with pytest.raises((ssl.SSLError, ConnectionError)):
            with socket.create_connection((host, int(port))) as plain, context.wrap_socket(plain) as stranger:
                assert not stranger.recv(1)  # in TLS 1.3 the refusal comes with the first bytes
                raise ConnectionError("closed")
