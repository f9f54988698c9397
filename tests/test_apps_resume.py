"""``--resume`` on what is finished or gone, the times of a run that goes on, and ``--quiet``."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import synthetic

from warpdef.apps.main import run
from warpdef.files import write_ply
from warpdef.files.checkpoint import read_checkpoint, write_checkpoint


@pytest.fixture
def command(tmp_path: Path) -> list[str]:
    moving = synthetic.turning_ellipsoid(3, 200, np.random.default_rng(0), subdivisions=1)
    np.savez(tmp_path / "clouds.npz", points=np.stack(moving.clouds), normals=np.stack(moving.normals))
    write_ply(tmp_path / "mesh.ply", moving.vertices[1], moving.faces)
    small = ["--keyframe", "1", "--grid.levels", "2", "--iterations", "20", "--optimiser.warmup", "5"]
    small += ["--refine.iterations", "1", "--template", str(tmp_path / "mesh.ply"), "--device", "cpu", "--threads", "1"]
    return ["reconstruct", str(tmp_path / "clouds.npz"), "-o", str(tmp_path / "out"), *small]


def seconds(folder: Path) -> dict[str, float]:
    return json.loads((folder / "report.json").read_text())["seconds"]


def test_a_finished_run_says_so(command, tmp_path: Path, capfd) -> None:
    assert run(command) == 0
    for _ in range(2):
        assert run(["reconstruct", "--resume", str(tmp_path / "out")]) == 2
        assert "this run is finished (20 iterations), there is nothing to go on with" in capfd.readouterr().err
        (tmp_path / "out" / "notes.txt").write_text("laid into it by someone")


def test_a_run_that_was_stopped_and_lost_its_checkpoint(command, tmp_path: Path, capfd) -> None:
    assert run([*command, "--max-seconds", "0.001"]) == 0
    (tmp_path / ".out.checkpoint").unlink()
    assert run(["reconstruct", "--resume", str(tmp_path / "out")]) == 2
    assert "its checkpoint is gone; begin it anew with --overwrite" in capfd.readouterr().err


def test_the_times_of_a_run_that_goes_on_add_up(command, tmp_path: Path) -> None:
    assert run([*command, "--max-seconds", "0.001"]) == 0
    checkpoint = tmp_path / ".out.checkpoint"
    saved = read_checkpoint(checkpoint)
    before = saved.facts["seconds"] | {"template": 1000.0, "optimise": 2000.0}
    write_checkpoint(
        checkpoint, saved.facts | {"seconds": before, "notes": saved.facts["notes"] | {"load": "500.0"}}, saved.arrays
    )
    assert run(["reconstruct", "--resume", str(tmp_path / "out"), "--device", "cpu"]) == 0
    found = seconds(tmp_path / "out")
    assert found["load"] > 500 and found["template"] >= 1000 and found["optimise"] > 2000
    parts = sum(value for name, value in found.items() if name != "total")
    assert 3500 < found["total"] and found["total"] >= parts - 0.01


def test_quiet_says_nothing(command, tmp_path: Path, capfd) -> None:
    assert run([*command, "--quiet"]) == 0
    assert capfd.readouterr() == ("", "")
    assert run([*command, "-q", "--overwrite", "--max-seconds", "0.001"]) == 0
    shown, told = capfd.readouterr()
    assert shown == "" and told.startswith("warpdef: stopped (time limit") and len(told.splitlines()) == 1
