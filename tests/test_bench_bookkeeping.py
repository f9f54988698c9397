"""The bench's own arithmetic: statistics, null test, exponents, sizes, comparison. No test here asks what a time is."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp
from present import present

from warpdef.apps.benchmark import timing
from warpdef.apps.benchmark.bed import difference
from warpdef.apps.benchmark.compare import SCHEMA, compare_reports, read_report
from warpdef.apps.benchmark.data import Source, Work, load_source, make_work
from warpdef.apps.benchmark.meshes import resize_mesh
from warpdef.apps.benchmark.point import array_bytes, module_seconds
from warpdef.apps.benchmark.scaling import exponents, sweep_sizes, thread_counts, within_bound
from warpdef.apps.benchmark.session import Options, chosen_sizes, targets
from warpdef.apps.benchmark.sizes import PARTS, ROWS, SIZES, WORK, Size, selection
from warpdef.apps.benchmark.timing import Effort, Timing, fit_exponent, measure, null_test
from warpdef.errors import InputError
from warpdef.geometry.triangles import unique_edges
from warpdef.mesh import MeshSequence
from warpdef.sequence import PointSequence


class FakeClock:
    """A clock on which every call takes as long as it is told to."""

    def __init__(self, seconds: float) -> None:
        self.per_call, self.calls = seconds, []

    def __call__(self, run, count: int) -> float:
        for _ in range(count):
            run()
        self.calls.append(count)
        return self.per_call * count


def test_statistics_of_known_times() -> None:
    timing = Timing.of([0.001, 0.002, 0.003, 0.004, 0.1])
    assert (timing.median, timing.low, timing.high, timing.count) == (0.003, 0.002, 0.004, 5)
    assert timing.to_json()["ms"] == pytest.approx(3.0)
    with pytest.raises(ValueError, match="at least one"):
        Timing.of([])


def test_short_calls_are_timed_several_at_a_time() -> None:
    clock = FakeClock(1e-5)
    timing = measure(lambda: None, clock, Effort(seconds=0.01, least=3, most=7))
    assert timing.median == pytest.approx(1e-5)
    assert clock.calls[:2] == [1, 1]  # warm-up
    assert set(clock.calls[2:]) == {50}
    assert timing.count == 7


def test_a_device_is_timed_on_its_own_stream(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not on the default device's, where an event of another device is an error."""
    noted: list[tuple] = []
    stream = SimpleNamespace(record_event=lambda event: noted.append(("at", event)))
    monkeypatch.setattr(timing, "is_cuda", lambda device: True)
    monkeypatch.setattr(wp, "Event", lambda device, enable_timing: (device, len(noted)))
    monkeypatch.setattr(wp, "get_stream", lambda device: noted.append(("of", device)) or stream)
    monkeypatch.setattr(wp, "synchronize_event", lambda event: None)
    monkeypatch.setattr(wp, "get_event_elapsed_time", lambda start, end: 3.0)
    clock = timing.DeviceTimer("cuda:1")  # pyright: ignore[reportArgumentType] - all that is asked of it
    assert clock.seconds(lambda: noted.append(("run",)), 2) == 3e-3
    event = ("at", ("cuda:1", 0))
    assert noted == [("of", "cuda:1"), event, ("run",), ("run",), event]


def test_preparation_is_outside_the_timed_part() -> None:
    order = []
    measure(
        lambda: order.append("run"),
        FakeClock(1e-5),
        Effort(0.0, least=2, most=2),
        before=lambda: order.append("before"),
    )
    assert order == ["before", "run"] * 4


@pytest.mark.parametrize(("power", "passed"), [(1.0, True), (0.0, False), (2.0, False)])
def test_null_test_tells_honest_work_from_none_and_too_much(power: float, passed: bool) -> None:
    result = null_test(lambda count: 1e-6 * count**power, (1000, 4000))
    assert result["ratio"] == pytest.approx(4.0**power)
    assert result["passed"] is passed


def test_null_test_of_a_stopped_clock_fails() -> None:
    assert null_test(lambda count: 0.0, (1, 4))["passed"] is False


def test_null_test_wants_four_times_the_work() -> None:
    with pytest.raises(ValueError, match="four times"):
        null_test(lambda count: 1.0, (10, 30))


def test_exponents_of_known_growth() -> None:
    sizes = np.array([1000, 2000, 5000, 100_000])
    assert fit_exponent(sizes, 3e-7 * sizes**1.3) == pytest.approx(1.3)
    points = [{"value": n, "ms": 2.0 * n, "arrays_mb": 5.0, "peak_mb": n**0.5} for n in sizes]
    found = exponents(points)
    assert found["ms"] == pytest.approx(1.0)
    assert found["arrays_mb"] == pytest.approx(0.0)
    assert found["peak_mb_top"] == pytest.approx(0.5)
    assert "cpu_ms" not in found  # not measured on CUDA
    found = exponents([{**p, "cpu_ms": 3.0 * p["value"] ** 1.5} for p in points])
    assert found["cpu_ms"] == pytest.approx(1.5)


@pytest.mark.parametrize(("sizes", "values"), [([5, 5], [1, 2]), ([1, 2], [1, 0]), ([1, 2], [1])])
def test_exponents_of_nothing_are_refused(sizes: list, values: list) -> None:
    with pytest.raises(ValueError, match="growth"):
        fit_exponent(sizes, values)


def test_growth_is_judged_where_it_is_promised() -> None:
    def sweep(field: str, ms: float) -> dict:
        return {"field": field, "exponents": {"ms": ms, "arrays_mb": 1.0}}

    assert within_bound(sweep("points", 1.05)) is True
    assert within_bound(sweep("points", 1.2)) is False
    assert within_bound(sweep("levels", 3.0)) is None
    # Processor time where there is one: wall time tells of the machine's other programs, too.
    for cpu_ms, within in ((1.0, True), (1.2, False)):
        disturbed = sweep("points", 5.0)
        disturbed["exponents"]["cpu_ms"] = cpu_ms
        assert within_bound(disturbed) is within


def test_sweeps_vary_one_thing() -> None:
    sizes = sweep_sizes(WORK, "frames", (5, 9))
    assert [s.frames for s in sizes] == [5, 9]
    assert {(s.points, s.vertices, s.levels) for s in sizes} == {(WORK.points, WORK.vertices, WORK.levels)}


@pytest.mark.parametrize(("most", "counts"), [(1, [1]), (2, [1, 2]), (4, [1, 2, 4]), (6, [1, 2, 4, 6])])
def test_thread_counts_end_at_all(most: int, counts: list[int]) -> None:
    assert thread_counts(most) == counts


def test_selection() -> None:
    assert selection("") == {name for names in ROWS.values() for name in names} | {*PARTS, "scaling"}
    assert selection("sampling") == {"sampling", "sampling adjoint"}
    assert selection("solves") == set(ROWS["solves"])
    assert selection("cayley") == {"Cayley"}
    assert selection("start") == {"start"}
    with pytest.raises(InputError, match="--only: expected part of one of motion, "):
        selection("nothing of the kind")


def test_sizes() -> None:
    assert chosen_sizes(Options()) == SIZES
    assert chosen_sizes(Options(size="work")) == (WORK,)
    with pytest.raises(InputError, match="--size: expected one of small, work, large"):
        chosen_sizes(Options(size="huge"))


def sphere(rings: int = 20) -> MeshSequence:
    """A sphere of latitudes and longitudes, its poles open, that grows."""
    u, v = np.meshgrid(np.linspace(0.2, np.pi - 0.2, rings), np.arange(2 * rings) * np.pi / rings, indexing="ij")
    points = np.stack([np.sin(u) * np.cos(v), np.sin(u) * np.sin(v), np.cos(u)], axis=-1).reshape(-1, 3)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(rings - 1), np.arange(2 * rings), indexing="ij"))
    a, b = i * 2 * rings + j, i * 2 * rings + (j + 1) % (2 * rings)
    faces = np.concatenate([np.stack([a, a + 2 * rings, b]), np.stack([b, a + 2 * rings, b + 2 * rings])], axis=1).T
    return MeshSequence(np.stack([points * (1 + 0.05 * t) for t in range(4)]), faces)


@pytest.mark.parametrize("count", [200, 800, 810, 3000])
def test_meshes_of_any_size(count: int) -> None:
    mesh = sphere()
    vertices, faces = resize_mesh(mesh.vertices[0], mesh.faces, count)
    assert abs(len(vertices) - count) <= 0.05 * count
    assert faces.min() == 0 and faces.max() == len(vertices) - 1
    assert all(len(set(face)) == 3 for face in faces[:50])
    # Edges of a surface: about three a vertex, and short.
    edges = unique_edges(faces)
    assert 2.5 < len(edges) / len(vertices) < 3.2
    lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    assert lengths.max() < 5.0 * np.sqrt(4 * np.pi / len(vertices))


def test_a_finer_mesh_keeps_its_surface() -> None:
    mesh = sphere()
    vertices, faces = resize_mesh(mesh.vertices[0], mesh.faces, 3000)

    def area(v: np.ndarray, f: np.ndarray) -> float:
        return 0.5 * np.linalg.norm(np.cross(v[f[:, 1]] - v[f[:, 0]], v[f[:, 2]] - v[f[:, 0]]), axis=1).sum()

    assert len(vertices) == 3000
    assert area(vertices, faces) == pytest.approx(area(mesh.vertices[0], mesh.faces))


def test_work_has_the_size_asked_for_and_survives_a_file(tmp_path: Path) -> None:
    source = Source("sphere", sphere())
    work = make_work(source, Size("s", 3, 100, 200, 4, 8))
    assert [c.shape for c in work.clouds] == [(100, 3)] * 3
    assert max(np.abs(c).max() for c in work.clouds) <= 1.0
    work.save(tmp_path / "work.npz")
    again = Work.load(tmp_path / "work.npz")
    assert again.keyframe == work.keyframe == 1
    ours, stored = ((*w.clouds, *w.normals, w.vertices, w.faces) for w in (work, again))
    for a, b in zip(ours, stored, strict=True):
        np.testing.assert_array_equal(a, b)


def test_the_same_motion_in_more_frames() -> None:
    source = Source("sphere", sphere())
    more = present(source.retimed(3, 5).truth).vertices
    x = present(source.truth).vertices
    np.testing.assert_allclose(more, [x[0], (x[0] + x[1]) / 2, x[1], (x[1] + x[2]) / 2, x[2]], atol=1e-12)
    assert source.retimed(3, 3) is source
    with pytest.raises(InputError, match="expected at least 9 frames, got 4"):
        source.retimed(9, 5)


def test_data_that_is_too_small_is_refused() -> None:
    with pytest.raises(InputError, match="expected at least 9 frames, got 4"):
        make_work(Source("sphere", sphere()), Size("s", 9, 100, 200, 4, 8))
    clouds = PointSequence.from_arrays(np.random.default_rng(0).normal(size=(3, 50, 3)))
    with pytest.raises(InputError, match="at least 100 points a frame for size 's', got 50"):
        make_work(Source("clouds", clouds=clouds), Size("s", 3, 100, 200, 4, 8))


def test_a_truth_and_clouds_are_told_apart(tmp_path: Path) -> None:
    mesh = sphere()
    np.savez(tmp_path / "truth.npz", vertices=mesh.vertices, faces=mesh.faces)
    np.savez(tmp_path / "clouds.npz", points=mesh.vertices)
    assert present(load_source(tmp_path / "truth.npz", "1:", 17).truth).vertices.shape == (3, *mesh.vertices.shape[1:])
    assert load_source(tmp_path / "clouds.npz", "", 17).frames == 4


def test_difference_of_answers() -> None:
    ours = np.array([3.0, 4.0])
    assert difference(ours, ours) == 0.0
    assert difference(ours * 1.01, ours) == pytest.approx(0.01)
    assert difference((ours, ours * 1.5), (ours, ours)) == pytest.approx(0.5)
    assert difference(ours, np.zeros(2)) == 1.0
    assert difference(ours, np.zeros(3)) == np.inf
    assert np.isnan(difference(np.array([np.nan]), np.array([1.0])))


def test_arrays_are_counted_once() -> None:
    import warp as wp

    class Holder(SimpleNamespace):
        pass

    Holder.__module__ = "warpdef.somewhere"
    inner, outer = Holder(), Holder()
    inner.a = wp.zeros((4, 5), dtype=wp.vec3, device="cpu")
    outer.views = [inner.a, inner.a.flatten(), inner.a[2:]]
    outer.inner, outer.again = inner, {"inner": inner}
    numbers = np.zeros(100)
    outer.numbers = (numbers, numbers[5:])
    assert array_bytes(outer) == 4 * 5 * 12 + 800


def test_module_seconds_are_read_from_warps_words() -> None:
    lines = [
        "Module warpdef.kernels.motion 3c1e0f2 load on device 'cpu' took 500.50 ms  (compiled)",
        "Module _kernels__locals__solve_systems_1a2b3c4d 1a2b3c4 load on device 'cpu' took 250.00 ms  (compiled)",
        "Module _kernels__locals__solve_systems_5a6b7c8d 5a6b7c8 load on device 'cpu' took 250.00 ms  (compiled)",
        "something else",
    ]
    assert module_seconds(lines) == {"motion": pytest.approx(0.5005), "solve_systems": pytest.approx(0.5)}


def report(**times: float) -> dict:
    """A report with a row a name, quartiles 10 % around the median."""
    rows = [
        {"name": n, "size": "work", "threads": 1, "ms": t, "ms_low": 0.9 * t, "ms_high": 1.1 * t}
        for n, t in times.items()
    ]
    return {"schema": SCHEMA, "environment": {"device_name": "x", "cores": 4, "data": "d"}, "rows": rows, "errors": []}


def test_comparison_of_two_runs() -> None:
    old, new = report(a=1.0, b=1.0, c=1.0, gone=1.0), report(a=0.5, b=1.05, c=2.0, fresh=1.0)
    new["environment"]["cores"] = 2
    old["errors"] = ["null test (x): four times the work cost 9.0 times; believe no figure", "a: differs from numpy"]
    found = compare_reports(new, old)
    assert [(r["name"], r["ratio"], r["verdict"]) for r in found["rows"]] == [
        ("a", 0.5, "faster"),
        ("b", 1.05, "same"),
        ("c", 2.0, "slower"),
    ]
    assert sorted(key[0] for key in found["missing"]) == ["fresh", "gone"]
    assert found["warnings"][0] == "cores: 4 then, 2 now"
    assert found["warnings"][1].startswith("then: null test")
    assert len(found["warnings"]) == 2


def test_reports_are_checked_when_read(tmp_path: Path) -> None:
    path = tmp_path / "report.json"
    with pytest.raises(InputError, match="found no file"):
        read_report(path)
    for content in ("not json", "[]", '{"schema": 0, "rows": []}', f'{{"schema": {SCHEMA}}}'):
        path.write_text(content)
        with pytest.raises(InputError, match="got something else"):
            read_report(path)
    path.write_text(json.dumps(report(a=1.0)))
    assert read_report(path)["rows"][0]["name"] == "a"


def test_targets_are_judged_at_their_size_only() -> None:
    def ratio(size: str, threads: int, value: float, error: str | None = None) -> dict:
        return {"size": size, "threads": threads, "ratio": value, "iteration_ms": 1.0, "error": error}

    base = {"environment": {"threads": 4}, "start": {}, "scaling": []}
    found = targets(
        {**base, "ratios": [ratio("work", 1, 0.4), ratio("work", 4, 0.4), ratio("small", 4, 9)]}, "work", "cpu"
    )
    assert [(t["value"], t["bound"], t["met"]) for t in found] == [(0.4, 0.3, False), (0.4, 0.5, True)]
    found = targets({**base, "ratios": [ratio("quick", 1, 0.1), ratio("quick", 4, 0.1)]}, "quick", "cpu")
    assert [t["met"] for t in found] == [None, None]
    assert targets({**base, "ratios": [ratio("work", 1, 0.1, "neighbours: differ")]}, "work", "cpu") == []
