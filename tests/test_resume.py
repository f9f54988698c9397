"""Runs that are cut short, gone on with, stopped or poisoned: the same bits, or the best state so far."""

from __future__ import annotations

import os
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import synthetic
from descent import chained

import warpdef
from warpdef.config import Config
from warpdef.errors import InputError, WarpdefError
from warpdef.files.checkpoint import read_checkpoint, write_checkpoint
from warpdef.fit import run as run_module
from warpdef.fit import saving
from warpdef.fit.objective import Objective
from warpdef.fit.optimise import Optimiser
from warpdef.fit.refine import Refinement
from warpdef.fit.terms import InputTerm
from warpdef.mesh import TriMesh
from warpdef.presets import preset
from warpdef.progress import Clock, Interruption, Limits, Progress
from warpdef.sequence import PointSequence

TRUTH = synthetic.turning_ellipsoid(4, 300, np.random.default_rng(3))
TEMPLATE = TriMesh(TRUTH.vertices[1], TRUTH.faces)
CLOUDS = PointSequence.from_arrays(TRUTH.clouds, TRUTH.normals)


def quick(base: Config | None = None, iterations: int = 60, rounds: int = 6, **groups: dict) -> Config:
    base = base or Config()
    config = replace(
        base,
        keyframe=replace(base.keyframe, choice="1"),
        grid=replace(base.grid, levels=3),
        optimiser=replace(base.optimiser, iterations=iterations, warmup=15),
        refine=replace(base.refine, iterations=rounds),
    )
    return replace(config, **{name: replace(getattr(config, name), **values) for name, values in groups.items()})


def fit(
    config: Config | None = None, threads: int = 1, clouds: PointSequence = CLOUDS, **how
) -> warpdef.Reconstruction:
    template = None if "resume" in how else TEMPLATE
    callback, safeguards = how.pop("callback", None), warpdef.Safeguards(**how)
    return warpdef.reconstruct(
        clouds, config, device="cpu", threads=threads, template=template, callback=callback, safeguards=safeguards
    )


class Cut(Exception):
    """A run is cut short, in this process."""


def cut_at(phase: str, iteration: int, config: Config, path: Path) -> None:
    """Leave the checkpoint of a run that dies when it tells of this iteration."""

    def die(progress: Progress) -> None:
        if progress.phase == phase and progress.iteration == iteration:
            raise Cut

    with pytest.raises(Cut):
        fit(config, checkpoint=path, checkpoint_seconds=0.0, callback=die)


@pytest.fixture(autouse=True)
def a_checkpoint_at_every_look(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(saving, "_SHARE", 1e9)


@pytest.fixture(autouse=True)
def some_arrive_and_some_do_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """All transitions would after 40 iterations, and tests here count on 60: the last one never does."""
    arrived = InputTerm.arrived
    monkeypatch.setattr(
        InputTerm, "arrived", lambda term, bound: arrived(term, bound) & (np.arange(len(term.loss)) < 2)
    )


def assert_same(found: warpdef.Reconstruction, expected: warpdef.Reconstruction) -> None:
    np.testing.assert_array_equal(found.vertices, expected.vertices)
    np.testing.assert_array_equal(found.faces, expected.faces)
    assert found.steps == expected.steps and found.keyframe == expected.keyframe
    told = ("solver", "losses", "iterations", "refine", "warnings", "template", "stopped", "keyframe_why")
    assert {name: found.report[name] for name in told} == {name: expected.report[name] for name in told}


# Same bits.

SOLVERS = {
    "cosine": quick(),
    "pruned, conjugate gradients": quick(grid={"prune": True}, sobolev={"solver": "cg"}),
    "paper": replace(quick(preset("paper")), refine=replace(Config().refine, iterations=0)),
    "chain": chained(quick()),
    "template follows all": chained(
        quick(loss={"template_follows_all": True}, optimiser={"template_rate": 1e-3}),
    ),
    "some points": quick(optimiser={"points": 100}),
}


@pytest.mark.parametrize("config", SOLVERS.values(), ids=SOLVERS)
def test_gone_on_with_from_any_look_it_ends_with_the_same_bits(config: Config, tmp_path: Path) -> None:
    whole = fit(config)
    for iteration in (20, 40, 60):  # of the checkpoint: 10, 30, 50; warm-up ends at 15
        cut_at("optimise", iteration, config, tmp_path / "c")
        result = fit(resume=tmp_path / "c", threads=2)
        assert_same(result, whole)
        assert result.report["resumed"] == [iteration - 10]


def test_the_vertex_stage_goes_on_from_any_round(tmp_path: Path) -> None:
    whole = fit(quick())
    for done in range(1, 7):  # the checkpoint of a round is written after it was told of
        cut_at("refine", done, quick(), tmp_path / "c")
        saved = read_checkpoint(tmp_path / "c")
        assert saved.facts["rounds"] == (done - 1 or None)
        assert_same(fit(resume=tmp_path / "c"), whole)


def test_frames_followed_are_followed_once_and_remembered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_module, "follow", lambda *_: ([0, 3], [3]))
    whole = fit(quick())
    assert whole.report["refine"]["frames_followed"] == [0, 3]
    cut_at("refine", 3, quick(), tmp_path / "c")
    monkeypatch.setattr(run_module, "follow", None)
    assert_same(fit(resume=tmp_path / "c"), whole)


def test_cut_short_again_and_again(tmp_path: Path) -> None:
    path = tmp_path / "c"
    cut_at("optimise", 30, quick(), path)
    for phase, iteration in (("optimise", 30), ("optimise", 50), ("refine", 3)):

        def die(progress: Progress, there=(phase, iteration)) -> None:
            if (progress.phase, progress.iteration) == there:
                raise Cut

        with pytest.raises(Cut):
            fit(resume=path, checkpoint=path, checkpoint_seconds=0.0, callback=die)
    result = fit(resume=path)
    assert_same(result, fit(quick()))
    assert result.report["resumed"] == [20, 20, 40, 60]


def test_what_searches_remember_is_only_for_speed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Why a checkpoint leaves the searches out: they answer exactly, whether or not they have been asked before."""
    whole = fit(quick())
    iterate, round_ = Optimiser.iterate, Refinement.run_round
    monkeypatch.setattr(Optimiser, "iterate", lambda self: (self.objective.forget(), iterate(self))[1])
    monkeypatch.setattr(Refinement, "run_round", lambda self: (self.objective.forget(), round_(self))[1])
    assert_same(fit(quick()), whole)
    assert callable(Objective.forget)


def test_keeping_checkpoints_changes_nothing(tmp_path: Path) -> None:
    assert_same(fit(quick(), checkpoint=tmp_path / "c", checkpoint_seconds=0.0), fit(quick()))


def test_the_template_stage_is_not_repeated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cut_at("optimise", 20, quick(), tmp_path / "c")
    whole = fit(quick())
    for name in ("choose_template", "accept_user_template"):
        monkeypatch.setattr(f"warpdef.starting_template.{name}", None)
    assert_same(fit(resume=tmp_path / "c"), whole)


def test_a_checkpoint_is_due_only_now_and_then(tmp_path: Path) -> None:
    fit(quick(), checkpoint=tmp_path / "c", checkpoint_seconds=1e6)
    assert not list(tmp_path.iterdir())


# What does not fit.


def test_another_input_is_refused_by_frame(tmp_path: Path) -> None:
    path = tmp_path / "c"
    cut_at("optimise", 20, quick(), path)
    points = [p.copy() for p in TRUTH.clouds]
    points[2][5, 1] += 1e-9
    other = PointSequence.from_arrays(points, TRUTH.normals)
    with pytest.raises(InputError, match=r"other points or normals in 1 of 4 frames: 2 \(frame 2\); give it the same"):
        fit(resume=path, clouds=other)
    shifted = PointSequence.from_arrays([p + 1 for p in TRUTH.clouds], TRUTH.normals)
    with pytest.raises(InputError, match=r"in 4 of 4 frames: 0 \(frame 0\), 1 \(frame 1\), 2 \(frame 2\), \.\.\.;"):
        fit(resume=path, clouds=shifted)
    with pytest.raises(InputError, match="had 4 frames, got 3"):
        fit(resume=path, clouds=CLOUDS.select(slice(3)))


def test_a_run_keeps_its_configuration(tmp_path: Path) -> None:
    path = tmp_path / "c"
    cut_at("optimise", 20, quick(), path)
    assert_same(fit(quick(), resume=path), fit(quick()))
    with pytest.raises(InputError, match="goes on with its own configuration; leave config out"):
        fit(quick(iterations=70), resume=path)


def test_another_template_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "c"
    cut_at("optimise", 20, quick(), path)
    again = warpdef.Safeguards(resume=path)
    same = warpdef.reconstruct(CLOUDS, device="cpu", threads=1, template=TEMPLATE, safeguards=again)
    assert_same(same, fit(quick()))
    other = TriMesh(TEMPLATE.vertices * 1.01, TEMPLATE.faces)
    with pytest.raises(InputError, match="the template given is not that of the run to continue"):
        warpdef.reconstruct(CLOUDS, device="cpu", template=other, safeguards=again)


def test_the_state_of_another_problem_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "c"
    cut_at("optimise", 20, quick(), path)
    saved = read_checkpoint(path)
    arrays = {name: a[:1] if name == "grids.u" else a for name, a in saved.arrays.items()}
    write_checkpoint(path, saved.facts, arrays)
    with pytest.raises(ValueError, match="expected the state of the same problem"):
        fit(resume=path)


def test_another_version_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cut_at("optimise", 20, quick(), tmp_path / "c")
    monkeypatch.setattr("warpdef.__version__", "9.9")
    (warning,) = fit(resume=tmp_path / "c").report["warnings"]
    assert "begun by warpdef" in warning and "continued by 9.9" in warning


def test_a_checkpoint_that_cannot_be_written_does_not_end_the_run(tmp_path: Path) -> None:
    heard: list[str] = []
    gone = tmp_path / "no folder" / "c"
    result = fit(quick(), checkpoint=gone, checkpoint_seconds=0.0, callback=lambda p: heard.append(p.message))
    (warning,) = result.report["warnings"]
    assert "no checkpoint could be written" in warning and heard.count(warning) == 1
    np.testing.assert_array_equal(result.vertices, fit(quick()).vertices)


# Stopped.


def test_the_time_limit_gives_the_best_state_so_far_and_can_be_gone_on_from(tmp_path: Path, monkeypatch) -> None:
    """The clock stands still until iteration 33; then the time is up but for what the vertex stage may take."""
    path, config = tmp_path / "c", quick()
    now = {"seconds": 0.0}
    monkeypatch.setattr(Limits, "seconds", property(lambda self: now["seconds"]))
    step = Optimiser.iterate

    def counted(self: Optimiser) -> None:
        step(self)
        now["seconds"] = 70.0 if self.done == 33 else now["seconds"]

    monkeypatch.setattr(Optimiser, "iterate", counted)
    result = fit(config, checkpoint=path, checkpoint_seconds=1e6, seconds_max=100.0)
    assert result.report["stopped"] == "time limit of 100 s" and not result.report["interrupted"]
    assert result.report["iterations"] == 33 and result.report["refine"]["rounds"] == 6
    assert [s["iteration"] for s in result.steps] == [10, 20, 30, 33]
    monkeypatch.setattr(Optimiser, "iterate", step)
    assert_same(fit(resume=path), fit(config))


def test_no_time_at_all_gives_the_template_everywhere(tmp_path: Path) -> None:
    result = fit(quick(), seconds_max=0.0)
    assert result.report["iterations"] == 1 and result.report["refine"]["rounds"] == 0
    assert np.abs(result.vertices - TEMPLATE.vertices).max() < 0.1


def test_ctrl_c_can_be_gone_on_from(tmp_path: Path) -> None:
    for phase, iteration in (("optimise", 30), ("refine", 2)):

        def interrupt(progress: Progress, there=(phase, iteration)) -> None:
            if (progress.phase, progress.iteration) == there:
                os.kill(os.getpid(), signal.SIGINT)

        result = fit(quick(), checkpoint=tmp_path / "c", checkpoint_seconds=1e6, callback=interrupt)
        assert result.report["stopped"] == "interrupted" and result.report["interrupted"]
        assert_same(fit(resume=tmp_path / "c"), fit(quick()))


def test_limits() -> None:
    interruption = Interruption()
    clock = Clock()
    assert Limits(interruption, clock).reason(1e9) == ""
    assert Limits(interruption, clock, 1e9).reason() == ""
    assert Limits(interruption, clock, 1e9).reason(1e9) == "time limit of 1e+09 s"
    interruption.asked = True
    assert Limits(interruption, clock).reason() == "interrupted"


# No numbers.


def poison(monkeypatch: pytest.MonkeyPatch, owner: type, name: str, iteration: int, bad: float, times: int = 1) -> None:
    """Fill an array with something not finite before this iteration (or round), so many times."""
    method = "iterate" if owner is Optimiser else "run_round"
    run, left = getattr(owner, method), [times]

    def poisoned(self) -> None:
        if self.done == iteration and left[0]:
            left[0] -= 1
            (self._state() if owner is Optimiser else self.state())[name].fill_(bad)
        run(self)

    monkeypatch.setattr(owner, method, poisoned)


@pytest.mark.parametrize("name", ["u", "second_moment", "nodes", "shape", "shape_u"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_steps_without_numbers_are_undone_at_half_the_rate(name: str, bad: float, monkeypatch) -> None:
    """The same as a run whose rate was halved by hand at the iteration that all went back to."""
    halved = Optimiser.iterate

    def by_hand(self: Optimiser) -> None:
        if self.done == 30:
            self.slow_down(0.5)
        halved(self)

    with monkeypatch.context() as patch:
        patch.setattr(Optimiser, "iterate", by_hand)
        expected = fit(quick())
    poison(monkeypatch, Optimiser, name, 34, bad)
    heard: list[str] = []
    result = fit(quick(), callback=lambda p: heard.append(p.message))
    np.testing.assert_array_equal(result.vertices, expected.vertices)
    assert result.steps == expected.steps
    (warning,) = result.report["warnings"]
    told = "iterations 31 to 40 left the finite numbers and were undone; learning rates are now 0.5 of the configured"
    assert warning.startswith(told) and warning in heard


def test_rates_far_too_high_are_halved_until_they_do(tmp_path: Path) -> None:
    config = quick(optimiser={"rate": 1e9, "rate_growth": 1e9, "chain": True, "points": 0}, refine={"iterations": 0})
    try:
        result = fit(config)
    except WarpdefError as error:
        assert "left the finite numbers" in str(error) and "lower optimiser.rate" in str(error)
    else:
        assert np.isfinite(result.vertices).all()


def test_lowered_rates_are_remembered(monkeypatch, tmp_path: Path) -> None:
    with monkeypatch.context() as patch:
        poison(patch, Optimiser, "u", 24, np.nan)
        whole = fit(quick())
        poison(patch, Optimiser, "u", 24, np.nan)
        cut_at("optimise", 50, quick(), tmp_path / "c")
    assert_same(fit(resume=tmp_path / "c"), whole)


def test_what_no_rate_can_mend(monkeypatch) -> None:
    with monkeypatch.context() as patch:
        poison(patch, Optimiser, "u", 4, np.nan, times=1000)
        with pytest.raises(
            WarpdefError, match="left the finite numbers by iteration 10 .* at any rate; lower optimiser"
        ):
            fit(quick())
    poison(monkeypatch, Optimiser, "u", 34, np.nan, times=1000)
    result = fit(quick())
    assert result.report["stopped"].endswith("at any rate; the state of iteration 30 was taken")
    assert result.report["iterations"] == 30 and result.report["refine"]["rounds"] == 6
    assert len(result.report["warnings"]) == run_module.UNDO_MAX and np.isfinite(result.vertices).all()


def test_stopped_among_steps_without_numbers(monkeypatch) -> None:
    poison(monkeypatch, Optimiser, "u", 34, np.nan)
    step = Optimiser.iterate

    def stopping(self: Optimiser) -> None:
        step(self)
        if self.done == 36:
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(Optimiser, "iterate", stopping)
    result = fit(quick())
    assert result.report["iterations"] == 30 and np.isfinite(result.vertices).all()


def test_a_round_without_numbers_is_undone(monkeypatch) -> None:
    expected = fit(quick(rounds=3, refine={"time": 0.0}))  # with time, when a round becomes smooth depends on how many
    poison(monkeypatch, Refinement, "rest", 3, np.nan)
    result = fit(quick(refine={"time": 0.0}))
    np.testing.assert_array_equal(result.vertices, expected.vertices)
    (warning,) = result.report["warnings"]
    assert warning.startswith(
        "round 4 of the vertex stage left the finite numbers and was undone; the result is that of"
    )


# Solves.


def test_solves_that_stall_are_told() -> None:
    config = quick(grid={"prune": True}, sobolev={"solver": "cg", "iterations_max": 1}, refine={"iterations_max": 1})
    grids, vertices = fit(config).report["warnings"]
    assert "cg solves looked at did not converge" in grids and "raise sobolev.iterations_max" in grids
    assert "block cg solves looked at did not converge" in vertices and "raise refine.iterations_max" in vertices
