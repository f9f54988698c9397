"""What the experiments consist of: settings, runs, and the published rows that belong to them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from experiment_samples import Named, known_data

from warpdef.apps.config_flags import entries
from warpdef.apps.experiment import NAMES, _builder
from warpdef.apps.experiments.code_version import digest
from warpdef.apps.experiments.own_experiments import IDEAS, OF_THE_DESCENT
from warpdef.apps.experiments.plan import Plan, PlanSize, benchmark
from warpdef.apps.experiments.published import ABOVE_FLOOR, PUBLISHED, WORST_FRAME
from warpdef.apps.experiments.run import TRUTH_TEMPLATE, frame_text, to_and_fro, value_of, with_values
from warpdef.config import Config
from warpdef.errors import ConfigError, InputError, WarpdefError
from warpdef.presets import preset


def built(name: str, plan: Plan):
    return _builder(name)(plan)


@pytest.mark.parametrize("name", NAMES)
def test_every_experiment_has_distinct_settings_and_runs(name: str, tmp_path: Path) -> None:
    table = built(name, known_data(tmp_path))
    names = [setting.name for setting in table.settings]
    assert table.name == name and len(set(names)) == len(names) > 0
    assert all(setting.runs for setting in table.settings)
    keys = [run.key for run in table.runs()]
    assert len(set(keys)) == len(keys)


def test_every_published_row_finds_its_setting(tmp_path: Path) -> None:
    plan = known_data(tmp_path)
    settings = {(name, setting.name) for name in NAMES for setting in built(name, plan).settings}
    assert [r for r in PUBLISHED if (r.experiment, r.setting) not in settings] == []
    assert {("accuracy", name) for name in (*WORST_FRAME, *ABOVE_FLOOR)} <= settings


def test_accuracy_has_exactly_the_rows_of_the_targets(tmp_path: Path) -> None:
    table = built("accuracy", known_data(tmp_path))
    runs = {setting.name: setting.runs[0] for setting in table.settings}
    assert set(runs) == {
        "ama_crane 10:27",
        "horse_gallop 0:17",
        "crane_clouds",
        "ama_crane 10:27, noise 0.5 %",
        "ama_crane 10:27, noise 1 %",
        "ama_crane 10:27, 2,500 points",
        "ama_crane 10:27, 20,000 points",
        "ama_crane 0:80",
        "cesiumman_walk 0:17",
        "face_mmface4d 0:17",
    }
    given = runs["crane_clouds"]
    assert given.frames == tuple(range(10, 27)) and given.scale == 0.5 and given.translation == (1.0, 2.0, 3.0)
    assert given.clouds is not None and given.clouds.name == "points.npz" and given.points == 0
    assert runs["ama_crane 10:27, noise 1 %"].noise == 0.01
    assert runs["ama_crane 10:27, 20,000 points"].points == 20000
    assert all(run.config == Config() and run.samples == 100_000 for run in runs.values())


def test_accuracy_says_when_no_sequence_is_long_enough() -> None:
    table = built("accuracy", Plan((Named("short", 20),)))
    assert [s.name for s in table.settings][0] == "short 0:17" and "fewer than 80 frames" in table.notes[0]


def test_components_switch_what_they_name(tmp_path: Path) -> None:
    configs = {s.name: s.runs[0].config for s in built("components", known_data(tmp_path)).settings}
    assert len(configs) == 8 and len(set(configs.values())) == 8
    assert all(c.optimiser.chain and not c.optimiser.points for c in configs.values()), "else isometry has no say"
    whole = Config().optimiser
    assert configs["P M I"].optimiser == replace(whole, chain=True, points=0, iterations=3 * whole.iterations)
    assert replace(configs["P M I"], optimiser=whole) == Config()
    for name, config in configs.items():
        assert config.sobolev.enabled == ("P" in name)
        assert (config.grid.coarsest == 1) == ("M" in name) and config.grid.levels == 10
        assert (config.loss.isometry_weight > 0) == ("I" in name)


def test_settings_of_sweeps(tmp_path: Path) -> None:
    plan = known_data(tmp_path)
    assert [s.runs[0].config.grid.levels for s in built("levels", plan).settings] == [1, 2, 4, 6, 8, 10, 12]
    assert [s.runs[0].points for s in built("resolution", plan).settings] == [2500, 5000, 10000, 20000]
    assert [s.runs[0].noise for s in built("noise", plan).settings] == [0, 0.0025, 0.005, 0.01, 0.02]
    length = built("length", plan)
    assert [len(s.runs[0].frames) for s in length.settings] == [10, 20, 40, 60, 80]
    assert [len(s.runs) for s in length.settings] == [4, 4, 4, 3, 1]
    assert any("horse_gallop" in note for note in length.notes)


def test_length_needs_frames() -> None:
    with pytest.raises(InputError, match="at least 10 frames"):
        built("length", Plan((Named("short", 9),)))


def test_main_takes_clouds_that_come_with_the_data() -> None:
    plan = Plan((Named("with", 17, clouds=Path("point_clouds")), Named("without", 17)))
    (setting,) = built("main", plan).settings
    assert [run.clouds for run in setting.runs] == [Path("point_clouds"), None]
    (setting,) = built("main", replace(plan, frames="3:9")).settings
    assert setting.runs[0].clouds is None, "the clouds begin at frame 0"


def test_every_idea_can_be_switched_off_and_changes_something(tmp_path: Path) -> None:
    table = built("ideas", known_data(tmp_path))
    assert [s.name for s in table.settings] == ["all on", *(f"without {name}" for name, _ in IDEAS)]
    assert len({s.runs[0].config for s in table.settings}) == len(table.settings)
    assert all([run.noise for run in s.runs] == [0, 0, 0, 0, 0.005] for s in table.settings)


def test_ideas_of_the_descent_are_switched_off_in_it(tmp_path: Path) -> None:
    """Where nothing but the input term acts, a row that switches isometry off would be the row with all on."""
    configs = {s.name: s.runs[0].config for s in built("ideas", known_data(tmp_path)).settings}
    assert {name.removeprefix("without ") for name, c in configs.items() if c.optimiser.chain} == set(OF_THE_DESCENT)
    chain = configs["without mesh that follows its guide"]
    assert configs["without isometry"] == with_values(chain, {"loss.isometry_weight": 0.0})
    assert chain.optimiser.for_length(80) != with_values(chain, {"optimiser.rate_fall": 0.0}).optimiser.for_length(80)


def test_in_the_papers_descent_there_is_no_guide_to_switch_off() -> None:
    paper = preset("paper")
    table = built("ideas", Plan((Named("a"),), paper))
    assert "mesh that follows its guide: off already in this configuration." in table.notes
    assert {s.runs[0].config.optimiser.iterations for s in table.settings} == {paper.optimiser.iterations}
    configs = {s.name: s.runs[0].config for s in built("components", Plan((Named("a"),), paper)).settings}
    assert configs["P M I"] == paper


def test_everything_beyond_the_paper_is_an_idea_that_can_be_switched_off() -> None:
    paper, default = preset("paper"), Config()
    beyond = {e.key for e in entries() if value_of(paper, e.key) != value_of(default, e.key)}
    how_long = {f"optimiser.{name}" for name in ("iterations", "iterations_per_frame", "warmup")}
    assert beyond - how_long <= {key for _, off in IDEAS for key in off}


def test_an_idea_that_is_off_already_is_told() -> None:
    config = with_values(Config(), {"refine.iterations": 0})
    table = built("ideas", Plan((Named("a"),), config))
    assert "without vertex stage" not in [s.name for s in table.settings]
    assert any("vertex stage" in note for note in table.notes)


def test_long_goes_to_and_fro_in_processes_of_its_own(tmp_path: Path) -> None:
    table = built("long", known_data(tmp_path))
    runs = table.runs()
    assert all(run.fresh for run in runs) and max(len(run.frames) for run in runs) == 300
    assert max(max(run.frames) for run in runs) == 99


def test_initialization_gives_the_true_mesh_or_the_users(tmp_path: Path) -> None:
    plan = known_data(tmp_path)
    given = [s for s in built("initialization", plan).settings if s.name.endswith("given")]
    assert [s.runs[0].config.keyframe.choice for s in given] == ["first", "middle", "auto"]
    assert all(run.template == TRUTH_TEMPLATE for s in given for run in s.runs)
    meshes = tmp_path / "meshes"
    meshes.mkdir()
    plan = replace(plan, sequences=plan.sequences[:1], meshes=meshes)
    with pytest.raises(InputError, match="ama_crane_first.ply"):
        built("initialization", plan)
    (meshes / "ama_crane.obj").touch()
    (meshes / "ama_crane_auto.ply").touch()
    given = [s for s in built("initialization", plan).settings if s.name.endswith("given")]
    assert [Path(s.runs[0].template).name for s in given] == ["ama_crane.obj", "ama_crane.obj", "ama_crane_auto.ply"]


def test_frames_asked_for_replace_the_usual_ones(tmp_path: Path) -> None:
    plan = replace(known_data(tmp_path), frames="4:10:2")
    assert plan.usual_frames(plan.sequences[0]) == (4, 6, 8)
    with pytest.raises(InputError, match="at least 2 of its 100 frames"):
        replace(plan, frames="99:").usual_frames(plan.sequences[0])


@pytest.mark.parametrize("text", ["", "[]", '{"dynosurf": 3}', '{"dynosurf": {"first_frame": "x"}}', '{"other": 1}'])
def test_a_note_that_says_nothing_is_passed_over(tmp_path: Path, text: str) -> None:
    (tmp_path / "meta.json").write_text(text)
    assert benchmark(Named("a", path=tmp_path / "gt.npz")) == {}
    (tmp_path / "meta.json").write_text(json.dumps({"dynosurf": {"first_frame": 3}}))
    assert benchmark(Named("a", path=tmp_path)) == {"first_frame": 3}


def test_the_key_changes_with_everything_that_changes_numbers() -> None:
    plan = Plan((Named("a"),), size=PlanSize())
    base = plan.run(plan.sequences[0])
    others = [
        replace(base, frames=base.frames[1:]),
        replace(base, points=7),
        replace(base, noise=0.1),
        replace(base, samples=5),
        replace(base, scale=2.0),
        replace(base, translation=(0.0, 0.0, 1.0)),
        replace(base, template=TRUTH_TEMPLATE),
        replace(base, clouds=Path("x")),
        replace(base, config=with_values(base.config, {"seed": 1})),
        replace(base, config=with_values(base.config, {"refine.damping": 0.5})),
        replace(base, source=Named("b")),
        replace(base, source=Named("a", vertices=5)),
    ]
    assert len({run.key for run in [base, *others]}) == 1 + len(others)
    assert replace(base, source=Named("a", path=Path("moved/gt.npz"))).key == base.key


def test_results_of_other_code_are_not_the_same_run(monkeypatch: pytest.MonkeyPatch) -> None:
    plan = Plan((Named("a"),))
    run = plan.run(plan.sequences[0])
    before = run.key
    monkeypatch.setattr("warpdef.apps.experiments.run.code_version", lambda: "other")
    assert run.key != before


def test_the_digest_is_of_all_that_makes_numbers(tmp_path: Path) -> None:
    flat, nested = tmp_path / "checkout", tmp_path / "site" / "warpdef"
    texts = {"warpdef/a.py": "1", "warpdef/fit/b.py": "2", "kernels/c.py": "3", "warpdef/export/d.py": "4"}
    for name, text in texts.items():
        for path in (flat / name, nested / name.removeprefix("warpdef/")):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
    installed = [nested, nested / "kernels"]
    assert digest([flat / "warpdef", flat / "kernels"]) == digest(installed), "wherever it is installed"
    (nested / "apps").mkdir()
    for name, changes in (("apps/x.py", 0), ("export/d.py", 0), ("kernels/c.py", 1), ("fit/b.py", 1), ("new.py", 1)):
        before = digest(installed)
        (nested / name).write_text("changed")
        assert (digest(installed) != before) == bool(changes), name


def test_frames_as_text() -> None:
    assert frame_text((3, 4, 5)) == "3:6"
    assert frame_text((3, 5, 7)) == "3:8:2"
    assert frame_text(to_and_fro(3, 5)) == "0:3 to and fro, 5 frames"


def test_to_and_fro_never_stands_still() -> None:
    assert to_and_fro(3, 8) == (0, 1, 2, 1, 0, 1, 2, 1)
    assert to_and_fro(5, 3) == (0, 1, 2)
    with pytest.raises(InputError, match="at least 2 frames"):
        to_and_fro(1, 3)


def test_values_by_key() -> None:
    config = with_values(Config(), {"grid.levels": 12, "grid.coarsest": 12, "seed": 3})
    assert (config.grid.levels, config.grid.coarsest, config.seed) == (12, 12, 3)
    with pytest.raises(WarpdefError, match="no key 'grid.level'"):
        with_values(Config(), {"grid.level": 1})
    with pytest.raises(WarpdefError, match="no key 'grids.levels'"):
        value_of(Config(), "grids.levels")
    with pytest.raises(ConfigError, match=r"grid\.levels"):
        with_values(Config(), {"grid.levels": 0})
