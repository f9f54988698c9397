"""The configuration as TOML: exact round trips, and errors that name the key, its place and the nearest known one."""

from __future__ import annotations

from dataclasses import asdict, fields, is_dataclass, replace
from typing import Any, Literal, cast, get_args, get_origin, get_type_hints

import pytest

from warpdef.config import Config
from warpdef.errors import ConfigError
from warpdef.files.config_file import config_from_mapping, config_to_toml, known_keys, load_config, nearest_key
from warpdef.presets import PRESETS, preset


def altered(config: Config) -> list[Config]:
    """For every field, ``config`` with that field alone changed to an unusual value where it is allowed."""
    made = []
    for f in fields(Config):
        group = getattr(config, f.name)
        owner = group if is_dataclass(group) else config
        if f.name == "landmarks":  # they need the vertex stage
            owner = replace(config, refine=replace(config.refine, iterations=1))
        for g in fields(group) if is_dataclass(group) else [f]:
            for value in candidates(get_type_hints(type(owner))[g.name], getattr(owner, g.name), g.name):
                try:
                    new = replace(cast(Any, owner), **{g.name: value})  # a group, or the whole
                    made.append(replace(config, **{f.name: new}) if is_dataclass(group) else new)
                except ConfigError:
                    continue
                break
            else:
                raise AssertionError(f"no other value of {f.name}.{g.name} is allowed")
    return made


def candidates(kind, value, name: str) -> list:
    if get_origin(kind) is Literal:
        return [choice for choice in get_args(kind) if choice != value]
    if kind is bool:
        return [not value]
    if kind is int:
        return [value + 1, value - 1, 10]
    if kind is float:
        return [value * (1 + 2**-52), value / 3, 1 / 3] if value else [1 / 3, 1.0]
    return ["C:\\tänze\t\"1\"\n'x' 😀 #"] if name == "mesh" else ["::2", "3", ":1,:,:"]


@pytest.mark.parametrize("name", PRESETS)
def test_round_trip_of_every_field(tmp_path, name):
    pytest.importorskip("tomli_w")
    configs = [preset(name), *altered(preset(name))]
    assert len(configs) == 1 + len(known_keys())
    assert len(set(configs)) == len(configs)
    for config in configs:
        (tmp_path / "run.toml").write_text(config_to_toml(config), encoding="utf-8")
        # The base must not matter: every field is written.
        for base in PRESETS:
            again = load_config(tmp_path / "run.toml", preset(base))
            assert again == config
            assert repr(again) == repr(config)


def test_toml_holds_every_key():
    pytest.importorskip("tomli_w")
    text = config_to_toml(Config())
    assert text.startswith("# ")
    assert all(f"\n{key.rpartition('.')[2]} = " in text for key in known_keys())
    assert all(f"\n[{group}]\n" in text for group in asdict(Config()) if f"{group}." in " ".join(known_keys()))


def test_missing_keys_come_from_the_base():
    made = config_from_mapping({"seed": 5, "grid": {"levels": 4, "coarsest": 2}, "loss": {}}, preset("paper"))
    paper = preset("paper")
    assert made == replace(paper, seed=5, grid=replace(paper.grid, levels=4, coarsest=2))
    assert config_from_mapping({}) == Config()


def test_integers_are_numbers():
    made = config_from_mapping({"fill": 1, "loss": {"isometry_weight": 100}})
    assert (made.fill, made.loss.isometry_weight) == (1.0, 100.0)
    assert type(made.fill) is float
    assert type(made.loss.isometry_weight) is float


@pytest.mark.parametrize(
    ("mapping", "message"),
    [
        ({"optimiser": {"iterations": 400.0}}, r"optimiser\.iterations: expected an integer, got 400\.0 \(float\)"),
        ({"optimiser": {"iterations": "400"}}, r"optimiser\.iterations: expected an integer, got '400' \(str\)"),
        ({"optimiser": {"iterations": True}}, r"optimiser\.iterations: expected an integer, got true"),
        ({"optimiser": {"rate": False}}, r"optimiser\.rate: expected a number, got false"),
        ({"optimiser": {"rate": [1]}}, r"optimiser\.rate: expected a number, got \[1\] \(list\)"),
        ({"optimiser": {"rate": float("inf")}}, r"optimiser\.rate: expected a finite number, got inf"),
        ({"optimiser": {"rate": float("nan")}}, r"optimiser\.rate: expected a finite number, got nan"),
        ({"optimiser": {"rate": 10**400}}, r"optimiser\.rate: expected a finite number, got inf"),
        ({"grid": {"prune": 1}}, r"grid\.prune: expected true or false, got 1 \(int\)"),
        ({"keyframe": {"choice": 3}}, r'keyframe\.choice: expected text in quotes, got 3 \(int\); write "3"'),
        ({"sobolev": {"solver": "lu"}}, r"sobolev\.solver: expected 'auto' or 'cosine' or .*, got 'lu'"),
        ({"loss": {"robust_power": 2.0}}, r"loss\.robust_power: expected 2 or 4, got 2\.0"),
        ({"loss": {"robust_power": True}}, r"loss\.robust_power: expected 2 or 4, got true"),
        ({"loss": {"reduction": ["sum"]}}, r"loss\.reduction: expected 'sum' or 'mean', got \['sum'\]"),
        ({"grid": 10}, r"grid: expected a table \[grid\], got 10 \(int\)"),
        ({"points": {"a": 1}}, r"points: expected an integer, got a table"),
        ({"points": 3}, r"points: expected 0 \(all\) or at least 10, got 3"),
        ({"grid": {"levels": 99}}, r"grid\.levels: expected 1 to 16, got 99"),
        ({"frames": "3"}, r"frames: expected start:stop"),
        ({"grid": {"prune": True}, "sobolev": {"solver": "cosine"}}, r"sobolev\.solver: expected cg, warp or auto"),
    ],
)
def test_wrong_values(mapping, message):
    with pytest.raises(ConfigError, match=f"^run.toml: {message}"):
        config_from_mapping(mapping, source="run.toml")


@pytest.mark.parametrize(
    ("mapping", "nearest"),
    [
        ({"sede": 1}, "seed"),
        ({"point": 1}, "points"),
        ({"optimizer": {"iterations": 1}}, "optimiser"),
        ({"grids": {}}, "grid"),
        ({"iterations": 100}, "optimiser.iterations"),
        ({"isometry": 1}, "loss.isometry_weight"),
        ({"optimiser": {"iteration": 1}}, "optimiser.iterations"),
        ({"optimiser": {"learning_rate": 1}}, "optimiser.rate"),
        ({"sobolev": {"iteration": 1}}, "sobolev.iterations_max"),
        ({"loss": {"lambda_bas": 1}}, "sobolev.lambda_base"),
        ({"loss": {"izometry_weight": 1}}, "loss.isometry_weight"),
    ],
)
def test_unknown_keys_name_the_nearest(mapping, nearest):
    with pytest.raises(ConfigError, match=rf"^run.toml: unknown key '.*'; did you mean '{nearest}'\?$"):
        config_from_mapping(mapping, source="run.toml")


@pytest.mark.parametrize("key", ["", "zzzzzz", "grid.", ".", "点", "a.b.c"])
def test_there_is_always_a_nearest(key):
    assert nearest_key(key) in {*known_keys(), *asdict(Config())}


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"seed = 1\nfill = = 2\n", r"not valid TOML: .*line 2"),
        (b"seed = 1\nseed = 2\n", r"not valid TOML: .*line 2"),
        (b"[grid\n", "not valid TOML"),
        (b"mesh = '\xff'", "expected TOML in UTF-8, got other bytes at 8"),
        (b"a = " + b"[" * 5000, "run.toml"),
        (b"sed = 1", "unknown key 'sed'; did you mean 'seed'"),
    ],
)
def test_broken_files(tmp_path, data, message):
    (tmp_path / "run.toml").write_bytes(data)
    with pytest.raises(ConfigError, match=message) as caught:
        load_config(tmp_path / "run.toml")
    assert str(tmp_path / "run.toml") in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_files(tmp_path):
    with pytest.raises(ConfigError, match=r"none\.toml: expected a file or folder, got nothing there"):
        load_config(tmp_path / "none.toml")
    with pytest.raises(ConfigError, match="cannot be read"):
        load_config(tmp_path)


def test_an_empty_file_is_the_base(tmp_path):
    (tmp_path / "run.toml").write_bytes(b"")
    assert load_config(tmp_path / "run.toml") == Config()
    assert load_config(tmp_path / "run.toml", preset("paper")) == preset("paper")
