"""Kernels are known before they run: nothing is compiled in the midst of a fit, and for a device on all cores."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
import synthetic
import warp as wp

from warpdef import device as device_module
from warpdef.config import Config
from warpdef.device import Way, find_device, going, load_kernels, usable_cores
from warpdef.fit.optimise import Optimiser
from warpdef.fit.problem import Problem
from warpdef.fit.refine import Refinement
from warpdef.fit.workers import Team
from warpdef.kernels.launching import listing
from warpdef.kernels.vectors import clear_vectors

CPU = find_device("cpu")


def test_what_is_listed_does_not_run() -> None:
    a = wp.ones(3, dtype=wp.vec3, device="cpu")
    with listing() as outer:
        clear_vectors(0, 3, a)
        with listing() as inner:
            clear_vectors(0, 0, a)  # no launch
        clear_vectors(1, 2, a)
    assert inner == [] and len(outer) == 2 and outer[0] is outer[1]
    np.testing.assert_array_equal(a.numpy(), 1)
    clear_vectors(0, 3, a)
    np.testing.assert_array_equal(a.numpy(), 0)
    with listing(), pytest.raises(ValueError):
        clear_vectors(0, 9, a)  # arguments are looked at all the same


@pytest.mark.parametrize("chain", [False, True])
@pytest.mark.parametrize("partial", [False, True])
def test_everything_that_runs_was_listed(chain: bool, partial: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """CUDA's way, on the CPU: iterations of both kinds, a look, the last move, a frame alone, all rounds."""
    moving = synthetic.turning_ellipsoid(4, 400, np.random.default_rng(0), 1)
    if partial:
        moving.clouds[3], moving.normals[3] = (
            a[moving.clouds[3][:, 0] < 0.1] for a in (moving.clouds[3], moving.normals[3])
        )
    base = Config()
    settings = replace(base.optimiser, chain=chain, warmup=1)
    # What is looked for in lost frames are neighbours, as in all clouds before.
    rounds = replace(base.refine, recover=False)
    config = replace(base, grid=replace(base.grid, levels=3), optimiser=settings, refine=rounds)
    ran, run = [], wp.launch

    def noted(kernel: wp.Kernel, *arguments, **how):
        ran.append(kernel)
        return run(kernel, *arguments, **how)

    with going(Way.WHOLE), closing(Team(1)) as team:
        problem = Problem(moving.clouds, moving.normals, moving.vertices[1], moving.faces, 1, config, CPU)
        assert problem.measures.complete.all() != partial
        optimiser = Optimiser(problem, 3, team)
        refinement = Refinement(optimiser.objective, team)
        listed = [*optimiser.kernels(), *refinement.kernels()]
        monkeypatch.setattr(wp, "launch", noted)
        optimiser.iterate()
        optimiser.iterate()
        assert optimiser.finite()
        optimiser.finish()
        refinement.start()
        refinement.settle(2, 1, 1)
        while refinement.done < refinement.config.iterations:
            refinement.run_round()
    assert len(ran) > 30
    assert {kernel.key for kernel in ran} <= {kernel.key for kernel in listed}


def test_a_device_gets_each_module_once_on_all_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    with listing() as kernels:
        for _ in range(3):
            clear_vectors(0, 1, wp.zeros(1, dtype=wp.vec3, device="cpu"))
    loaded = []
    monkeypatch.setattr(wp, "force_load", lambda device, modules, max_workers: loaded.append((modules, max_workers)))
    load_kernels(kernels, CPU)
    assert loaded == []
    monkeypatch.setattr(device_module, "is_cuda", lambda device: True)
    load_kernels(kernels, CPU)
    load_kernels([], CPU)
    assert loaded == [([kernels[0].module], min(1, usable_cores()))]
