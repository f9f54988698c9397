"""What an iteration and a round would take on an H100, by arithmetic: launches and bytes counted, rates as published.

    python tests/estimate.py

Nothing here was measured on a device. The fit goes CUDA's way on the CPU at work size (17 frames of 5,000 points,
10,242 vertices, ten levels, as the crane's), and of every launch its threads and the bytes of its arrays are written
down. A launch takes the longest of

    floor      a small dependent node of a graph
    memory     its arrays once, from the second cache if they fit there, else from memory
    own        what its own line in ``OWN`` says: gathers, exchanges within a warp, the longest of its blocks

and launches follow one another, or tasks of a phase go side by side (``fit.branches``), where a phase takes as long as
the longest of its tasks: at best, as what two of them ask of one memory is not told. ``OWN`` is where the numbers come
from; what is not there is one pass over its arrays.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any
from unittest import mock

import numpy as np
import synthetic
from descent import chained
from launches import FRAMES, KEYFRAME, Counted, Launch, counting

from warpdef.config import Config
from warpdef.device import Way, find_device, going
from warpdef.fit import workers
from warpdef.fit.optimise import Optimiser
from warpdef.fit.problem import Problem
from warpdef.fit.refine import Refinement
from warpdef.fit.workers import Team
from warpdef.kernels.clusters import CLUSTER
from warpdef.kernels.ways import LANES

FLOOR = 2.2e-6  # s: a small node of a graph that waits for the one before
SMS, CLOCK = 132, 1.7e9
L2, MEMORY, L2_BYTES = 5.5e12, 3.0e12, 50e6  # B/s, B/s, B
L2_OF_ONE = 64 * CLOCK  # B/s that one multiprocessor gets from the second cache
LATENCY = 270 / CLOCK  # s from there
SHUFFLES = SMS * CLOCK  # exchanges within a warp a second
ADDS = 48 * CLOCK  # atomic adds of up to four floats a second, to places that differ
EXCHANGES, CORNERS = 54, 8  # of a cell that a warp has in common, see ``kernels.warp_sums``
POINTS, SUBDIVISIONS = 5000, 5
ITERATIONS_OF_CG = {"frames": 23, "shape": 60, "template": (37, 6)}  # on the crane


@dataclass(frozen=True)
class Estimate:
    """each: launches with their times, s. branched: s of all of them, tasks of a phase side by side."""

    each: list[tuple[Launch, float]]
    branched: float


def _gathers(points: int, levels: int, numbers: int = 32) -> float:
    """Eight nodes a level and point, from the second cache."""
    return points * levels * 8 * numbers / L2


def _scattered(points: np.ndarray, groups: np.ndarray, resolution: np.ndarray) -> float:
    """Warps add up cell by cell: exchanges and adds for as many cells as each has."""
    warps = len(points) // 32
    cells = 0
    for n in resolution:
        low = np.clip(((points + 1) / 2 * (n - 1)).astype(int), 0, max(n - 2, 0))
        key = ((groups.astype(np.int64) * n + low[:, 0]) * n + low[:, 1]) * n + low[:, 2]
        ordered = np.sort(key[: warps * 32].reshape(warps, 32), axis=1)
        cells += int((np.diff(ordered, axis=1) != 0).sum()) + warps
    return max(cells * EXCHANGES / SHUFFLES, cells * CORNERS * 2 / ADDS)


def _searched(queries: int) -> float:
    """A chain of some twenty dependent loads a query, a kilobyte each, 1,024 threads at a time."""
    return max(-(-queries // (SMS * 1024)) * 20 * LATENCY, queries * 1024 / L2)


def _sorted(points: int, cells: int) -> float:
    """The block of a group: three passes over its points, two loads each, and one over its cells."""
    return -(-points // LANES) * 3 * 2 * LATENCY + -(-cells // (8 * LANES)) * 3 * LATENCY


def _transformed(resolution: np.ndarray, transitions: int) -> float:
    """Both solves: the longest block, or all of them over all multiprocessors.

    Of half a node of a line in a warp: products on four schedulers, and loads of 512 bytes at 128 a clock.
    """
    times = []
    for n in (int(n) for n in resolution):
        h, m = n // 2, n - n // 2
        products = m * m + h * h
        loads = 4 * (m * -(-m // 4) + h * -(-h // 4)) + 2 * 4 * n + (m * -(-m // 4) + h * -(-h // 4))
        warps = -(-2 * n * n // 32)
        times.append(2 * 6 * warps * max(products, loads) / CLOCK)
    return max(max(times) + 12 * LATENCY, transitions * sum(times) / SMS)


def _solved(steps: int, systems: int, vertices: int, numbers: int) -> float:
    """A cluster a system. A step: its bytes, through the multiprocessors of one or all; dependent loads; three waits.

    Where there are more blocks than multiprocessors some share one.
    """
    sharing = -(-systems * CLUSTER // SMS)
    through = max(vertices * numbers / CLUSTER / L2_OF_ONE * sharing, systems * vertices * numbers / L2)
    loads = -(-vertices // (256 * CLUSTER)) * 3 * LATENCY
    return steps * (max(through, loads) + 3 * 2 * LATENCY)


def own_times(problem: Problem) -> dict[str, Callable[[Launch], float]]:
    """Of kernels that do more than pass over their arrays once, by name."""
    p, resolution = problem, problem.levels.resolution
    vertices, transitions, levels = p.vertex_count, len(p.transitions), len(resolution)
    moved = p.origin.numpy(), p.moved_transition.numpy()
    template = np.tile(p.template, (transitions, 1)), np.repeat(np.arange(transitions), vertices)
    of_template = iter(ITERATIONS_OF_CG["template"] * 100)

    def systems(launch: Launch) -> float:
        steps = ITERATIONS_OF_CG["shape"] if launch.piece == "round" else next(of_template)
        return _solved(steps, 1, vertices, 6 * 16 + 12 * 12)

    return {
        "move_points": lambda a: _gathers(a.threads, levels),
        "adj_move_points": lambda a: _scattered(*moved, resolution),
        "scatter_vertices": lambda a: _scattered(*template, resolution),
        # Half of the transitions one after the other, each two dependent loads a level.
        "move_chains": lambda a: max(_gathers(vertices * transitions, levels), transitions / 2 * 2 * levels * LATENCY),
        "adj_move_chains": lambda a: transitions / 2 * 2 * LATENCY,
        "nearest": lambda a: _searched(a.threads),
        "sort_groups_in_blocks": lambda a: _sorted(a.longest, a.cells),
        "descend_in_blocks": lambda a: _transformed(resolution, transitions),
        "solve_systems": systems,
        # A step: block once and inverse twice, six neighbours, and fourteen passes over vectors.
        "solve_frames": lambda a: _solved(ITERATIONS_OF_CG["frames"], a.systems, vertices, 3 * 36 + 6 * 16 + 14 * 12),
        # Four terms an edge of a frame, from the second cache.
        "isometry": lambda a: a.threads * 12 * 12 / L2,
        "fit_rotations": lambda a: max(a.threads * 6 * 28 / L2, a.threads * 1200 / (SMS * 128 * CLOCK)),
        "rigid_rhs": lambda a: a.threads * 6 * 60 / L2,
        "rest_rhs": lambda a: 2 * FRAMES * LATENCY,
    }


def seconds_of(launch: Launch, own: dict[str, Callable[[Launch], float]]) -> float:
    memory = launch.bytes / (L2 if launch.bytes < L2_BYTES else MEMORY)
    return max(FLOOR, memory, own.get(launch.kernel, lambda _: 0.0)(launch))


@contextmanager
def telling_tasks(counted: Counted) -> Iterator[list[list[int]]]:
    """How many launches were counted when each task of each phase ended: a list a phase, with its beginning first."""
    phases: list[list[int]] = []

    def run_plain(iteration: workers.Iteration) -> None:
        for phase in iteration._phases:
            phases.append([len(counted.each)])
            for task in phase.tasks:
                task()
                phases[-1].append(len(counted.each))

    with mock.patch.object(workers.Iteration, "_run_plain", run_plain):
        yield phases


def side_by_side(seconds: list[float], phases: list[list[int]]) -> float:
    """Of launches, where a phase takes the longest of its tasks; launches outside of phases follow."""
    saved = 0.0
    for first, *ends in phases:
        tasks = [sum(seconds[a:b]) for a, b in pairwise([first, *ends])]
        saved += sum(tasks) - max(tasks, default=0.0)
    return sum(seconds) - saved


def estimates(points: int = POINTS, subdivisions: int = SUBDIVISIONS) -> dict[str, Estimate]:
    """Of an iteration, of one of the paper's descent, of a frame settled and of a round."""
    moving = synthetic.turning_ellipsoid(FRAMES, points, np.random.default_rng(0), subdivisions)
    config = Config()
    warm = replace(config, optimiser=replace(config.optimiser, warmup=1))

    def problem(of: Config) -> Problem:
        return Problem(
            moving.clouds, moving.normals, moving.vertices[KEYFRAME], moving.faces, KEYFRAME, of, find_device("cpu")
        )

    found: dict[str, Estimate] = {}
    with going(Way.WHOLE), closing(Team(1)) as team:

        def count(name: str, on: Problem, work: Callable[[], Any]) -> None:
            work()
            with counting() as counted, telling_tasks(counted) as phases:
                work()
            own = own_times(on)
            each = [(a, seconds_of(a, own)) for a in (replace(a, piece=name) for a in counted.each)]
            found[name] = Estimate(each, side_by_side([t for _, t in each], phases))

        guide = Optimiser(problem(config), 9, team)
        count("iteration", guide.problem, guide.iterate)
        guide.finish()
        stage = Refinement(guide.objective, team)
        stage.start()
        count("frame settled, a round", guide.problem, lambda: stage.settle(KEYFRAME + 1, KEYFRAME, 1))
        count("round", guide.problem, stage.run_round)
        chain = Optimiser(problem(chained(warm)), 9, team)
        chain.iterate()
        count("iteration of the paper's descent", chain.problem, chain.iterate)
    return found


def table(found: dict[str, Estimate]) -> str:
    """Markdown: a row a piece, then its kernels by their share."""
    lines = ["| | launches | MB | ms, estimated | of branches, at best |", "| --- | ---: | ---: | ---: | ---: |"]
    for name, of in found.items():
        total, megabytes = sum(t for _, t in of.each), sum(a.bytes for a, _ in of.each) / 1e6
        lines.append(f"| {name} | {len(of.each)} | {megabytes:.0f} | {1e3 * total:.2f} | {1e3 * of.branched:.2f} |")
    for name, of in found.items():
        by_kernel: dict[str, float] = defaultdict(float)
        for launch, t in of.each:
            by_kernel[launch.kernel] += 1e6 * t
        parts = sorted(by_kernel.items(), key=lambda item: -item[1])
        lines += ["", f"{name}, us: " + ", ".join(f"{kernel} {t:.0f}" for kernel, t in parts)]
    return "\n".join(lines)


if __name__ == "__main__":
    print(table(estimates()))
