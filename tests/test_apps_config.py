"""Every field of the configuration as a flag, and the order preset < file < flags."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, cast

import pytest
from cyclopts import App, CycloptsError

from warpdef.apps.config_flags import ConfigFlags, entries, flag_name, resolve_config
from warpdef.config import Config
from warpdef.errors import ConfigError
from warpdef.files.config_file import config_to_toml, known_keys
from warpdef.presets import preset


def parse(*arguments: str) -> ConfigFlags | None:
    """The flags as a command would get them."""
    app = App()

    @app.default
    def command(*, flags: ConfigFlags | None = None) -> ConfigFlags | None:
        return flags

    return app(arguments, exit_on_error=False, print_error=False, result_action="return_value")


def other_value(key: str, default: object) -> object:
    """A valid value that is not the default."""
    special = {
        "frames": "1:9:2",
        "points": 50,
        "keyframe.choice": "first",
        "template.mesh": "mesh.ply",
        "template.backend": "pymeshlab",
        "template.surface": "open",
        "template.method": "tetrahedra",
        "sobolev.solver": "cg",
        "loss.reduction": "mean",
        "loss.robust_power": 4,
        "loss.confidence_bound": "mean",
        "optimiser.decay": "constant",
        "template.depth": 9,
        "refine.noisy_thickness": 0.7,
        "colours": "moving",
        "order": "time",
        "landmarks": "known.csv",
        "columns": "x,y,z",
        "crop": "0:1,:,:",
    }
    if key in special:
        return special[key]
    if isinstance(default, bool):
        return not default
    if isinstance(default, int):
        return default + 1
    assert isinstance(default, float)
    return default * 0.5 if default else 0.25


def get(config: Config, key: str) -> object:
    for name in key.split("."):
        config = getattr(config, name)
    return config


def test_every_key_has_a_flag_with_help() -> None:
    assert tuple(entry.key for entry in entries()) == known_keys()
    assert [entry.key for entry in entries() if not entry.help] == []
    assert {entry.group for entry in entries()} == {
        "run",
        *(key.partition(".")[0] for key in known_keys() if "." in key),
    }


@pytest.mark.parametrize("entry", entries(), ids=lambda entry: entry.key)
def test_each_flag_sets_its_field_and_no_other(entry) -> None:
    value = other_value(entry.key, entry.default)
    group, _, name = flag_name(entry.key)[2:].rpartition(".")
    prefix = f"{group}." if group else ""
    if value is False:
        arguments = [f"--{prefix}no-{name}"]
    else:
        arguments = [f"--{prefix}{name}"] + ([] if value is True else [str(value)])
    config = resolve_config("default", None, parse(*arguments))
    assert get(config, entry.key) == value
    assert [e.key for e in entries() if get(config, e.key) != e.default] == [entry.key]


@pytest.mark.parametrize(
    ("arguments", "key", "value"),
    [
        (["--keyframe", "middle"], "keyframe.choice", "middle"),
        (["--template", "mesh.off"], "template.mesh", "mesh.off"),
        (["--iterations", "7"], "optimiser.iterations", 7),
        (["--frames", "-5:"], "frames", "-5:"),
        (["--frames=-5:"], "frames", "-5:"),
        (["--grid.prune=true"], "grid.prune", True),
        (["--loss.isometry_weight", "0"], "loss.isometry_weight", 0.0),
    ],
)
def test_short_ways(arguments: list[str], key: str, value: object) -> None:
    assert get(resolve_config("default", None, parse(*arguments)), key) == value


def test_flags_over_file_over_preset(tmp_path: Path) -> None:
    file = tmp_path / "run.toml"
    file.write_text("seed = 3\n[optimiser]\niterations = 77\nwarmup = 5\n")
    config = resolve_config("paper", file, parse("--optimiser.warmup", "6"))
    assert (config.seed, config.optimiser.iterations, config.optimiser.warmup) == (3, 77, 6)
    assert config.loss == preset("paper").loss
    assert config.loss != preset("default").loss


def test_a_flag_equal_to_the_default_still_wins(tmp_path: Path) -> None:
    file = tmp_path / "run.toml"
    file.write_text("seed = 3\n[grid]\nprune = true\nlevels = 4\n[sobolev]\nsolver = 'cg'\n")
    flags = parse("--seed", "0", "--grid.no-prune", "--grid.levels", "10", "--sobolev.solver", "auto")
    assert resolve_config("default", file, flags) == Config()


def test_the_written_file_repeats_the_configuration(tmp_path: Path) -> None:
    first = resolve_config("paper", None, parse("--frames", "2:9", "--loss.isometry-weight", "0"))
    file = tmp_path / "config.toml"
    file.write_text(config_to_toml(first))
    assert resolve_config("default", file, None) == first


def test_fields_that_bound_each_other_change_together() -> None:
    config = resolve_config("default", None, parse("--grid.coarsest", "12", "--grid.levels", "12"))
    assert (config.grid.coarsest, config.grid.levels) == (12, 12)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--grid.level", "3"], "Did you mean --grid.levels?"),
        (["--loss.isometric-weight", "3"], "Did you mean --loss.isometry-weight?"),
        (["--grid.levels", "many"], 'unable to convert "many" into int'),
        (["--loss.reduction", "median"], 'Choose from: "sum", "mean"'),
    ],
)
def test_wrong_flags_are_usage_errors(arguments: list[str], expected: str) -> None:
    with pytest.raises(CycloptsError) as caught:
        parse(*arguments)
    assert expected in " ".join(str(caught.value).split())


def test_values_are_checked_by_the_configuration() -> None:
    with pytest.raises(ConfigError, match="grid.levels: expected 1 to 16, got 99"):
        resolve_config("default", None, parse("--grid.levels", "99"))
    with pytest.raises(ConfigError, match="preset: expected default or paper, got 'best'"):
        resolve_config("best", None, None)


def test_no_flag_means_no_change() -> None:
    assert resolve_config("default", None, parse()) == Config()
    assert all(getattr(parse("--seed", "1"), f.name) is None for f in dataclasses.fields(cast(Any, ConfigFlags))[:3])
