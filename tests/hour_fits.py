"""Parts of an hour on a device that fit: distances between its ways, time and memory, what a run must survive."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import replace
from typing import Any
from unittest import mock

import numpy as np
import warp as wp
from hour_book import Row, row
from hour_job import Job, sized, without_graphs

import warpdef
from warpdef.apps.benchmark.data import Source, Work, make_work
from warpdef.config import Config
from warpdef.device import Way, going
from warpdef.fit.optimise import Optimiser
from warpdef.fit.problem import Problem
from warpdef.fit.refine import Refinement
from warpdef.fit.workers import Team
from warpdef.mesh import MeshSequence

SAMPLES = 20_000
ORDER_MAX = 1e-4
"""Mean distance of two fits that differ by the order of sums alone, over the extent: by the emulation 1.3e-5."""
TRACKING_MAX = 0.02


def _config(job: Job, keyframe: int, **optimiser: Any) -> Config:
    """The default one with the keyframe given; where quick, few of everything."""
    base = Config()
    config = replace(base, keyframe=replace(base.keyframe, choice=str(keyframe)), drop_strays=False)
    if job.quick:
        few = {"iterations": 30, "warmup": 5, "iterations_per_frame": 0.0}
        config = replace(config, grid=replace(base.grid, levels=4), refine=replace(base.refine, iterations=6))
        optimiser = {**few, **optimiser}
    return replace(config, optimiser=replace(config.optimiser, **optimiser))


def _fit(job: Job, truth: MeshSequence, points: int, device: str = "", **how: Any) -> warpdef.Reconstruction:
    """The sequence sampled and fitted from its own mesh in the middle."""
    keyframe = len(truth) // 2
    clouds = warpdef.sample_sequence(truth, points)
    config = how.pop("config", None) or _config(job, keyframe)
    template = None if how.get("resume") else warpdef.TriMesh(truth.vertices[keyframe], truth.faces)
    callback = how.pop("callback", None)
    config = None if how.get("resume") else config
    return warpdef.reconstruct(
        clouds,
        config,
        device=device or job.device,
        threads=1 if job.quick else None,
        template=template,
        callback=callback,
        safeguards=warpdef.Safeguards(**how),
    )


def _extent(truth: MeshSequence) -> float:
    return float(np.ptp(truth.vertices.reshape(-1, 3), axis=0).max())


def _apart(a: np.ndarray, b: np.ndarray, extent: float) -> tuple[float, float]:
    """Mean and largest distance of the same vertices, over the extent."""
    distance = np.linalg.norm(np.asarray(a, np.float64) - b, axis=-1) / extent
    return float(distance.mean()), float(distance.max())


def _memory(job: Job, most: float | None = None) -> Row:
    used = job.used_mb()
    return row("memory at most", "not counted" if used is None else used, "" if used is None else "MB", used and most)


def chamfer(found: MeshSequence, truth: MeshSequence) -> float:
    """Mean over frames of both mean squared distances between samples of the surfaces, extent 1; in 1e-5."""
    from scipy.spatial import cKDTree

    from warpdef.geometry.sampling import sample_surface

    total, extent = [], _extent(truth)
    for t in range(len(truth)):
        clouds = [
            sample_surface(m.vertices[t] / extent, m.faces, SAMPLES, np.random.default_rng([seed, t]))[0]
            for seed, m in enumerate((found, truth))
        ]
        total += [sum(float((cKDTree(a).query(b)[0] ** 2).mean()) for a, b in (clouds, clouds[::-1]))]
    return 1e5 * float(np.mean(total))


def fit_four(device: str) -> None:
    """A short fit of four frames with both stages, for tools that watch."""
    from pathlib import Path

    job = Job(device, True, Path())
    _fit(job, job.truth(4), 500)


def part_e(job: Job) -> list[Row]:
    """The same fit on the CPU, and on the device as graphs, as graphs again, and launch by launch."""
    truth = job.truth(job.size.frames)
    ways: dict[str, tuple[str, Callable[[], AbstractContextManager]]] = {"CPU": ("cpu", nullcontext)}
    if job.cuda:
        graphs = (job.device, nullcontext)
        ways |= {"graphs": graphs, "graphs again": graphs, "plain": (job.device, without_graphs)}
    else:
        whole = ("cpu", lambda: going(Way.WHOLE))
        ways |= {"whole": whole, "whole again": whole}
    rows, found = [], {}
    extent = _extent(truth)
    for name, (device, way) in ways.items():
        with way():
            result = found[name] = _fit(job, truth, job.size.points, device)
        seconds = result.report["seconds"]
        rows += [row(f"{name}: {phase}", seconds[phase], "s") for phase in ("compile", "optimise", "refine", "assess")]
        rows.append(
            row(
                f"{name}: tracking",
                _apart(result.vertices, truth.vertices, extent)[0],
                "",
                None if job.quick else TRACKING_MAX,
            )
        )
        if result.report["device_memory"]:
            rows.append(
                row(f"{name}: memory so far", result.report["device_memory"]["peak_mb"] or "not counted", "MiB")
            )
        rows.append(row(f"{name}: CD", chamfer(MeshSequence(result.vertices, result.faces), truth), "1e-5"))
    rows.append(row("floor of CD", chamfer(truth, MeshSequence(truth.vertices, truth.faces)), "1e-5"))
    others = list(found)[1:]
    for a, b in [("CPU", other) for other in others] + [(others[0], other) for other in others[1:]]:
        mean, largest = _apart(found[a].vertices, found[b].vertices, extent)
        rows += [
            row(f"{a} to {b}, mean", mean, "of the extent", None if job.quick else ORDER_MAX),
            row(f"{a} to {b}, largest", largest),
        ]
    return rows


class _Bench:
    """Both stages on a problem, timed call by call."""

    def __init__(self, job: Job, work: Work, config: Config) -> None:
        from warpdef.apps.benchmark.timing import DeviceTimer

        self.team = Team(1)
        self.problem = Problem(work.clouds, work.normals, work.vertices, work.faces, work.keyframe, config, job.target)
        self.optimiser = Optimiser(self.problem, config.optimiser.total(len(work.clouds)), self.team)
        self.optimiser.prepare()
        self._clock = DeviceTimer(job.target)

    def iterations(self, count: int) -> list[float]:
        """Milliseconds of each."""
        return [1e3 * self._clock.seconds(self.optimiser.iterate) for _ in range(count)]

    def rounds(self, count: int) -> tuple[list[float], float]:
        """Milliseconds of rounds, and of settling one frame by five of them."""
        self.optimiser.finish()
        stage = Refinement(self.optimiser.objective, self.team)
        stage.prepare()
        stage.start()
        key = self.problem.transitions.keyframe
        alone = [self._clock.seconds(lambda: stage.settle(key - 1, key, 5)) for _ in range(3)]
        return [1e3 * self._clock.seconds(stage.run_round) for _ in range(count)], 1e3 * min(alone)


def part_f(job: Job) -> list[Row]:
    """An iteration of the default descent and of the paper's, a round, a frame settled, and memory."""
    from warpdef.memory import estimate_memory

    work = make_work(Source("", job.truth(job.size.frames)), job.size)
    rows, count = [], 20 if job.quick else 200
    for name, chain in (("default", False), ("the paper's", True)):
        config = _config(job, work.keyframe, chain=chain, warmup=2, iterations=count)
        bench = _Bench(job, work, config)
        with closing(bench.team):
            times = bench.iterations(count)[count // 4 :]
            rows += [
                row(f"iteration, {name}", float(np.median(times)), "ms", 1.5),
                row("... 9th decile", float(np.quantile(times, 0.9)), "ms"),
            ]
            if not chain:
                rounds, settled = bench.rounds(6 if job.quick else 30)
                rows += [
                    row("a round", float(np.median(rounds[2:])), "ms"),
                    row("a frame settled in five rounds", settled, "ms"),
                ]
    sizes = [len(c) for c in work.clouds]
    estimate = estimate_memory(sizes, len(work.vertices), _config(job, 0), job.cuda)
    return [
        *rows,
        row("memory estimated", estimate.device / 1e6, "MB"),
        _memory(job),
    ]


def part_h(job: Job) -> list[Row]:
    """Ten iterations and two rounds of a hundred frames of 100,000 points and vertices."""
    from warpdef.apps.benchmark.sizes import LARGEST
    from warpdef.memory import estimate_memory

    size = sized(job.size, frames=6, points=1_000, vertices=2_000) if job.quick else LARGEST
    frames = job.size.frames
    work = make_work(Source("", job.truth(frames)).retimed(frames, size.frames), size)
    config = _config(job, work.keyframe, warmup=0, points=0, iterations=10)
    estimate = estimate_memory([len(c) for c in work.clouds], len(work.vertices), config, job.cuda)
    bench = _Bench(job, work, config)
    with closing(bench.team):
        times, (rounds, settled) = bench.iterations(10), bench.rounds(2)
    return [
        row("iteration", float(np.median(times[2:])), "ms"),
        row("a round", rounds[-1], "ms"),
        row("a frame settled in five rounds", settled, "ms"),
        row("memory estimated", estimate.device / 1e6, "MB"),
        _memory(job, estimate.device / 1e6),
    ]


class _Cut(Exception):
    """The run ends here, without a word."""


def part_i(job: Job) -> list[Row]:
    """A run gone on with, one that meets NaN and goes back, one interrupted while it replays."""
    truth, points = job.truth(4 if job.quick else 9), job.size.points
    extent, kept = _extent(truth), job.folder / "cut"
    whole, again = (_fit(job, truth, points) for _ in range(2))
    order = _apart(whole.vertices, again.vertices, extent)[0]
    total = whole.report["iterations"]

    def cut(progress: warpdef.Progress) -> None:
        if progress.phase == "optimise" and progress.iteration >= total // 2:
            raise _Cut

    with mock.patch("warpdef.fit.saving._SHARE", 1e9):
        try:
            _fit(job, truth, points, callback=cut, checkpoint=kept, checkpoint_seconds=0.0)
            raise RuntimeError("the run was not cut")
        except _Cut:
            pass
    resumed = _fit(job, truth, points, resume=kept)
    kept.unlink(missing_ok=True)
    apart = _apart(whole.vertices, resumed.vertices, extent)[0]
    rows = [
        row("two runs apart, mean", order, "of the extent"),
        row("a run gone on with apart, mean", apart, "of the extent", 3 * order + 1e-7),
        row("... from iteration", resumed.report["resumed"][0]),
    ]

    poisoned, iterate = [0], Optimiser.iterate

    def poison(self: Optimiser) -> None:
        iterate(self)
        if self.done == total // 2 and not poisoned[0]:
            poisoned[0] = 1
            self.grids.u.fill_(float("nan"))

    with mock.patch.object(Optimiser, "iterate", poison):
        found = _fit(job, truth, points)
    undone = [w for w in found.report["warnings"] if "left the finite numbers and were undone" in w]
    if not (np.isfinite(found.vertices).all() and undone):
        raise AssertionError(f"NaN was not undone: {found.report['warnings']}")
    rows.append(row("NaN undone, tracking", _apart(found.vertices, truth.vertices, extent)[0]))

    sent: list[threading.Timer] = []

    def interrupt(progress: warpdef.Progress) -> None:
        if progress.phase == "optimise" and progress.iteration and not sent:
            # From outside, while iterations run on.
            sent.append(threading.Timer(1e-3, os.kill, (os.getpid(), signal.SIGINT)))
            sent[0].start()

    found = _fit(job, truth, points, callback=interrupt)
    if not (found.report["interrupted"] and np.isfinite(found.vertices).all()):
        raise AssertionError(f"the interrupt was not heard: {found.report['stopped']}")
    wp.synchronize_device(job.target)
    return [*rows, row("interrupted at iteration", found.report["iterations"])]


def part_j(job: Job) -> list[Row]:
    """Three hundred frames, each fitted from its neighbour."""
    frames, points = (12, 300) if job.quick else (300, 2_000)
    truth = MeshSequence(*_coarse(job, frames))
    result = _fit(job, truth, points, config=_config(job, frames // 2, **({} if job.quick else {"iterations": 100})))
    seconds, followed = result.report["seconds"], len(result.report["refine"]["frames_followed"])
    apart = np.linalg.norm(result.vertices - truth.vertices, axis=2).mean(axis=1) / _extent(truth)
    return [
        row("frames followed", followed),
        row("optimise", seconds["optimise"], "s"),
        row("refine", seconds["refine"], "s"),
        row("refine, a frame", 1e3 * seconds["refine"] / frames, "ms"),
        row("tracking, mean", float(apart.mean())),
        row("tracking, worst frame", float(apart.max())),
        _memory(job),
    ]


def _coarse(job: Job, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """The sequence, or as many frames of the figure as there must be, in few triangles."""
    from bare_figure import bare_figure

    mesh = bare_figure(frames, 0.08 if job.quick else 0.05)
    return mesh.vertices, mesh.faces
