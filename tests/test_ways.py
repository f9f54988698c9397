"""Which way work goes on a device: said in one place, and CUDA's way through the whole pipeline, on the CPU."""

from __future__ import annotations

import ast
import re
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
import synthetic
import warp as wp
from descent import chained
from logged_streams import LoggedStreams

import warpdef
from warpdef.config import Config
from warpdef.device import Way, find_device, going, team_size, usable_cores, way_of
from warpdef.fit import workers
from warpdef.fit.optimise import Optimiser
from warpdef.fit.problem import Problem
from warpdef.fit.workers import Team

ROOT = Path(__file__).resolve().parents[1]
CPU, CUDA = find_device("cpu"), cast(wp.Device, SimpleNamespace(is_cpu=False))  # all that is asked of it
ROOMS = ("kernels/ways.py", "warpdef/device.py")
"""Where a device may be asked what it is."""


def test_spans_are_cut_or_whole() -> None:
    assert Way.SPANS.cut(5, 2) == [(0, 2), (2, 4), (4, 5)]
    assert Way.SPANS.cut(2) == [(0, 1), (1, 2)]
    assert Way.WHOLE.cut(5, 2) == [(0, 5)]
    assert Way.SPANS.cut(0) == Way.WHOLE.cut(0) == []


def test_the_cpu_goes_its_own_way_or_the_one_asked_for() -> None:
    assert way_of(CPU) is Way.SPANS and way_of(CUDA) is Way.WHOLE
    assert team_size(CPU) == usable_cores() and team_size(CPU, 3) == 3
    with going(Way.WHOLE):
        assert way_of(CPU) is Way.WHOLE and team_size(CPU, 3) == 1
        with going(Way.SPANS):
            assert way_of(CPU) is Way.SPANS and way_of(CUDA) is Way.WHOLE
        assert way_of(CPU) is Way.WHOLE
    with pytest.raises(KeyError), going(Way.WHOLE):
        raise KeyError
    assert way_of(CPU) is Way.SPANS


def test_no_other_room_asks_a_device_what_it_is() -> None:
    found = [
        f"{path.relative_to(ROOT)}: {line.strip()}"
        for folder in ("kernels", "warpdef", "apps")
        for path in sorted((ROOT / folder).rglob("*.py"))
        if str(path.relative_to(ROOT)) not in ROOMS
        for line in path.read_text(encoding="utf-8").splitlines()
        if re.search(r"\.is_(cpu|cuda)\b", line)
    ]
    assert found == []


def test_nothing_lands_on_a_default_device() -> None:
    """Which is the first CUDA device where there is one, whatever was asked for. A mesh goes where its arrays are."""
    made = ("array", "zeros", "ones", "full", "empty", "ScopedCapture", "synchronize")
    calls = [
        (node, path)
        for folder in ("kernels", "warpdef", "apps")
        for path in sorted((ROOT / folder).rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and ast.unparse(node.func) in [f"wp.{name}" for name in made]
    ]
    assert len(calls) > 100
    assert [f"{p.name}:{c.lineno}" for c, p in calls if "device" not in [k.arg for k in c.keywords]] == []


def turning(rng: np.random.Generator) -> synthetic.Synthetic:
    """A turning ellipsoid; its last frame shows a part, so that what is unseen and one-sided has its say."""
    moving = synthetic.turning_ellipsoid(5, 320, rng, subdivisions=2)
    seen = moving.clouds[4][:, 0] < 0.1
    clouds, normals = ([*part[:4], part[4][seen]] for part in (moving.clouds, moving.normals))
    return replace(moving, clouds=clouds, normals=normals)


def fit(moving: synthetic.Synthetic, way: Way, chain: bool) -> tuple[np.ndarray, dict]:
    """Vertices of all frames, and the report."""
    base = Config()
    config = replace(
        base,
        drop_strays=False,
        keyframe=replace(base.keyframe, choice="2"),
        grid=replace(base.grid, levels=4),
        # Two ways to solve agree as far as they solve; and where Adam's step goes by the sign of a gradient that is
        # nothing but rounding, no two sums would agree.
        sobolev=replace(base.sobolev, tolerance=1e-6),
        optimiser=replace(base.optimiser, iterations=30, warmup=8, epsilon=1e-2),
        refine=replace(base.refine, tolerance=1e-6, iterations=6),
    )
    config = chained(config) if chain else config
    template = warpdef.TriMesh(moving.vertices[2], moving.faces)
    sequence = warpdef.PointSequence.from_arrays(moving.clouds, moving.normals)
    with going(way):
        result = warpdef.reconstruct(sequence, config, device="cpu", threads=1, template=template)
    return result.vertices.astype(np.float64), result.report


def test_what_has_arrived_stays_either_way() -> None:
    """The CPU leaves such transitions out, CUDA their steps: going on with them would be another result."""
    found = []
    for way in Way:
        moving = turning(np.random.default_rng(0))  # of its last frame no transition arrives before its time
        config = replace(Config(), grid=replace(Config().grid, levels=4))
        with going(way), closing(Team(1)) as team:
            problem = Problem(moving.clouds, moving.normals, moving.vertices[2], moving.faces, 2, config, CPU)
            optimiser = Optimiser(problem, 70, team)
            while not optimiser.ended:
                optimiser.iterate()
                if optimiser.done % 10 == 0:
                    optimiser.look()
            going_on = optimiser._moving.numpy()
            assert not optimiser.grids.adj_x.numpy().any()
        found.append((going_on, optimiser.nodes.numpy()))
    (of_spans, by_spans), (of_whole, whole) = found
    np.testing.assert_array_equal(of_spans, of_whole)
    assert 0 < of_spans.sum() < len(of_spans)
    # Float32 sums in another order, through as many steps; a step more is a thousandth.
    np.testing.assert_allclose(whole, by_spans, rtol=0, atol=1e-4)


@pytest.mark.parametrize("chain", [False, True])
def test_both_ways_through_the_whole_pipeline_agree(chain: bool) -> None:
    """As far as float32 says: no further apart than what rounding the input anew, a few times, does to the result."""
    moving = turning(np.random.default_rng(0))
    (by_spans, report), (whole, _) = (fit(moving, way, chain) for way in (Way.SPANS, Way.WHOLE))
    assert report["refine"]["frames_partial"] == 1
    assert not np.array_equal(whole, by_spans)  # it did go another way
    rounded = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        clouds = [c * (1 + rng.uniform(-1, 1, c.shape) * np.finfo(np.float32).eps) for c in moving.clouds]
        rounded.append(np.abs(fit(replace(moving, clouds=clouds), Way.SPANS, chain)[0] - by_spans))
    apart = np.abs(whole - by_spans)
    assert apart.mean() < 3 * max(r.mean() for r in rounded)
    assert apart.max() < 3 * max(r.max() for r in rounded)
    # Which is little: of what the frames move, a few millionths.
    assert max(r.mean() for r in rounded) < 1e-4 * np.abs(by_spans - by_spans[2]).mean()


@pytest.mark.parametrize("chain", [False, True])
def test_as_graphs_the_whole_pipeline_gives_the_same_bits(chain: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """CUDA's way with iterations and rounds captured and replayed, which Warp does on the CPU, too.

    All that a graph launches it launches again as it was captured: from one iteration to the next nothing may change
    but what the device holds. Where the vertices have their branch, too, it is taken before the one that is plainly
    first; without streams, which the CPU has not, a graph has but one.
    """
    moving = turning(np.random.default_rng(0))
    plain, _ = fit(moving, Way.WHOLE, chain)
    replays, replay = [], wp.capture_launch
    monkeypatch.setattr(workers, "is_cuda", lambda device: True)
    monkeypatch.setattr(wp, "capture_launch", lambda graph: replays.append(graph) or replay(graph))
    streams = LoggedStreams()
    if chain:
        streams.stand_in(monkeypatch)
    captured, report = fit(moving, Way.WHOLE, chain)
    np.testing.assert_array_equal(captured, plain)
    # Warm-up, iterations, rounds, rounds that smooth in time; the first of each kind is launched plainly.
    assert len({id(graph) for graph in replays}) == 4 and len(replays) == 30 - 2 + 6 - 2
    assert not any("not captured" in warning for warning in report["warnings"])
    assert (len({stream for stream, _, _ in streams.log}) > 1) == chain
