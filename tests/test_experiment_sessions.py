"""Running: what is finished is skipped, what fails is told, nothing half-done is kept. And the command as a whole."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from experiment_samples import TINY_CONFIG, Named, made_up, tiny_plan, write_ball
from stand_in_method import StandInMethod

import warpdef
from warpdef.apps.experiment import NAMES, _builder
from warpdef.apps.experiments import session
from warpdef.apps.experiments.plan import Plan
from warpdef.apps.experiments.run import TRUTH_TEMPLATE, Figure, execute, load_truth, with_values
from warpdef.apps.experiments.session import here, run_experiment
from warpdef.apps.experiments.store import Store
from warpdef.apps.main import run as command
from warpdef.datasets import find_sequences
from warpdef.errors import InputError
from warpdef.files import write_clouds_npz

TABLE = _builder("levels")(Plan((Named("one"), Named("two"))))


def counting(done: list[str], stop_after: int = 1000, error: BaseException | None = None):
    """An executor that makes results up, notes what it was asked for, and raises or yields ``error`` in the end."""

    def go(runs) -> Iterator:
        for run in runs:
            if len(done) == stop_after:
                if isinstance(error, Exception):
                    yield run, error
                    continue
                raise error or AssertionError
            done.append(run.key)
            yield run, made_up(run)

    return go


def test_a_second_call_does_nothing_again(tmp_path: Path) -> None:
    done: list[str] = []
    first = run_experiment(TABLE, Store(tmp_path), counting(done))
    assert sorted(done) == sorted(run.key for run in TABLE.runs()) and not first.skipped
    again: list[str] = []
    second = run_experiment(TABLE, Store(tmp_path), counting(again))
    assert again == [] and second.skipped == len(done)
    assert json.loads(json.dumps(second.results)) == json.loads(json.dumps(first.results))
    run_experiment(TABLE, Store(tmp_path), counting(again), again=True)
    assert len(again) == len(done)


def test_it_goes_on_where_it_was_interrupted(tmp_path: Path) -> None:
    done: list[str] = []
    with pytest.raises(KeyboardInterrupt):
        run_experiment(TABLE, Store(tmp_path), counting(done, 3, KeyboardInterrupt()))
    rest: list[str] = []
    run_experiment(TABLE, Store(tmp_path), counting(rest))
    assert len(done) == 3 and sorted(done + rest) == sorted(run.key for run in TABLE.runs())


@pytest.mark.parametrize("error", [InputError("no good"), ZeroDivisionError("defect")])
def test_a_failed_run_is_told_and_tried_again(tmp_path: Path, error: Exception) -> None:
    said: list[str] = []
    done: list[str] = []
    outcome = run_experiment(TABLE, Store(tmp_path), counting(done, 13, error), say=said.append)
    assert len(outcome.results) == 13 and len(outcome.failures) == 1
    assert str(error) in next(iter(outcome.failures.values()))
    defect = isinstance(error, ZeroDivisionError)
    assert any("ZeroDivisionError: defect\n" in line for line in said) == defect, "only a defect has a traceback"
    rest: list[str] = []
    assert not run_experiment(TABLE, Store(tmp_path), counting(rest)).failures and len(rest) == 1


def test_experiments_share_runs(tmp_path: Path) -> None:
    plan = Plan((Named("one"),))
    done: list[str] = []
    for name in ("noise", "resolution", "main"):
        run_experiment(_builder(name)(plan), Store(tmp_path), counting(done))
    assert len(done) == 5 + 4 - 1, "no noise, 5,000 points and table 1 are one run"


@pytest.mark.parametrize("text", ["", "{", "[]", '{"key": "other", "mean": {}}', '{"key": 3}'])
def test_a_damaged_result_is_an_error(tmp_path: Path, text: str) -> None:
    store = Store(tmp_path)
    run = TABLE.runs()[0]
    store.put(run, made_up(run))
    store.path(run).write_text(text)
    with pytest.raises(InputError, match="remove it to run again"):
        store.find(run)


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot be made"):
        Store(tmp_path / "file")


def test_an_interrupted_reconstruction_is_no_result(monkeypatch: pytest.MonkeyPatch) -> None:
    method = StandInMethod.install(monkeypatch)
    method.interrupted = True
    monkeypatch.setattr(warpdef, "reconstruct", method.reconstruct, raising=False)
    plan = tiny_plan([Named("one", 3)])
    with pytest.raises(KeyboardInterrupt):
        execute(plan.run(plan.sequences[0]))


def test_errors_of_a_run_do_not_stop_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    plan = tiny_plan([Named("one", 3), Named("two", 3)])

    def work(run, device, threads, keep):
        if run.source.name == "one":
            raise InputError("no good")
        return made_up(run)

    monkeypatch.setattr(session, "execute", work)
    outcomes = [result for _, result in here()(plan.each())]
    first, second = outcomes
    assert isinstance(first, InputError)
    assert not isinstance(second, Exception) and second["key"] == plan.each()[1].key


def test_truth_moves_with_given_clouds_and_repeats_frames() -> None:
    source = Named("one", 5)
    run = replace(tiny_plan([source]).run(source), frames=(2, 3, 2), scale=2.0, translation=(1.0, 0.0, -1.0))
    truth = load_truth(run)
    assert np.allclose(truth.vertices[0], 2.0 * source.load().vertices[2] + [1.0, 0.0, -1.0])
    assert np.array_equal(truth.vertices[0], truth.vertices[2]) and len(truth) == 3
    with pytest.raises(InputError, match="frames up to 4, got 5"):
        load_truth(replace(run, frames=(4, 5)))


def test_given_clouds_must_cover_the_frames(tmp_path: Path) -> None:
    source = Named("one", 5)
    clouds = warpdef.sample_sequence(source.load(), 50)
    write_clouds_npz(tmp_path / "points.npz", clouds.select(slice(2)))
    run = tiny_plan([source]).run(source, frames=(0, 1, 2), clouds=tmp_path / "points.npz")
    with pytest.raises(InputError, match="clouds for 3 frames, got 2"):
        execute(run)


@pytest.fixture(scope="module")
def ball(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_ball(tmp_path_factory.mktemp("data"))


def test_a_template_from_outside_keeps_its_vertices(ball: Path) -> None:
    (source,) = find_sequences(ball)
    run = tiny_plan([source]).run(source, {"keyframe.choice": "first"}, template=TRUTH_TEMPLATE)
    result = execute(run, "cpu", 1)
    assert result["template"]["vertices"] == 642 and result["keyframe"] == 0
    assert result["mean"]["tracking"] is not None and len(result["frames"]) == 3


def test_a_run_of_its_own_process_gives_the_same_numbers(ball: Path) -> None:
    (source,) = find_sequences(ball)
    run = tiny_plan([source]).run(source)
    ((_, inside),) = here("cpu", 1)([run])
    ((_, fresh),) = here("cpu", 2)([replace(run, fresh=True)])
    assert not isinstance(inside, Exception) and not isinstance(fresh, Exception), (inside, fresh)
    assert fresh["frames"] == inside["frames"] and fresh["threads"] == 2


def test_the_command_on_a_folder(ball: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib")
    arguments = ["experiment", "main", "--data", str(ball), "-o", str(tmp_path), "--quick", "--points", "200"]
    arguments += ["--samples", "500", "--threads", "2", "--device", "cpu"]
    assert command([*arguments, "--keep"]) == 0
    shown = capfd.readouterr().out
    assert "| all | warpdef | mean of 1 |" in shown or "| all | warpdef | ball 0:4 |" in shown
    assert "| all | paper | AMA (33 sequences) | 0.470 |" in shown and "A quick run" in shown
    assert {p.name for p in tmp_path.iterdir()} == {"main.csv", "main.json", "main.md", "main.png", "runs", "meshes"}
    (kept,) = (tmp_path / "meshes").iterdir()
    assert len(warpdef.load_run(kept).meshes) == 4 and (kept / "metrics.json").exists()

    before = (tmp_path / "main.csv").read_bytes()
    assert command([*arguments, "--json", "--no-plot"]) == 0
    captured = capfd.readouterr()
    assert json.loads(captured.out)["experiment"] == "main" and "1 of 1 runs are finished already" in captured.err
    assert (tmp_path / "main.csv").read_bytes() == before


def test_the_command_on_the_built_in_figure(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    arguments = ["experiment", "length", "-o", str(tmp_path), "--quick", "--points", "200", "--samples", "500"]
    assert command([*arguments, "--device", "cpu", "--threads", "2", "--no-plot", "--seed", "3"]) == 0
    report = json.loads((tmp_path / "length.json").read_text())
    assert [row["frames"] for row in report["rows"]] == ["0:3", None, "0:5", None]
    assert "seed = 3 (preset: 0)" in " ".join(report["notes"]) and capfd.readouterr().out


def test_rows_are_chosen_beside_the_first(ball: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "execute", lambda run, device, threads, keep: made_up(run))
    arguments = ["experiment", "ideas", "--data", str(ball), "-o", str(tmp_path), "--quick", "--no-plot"]
    assert command([*arguments, "--rows", "static planes", "--rows", "odd frames"]) == 0
    rows = list(json.loads((tmp_path / "ideas.json").read_text())["runs"])
    assert rows == ["all on", "without static planes cut", "without odd frames left out"]


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        (["--only", "nobody"], "part of a sequence's name (ball), got nobody"),
        (["--rows", "nothing"], "part of a row's name (all), got nothing"),
        (["--cluster", "tcp://here:1"], "--workers dask"),
        (["--worker-count", "2"], "--workers dask"),
        (["--frames", "5:"], "at least 2 of its 6 frames"),
        (["--config", "nowhere.toml"], "nowhere.toml"),
    ],
)
def test_bad_calls_end_with_code_2(
    ball: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], extra: list[str], message: str
) -> None:
    assert command(["experiment", "main", "--data", str(ball), "-o", str(tmp_path / "out"), "--no-plot", *extra]) == 2
    assert message in capsys.readouterr().err and not (tmp_path / "out").exists()


def test_memory_is_not_measured_on_a_cluster(ball: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["experiment", "long", "--data", str(ball), "-o", str(tmp_path / "out"), "--quick", "--no-plot"]
    assert command([*arguments, "--workers", "dask"]) == 2
    assert "memory of single processes" in capsys.readouterr().err and not (tmp_path / "out").exists()


def test_a_failure_and_an_interruption_have_their_exit_codes(
    ball: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    errors: list[BaseException] = [InputError("no good"), KeyboardInterrupt()]

    def work(run, device, threads, keep):
        raise errors.pop(0)

    monkeypatch.setattr(session, "execute", work)
    arguments = ["experiment", "main", "--data", str(ball), "-o", str(tmp_path), "--quick", "--no-plot"]
    assert command(arguments) == 2
    assert "error: ball 0:4, all: no good" in capsys.readouterr().err
    assert command(arguments) == 130
    assert "finished runs are kept" in capsys.readouterr().err


@pytest.mark.parametrize("name", NAMES)
def test_every_experiment_runs_on_the_crane_and_the_horse(name: str, shared_data: Path, tmp_path: Path) -> None:
    sequences = [s for s in find_sequences(shared_data) if s.name in ("ama_crane", "horse_gallop")]
    table = _builder(name)(tiny_plan(sequences, folder=shared_data))
    # What differs most from the plain run; the plans of all settings are tested elsewhere.
    last = table.settings[-1]
    cut = replace(table, settings=(replace(last, runs=tuple(replace(r, fresh=False) for r in last.runs)),))
    outcome = run_experiment(cut, Store(tmp_path), here("cpu", 2))
    assert not outcome.failures and len(outcome.results) == len(cut.runs())
    assert all(0 < r["mean"]["chamfer_l2"] < 1e-2 for r in outcome.results.values())


def test_the_figure_is_a_sequence() -> None:
    figure = Figure(5)
    assert len(figure.load(slice(1, 3))) == 2
    assert np.array_equal(figure.load(slice(1, 3)).vertices, figure.load().vertices[1:3])
    run = tiny_plan([figure]).run(figure)
    assert run.key != replace(run, config=with_values(TINY_CONFIG, {"seed": 1})).key
