"""The run folder is read back as written; what does not fit is refused, what is damaged is named."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from present import present
from run_folder_samples import FACES, VERTICES, drop_report, entries, full_disk, save

import warpdef
from warpdef.config import Config, OptimiserConfig
from warpdef.errors import InputError
from warpdef.files import read_mesh, read_mesh_frames, read_mesh_sequence
from warpdef.files.json_text import json_text
from warpdef.files.run_folder import RunFolder
from warpdef.files.saved_run import load_run, write_metrics

pytest.importorskip("tomli_w")


def test_a_run_is_read_back(tmp_path):
    out = save(RunFolder.prepare(tmp_path / "new" / "out"))
    assert out == tmp_path / "new" / "out"
    assert entries(tmp_path / "new") == ["out"]
    assert entries(out) == ["config.toml", "meshes", "report.json", "sequence.npz", "steps.jsonl"]
    run = load_run(out)
    np.testing.assert_array_equal(run.meshes.vertices, VERTICES)
    np.testing.assert_array_equal(run.meshes.faces, FACES)
    assert run.meshes.vertices.dtype == np.float32
    assert run.keyframe == 5
    assert run.names == tuple(f"scan{i}.ply" for i in range(12))
    assert run.config == Config(seed=7, optimiser=OptimiserConfig(iterations=3))
    assert run.report == {"iterations": 3, "seconds": {"load": 0.5}, "warnings": ["naïve"]}
    steps = [json.loads(line) for line in (out / "steps.jsonl").read_text().splitlines()]
    assert steps == [{"iteration": 0, "loss": 1.0}, {"iteration": 1, "loss": 0.5}, {"iteration": 2, "loss": 1 / 3}]


def test_other_readers_take_a_run(tmp_path):
    out = save(RunFolder.prepare(tmp_path / "out"))
    with np.load(out / "sequence.npz", allow_pickle=False) as stored:
        assert sorted(stored.files) == ["faces", "keyframe", "names", "vertices"]
        assert (stored["vertices"].dtype, stored["faces"].dtype, stored["keyframe"].shape) == (np.float32, np.int32, ())
    for path in (out, out / "meshes"):
        np.testing.assert_array_equal(read_mesh_sequence(path).vertices, VERTICES)
        np.testing.assert_array_equal([m.vertices for m in read_mesh_frames(path, slice(9, 12))], VERTICES[9:])
    assert entries(out / "meshes") == [f"{i:04d}.ply" for i in range(12)]
    np.testing.assert_array_equal(read_mesh(out / "meshes" / "0003.ply").vertices, VERTICES[3])


def test_a_result_in_python_becomes_a_folder(tmp_path):
    trust = np.full(VERTICES.shape[:2], 9, dtype=np.uint8)
    config = Config(seed=7)
    result = warpdef.Reconstruction(VERTICES, FACES, 5, config, {"warnings": []}, [{"loss": 1.0}], confidence=trust)
    out = warpdef.save_run(result, tmp_path / "out")
    run = warpdef.load_run(out)
    np.testing.assert_array_equal(run.vertices, VERTICES)
    np.testing.assert_array_equal(present(run.confidence), trust)
    assert (run.keyframe, run.config, run.names[3]) == (5, config, "frame 3")
    with pytest.raises(InputError, match="already exists"):
        warpdef.save_run(result, out)
    names = [f"{t}.ply" for t in range(len(VERTICES))]
    assert warpdef.load_run(warpdef.save_run(result, out, names, overwrite=True)).names == tuple(names)


def test_a_result_obeys_the_umask(tmp_path):
    out = save(RunFolder.prepare(tmp_path / "out"))
    (tmp_path / "plain").mkdir()
    assert out.stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_the_confidence_comes_back(tmp_path):
    trust = np.arange(48, dtype=np.uint8).reshape(12, 4)
    found = present(load_run(save(RunFolder.prepare(tmp_path / "out"), confidence=trust)).confidence)
    assert found.dtype == np.uint8 and (found == trust).all()
    assert load_run(save(RunFolder.prepare(tmp_path / "older"))).confidence is None


def test_report_may_be_asked_for_last(tmp_path):
    def report():
        (partial,) = tmp_path.iterdir()
        return {"there": entries(partial)}

    out = save(RunFolder.prepare(tmp_path / "out"), report=report)
    assert load_run(out).report == {"there": ["config.toml", "meshes", "sequence.npz", "steps.jsonl"]}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"names": ["a"]}, "expected 12 frame names and a keyframe among them, got 1 names and keyframe 5"),
        ({"keyframe": 12}, "got 12 names and keyframe 12"),
        ({"vertices": VERTICES[0]}, r"expected shape \(T, V, 3\)"),
        ({"vertices": VERTICES * np.nan}, "NaN or infinity"),
        ({"faces": FACES + 1}, r"vertex indices in 0\.\.3"),
        ({"confidence": np.zeros((12, 3), dtype=np.uint8)}, r"confidence: expected shape \(12, 4\), got \(12, 3\)"),
    ],
)
def test_results_that_do_not_fit(tmp_path, changes, message):
    with pytest.raises(InputError, match=message):
        save(RunFolder.prepare(tmp_path / "out"), **changes)
    assert entries(tmp_path) == []


def test_metrics(tmp_path, monkeypatch):
    out = save(RunFolder.prepare(tmp_path / "out"))
    assert write_metrics(out, {"mean": {"tracking": float("nan")}, "frames": []}) == out / "metrics.json"
    assert json.loads((out / "metrics.json").read_text()) == {"mean": {"tracking": None}, "frames": []}
    write_metrics(out, {"mean": 2})
    monkeypatch.setattr("warpdef.files.disk.os.replace", full_disk)
    with pytest.raises(InputError, match=r"metrics\.json: cannot be written \(No space left on device\)"):
        write_metrics(out, {"mean": 3})
    assert json.loads((out / "metrics.json").read_text()) == {"mean": 2}
    assert not [name for name in entries(out) if name.startswith(".")]
    with pytest.raises(
        InputError, match="expected the folder of a warpdef run, got one without sequence.npz, config.toml"
    ):
        write_metrics(tmp_path, {})


def spoil_json(out: Path) -> None:
    (out / "report.json").write_text("{")


def spoil_config(out: Path) -> None:
    (out / "config.toml").write_text("sede = 1")


def spoil_sequence(out: Path) -> None:
    data = (out / "sequence.npz").read_bytes()
    (out / "sequence.npz").write_bytes(data[: len(data) // 2])


def spoil_keyframe(out: Path) -> None:
    np.savez(out / "sequence.npz", vertices=VERTICES, faces=FACES, keyframe=99, names=["a"] * 12)


def spoil_names(out: Path) -> None:
    np.savez(out / "sequence.npz", vertices=VERTICES, faces=FACES, keyframe=[1, 2], names=["a"] * 11)


def spoil_confidence(out: Path) -> None:
    arrays = {"vertices": VERTICES, "faces": FACES, "keyframe": 5, "names": ["a"] * 12}
    np.savez(out / "sequence.npz", **arrays, confidence=np.zeros((12, 4)))


def drop_keyframe(out: Path) -> None:
    np.savez(out / "sequence.npz", vertices=VERTICES, faces=FACES)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (spoil_json, r"report\.json: not valid JSON"),
        (spoil_config, r"config\.toml: unknown key 'sede'; did you mean 'seed'"),
        (spoil_sequence, r"sequence\.npz: cannot be read"),
        (spoil_keyframe, "expected 12 names and a keyframe among them"),
        (spoil_confidence, r"confidence: expected shape \(12, 4\) uint8, got \(12, 4\) float64"),
        (spoil_names, "expected 12 names and a keyframe among them"),
        (drop_keyframe, "expected an array 'keyframe', got vertices, faces"),
        (drop_report, "without report.json"),
        (shutil.rmtree, "got nothing there"),
    ],
)
def test_damaged_runs(tmp_path, spoil, message):
    out = save(RunFolder.prepare(tmp_path / "out"))
    spoil(out)
    with pytest.raises(InputError, match=message):
        load_run(out)


def test_json_is_plain(tmp_path):
    value = {1: np.arange(2), "path": Path("a"), "inf": [np.float32("inf"), (True, None)], "flag": np.bool_(True)}
    assert json.loads(json_text(value)) == {"1": [0, 1], "path": "a", "inf": [None, [True, None]], "flag": True}
    assert "\n" not in json_text(value, None)
    with pytest.raises(TypeError):
        json_text({"a": object()})


# What a killed process left.
