"""Memory that runs out all the same: which flags are named, what is tried again, and what the report says of it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
import synthetic
import warp as wp

import warpdef
from warpdef import shortage
from warpdef.config import Config
from warpdef.errors import DeviceError, OutOfMemory
from warpdef.fit.optimise import Optimiser
from warpdef.memory import estimate_memory
from warpdef.shortage import device_memory, explained_shortage, retried, with_fewer_points

CPU = wp.get_device("cpu")
FULL = "Failed to allocate 4096 bytes on device 'cuda:0'"


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        RuntimeError("Failed to allocate 1073741824 bytes on device 'cuda:0'"),
        RuntimeError("Warp CUDA error 2: out of memory (in function ...)"),
    ],
)
def test_running_out_names_the_flags_that_help(error: Exception) -> None:
    estimate = estimate_memory([5000] * 17, 10_000, Config())
    with (
        pytest.raises(DeviceError, match="--points, --optimiser.points, --template.faces-max or --grid.levels"),
        explained_shortage(estimate, CPU),
    ):
        raise error


def test_other_errors_stay_what_they_are() -> None:
    with (
        pytest.raises(RuntimeError, match="something else"),
        explained_shortage(estimate_memory([10], 10, Config()), CPU),
    ):
        raise RuntimeError("something else")


def test_running_out_in_the_middle(rng: np.random.Generator, monkeypatch) -> None:
    def full(self) -> None:
        raise RuntimeError("Failed to allocate 4096 bytes on device 'cuda:0'")

    monkeypatch.setattr(Optimiser, "iterate", full)
    moving = synthetic.turning_ellipsoid(3, 200, rng)
    template = warpdef.TriMesh(moving.vertices[1], moving.faces)
    with pytest.raises(DeviceError, match="out of memory on .*: the run needs about"):
        warpdef.reconstruct(np.stack(moving.clouds), device="cpu", template=template, threads=1)


# Another try.


def card(free: int = 3 << 30, pool: bool = True) -> wp.Device:
    """A device of 8 GiB."""
    told = SimpleNamespace(
        is_cuda=True,
        is_cpu=False,
        name="Card",
        alias="cuda:0",
        free_memory=free,
        total_memory=8 << 30,
        is_mempool_enabled=pool,
    )
    return cast(wp.Device, told)


def grids_on(points: int) -> Config:
    return replace(Config(), optimiser=replace(Config().optimiser, points=points))


def test_fewer_points_only_where_that_frees_enough() -> None:
    many, few = [100_000] * 20, [5_000] * 17
    estimates = [estimate_memory(sizes, 10_000, Config(), True) for sizes in (many, few)]
    for before, after in ((0, 25_000), (40_000, 10_000), (10**6, 25_000)):
        found = with_fewer_points(many, grids_on(before), estimates[0])
        assert found == grids_on(after)
    assert with_fewer_points(many, grids_on(shortage.FEWEST), estimates[0]) is None
    assert with_fewer_points(few, Config(), estimates[1]) is None


def run_out_until(points: int, tried: list[int]):
    """A run that has enough memory for so many points; notes what was tried."""

    def run(config: Config, told: list[str]) -> list[str]:
        tried.append(config.optimiser.points)
        with explained_shortage(ESTIMATE, card()):
            if config.optimiser.points == 0 or config.optimiser.points > points:
                raise RuntimeError(FULL)
        return list(told)

    return run


SIZES = [100_000] * 20
ESTIMATE = estimate_memory(SIZES, 10_000, Config(), True)


def test_a_run_begins_again_and_says_so() -> None:
    tried: list[int] = []
    told = retried(run_out_until(8_000, tried), grids_on(0), SIZES, ESTIMATE, card())
    assert tried == [0, 25_000, 6_250]
    assert "begun again with --optimiser.points 25000 instead of 100000" in told[0] and FULL in told[0]
    assert "--optimiser.points 6250 instead of 25000" in told[1]


def test_in_the_end_it_gives_up_and_names_the_flags() -> None:
    tried: list[int] = []
    with pytest.raises(OutOfMemory, match="out of memory on Card .*3.0 are free now. Lower --points.*--device cpu"):
        retried(run_out_until(1, tried), grids_on(0), SIZES, ESTIMATE, card())
    assert tried[0] == 0 and len(tried) < 5


def test_the_cpu_is_not_tried_again() -> None:
    tried: list[int] = []
    with pytest.raises(OutOfMemory):
        retried(run_out_until(1, tried), grids_on(0), SIZES, ESTIMATE, CPU)
    assert tried == [0]


def test_other_errors_are_not_tried_again() -> None:
    tried: list[int] = []

    def run(config: Config, told: list[str]) -> None:
        tried.append(config.optimiser.points)
        raise DeviceError("another")

    with pytest.raises(DeviceError, match="another"):
        retried(run, grids_on(0), SIZES, ESTIMATE, card())
    assert tried == [0]


def test_a_whole_run_that_began_again_is_that_of_fewer_points(monkeypatch: pytest.MonkeyPatch) -> None:
    """The report says it, the configuration is the one that was run, and the result is that one's."""
    moving = synthetic.turning_ellipsoid(3, 400, np.random.default_rng(0))
    template = warpdef.TriMesh(moving.vertices[1], moving.faces)
    short = replace(Config(), optimiser=replace(Config().optimiser, iterations=10, warmup=2, points=0))
    expected = warpdef.reconstruct(
        moving.clouds, replace(short, optimiser=replace(short.optimiser, points=100)), device="cpu", template=template
    )
    monkeypatch.setattr(shortage, "is_cuda", lambda device: True)
    monkeypatch.setattr(shortage, "FEWEST", 100)
    monkeypatch.setattr(shortage, "_WORTH", 0.0)
    iterate, begun = Optimiser.iterate, []

    def full(self: Optimiser) -> None:
        begun.append(len(self.problem.sample.points))
        if begun[-1] == 1200 and self.done == 4:
            raise RuntimeError(FULL)
        iterate(self)

    monkeypatch.setattr(Optimiser, "iterate", full)
    found = warpdef.reconstruct(moving.clouds, short, device="cpu", template=template)
    assert set(begun) == {1200, 300} and found.config.optimiser.points == 100
    np.testing.assert_array_equal(found.vertices, expected.vertices)
    (warning,) = (w for w in found.report["warnings"] if "begun again" in w)
    assert "--optimiser.points 100 instead of 400" in warning


# The report.


def test_a_report_tells_of_the_device(monkeypatch: pytest.MonkeyPatch) -> None:
    assert device_memory(CPU) is None
    monkeypatch.setattr(wp, "get_mempool_used_mem_high", lambda device: 300 << 20)
    assert device_memory(card()) == {"peak_mb": 300.0, "pool": True, "used_mb": 5120.0, "total_mb": 8192.0}
    assert device_memory(card(pool=False)) == {"peak_mb": None, "pool": False, "used_mb": 5120.0, "total_mb": 8192.0}
