"""What the rows of ``warpdef bench`` stand on: a problem some way into its descent, and cases to be timed on it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace

import numpy as np
import warp as wp

from warpdef.apps.benchmark.data import Work
from warpdef.apps.benchmark.sizes import Size
from warpdef.config import Config
from warpdef.fit.optimise import Optimiser
from warpdef.fit.problem import Problem
from warpdef.fit.workers import Iteration, Phase, Task, Team
from warpdef.kernels.levels import node8
from warpdef.kernels.motion import adj_move_points, scatter_vertices

Answer = np.ndarray | tuple[np.ndarray, ...]
_SNAPSHOTS = 12


@dataclass(frozen=True)
class Peer:
    """Somebody else's way to the same answer (an array, or a few).

    run: (workers) -> the answer, comparable with the case's; workers is 1 or all. parallel: whether workers matter.
    timed: what to time if not ``run``, such as a solve without its factorisation.
    """

    name: str
    run: Callable[[int], Answer]
    parallel: bool = False
    timed: Callable[[int], object] | None = None


def difference(ours: Answer, theirs: Answer) -> float:
    """Distance of two answers over the length of the second; the worst where they have several parts."""
    if isinstance(ours, tuple):
        return max(difference(a, b) for a, b in zip(ours, theirs, strict=True))
    ours, theirs = np.asarray(ours, dtype=np.float64).ravel(), np.asarray(theirs, dtype=np.float64).ravel()
    if ours.shape != theirs.shape:
        return float("inf")
    apart, length = np.linalg.norm(ours - theirs), np.linalg.norm(theirs)
    return float(apart / length) if length > 0 else float(apart > 0)


@dataclass(frozen=True)
class Case:
    """One thing to time.

    elements: how many are treated, named by unit. bytes: array bytes that must be read or written once, gathers counted
    as the array gathered from. flops: floating-point operations, by hand, 0 where they depend on the data.
    tasks: what a team shares. before: untimed, ahead of each launch. answer: our result from a fresh start.
    tolerance: largest difference from a peer's answer, relative, in the Euclidean norm.
    """

    name: str
    unit: str
    elements: int
    bytes: int
    tasks: list[Task]
    flops: int = 0
    before: Callable[[], None] | None = None
    answer: Callable[[], Answer] | None = None
    peers: list[Peer] = field(default_factory=list)
    tolerance: float = 1e-4


def bench_config(size: Size) -> Config:
    """The default configuration with the paper's descent, and this size's levels and iterations."""
    base = Config()
    descent = replace(base.optimiser, chain=True, points=0, iterations_per_frame=0.0)
    return replace(
        base,
        grid=replace(base.grid, levels=size.levels),
        optimiser=replace(descent, iterations=size.iterations, warmup=size.warmup),
    )


def bench_problem(work: Work, config: Config, device: wp.Device) -> Problem:
    """The problem of a run on this work."""
    return Problem(work.clouds, work.normals, work.vertices, work.faces, work.keyframe, config, device)


class Bed:
    """A problem a quarter into its descent, the last iterations of which are kept to be played back.

    gradient: of the nodes, (S, M, 8) float32. moved_path, vertex_path: positions in consecutive iterations,
    (iterations, N, 3) and (iterations, T V, 3) float32.
    """

    def __init__(self, work: Work, size: Size, device: wp.Device, threads: int) -> None:
        self.size, self.device = size, device
        self.problem = bench_problem(work, bench_config(size), device)
        moved, vertices = [], []
        with closing(Team(threads)) as team:
            optimiser = Optimiser(self.problem, size.iterations, team)
            settle = max(size.warmup + 1, size.iterations // 4)
            while optimiser.done < settle + _SNAPSHOTS:
                optimiser.iterate()
                if optimiser.done > settle:
                    moved.append(optimiser.objective.input.points.numpy().copy())
                    vertices.append(optimiser.objective.vertices.numpy().reshape(-1, 3).copy())
        self.objective, self.nodes = optimiser.objective, optimiser.nodes
        self.moved_path, self.vertex_path = np.stack(moved), np.stack(vertices)
        self.levels = self.objective.chain.levels
        self.gradient = self._gradient()

    def _gradient(self) -> np.ndarray:
        p, o = self.problem, self.objective
        out = wp.zeros_like(self.nodes)
        adj_move_points(
            0, len(o.input.points), self.levels, p.origin, p.moved_transition, o.input.rotation, o.input.adj_points, out
        )
        count, sources = len(p.transitions) * p.vertex_count, p.integers(p.transitions.source)
        scatter_vertices(0, count, self.levels, sources, o.vertices, o.chain.adj_motion, out)
        return out.numpy()

    def zeros(self, like: wp.array) -> wp.array:
        return wp.zeros_like(like)

    def node_array(self, values: np.ndarray | None = None) -> wp.array:
        """An array shaped like the nodes, zero or with these values."""
        if values is None:
            return wp.zeros(self.nodes.shape, dtype=node8, device=self.device)
        return wp.array(np.ascontiguousarray(values, dtype=np.float32), dtype=node8, device=self.device)

    def path(self, positions: np.ndarray) -> list[wp.array]:
        """Snapshots as vec3 arrays on the device."""
        return [self.problem.vectors(p) for p in positions]

    # How an iteration divides its work among threads, and so how the rows do; on CUDA all at once.

    def transition_tasks(self, call: Callable[[int, int], None]) -> list[Task]:
        """``call(first, last)`` a transition."""
        return [_later(call, a, b) for a, b in self._singles(len(self.problem.transitions))]

    def frame_tasks(self, call: Callable[[int, int], None]) -> list[Task]:
        """``call(first, last)`` a frame."""
        return [_later(call, a, b) for a, b in self._singles(self.problem.frame_count)]

    def span_tasks(self, call: Callable[[int, int], None], first_of: np.ndarray) -> list[Task]:
        """``call(begin, count)`` a run of elements, runs given by their first elements and the last's end."""
        runs = self._singles(len(first_of) - 1)
        return [_later(call, int(first_of[a]), int(first_of[b] - first_of[a])) for a, b in runs]

    def vertex_tasks(self, call: Callable[[int, int], None]) -> list[Task]:
        """``call(begin, count)`` a range of template vertices."""
        return [_later(call, a, b - a) for a, b in self.problem.vertex_spans()]

    def _singles(self, count: int) -> list[tuple[int, int]]:
        return self.problem.way.cut(count)


def _later(call: Callable[[int, int], None], a: int, b: int) -> Task:
    return lambda: call(a, b)


@contextmanager
def teams(threads: tuple[int, ...]) -> Iterator[dict[int, Team]]:
    """A team for each thread count; closed at the end."""
    made = {count: Team(count) for count in threads}
    try:
        yield made
    finally:
        for team in made.values():
            team.close()


def runner(case: Case, device: wp.Device, team: Team) -> Callable[[], None]:
    """The case as an iteration would run it: recorded and shared on the CPU, one graph on CUDA."""
    return Iteration([Phase(case.name, case.tasks)], device, team).run


def run_tasks(tasks: list[Task]) -> None:
    """Launch at once, in order."""
    for task in tasks:
        task()
