"""``warpdef reconstruct`` with a stand-in method: what goes where, and which exit code."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import synthetic
import trimesh
from present import present
from stand_in_method import StandInMethod
from trimesh.visual import ColorVisuals

from warpdef.apps.main import run
from warpdef.files import write_ply
from warpdef.files.config_file import load_config
from warpdef.files.run_folder import RunFolder
from warpdef.files.saved_run import load_run


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


@pytest.mark.parametrize(("worst", "strict", "code"), [("good", True, 0), ("lost", False, 0), ("lost", True, 3)])
def test_the_verdict_comes_last(method, clouds: Path, tmp_path: Path, capfd, worst, strict, code: int) -> None:
    method.more = {"verdicts": ["good"] * 4 + ["doubtful", worst]}
    arguments = ["reconstruct", str(clouds), "-o", str(tmp_path / "out"), *["--strict"] * strict]
    assert run(arguments) == code
    shown = capfd.readouterr().out.splitlines()
    assert shown[-1] == {"good": "5 good, 1 doubtful (4)", "lost": "4 good, 1 doubtful (4), 1 lost (5)"}[worst]
    assert load_run(tmp_path / "out").report["verdicts"][-1] == worst  # written all the same


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


# Cut short, and gone on with.


@pytest.fixture
def real(tmp_path: Path) -> list[str]:
    """A small real problem on the command line."""
    moving = synthetic.turning_ellipsoid(3, 200, np.random.default_rng(0), subdivisions=1)
    np.savez(tmp_path / "clouds.npz", points=np.stack(moving.clouds), normals=np.stack(moving.normals))
    write_ply(tmp_path / "mesh.ply", moving.vertices[1], moving.faces)
    small = ["--keyframe", "1", "--grid.levels", "2", "--iterations", "40", "--optimiser.warmup", "10"]
    small += ["--refine.iterations", "2", "--template", str(tmp_path / "mesh.ply")]
    return [str(tmp_path / "clouds.npz"), "-o", str(tmp_path / "out"), *small]


def device(*more: str) -> list[str]:
    return ["--device", "cpu", "--threads", "1", *more]


def cut(real: list[str], monkeypatch: pytest.MonkeyPatch, *more: str) -> None:
    """A run that dies while it writes its result."""

    def die(*_args: object, **_kwargs: object) -> None:
        raise MemoryError

    with monkeypatch.context() as patch, pytest.raises(MemoryError):
        patch.setattr(RunFolder, "save", die)
        patch.setattr("warpdef.fit.saving._SHARE", 1e9)  # however slow the disk, a checkpoint at every look
        run(["reconstruct", *real, *device("--checkpoint-seconds", "0", *more)])


def test_resume_goes_on_with_what_was_cut_short(real, tmp_path: Path, monkeypatch, capfd) -> None:
    assert run(["reconstruct", *real, *device("--frames", ":3")]) == 0
    first = load_run(tmp_path / "out")
    shutil.rmtree(tmp_path / "out")
    cut(real, monkeypatch, "--frames", ":3")
    told = capfd.readouterr().err.splitlines()[-1]
    assert told == f"warpdef: the last checkpoint is kept; go on with: warpdef reconstruct --resume {tmp_path / 'out'}"
    assert (tmp_path / ".out.checkpoint").exists()
    assert run(["reconstruct", "--resume", str(tmp_path / "out"), *device()]) == 0
    second = load_run(tmp_path / "out")
    np.testing.assert_array_equal(second.meshes.vertices, first.meshes.vertices)
    assert second.config == first.config and second.config.frames == ":3"
    assert second.report["resumed"] == [40] and second.report["stopped"] is None
    assert not (tmp_path / ".out.checkpoint").exists()


@pytest.mark.parametrize("there", [True, False])
def test_a_run_that_goes_on_needs_its_template_only_for_the_colours(there, real, tmp_path: Path, monkeypatch, capfd):
    """The shape is in the checkpoint: a file that is gone is told, and loses nothing else."""
    colors = np.arange(3 * 42, dtype=np.uint8).reshape(42, 3)
    mesh = trimesh.load_mesh(tmp_path / "mesh.ply", process=False)
    mesh.visual = ColorVisuals(mesh, vertex_colors=colors)
    mesh.export(tmp_path / "mesh.ply")
    cut(real, monkeypatch)
    if not there:
        (tmp_path / "mesh.ply").unlink()
    assert run(["reconstruct", "--resume", str(tmp_path / "out"), *device()]) == 0
    result = load_run(tmp_path / "out")
    assert result.report["resumed"] == [40] and result.vertices.shape[1] == 42
    told = "warpdef: warning: the result has no colours of the template: " in capfd.readouterr().err
    assert told == (not there)
    if there:
        np.testing.assert_array_equal(present(present(result.appearance).colors)[:, :3], colors)
    else:
        assert result.appearance.colors is None


def test_an_unfinished_run_is_not_begun_anew_by_accident(real, tmp_path: Path, monkeypatch, capfd) -> None:
    cut(real, monkeypatch)
    assert run(["reconstruct", *real, *device()]) == 2
    assert "an unfinished run is kept beside it; go on with --resume" in capfd.readouterr().err
    assert run(["reconstruct", *real, *device("--overwrite")]) == 0
    assert not (tmp_path / ".out.checkpoint").exists()


def test_resume_to_another_place(real, tmp_path: Path, monkeypatch) -> None:
    cut(real, monkeypatch)
    assert run(["reconstruct", "--resume", str(tmp_path / "out"), "-o", str(tmp_path / "new"), *device()]) == 0
    assert load_run(tmp_path / "new").report["resumed"] == [40]
    assert not (tmp_path / "out").exists() and not (tmp_path / ".out.checkpoint").exists()


@pytest.mark.parametrize("changed", [["--seed", "3"], ["--preset", "paper"], ["--config", "x.toml"]])
def test_resume_keeps_the_configuration(changed: list[str], tmp_path: Path, capfd) -> None:
    assert run(["reconstruct", "--resume", str(tmp_path / "out"), *changed]) == 2
    assert "--resume goes on with the configuration of that run" in capfd.readouterr().err


def test_nothing_to_resume(tmp_path: Path, capfd) -> None:
    assert run(["reconstruct", "--resume", str(tmp_path / "out")]) == 2
    assert "no checkpoint of an unfinished run is kept there" in capfd.readouterr().err


def test_the_input_to_resume_with_has_gone(real, tmp_path: Path, monkeypatch, capfd) -> None:
    cut(real, monkeypatch)
    (tmp_path / "clouds.npz").rename(tmp_path / "elsewhere.npz")
    assert run(["reconstruct", "--resume", str(tmp_path / "out"), *device()]) == 2
    assert "the input of the run to resume is gone; give its new place before --resume" in capfd.readouterr().err
    arguments = [str(tmp_path / "elsewhere.npz"), "--resume", str(tmp_path / "out"), *device()]
    assert run(["reconstruct", *arguments]) == 0


def test_a_time_limit_ends_with_a_whole_result_that_can_go_on(real, tmp_path: Path, capfd) -> None:
    """No time at all: one iteration."""
    assert run(["reconstruct", *real, *device("--max-seconds", "0.001")]) == 0
    report = load_run(tmp_path / "out").report
    assert report["stopped"].startswith("time limit of ") and report["iterations"] == 1
    told = capfd.readouterr().err.splitlines()[-1]
    assert told.startswith("warpdef: stopped (time limit of ") and told.endswith(f"--resume {tmp_path / 'out'}")
    assert run(["reconstruct", "--resume", str(tmp_path / "out"), *device()]) == 0
    assert load_run(tmp_path / "out").report["iterations"] == 40


def test_a_run_too_large_is_refused(real, tmp_path: Path, capfd) -> None:
    assert run(["reconstruct", *real, *device("--memory-limit", "0.01")]) == 2
    assert "--memory-limit 0 tries all the same" in capfd.readouterr().err
    assert run(["reconstruct", *real, *device("--memory-limit", "0")]) == 0
