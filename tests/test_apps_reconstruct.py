"""``warpdef reconstruct`` with a stand-in method: what goes where, and which exit code."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from stand_in_method import StandInMethod

from warpdef.apps.main import run
from warpdef.files.config_file import load_config
from warpdef.files.run_folder import load_run


@pytest.fixture
def method(monkeypatch: pytest.MonkeyPatch) -> StandInMethod:
    return StandInMethod.install(monkeypatch)


@pytest.fixture
def clouds(tmp_path: Path, rng: np.random.Generator) -> Path:
    """Six frames of 30 points as an npz."""
    np.savez(tmp_path / "clouds.npz", points=rng.normal(size=(6, 30, 3)))
    return tmp_path / "clouds.npz"


def test_a_run_folder_and_a_summary(method, clouds: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "out"
    assert run(["reconstruct", str(clouds), "-o", str(output)]) == 0
    loaded = load_run(output)
    assert loaded.meshes.vertices.shape == (6, 4, 3)
    assert {"load", "optimise", "write", "total"} <= set(loaded.report["seconds"])
    assert all(seconds >= 0 for seconds in loaded.report["seconds"].values())
    shown, told = capfd.readouterr()
    for part in ("6 frames, 4 vertices, 2 faces", "as told", "frame 0 has no closed surface", str(output)):
        assert part in " ".join(shown.split())
    assert "a library talks" not in shown
    # Not a terminal: a line a phase, and a message once.
    lines = told.splitlines()
    assert lines.count("optimise: 3 iterations") == 1
    assert lines.count("template: frame 0 has no closed surface; trying frame 1") == 1
    assert not (set(output.parent.iterdir()) - {output, clouds})


def test_json_leaves_nothing_else_on_standard_output(method, clouds: Path, tmp_path: Path, capfd) -> None:
    assert run(["reconstruct", str(clouds), "-o", str(tmp_path / "out"), "--json"]) == 0
    shown = json.loads(capfd.readouterr().out)
    assert shown == json.loads((tmp_path / "out" / "report.json").read_text())


def test_options_reach_the_method(method, clouds: Path, tmp_path: Path) -> None:
    mesh = tmp_path / "mesh.off"
    mesh.write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    arguments = ["--device", "cpu", "--threads", "2", "--frames", "1:6:2", "--points", "20", "--template", str(mesh)]
    assert run(["reconstruct", str(clouds), "-o", str(tmp_path / "out"), *arguments]) == 0
    call = method.calls[0]
    assert (call["device"], call["threads"], len(call["sequence"])) == ("cpu", 2, 3)
    np.testing.assert_array_equal(call["sequence"].points[1], np.load(clouds)["points"][3])
    assert call["config"].points == 20
    assert len(call["template"].vertices) == 3


def test_the_written_configuration_repeats_the_run(method, clouds: Path, tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    arguments = ["--frames", "1:5", "--preset", "paper", "--seed", "4", "--iterations", "9"]
    assert run(["reconstruct", str(clouds), "-o", str(first), *arguments]) == 0
    written = first / "config.toml"
    assert load_config(written).frames == "1:5"
    assert run(["reconstruct", str(clouds), "-o", str(second), "--config", str(written)]) == 0
    assert (second / "config.toml").read_text() == written.read_text()
    assert method.calls[0]["config"] == method.calls[1]["config"]
    assert len(method.calls[1]["sequence"]) == 4


def test_an_existing_result_is_replaced_only_when_told(method, clouds: Path, tmp_path: Path, capfd) -> None:
    command = ["reconstruct", str(clouds), "-o", str(tmp_path / "out")]
    assert run(command) == 0
    before = (tmp_path / "out" / "config.toml").stat().st_ino
    assert run([*command, "--seed", "5"]) == 2
    assert "already exists" in capfd.readouterr().err
    assert (tmp_path / "out" / "config.toml").stat().st_ino == before
    assert len(method.calls) == 1  # refused before any work
    assert run([*command, "--seed", "5", "--overwrite"]) == 0
    assert load_run(tmp_path / "out").config.seed == 5


def test_interrupted_with_a_state_to_keep(method, clouds: Path, tmp_path: Path, capfd) -> None:
    method.interrupted = True
    assert run(["reconstruct", str(clouds), "-o", str(tmp_path / "out")]) == 130
    assert load_run(tmp_path / "out").report["interrupted"] is True
    last = capfd.readouterr().err.splitlines()[-1]
    assert last == f"warpdef: interrupted after 3 iterations: the best state is in {tmp_path / 'out'}"


def test_interrupted_with_nothing_to_keep(method, clouds: Path, tmp_path: Path, capfd) -> None:
    method.error = KeyboardInterrupt()
    assert run(["reconstruct", str(clouds), "-o", str(tmp_path / "out")]) == 130
    assert capfd.readouterr().err.splitlines()[-1] == "warpdef: interrupted: nothing was written"
    assert list(tmp_path.iterdir()) == [clouds]


def test_a_defect_of_ours_keeps_its_traceback(method, clouds: Path, tmp_path: Path) -> None:
    method.error = ZeroDivisionError("ours")
    with pytest.raises(ZeroDivisionError):
        run(["reconstruct", str(clouds), "-o", str(tmp_path / "out")])
    assert list(tmp_path.iterdir()) == [clouds]
