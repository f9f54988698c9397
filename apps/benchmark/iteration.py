"""The whole iteration, over a real descent, and what cKDTree needs for the same iterations' neighbours alone.

The descent runs from its start to its end. At ``CHECKPOINTS`` evenly spaced places after the warm-up it pauses, and
cKDTree does the nearest-neighbour work of the iteration just done, on the same positions: it builds the trees of the
moving targets (moved clouds, vertices of all frames; the clouds' own trees stand from the start) and answers all four
sets of queries. The ratio is the mean full iteration over the mean of these, so that fast early motion and slow late
motion count as they occur.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import closing

import numpy as np
import warp as wp

from warpdef.apps.benchmark.bed import bench_config, bench_problem
from warpdef.apps.benchmark.data import Work
from warpdef.apps.benchmark.sizes import Size
from warpdef.apps.benchmark.timing import DeviceTimer, Timing
from warpdef.device import Way, is_cuda, way_of
from warpdef.fit.objective import Objective
from warpdef.fit.optimise import Optimiser
from warpdef.fit.workers import Team

CHECKPOINTS = 8
_PROFILED = 3  # iterations after each checkpoint whose launches are timed one by one, and which are not counted
_DISTANCE_TOLERANCE = 1e-5  # relative: float32 positions, distances compared in float64


class ProfilingTeam(Team):
    """A team that can tell how long each phase took, and on one thread each kernel."""

    def __init__(self, size: int) -> None:
        super().__init__(size)
        self.phases: list[list[float]] | None = None
        self.kernels: dict[tuple[int, str], float] | None = None
        self._phase = 0

    def begin(self, kernels: bool) -> None:
        """Watch the next iterations; ``next_iteration`` before each."""
        self.phases = []
        self.kernels = defaultdict(float) if kernels else None

    def next_iteration(self) -> None:
        self._phase = 0
        assert self.phases is not None, "begin() comes first"
        self.phases.append([])

    def end(self) -> None:
        """Stop watching; the results stay until the next ``begin``."""
        self.phases = self.kernels = None

    def run(self, work: list[list[wp.Launch]]) -> None:
        if self.phases is None:
            super().run(work)
            return
        start = time.perf_counter()
        if self.kernels is None:
            super().run(work)
        else:
            for commands in work:
                for command in commands:
                    before = time.perf_counter()
                    command.launch()
                    self.kernels[self._phase, kernel_name(command)] += time.perf_counter() - before
        self.phases[-1].append(time.perf_counter() - start)
        self._phase += 1


def kernel_name(command: wp.Launch) -> str:
    """The kernel's own name, without the function that made it."""
    return command.kernel.key.split("__locals__")[-1].strip("_")


class TreeWork:
    """The nearest-neighbour work of an iteration, by cKDTree."""

    def __init__(self, objective: Objective, workers: tuple[int, ...]) -> None:
        from scipy.spatial import cKDTree

        p = objective.problem
        self._objective, self._workers, self._tree = objective, workers, cKDTree
        self._clouds = np.split(p.cloud.numpy(), p.cloud_offsets[1:-1])
        self._targets = [int(t) for t in p.transitions.target]
        self._static = [cKDTree(c) for c in self._clouds]
        self._build: dict[int, list[float]] = {w: [] for w in workers}
        self._query: dict[int, list[float]] = {w: [] for w in workers}
        self._options: dict | None = None
        self.worst = 0.0
        self.runs = 0

    def build(self, workers: int) -> float:
        """Mean seconds of building."""
        return float(np.mean(self._build[workers]))

    def query(self, workers: int) -> float:
        """Mean seconds of all queries."""
        return float(np.mean(self._query[workers]))

    def run(self) -> None:
        """Do the last iteration's work once for each number of workers; notes the worst difference of a distance."""
        p, o = self._objective.problem, self._objective
        moved = np.split(o.input.points.numpy(), p.moved_offsets[1:-1])
        vertices = list(o.vertices.numpy())
        if self._options is None:
            # The peer is given whichever way of building answers sooner.
            ways = ({}, {"balanced_tree": False, "compact_nodes": False})
            most = max(self._workers)
            self._options = min(ways, key=lambda way: sum(self._once(moved, vertices, way, most)[:2]))
        for workers in self._workers:
            build, query, distances = self._once(moved, vertices, self._options, workers)
            self._build[workers].append(build)
            self._query[workers].append(query)
            self.worst = max(self.worst, self._compare(distances))
        self.runs += 1

    @property
    def built(self) -> str:
        """Which way of building was taken."""
        return "default" if not self._options else ", ".join(f"{k}={v}" for k, v in self._options.items())

    def _once(self, moved: list, vertices: list, options: dict, w: int) -> tuple[float, float, list[np.ndarray]]:
        start = time.perf_counter()
        moved_trees = [self._tree(m, **options) for m in moved]
        vertex_trees = [self._tree(v, **options) for v in vertices]
        built = time.perf_counter()
        found = [
            [self._static[t].query(m, workers=w) for m, t in zip(moved, self._targets, strict=True)],
            [tree.query(self._clouds[t], workers=w) for tree, t in zip(moved_trees, self._targets, strict=True)],
            [tree.query(v, workers=w) for tree, v in zip(self._static, vertices, strict=True)],
            [tree.query(c, workers=w) for tree, c in zip(vertex_trees, self._clouds, strict=True)],
        ]
        done = time.perf_counter()
        return built - start, done - built, [np.concatenate([d for d, _ in group]) for group in found]

    def _compare(self, theirs: list[np.ndarray]) -> float:
        p, o = self._objective.problem, self._objective
        cloud, moved = p.cloud.numpy(), o.input.points.numpy()
        vertices = o.vertices.numpy().reshape(-1, 3)
        # Clouds are asked by frame; the transitions' order is that of their targets.
        by_target = np.concatenate([np.arange(p.cloud_offsets[t], p.cloud_offsets[t + 1]) for t in self._targets])
        ours = [
            _lengths(moved, cloud, o.input.correspondences.forth.index.numpy()),
            _lengths(cloud[by_target], moved, o.input.correspondences.back.index.numpy()[by_target]),
            _lengths(vertices, cloud, o.transform.correspondences.forth.index.numpy()),
            _lengths(cloud, vertices, o.transform.correspondences.back.index.numpy()),
        ]
        return max(float(np.max(np.abs(a - b) / np.maximum(b, 1e-3))) for a, b in zip(ours, theirs, strict=True))


def _lengths(queries: np.ndarray, targets: np.ndarray, index: np.ndarray) -> np.ndarray:
    return np.linalg.norm(queries.astype(np.float64) - targets[index], axis=1)


def descend(work: Work, size: Size, device: wp.Device, threads: int, tree_workers: int) -> dict:
    """Run a whole descent and take its times; cKDTree has its turns with 1 and with ``tree_workers`` workers.

    Returns:
        ``full`` and ``warmup``: Timing of an iteration; ``total_s``; ``elements``: points and vertices moved in one;
        ``trees``: the finished TreeWork; ``phases``: milliseconds by name; ``kernels``: milliseconds by phase and
        kernel, on one CPU thread; ``losses``.
    """
    problem = bench_problem(work, bench_config(size), device)
    clock = DeviceTimer(device)
    full, warmup, phases, kernels = [], [], [], defaultdict(list)
    with closing(ProfilingTeam(threads)) as team:
        optimiser = Optimiser(problem, size.iterations, team)
        optimiser.prepare()
        trees = TreeWork(optimiser.objective, tuple(sorted({1, tree_workers})))
        names = ["advance", *(phase.name for phase in optimiser.objective.phases(False)), "descend"]
        for count, stop in _runs(size):
            watched = way_of(device) is Way.SPANS and stop == "profile"
            if watched:
                team.begin(kernels=threads == 1)
            times = []
            for _ in range(count):
                if watched:
                    team.next_iteration()
                times.append(clock.seconds(optimiser.iterate))
            if watched:
                phases.extend(team.phases or [])
                for key, seconds in (team.kernels or {}).items():
                    kernels[key].append(seconds / count)
                team.end()
            else:
                (warmup if stop == "warmup" else full).extend(times)
            if stop == "check":
                wp.synchronize_device(device)
                trees.run()
        losses = optimiser.look()
    elements = len(problem.origin) + len(problem.transitions) * problem.vertex_count
    return {
        "full": Timing.of(full),
        "warmup": Timing.of(warmup) if warmup else None,
        "elements": elements,
        "trees": trees,
        "phases": _by_phase(names, phases),
        "kernels": {
            f"{_name(names, phase)}: {kernel}": 1e3 * sum(seconds) / CHECKPOINTS
            for (phase, kernel), seconds in sorted(kernels.items())
        },
        "losses": losses,
    }


def _runs(size: Size) -> Iterator[tuple[int, str]]:
    """The descent in pieces: (iterations, what they are or what follows them)."""
    if size.warmup:
        yield size.warmup, "warmup"
    left = size.iterations - size.warmup
    each = left // CHECKPOINTS
    profiled = min(_PROFILED, max(each - 1, 0))
    for k in range(CHECKPOINTS):
        length = each + (left % CHECKPOINTS if k == CHECKPOINTS - 1 else 0)
        yield length - profiled, "check"
        if profiled:
            yield profiled, "profile"


def _name(names: list[str], phase: int) -> str:
    return names[phase] if phase < len(names) else f"phase {phase}"


def _by_phase(names: list[str], phases: list[list[float]]) -> dict[str, float]:
    if not phases:
        return {}
    return {_name(names, k): 1e3 * float(np.mean(column)) for k, column in enumerate(zip(*phases, strict=True))}


def kernel_milliseconds_cuda(work: Work, size: Size, device: wp.Device) -> dict[str, float]:
    """Milliseconds of an iteration by kernel on CUDA, from its own timers, without a graph; empty on the CPU."""
    if not is_cuda(device):
        return {}
    problem = bench_problem(work, bench_config(size), device)
    seconds: dict[str, float] = defaultdict(float)
    with closing(Team(1)) as team:
        optimiser = Optimiser(problem, size.iterations, team, capture=False)
        while optimiser.done < size.iterations // 4 + size.warmup:
            optimiser.iterate()
        wp.synchronize_device(device)
        wp.timing_begin(cuda_filter=wp.TIMING_KERNEL)
        for _ in range(_PROFILED):
            optimiser.iterate()
        for result in wp.timing_end():
            seconds[result.name] += result.elapsed / _PROFILED
    return dict(seconds)


def iteration_rows(results: dict, size: Size, threads: int) -> list[dict]:
    """The descent as rows of the table."""
    rows = []
    for name, timing in (("iteration", results["full"]), ("iteration, warm-up", results["warmup"])):
        if timing is not None:
            rate = 1e-6 * results["elements"] / timing.median
            key = {"name": name, "size": size.name, "threads": threads}
            work = {"unit": "points", "elements": results["elements"], "melements_per_s": rate}
            rows.append({**key, **work, **timing.to_json(), "peers": [], "error": None})
    return rows


def ratio_entry(results: dict, size: Size, threads: int, tree_workers: int) -> dict:
    """One full iteration against cKDTree for its neighbours, with as many workers, and against its best."""
    trees, mean = results["trees"], results["full"].mean
    build, query = trees.build(tree_workers), trees.query(tree_workers)
    best = min(trees.build(w) + trees.query(w) for w in {1, tree_workers})
    agrees = trees.worst <= _DISTANCE_TOLERANCE
    error = f"neighbours: a distance differs from cKDTree's by {trees.worst:.1e} of it"
    return {
        "size": size.name,
        "threads": threads,
        "workers": tree_workers,
        "iteration_ms": 1e3 * mean,
        "ckdtree_ms": 1e3 * (build + query),
        "ckdtree_build_ms": 1e3 * build,
        "ckdtree_query_ms": 1e3 * query,
        "ckdtree_built": trees.built,
        "ratio": mean / (build + query),
        "ratio_best": mean / best,
        "checkpoints": trees.runs,
        "difference": trees.worst,
        "error": None if agrees else error,
    }
