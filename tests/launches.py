"""How many launches and allocations a piece of the fit takes the way of CUDA, counted on the CPU.

    python tests/launches.py

A launch on a device costs some two microseconds even where it has nothing to do, and an allocation inside a captured
graph needs memory pools. Both can be counted without a device: the CPU is made to go CUDA's way, and what it asks of
Warp is written down. A prefix sum of Warp's counts as its two launches and the scratch memory that it takes on CUDA.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from typing import Any
from unittest import mock

import numpy as np
import synthetic
import warp as wp
from descent import chained

from warpdef.config import Config
from warpdef.device import Way, find_device, going
from warpdef.fit.optimise import Optimiser
from warpdef.fit.problem import Problem
from warpdef.fit.refine import Refinement
from warpdef.fit.workers import Team
from warpdef.geometry.denoise import Scattered

FRAMES, KEYFRAME = 17, 8  # as the sequences of the results have: what goes frame by frame must show
LEVELS, SUBDIVISIONS, POINTS = 3, 2, 400  # of half a cloud enough must be left that it is judged


@dataclass(frozen=True)
class Launch:
    """One of a kernel. bytes: of the arrays among its arguments, views once. piece: of the fit.

    systems: of a kernel for blocks. longest, cells: where points are sorted, those of the largest group, and cells of a
    group; else 0.
    """

    kernel: str
    threads: int
    bytes: int
    systems: int = 0
    longest: int = 0
    cells: int = 0
    piece: str = ""


@dataclass
class Counted:
    """launches: of each kernel, by its name; each: of kernels, in order. allocations: of device memory.

    reads, writes: arrays that the host asked for, each of which waits for the device, and that it filled.
    """

    launches: Counter[str] = field(default_factory=Counter)
    each: list[Launch] = field(default_factory=list)
    allocations: int = 0
    reads: int = 0
    writes: int = 0

    @property
    def total(self) -> int:
        return self.launches.total()


def _arrays(kernel: wp.Kernel, inputs: Sequence[Any]) -> dict[str, wp.array]:
    """Arrays among the inputs of a launch, those in structs, too, by name."""
    found: dict[str, wp.array] = {}

    def look(name: str, value: Any) -> None:
        if isinstance(value, wp.array):
            found[name] = value
        elif hasattr(value, "_cls"):
            for member in value._cls.vars:
                look(f"{name}.{member}", getattr(value, member))

    for argument, value in zip(kernel.adj.args, inputs, strict=True):
        look(argument.label, value)
    return found


@contextmanager
def counting() -> Iterator[Counted]:
    """Count what the block asks of Warp on the CPU; kernels run as ever."""
    counted = Counted()

    def count(name: Callable[..., str], real: Callable[..., Any], times: int = 1) -> Callable[..., Any]:
        def counting_one(*args: Any, **kwargs: Any) -> Any:
            counted.launches[name(*args, **kwargs)] += times
            return real(*args, **kwargs)

        return counting_one

    allocator = wp.get_device("cpu").default_allocator
    allocate, scan = allocator.allocate, wp.utils.array_scan

    def counting_memory(size: int) -> Any:
        counted.allocations += 1
        return allocate(size)

    def counting_scan(*args: Any, **kwargs: Any) -> Any:
        counted.allocations += 1
        return count(lambda *_, **__: "array_scan", scan, 2)(*args, **kwargs)

    read, write = wp.array.numpy, wp.array.assign

    def counting_reads(array: wp.array) -> Any:
        counted.reads += 1
        return read(array)

    def counting_writes(array: wp.array, source: Any) -> Any:
        counted.writes += 1
        return write(array, source)

    def kernel_of(kernel: wp.Kernel, dim: Any, inputs: Sequence[Any], block_dim: int = 0, **_: Any) -> str:
        name, arrays = kernel.func.__name__.lstrip("_"), _arrays(kernel, inputs)
        size = sum({a.ptr: a.size * wp.types.type_size_in_bytes(a.dtype) for a in arrays.values()}.values())
        longest, cells = 0, 0
        if name.startswith("sort_groups"):
            longest, cells = int(np.diff(read(arrays["offset"])).max()), arrays["start_out"].shape[1]
        threads = int(np.prod(dim))
        counted.each.append(Launch(name, threads, size, threads // block_dim if block_dim else 0, longest, cells))
        return name

    with (
        mock.patch.object(wp, "launch", count(kernel_of, wp.launch)),
        mock.patch.object(wp, "copy", count(lambda *_, **__: "copy", wp.copy)),
        mock.patch.object(wp.utils, "array_scan", counting_scan),
        mock.patch.object(wp.array, "fill_", count(lambda *_, **__: "fill", wp.array.fill_)),
        mock.patch.object(wp.array, "zero_", count(lambda *_, **__: "fill", wp.array.zero_)),
        mock.patch.object(wp.array, "numpy", counting_reads),
        mock.patch.object(wp.array, "assign", counting_writes),
        mock.patch.object(allocator, "allocate", counting_memory),
    ):
        yield counted


def small_grids() -> Config:
    """The default configuration on a few levels."""
    return replace(Config(), grid=replace(Config().grid, levels=LEVELS))


def example_problem(config: Config, partial: bool = False, **how: Any) -> Problem:
    """A turning ellipsoid; ``partial``: one frame shows half of the surface. ``how``: what else a problem is told."""
    moving = synthetic.turning_ellipsoid(FRAMES, POINTS, np.random.default_rng(0), subdivisions=SUBDIVISIONS)
    clouds, normals = moving.clouds, moving.normals
    if partial:
        seen = [cloud[:, 0] < (0.1 if t == FRAMES - 2 else 9.0) for t, cloud in enumerate(clouds)]
        clouds, normals = ([a[s] for a, s in zip(arrays, seen, strict=True)] for arrays in (clouds, normals))
    template = moving.vertices[KEYFRAME]
    return Problem(clouds, normals, template, moving.faces, KEYFRAME, config, find_device("cpu"), **how)


def noisy_problem(config: Config, seed: int = 0) -> Problem:
    """The same, measured with wide noise."""
    rng = np.random.default_rng(seed)
    clouds = synthetic.turning_ellipsoid(FRAMES, POINTS, rng, subdivisions=SUBDIVISIONS).clouds
    scattered = [Scattered(cloud + rng.normal(scale=0.1, size=cloud.shape), 0.1) for cloud in clouds]
    return example_problem(config, scattered=scattered)


def _counted(work: Callable[[], object]) -> Counted:
    """Of the second time: the first may lay out what later ones use again."""
    work()
    with counting() as counted:
        work()
    return counted


def count_all(partial: bool = False) -> dict[str, Counted]:
    """Of an iteration of the default fit, one of the paper's descent, a round, and one frame settled by one round.

    partial: one frame shows half of the surface.
    """
    config = small_grids()
    warm = replace(config, optimiser=replace(config.optimiser, warmup=1))
    with going(Way.WHOLE), closing(Team(1)) as team:
        guide = Optimiser(example_problem(config, partial), 9, team)
        chain = Optimiser(example_problem(chained(warm), partial), 9, team)
        chain.iterate()  # the warm-up
        guided = _counted(guide.iterate)
        guide.finish()
        refinement = Refinement(guide.objective, team)
        refinement.start()
        return {
            "iteration": guided,
            "iteration of the paper's descent": _counted(chain.iterate),
            "frame settled, a round": _counted(lambda: refinement.settle(KEYFRAME + 1, KEYFRAME, 1)),
            "round": _counted(refinement.run_round),
        }


def count_rounds(problem: Problem, team: Team) -> dict[str, Counted]:
    """Of a frame settled by one round, of a round, and of one that smooths in time, which may be the same."""
    guide = Optimiser(problem, 9, team)
    guide.finish()
    refinement = Refinement(guide.objective, team)
    refinement.start()
    counts = {
        "frame settled, a round": _counted(lambda: refinement.settle(KEYFRAME + 1, KEYFRAME, 1)),
        "round": _counted(refinement.run_round),
    }
    refinement.done = refinement.config.iterations
    return {**counts, "late round": _counted(refinement.run_round)}


def table(counts: dict[str, Counted]) -> str:
    """Markdown: a row a piece of the fit, then what it launches."""
    lines = ["| | launches | allocations |", "| --- | ---: | ---: |"]
    lines += [f"| {name} | {c.total} | {c.allocations} |" for name, c in counts.items()]
    for name, c in counts.items():
        kernels = ", ".join(f"{kernel} {n}" if n > 1 else kernel for kernel, n in c.launches.most_common())
        lines += ["", f"{name}: {kernels}"]
    return "\n".join(lines)


if __name__ == "__main__":
    print(table(count_all()))
