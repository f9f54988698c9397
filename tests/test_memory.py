"""Memory: the estimate against what is really allocated, what is free, and refusals that say what would fit."""

from __future__ import annotations

import gc
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import synthetic
import warp as wp

import warpdef
from warpdef import memory, pipeline
from warpdef.config import Config
from warpdef.errors import InputError
from warpdef.fit.optimise import Optimiser
from warpdef.fit.pool import Pool
from warpdef.fit.problem import Problem
from warpdef.fit.refine import Refinement
from warpdef.fit.workers import Team
from warpdef.memory import (
    GIB,
    estimate_memory,
    pooled_bytes,
    require_memory,
    vertices_most,
)
from warpdef.presets import preset

CPU = wp.get_device("cpu")


def allocated() -> int:
    """Bytes of all Warp arrays there are, views counted once."""
    gc.collect()
    arrays = [a for a in gc.get_objects() if type(a) is wp.array]
    spans = sorted((a.ptr, a.ptr + a.size * wp.types.type_size_in_bytes(a.dtype)) for a in arrays if a.ptr)
    total = end = 0
    for first, last in spans:
        total += max(last - max(first, end), 0)
        end = max(end, last)
    return total


@pytest.mark.parametrize("base", ["default", "paper"])
@pytest.mark.parametrize(("frames", "points", "subdivisions", "levels"), [(3, 400, 3, 8), (8, 3000, 4, 4)])
def test_the_estimate_is_what_is_allocated(base: str, frames: int, points: int, subdivisions: int, levels: int) -> None:
    config = preset(base)
    config = replace(config, grid=replace(config.grid, levels=levels, prune=False))
    moving = synthetic.turning_ellipsoid(frames, points, np.random.default_rng(0), subdivisions)
    before = allocated()
    problem = Problem(moving.clouds, moving.normals, moving.vertices[1], moving.faces, 1, config, CPU)
    optimiser = Optimiser(problem, 10, Team(1))
    optimiser.keep()
    state = {}
    if config.refine.iterations:
        refinement = Refinement(optimiser.objective, Team(1))
        state = {name: wp.clone(a) for name, a in refinement.state().items()}
    found = allocated() - before
    estimate = estimate_memory([points] * frames, problem.vertex_count, config)
    assert 0.75 * found < estimate.device < 1.4 * found, (found, estimate)
    assert bool(state) == bool(config.refine.iterations)
    assert dict(problem.pool.bytes) == pooled_bytes([points] * frames, problem.vertex_count, config)


@pytest.mark.parametrize("fitted", [2900, 300])
def test_only_points_that_grids_are_fitted_to_cost_what_these_do(fitted: int) -> None:
    config = replace(Config(), grid=replace(Config().grid, levels=4))
    whole, config = config, replace(config, optimiser=replace(config.optimiser, points=fitted))
    moving = synthetic.turning_ellipsoid(8, 3000, np.random.default_rng(0), 4)
    before = allocated()
    problem = Problem(moving.clouds, moving.normals, moving.vertices[1], moving.faces, 1, config, CPU)
    optimiser = Optimiser(problem, 10, Team(1))
    optimiser.keep()
    refinement = Refinement(optimiser.objective, Team(1))
    state = {name: wp.clone(a) for name, a in refinement.state().items()}
    found = allocated() - before
    estimate = estimate_memory([3000] * 8, problem.vertex_count, config)
    assert problem.sample.sizes.max() <= fitted and state
    assert 0.75 * found < estimate.device < 1.4 * found, (found, estimate)
    if fitted == 300:
        assert estimate.points < 0.6 * estimate_memory([3000] * 8, problem.vertex_count, whole).points
    counted = pooled_bytes([3000] * 8, problem.vertex_count, config)
    assert all(0 < problem.pool.bytes[owner] <= counted[owner] for owner in counted)


def test_what_the_pool_hands_out_is_at_most_what_was_counted() -> None:
    """Clouds of unequal sizes: which of them are moved is not known before the keyframe is."""
    sizes, moving = [300, 120, 250, 400], synthetic.turning_ellipsoid(4, 400, np.random.default_rng(0), 1)
    clouds, normals = ([a[:n] for a, n in zip(s, sizes, strict=True)] for s in (moving.clouds, moving.normals))
    for keyframe in range(4):
        vertices = moving.vertices[keyframe]
        problem = Problem(clouds, normals, vertices, moving.faces, keyframe, Config(), CPU)
        Optimiser(problem, 10, Team(1))
        counted = pooled_bytes(sizes, problem.vertex_count, Config())
        assert set(problem.pool.bytes) == set(counted)
        assert all(problem.pool.bytes[owner] <= counted[owner] for owner in counted)


def test_stages_borrow_the_same_memory_and_each_its_own_arrays() -> None:
    pool = Pool(CPU)
    one, other = pool.borrower(), pool.borrower()
    a, b = (one(wp.vec3, (2, 5)) for _ in range(2))
    assert a.ptr != b.ptr
    assert [other(wp.vec3, (2, 5)).ptr for _ in range(3)][:2] == [a.ptr, b.ptr]
    assert other(wp.float32, (2, 5)).ptr not in (a.ptr, b.ptr)
    pool.own("somebody", wp.mat33, 7, (2, 3))
    assert pool.bytes == {"lent": 3 * 120 + 40, "somebody": 13 * 36}


def test_it_grows_with_everything() -> None:
    config = Config()
    least = estimate_memory([1000] * 5, 2000, config)
    finer = replace(config, grid=replace(config.grid, levels=11))
    for more in (
        estimate_memory([1000] * 6, 2000, config),
        estimate_memory([1100] * 5, 2000, config),
        estimate_memory([1000] * 5, 2100, config),
        estimate_memory([1000] * 5, 2000, finer),
        estimate_memory([1000] * 5, 2000, config, cuda=True),
    ):
        assert more.total > least.total and more.device > least.device
    assert vertices_most([1000, 200], config) == 4002  # a sparse keyframe's faces, by all frames
    assert vertices_most([1000] * 9, config) == 5002
    assert vertices_most([100_000], config) == 10_002


def test_a_run_that_fits_passes() -> None:
    assert require_memory([1000] * 5, 500, Config(), CPU).total > 0
    assert require_memory([10**6] * 1000, None, Config(), CPU, limit=0).total > GIB


@pytest.mark.parametrize("limit", [0.8, 1.5])
def test_what_would_fit_is_named_and_does_fit(limit: float) -> None:
    sizes, config = [20_000] * 120, Config()
    with pytest.raises(
        InputError, match=r"needs about .* GiB of memory, expected at most .*--memory-limit 0 tries"
    ) as e:
        require_memory(sizes, None, config, CPU, limit=limit)
    text = str(e.value)
    tried = 0
    if "--frames ::" in text:
        step = int(text.split("--frames ::")[1].split()[0])
        assert require_memory(sizes[::step], None, config, CPU, limit=limit)
        tried += 1
    if "--points " in text:
        fewer = int(text.split("--points ")[1].split()[0])
        assert require_memory([fewer] * len(sizes), None, config, CPU, limit=limit)
        tried += 1
    assert tried


def test_nothing_fits_into_nothing() -> None:
    with pytest.raises(InputError, match="take fewer frames and points; --memory-limit 0 tries all the same"):
        require_memory([1000] * 4, None, Config(), CPU, limit=0.001)


def test_a_run_is_refused_before_it_begins(rng: np.random.Generator, monkeypatch) -> None:
    clouds = rng.normal(size=(3, 50, 3))
    with pytest.raises(InputError, match="GiB of memory"):
        warpdef.reconstruct(clouds, device="cpu", safeguards=warpdef.Safeguards(memory_limit=0.01))
    monkeypatch.setattr(memory, "available_memory", lambda: 1000)
    with pytest.raises(InputError, match="GiB of memory"):
        warpdef.reconstruct(clouds, device="cpu")


def test_the_device_has_its_own_limit(monkeypatch) -> None:
    class Small:
        is_cuda, name, free_memory = True, "Tiny", 10 << 20

    with pytest.raises(InputError, match="GiB of memory of Tiny, expected at most 0.0098"):
        require_memory([5000] * 17, None, Config(), Small())  # type: ignore[arg-type]


# What is free.


def test_the_system_tells_what_is_free() -> None:
    free = memory.available_memory()
    assert free is None or 2**20 < free < 2**50


def group(folder: Path, version: int, limit: str, used: int, cache: int) -> None:
    names = [("memory.limit_in_bytes", "memory.usage_in_bytes"), ("memory.max", "memory.current")][version - 1]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / names[0]).write_text(f"{limit}\n")
    (folder / names[1]).write_text(f"{used}\n")
    key = ["total_inactive_file", "inactive_file"][version - 1]
    (folder / "memory.stat").write_text(f"other 7\n{key} {cache}\n")


@pytest.mark.parametrize(("version", "line", "place"), [(1, "4:memory:/a/b", "memory"), (2, "0::/a/b", ".")])
def test_containers_limits_count(version: int, line: str, place: str, tmp_path: Path) -> None:
    own, root = tmp_path / "own", tmp_path / "root"
    own.write_text(f"9:name=systemd:/\n{line}\nbroken\n")

    def left() -> int | None:
        return memory._group_left(root, own)

    assert left() is None
    group(root / place / "a", version, "1000", 700, 50)
    assert left() == 350
    group(root / place / "a" / "b", version, "500", 400, 0)
    assert left() == 100
    group(root / place, version, "max" if version == 2 else str(2**63 - 4096), 400, 0)
    assert left() == 100
    group(root / place, version, "90", 400, 0)  # all that a container sees of itself
    assert left() == 0
    assert memory._group_left(root, tmp_path / "missing") is None


def test_the_fit_is_gone_when_its_result_is_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    moving = synthetic.turning_ellipsoid(4, 400, np.random.default_rng(0), 3)
    judge, compiled, there = pipeline.find_verdicts, pipeline._compile, {}

    def fitting(optimiser: Optimiser, refinement: Refinement | None) -> None:
        there["fit"] = allocated() - before
        compiled(optimiser, refinement)

    def judging(*a: Any, **k: Any) -> dict[str, Any]:
        there["judge"] = allocated() - before
        return judge(*a, **k)

    monkeypatch.setattr(pipeline, "_compile", fitting)
    monkeypatch.setattr(pipeline, "find_verdicts", judging)
    before = allocated()
    config = replace(Config(), optimiser=replace(Config().optimiser, iterations=10))
    warpdef.reconstruct(moving.clouds, config, device="cpu", threads=1)
    # The nodes of the grids are the result's.
    assert there["judge"] < 0.4 * there["fit"], there
