"""``warpdef evaluate``, ``sample`` and ``demo``, without the method itself."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from stand_in_method import StandInMethod

from warpdef.apps.evaluate import evaluate_run
from warpdef.apps.main import run
from warpdef.config import Config
from warpdef.files import read_clouds
from warpdef.files.checkpoint import digests
from warpdef.files.run_folder import RunFolder
from warpdef.files.saved_run import load_run
from warpdef.geometry.sampling import sample_surface
from warpdef.mesh import MeshSequence
from warpdef.truth.metrics import METRICS


def moving_box(frames: int) -> MeshSequence:
    """A box that travels and grows a little; outward triangles."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return MeshSequence(np.stack([corners * (1 + 0.1 * t) + [t, 0, 0] for t in range(frames)]), np.array(faces))


@dataclass
class EvaluateCase:
    truth: Path
    output: Path


@pytest.fixture
def case(tmp_path: Path) -> EvaluateCase:
    """Six true frames, and a perfect result made from frames 1, 3 and 5."""
    mesh = moving_box(6)
    np.savez(tmp_path / "truth.npz", vertices=mesh.vertices, faces=mesh.faces)
    RunFolder.prepare(tmp_path / "out").save(
        vertices=mesh.vertices[1::2],
        faces=mesh.faces,
        keyframe=1,
        config=Config(),
        report={},
        steps=[],
        names=["1", "3", "5"],
    )
    return EvaluateCase(tmp_path / "truth.npz", tmp_path / "out")


def test_measures_as_json(case: EvaluateCase, capfd) -> None:
    arguments = ["evaluate", str(case.output), str(case.truth), "--frames", "1::2", "--samples", "2000", "--json"]
    assert run(arguments) == 0
    shown = json.loads(capfd.readouterr().out)
    assert shown == json.loads((case.output / "metrics.json").read_text())
    assert set(shown) == {"mean", "frames"}
    assert set(shown["mean"]) == set(METRICS)
    assert len(shown["frames"]) == 3
    assert shown["mean"]["tracking"] == pytest.approx(0.0, abs=1e-6)
    assert shown["mean"]["chamfer_l2"] == pytest.approx(shown["mean"]["chamfer_floor"], rel=0.2)
    # The box grows by the tenth part of its first size in a frame; the keyframe is frame 3.
    assert shown["frames"][2]["edge_distortion"] == pytest.approx(1.5 / 1.3 - 1, rel=1e-5)


def test_measures_as_tables(case: EvaluateCase, capfd) -> None:
    arguments = ["evaluate", str(case.output), str(case.truth), "--frames", "1::2", "--samples", "500"]
    assert run(arguments) == 0
    brief = capfd.readouterr().out
    mean = json.loads((case.output / "metrics.json").read_text())["mean"]
    assert f"{mean['chamfer_l2'] * 1e5:.3f}" in brief
    assert f"{mean['normal_consistency']:.4f}" in brief
    assert run([*arguments, "--per-frame"]) == 0
    assert len(capfd.readouterr().out.splitlines()) > len(brief.splitlines()) + 3


@pytest.fixture
def without_truth(case: EvaluateCase, rng: np.random.Generator) -> Path:
    """Clouds of the case's three frames, of which the last is elsewhere, known to the run."""
    meshes = load_run(case.output).meshes
    clouds = [sample_surface(v, meshes.faces, 800, rng)[0] for v in meshes.vertices]
    clouds[2] += 3.0
    path = case.output.parent / "clouds.npz"
    np.savez(path, points=np.stack(clouds))
    report = {"input": {"path": str(path), "digests": digests(read_clouds(path).points, [None] * 3)}}
    (case.output / "report.json").write_text(json.dumps(report))
    return path


def test_without_a_truth_frames_are_judged(case: EvaluateCase, without_truth: Path, capfd) -> None:
    assert run(["evaluate", str(case.output)]) == 0
    lines = capfd.readouterr().out.splitlines()
    assert lines[-1] == "2 good, 1 lost (2)"
    assert lines[-2].startswith("frame 2 is lost: ") and "points" in lines[-2]
    assert run(["evaluate", str(case.output), "--json"]) == 0
    shown = json.loads(capfd.readouterr().out)
    assert shown["verdicts"] == ["good", "good", "lost"] and shown["quality"][0]["residual_mean_percent"] < 1e-3
    assert not (case.output / "metrics.json").exists()


def test_other_clouds_than_the_runs_are_refused_by_frame(case: EvaluateCase, without_truth: Path, capfd) -> None:
    points = np.load(without_truth)["points"]
    points[1, 5] += 1e-3
    np.savez(without_truth, points=points)
    assert run(["evaluate", str(case.output)]) == 2
    told = capfd.readouterr().err
    assert "1 of 3 frames: 1 (" in told and "--clouds" in told
    assert run(["evaluate", str(case.output), "--clouds", str(without_truth)]) == 0  # as told
    np.savez(without_truth, points=points[:2])
    for arguments in ([], ["--clouds", str(without_truth)]):
        assert run(["evaluate", str(case.output), *arguments]) == 2
        assert "expected 3 frames" in capfd.readouterr().err
    without_truth.unlink()
    assert run(["evaluate", str(case.output)]) == 2
    assert "no longer there" in capfd.readouterr().err


def test_clouds_in_the_run_folder_come_first(case: EvaluateCase, without_truth: Path, capfd) -> None:
    """As a demo keeps them, rounded."""
    points = np.load(without_truth)["points"].astype(np.float32)
    points[2] -= 3.0
    np.savez(case.output / "clouds.npz", points=points)
    assert run(["evaluate", str(case.output)]) == 0
    assert capfd.readouterr().out.splitlines()[-1] == "3 good"


def test_a_run_that_does_not_know_its_clouds(case: EvaluateCase, capfd) -> None:
    assert run(["evaluate", str(case.output)]) == 2
    assert "--clouds" in capfd.readouterr().err
    assert run(["evaluate", str(case.output), str(case.truth), "--clouds", str(case.truth)]) == 2
    assert "--clouds: expected no truth" in capfd.readouterr().err


def test_other_frames_than_the_result(case: EvaluateCase, capfd) -> None:
    assert run(["evaluate", str(case.output), str(case.truth)]) == 2
    told = capfd.readouterr().err
    assert "3 frames" in told
    assert "--frames" in told
    assert not (case.output / "metrics.json").exists()


def test_not_a_result(case: EvaluateCase, capfd) -> None:
    assert run(["evaluate", str(case.truth.parent), str(case.truth)]) == 2
    assert "expected the folder of a warpdef run" in capfd.readouterr().err


def test_sample(case: EvaluateCase, tmp_path: Path, capfd) -> None:
    clouds = tmp_path / "clouds.npz"
    command = ["sample", str(case.truth), "-o", str(clouds), "--points", "40", "--frames", "1::2"]
    assert run(command) == 0
    assert "3 frames of 40 points with normals" in capfd.readouterr().out
    first = read_clouds(clouds)
    assert [len(p) for p in first.points] == [40, 40, 40]
    assert first.points[0].min() >= 0 and first.points[0].max() <= 2.2 + 1e-9
    assert run(command) == 2
    assert "already exists" in capfd.readouterr().err
    assert run([*command, "--overwrite", "--seed", "1", "--noise", "0.1", "--normals", "none"]) == 0
    second = read_clouds(clouds)
    assert second.normals[0] is None
    assert not np.isin(second.points[0], first.points[0]).any()


@pytest.fixture
def small_demo(monkeypatch: pytest.MonkeyPatch) -> StandInMethod:
    """The demo with a box for its figure, a method that does nothing, and few samples."""
    monkeypatch.setattr("warpdef.truth.figure.walking_figure", moving_box)
    monkeypatch.setattr("warpdef.apps.demo.evaluate_run", partial(evaluate_run, samples=200))
    return StandInMethod.install(monkeypatch)


def test_demo(small_demo: StandInMethod, tmp_path: Path, monkeypatch, capfd) -> None:
    monkeypatch.chdir(tmp_path)
    command = ["demo", "--frames", "3", "--points", "60"]
    assert run(command) == 0
    output = tmp_path / "warpdef-demo"
    shown = capfd.readouterr().out
    assert str(output) in shown
    assert "Chamfer distance" in shown
    assert len(load_run(output).meshes) == 3
    assert [len(p) for p in read_clouds(output / "clouds.npz").points] == [60, 60, 60]
    assert (output / "metrics.json").is_file()
    # What it leaves can be used again.
    assert run(["evaluate", str(output), str(output / "truth.npz"), "--samples", "100"]) == 0
    assert run(["reconstruct", str(output / "clouds.npz"), "-o", "again"]) == 0
    # An older demo is replaced only when told, and only where nothing else lies in it.
    assert run(command) == 2
    assert run([*command, "--overwrite", "--json"]) == 0
    capfd.readouterr()
    (output / "truth.npz").write_bytes(b"mine")
    assert run([*command, "--overwrite"]) == 2
    assert "truth.npz" in capfd.readouterr().err
    assert (output / "truth.npz").read_bytes() == b"mine"


def test_demo_as_json(small_demo: StandInMethod, tmp_path: Path, capfd) -> None:
    command = ["demo", "-o", str(tmp_path / "out"), "--frames", "3", "--points", "60", "--iterations", "7", "--json"]
    assert run(command) == 0
    shown = json.loads(capfd.readouterr().out)
    assert shown["metrics"] == json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert shown["report"]["iterations"] == 3
    assert small_demo.calls[0]["config"].optimiser.iterations == 7


def test_demo_interrupted(small_demo: StandInMethod, tmp_path: Path, capfd) -> None:
    small_demo.interrupted = True
    assert run(["demo", "-o", str(tmp_path / "out"), "--frames", "3", "--points", "60"]) == 130
    assert (tmp_path / "out" / "clouds.npz").is_file()
    assert not (tmp_path / "out" / "metrics.json").exists()
    assert "the best state is in" in capfd.readouterr().err
