"""``warpdef bench`` from end to end on small sizes, and what it does when an answer is wrong."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_bench_bookkeeping import sphere

from warpdef.apps.benchmark import scaling
from warpdef.apps.benchmark.bed import Bed, Peer, teams
from warpdef.apps.benchmark.compare import SCHEMA
from warpdef.apps.benchmark.data import Source, Work, make_work
from warpdef.apps.benchmark.iteration import CHECKPOINTS, _runs, descend, iteration_rows, ratio_entry
from warpdef.apps.benchmark.loss_cases import loss_cases
from warpdef.apps.benchmark.point import run_point
from warpdef.apps.benchmark.refine_cases import ROUND
from warpdef.apps.benchmark.rows import case_rows, kernel_rows
from warpdef.apps.benchmark.scaling import run_sweeps
from warpdef.apps.benchmark.sizes import ROWS, WORK, Size, selection
from warpdef.apps.benchmark.timing import QUICK
from warpdef.apps.benchmark.whole import whole_row, whole_run
from warpdef.apps.main import run
from warpdef.device import find_device
from warpdef.errors import WarpdefError

TINY = Size("tiny", 3, 200, 300, 4, 24)


@pytest.fixture(scope="module")
def work() -> Work:
    return make_work(Source("sphere", sphere()), TINY)


@pytest.fixture(scope="module")
def bed(work: Work) -> Bed:
    return Bed(work, TINY, find_device("cpu"), 2)


def measured(bed: Bed, only: str) -> list[dict]:
    with teams((1, 2)) as made:
        return list(kernel_rows(bed, made, {1: 1e10, 2: 2e10}, QUICK, selection(only)))


@pytest.mark.parametrize("group", list(ROWS))
def test_every_declared_row_is_measured_and_every_peer_agrees(bed: Bed, group: str) -> None:
    rows = measured(bed, group)
    assert [(row["name"], row["threads"]) for row in rows] == [(name, n) for name in ROWS[group] for n in (1, 2)]
    for row in rows:
        assert row["error"] is None
        assert all(peer["agrees"] and peer["speed_up"] > 0 for peer in row["peers"])
        assert row["melements_per_s"] == pytest.approx(row["elements"] / row["ms"] * 1e-3)
        if row["name"] != ROUND:  # many kernels: no one number of bytes
            assert row["gb_per_s"] == pytest.approx(row["bytes_per_element"] * row["melements_per_s"] * 1e-3)
            assert row["share_of_copy"] == pytest.approx(row["gb_per_s"] / (10 * row["threads"]))
        assert row["ms_low"] <= row["ms"] <= row["ms_high"]


def test_peers_are_beside_the_rows_that_were_asked_for(bed: Bed) -> None:
    names = {row["name"]: {p["name"] for p in row["peers"]} for row in measured(bed, "")}
    assert all("scipy cKDTree" in peers for name, peers in names.items() if name.startswith("neighbours"))
    for name in ("Cayley", "isometry", "Adam", "Chamfer, vertices to cloud", "Chamfer, cloud to vertices"):
        assert names[name] == {"numpy"}
    assert names["cosine solve"] == {"numpy matmul (BLAS)"}
    assert "scipy map_coordinates" in names["sampling"]


def test_a_wrong_answer_is_an_error_and_has_no_speed_up(bed: Bed) -> None:
    case = loss_cases(bed)[0]
    right = case.peers[0]

    def wrong(workers: int) -> tuple:
        gradient, loss = right.run(workers)
        return gradient * 1.001, loss

    with teams((1,)) as made:
        (row,) = case_rows(replace(case, peers=[right, Peer("wrong", wrong)]), bed, made, {1: 1e10}, QUICK)
    assert row["error"].startswith("Chamfer, vertices to cloud: differs from wrong by ")
    assert [peer["agrees"] for peer in row["peers"]] == [True, False]
    assert "speed_up" in row["peers"][0] and "speed_up" not in row["peers"][1]


@pytest.mark.parametrize("size", [TINY, WORK, replace(TINY, iterations=9)])
def test_a_descent_runs_all_its_iterations(size: Size) -> None:
    pieces = list(_runs(size))
    assert sum(count for count, _ in pieces) == size.iterations
    assert sum(kind == "check" for _, kind in pieces) == CHECKPOINTS
    assert all(count > 0 for count, _ in pieces)


def test_iteration_against_trees(work: Work) -> None:
    results = descend(work, TINY, find_device("cpu"), 1, 2)
    entry = ratio_entry(results, TINY, 1, 2)
    assert entry["error"] is None
    assert entry["ratio"] == pytest.approx(entry["iteration_ms"] / entry["ckdtree_ms"])
    assert entry["ratio_best"] >= entry["ratio"]
    full, warmup = iteration_rows(results, TINY, 1)
    assert warmup["launches"] == TINY.warmup
    assert full["elements"] == 2 * 200 + 2 * len(work.vertices)
    assert {"move", "compare", "trust", "return", "descend"} <= set(results["phases"])
    assert sum(results["kernels"].values()) <= sum(results["phases"].values())
    assert {"move: move_vertices", "compare: nearest_in_packets", "descend: adam"} <= set(results["kernels"])


def test_a_whole_run_over_one_pass_of_trees(work: Work, tmp_path: Path) -> None:
    found = whole_run(work, TINY, "cpu", 1, tmp_path)
    assert (found["frames"], found["points"]) == (3, 200) and 0 < found["vertices"] <= 302
    assert set(found["stages"]) == {"clean", "template", "compile", "optimise", "refine", "assess"}
    parts = [*found["stages"].values(), found["others"]]
    for key in ("cpu_s", "wall_s"):
        assert found[key] == pytest.approx(sum(part[key] for part in parts))
        assert all(part[key] > 0 for part in parts)
    assert found["ratio"] == found["cpu_s"] / found["ckdtree_s"] > 1.0
    row = whole_row(found, work)
    assert row["elements"] == 600 and row["ms"] == pytest.approx(1e3 * found["cpu_s"])
    assert row["peers"][0]["speed_up"] == pytest.approx(1.0 / found["ratio"])
    with pytest.raises(WarpdefError, match=r"warpdef reconstruct .* ended with code 2: .*nowhere"):
        whole_run(work, TINY, "nowhere", 1, tmp_path)


def test_neighbours_that_differ_are_an_error(work: Work) -> None:
    results = descend(work, TINY, find_device("cpu"), 1, 1)
    results["trees"].worst = 0.5
    assert "differs from cKDTree's by 5.0e-01" in ratio_entry(results, TINY, 1, 1)["error"]


def test_sweeps_and_processes_of_their_own(tmp_path: Path, monkeypatch) -> None:
    heard: list[str] = []
    sweeps = run_sweeps(
        Source("sphere", sphere()), TINY, {"frames": (3, 6)}, None, "cpu", 1, 3, 2, tmp_path, heard.append
    )
    assert [sweep["field"] for sweep in sweeps] == ["threads", "frames"]
    points = sweeps[1]["points"]
    assert [p["value"] for p in points] == [3, 6]
    assert points[1]["arrays_mb"] > points[0]["arrays_mb"] > 0
    assert all(p["first_s"] >= p["step_s"] > 0 and p["ms"] > 0 and p["peak_mb"] > p["arrays_mb"] for p in points)
    assert set(sweeps[1]["exponents"]) >= {"ms", "cpu_ms", "arrays_mb", "peak_mb"}
    assert all(p["cpu_ms"] > 0 for p in points)
    monkeypatch.setattr(scaling, "thread_counts", lambda most: [])
    largest = replace(TINY, levels=99)  # more than the configuration allows: its process fails
    (sweep,) = run_sweeps(Source("sphere", sphere()), TINY, {}, largest, "cpu", 1, 3, 2, tmp_path, heard.append)[1:]
    assert sweep["points"] == [] and "ended with code" in sweep["error"]
    with pytest.raises(WarpdefError, match="ended with code"):
        run_point(tmp_path / "absent.npz", TINY, "cpu", 1, 2)


def test_quick_run_from_the_command_line(tmp_path: Path, capfd) -> None:
    mesh = sphere()
    np.savez(tmp_path / "truth.npz", vertices=mesh.vertices, faces=mesh.faces)
    file, again = tmp_path / "a.json", tmp_path / "b.json"
    common = ["bench", "--quick", "--threads", "2", "--device", "cpu", "--data", str(tmp_path / "truth.npz")]
    assert run([*common, "--json", str(file)]) == 0
    shown = capfd.readouterr().out
    written = json.loads(file.read_text())
    assert written["schema"] == SCHEMA
    parts = "schema environment null_tests machine rows ratios whole phases start scaling targets errors"
    assert set(written) == set(parts.split())
    assert {row["name"] for row in written["rows"]} == {n for names in ROWS.values() for n in names} | {
        "iteration", "iteration, warm-up", "whole run",
    }  # fmt: skip
    assert {t["name"] for t in written["null_tests"]} == {"Adam, memory", "sampling, arithmetic"}
    assert written["start"]["cold"]["modules"].keys() >= {"motion", "packets", "cosine"}
    assert len(written["targets"]) == 5
    for words in ("null test", "iteration / cKDTree", "Where an iteration goes", "at most", "GB/s", "A whole run"):
        assert words in shown

    assert run([*common, "--only", "Adam", "--json", str(again), "--compare", str(file)]) == 0
    shown = capfd.readouterr().out
    assert f"Against {file.name}" in shown
    assert [row["name"] for row in json.loads(again.read_text())["comparison"]["rows"]] == ["Adam", "Adam"]

    assert run(["bench", "--show", str(file), "--json", "-"]) == 0
    assert json.loads(capfd.readouterr().out)["rows"] == written["rows"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--only", "qqq"], "--only: expected part of one of"),
        (["--size", "qqq"], "--size: expected one of"),
        (["--compare", "absent.json"], "found no file"),
        (["--show", "absent.json"], "found no file"),
        (["--plot", "picture.svg"], "ending in .png"),
        (["--plot", "nowhere/picture.png"], "is not a folder"),
        (["--json", "nowhere/report.json"], "is not a folder"),
    ],
)
def test_mistakes_are_said_before_anything_is_measured(arguments, message, tmp_path, monkeypatch, capfd) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(["bench", *arguments]) == 2
    assert message in " ".join(capfd.readouterr().err.split())


def plottable() -> dict:
    row = {"name": "a", "size": "work", "threads": 1, "flops_per_byte": 2.0, "gflop_per_s": 5.0}
    points = [{"value": v, "ms": v * 1.0} for v in (1, 2)]
    return {
        "environment": {"device_name": "x", "threads": 1, "warpdef": "0"},
        "machine": {"copy_gb_per_s": {"1": 10.0}, "peak_gflop_per_s": {"1": 100.0}},
        "rows": [row],
        "scaling": [{"field": "points", "points": points, "exponents": {"ms": 1.0}}],
    }


def test_a_picture_is_drawn(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    from warpdef.apps.benchmark.plot import plot_report
    from warpdef.errors import InputError

    plot_report(plottable(), tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(InputError, match="nothing to draw"):
        plot_report({**plottable(), "rows": [], "scaling": []}, tmp_path / "b.png")


def test_without_matplotlib_it_is_named(tmp_path: Path, monkeypatch) -> None:
    from warpdef.apps.benchmark.plot import require_plotting
    from warpdef.errors import MissingPackageError

    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingPackageError, match=r"pip install 'warpdef\[bench\]'"):
        require_plotting(tmp_path / "a.png")
