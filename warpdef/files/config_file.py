"""The configuration as TOML: a missing key keeps its value, an unknown one is an error that names the nearest known.

seed = 1
[optimiser]
iterations = 800
"""

from __future__ import annotations

import difflib
import math
import sys
from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

from warpdef.config import Config
from warpdef.errors import ConfigError, InputError
from warpdef.files.disk import must_exist, reason

_HEADER = """\
# The configuration of one warpdef run, whole: the same input and this file give the same result.
# Use it again with --config; keys left out keep their defaults.

"""
_KINDS = {bool: "true or false", int: "an integer", float: "a number", str: "text in quotes"}


def config_to_toml(config: Config) -> str:
    """Every field of ``config``, groups as tables; ``load_config`` gives an equal Config back."""
    import tomli_w

    return _HEADER + tomli_w.dumps(asdict(config))


def load_config(path: Path | str, base: Config | None = None) -> Config:
    """Read a TOML configuration.

    Args:
        path: the file.
        base: where the keys that the file leaves out come from; ``Config()`` if not given.

    Raises:
        ConfigError: missing file, broken TOML (with its line), unknown key, wrong type or value.
    """
    if sys.version_info >= (3, 11):
        import tomllib
    else:
        import tomli as tomllib  # pyright: ignore[reportMissingImports]
    path = Path(path)
    try:
        must_exist(path)
        mapping = tomllib.loads(path.read_text(encoding="utf-8"))
    except InputError as error:
        raise ConfigError(f"configuration: {error}") from None
    except UnicodeDecodeError as error:
        raise ConfigError(
            f"{path}: expected TOML in UTF-8, got other bytes at {error.start}; save it as UTF-8"
        ) from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path}: not valid TOML: {reason(error)}; mend that line") from None
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(f"{path}: cannot be read ({reason(error)}); check the path and its permissions") from None
    return config_from_mapping(mapping, base, source=str(path))


def config_from_mapping(
    mapping: Mapping[str, Any], base: Config | None = None, source: str = "configuration"
) -> Config:
    """``base`` with the values of a nested mapping, as read from TOML or JSON.

    Args:
        mapping: ``{"seed": 1, "optimiser": {"iterations": 800}}``. Integers are accepted for numbers.
        base: where all other values come from; ``Config()`` if not given.
        source: what the mapping is called in errors, usually a file name.

    Raises:
        ConfigError: unknown key or group, wrong type, or a value out of bounds.
    """
    base = Config() if base is None else base
    types = get_type_hints(Config)
    changes: dict[str, Any] = {}
    for key, value in mapping.items():
        if key not in types:
            raise _unknown(key, source)
        if not is_dataclass(types[key]):
            changes[key] = _typed(value, types[key], key, source)
            continue
        if not isinstance(value, Mapping):
            raise ConfigError(f"{source}: {key}: expected a table [{key}], got {_shown(value)}")
        group_types = get_type_hints(types[key])
        for name in value:
            if name not in group_types:
                raise _unknown(f"{key}.{name}", source)
        values = {name: _typed(v, group_types[name], f"{key}.{name}", source) for name, v in value.items()}
        changes[key] = _replaced(getattr(base, key), values, source)
    return _replaced(base, changes, source)


@cache
def known_keys() -> tuple[str, ...]:
    """Every key of ``Config`` as written in TOML with dots: ``seed``, ..., ``grid.levels``, ..."""
    keys: list[str] = []
    for name, kind in get_type_hints(Config).items():
        keys += [f"{name}.{f.name}" for f in fields(kind)] if is_dataclass(kind) else [name]
    return tuple(keys)


def nearest_key(key: str) -> str:
    """The known key or group that most likely was meant by an unknown one."""
    groups = tuple(dict.fromkeys(known.split(".")[0] for known in known_keys() if "." in known))
    if "." not in key and (close := difflib.get_close_matches(key, groups, 1, 0.7)):
        return close[0]
    leaf = key.rpartition(".")[2]
    same_group = [known for known in known_keys() if known.rpartition(".")[0] == key.rpartition(".")[0]]
    for candidates in (same_group, known_keys()):
        by_leaf = {known.rpartition(".")[2]: known for known in reversed(candidates)}
        if close := difflib.get_close_matches(leaf, by_leaf, 1, 0.6):
            return by_leaf[close[0]]
    return difflib.get_close_matches(key, (*known_keys(), *groups), 1, 0.0)[0]


def _unknown(key: str, source: str) -> ConfigError:
    return ConfigError(f"{source}: unknown key {key!r:.80}; did you mean '{nearest_key(key)}'?")


def _replaced(group: Any, values: dict[str, Any], source: str) -> Any:
    try:
        return replace(group, **values)
    except ConfigError as error:
        raise ConfigError(f"{source}: {str(error).removeprefix('configuration: ')}") from None


def _typed(value: Any, kind: Any, key: str, source: str) -> Any:
    """``value`` as the field's type; bounds and choices are checked by ``Config`` itself."""
    if get_origin(kind) is Literal:
        choices = get_args(kind)
        if not any(type(value) is type(c) and value == c for c in choices):
            raise ConfigError(f"{source}: {key}: expected {' or '.join(map(repr, choices))}, got {_shown(value)}")
        return value
    if kind is float and type(value) is int:
        # Too large an integer has no float; it is then refused below like infinity.
        value = float(value) if abs(value) < 10**308 else math.inf
    if type(value) is not kind:
        hint = f'; write "{value}"' if kind is str and type(value) in (int, float) else ""
        raise ConfigError(f"{source}: {key}: expected {_KINDS[kind]}, got {_shown(value)}{hint}")
    if kind is float and not math.isfinite(value):
        raise ConfigError(f"{source}: {key}: expected a finite number, got {value}")
    return value


def _shown(value: Any) -> str:
    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, bool):
        return str(value).lower()
    try:
        text = repr(value)
    except ValueError:
        return "a number of very many digits"
    return f"{text if len(text) <= 60 else text[:57] + '...'} ({type(value).__name__})"
