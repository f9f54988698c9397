"""Every field of ``Config`` as a command-line flag, generated from the dataclasses so that an option is described once.

``Config.grid.levels`` becomes ``--grid.levels``. A flag that is not given stays None, so that a given flag always wins
over preset and file, even where it repeats a default.
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import typing
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Group, Parameter

from warpdef.config import Config
from warpdef.presets import preset

ALIASES = {
    "keyframe.choice": "--keyframe",
    "template.mesh": "--template",
    "template.align": "--align-template",
    "template.method": "--template-method",
    "optimiser.iterations": "--iterations",
}
HYPHENATED = ("frames",)  # "-5:" is a slice, not a flag


@dataclasses.dataclass(frozen=True)
class Entry:
    """One field of the configuration: ``key`` as in the TOML file (``grid.levels``), its type, default and help."""

    key: str
    group: str
    hint: Any
    default: Any
    help: str


@cache
def field_help(module_file: str) -> dict[str, dict[str, str]]:
    """Attribute docstrings of every class in a Python file: class name to field name to text."""
    found: dict[str, dict[str, str]] = {}
    for node in ast.parse(Path(module_file).read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ClassDef):
            texts = found.setdefault(node.name, {})
            for before, after in zip(node.body, node.body[1:], strict=False):
                if not (isinstance(before, ast.AnnAssign) and isinstance(before.target, ast.Name)):
                    continue
                if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
                    texts[before.target.id] = inspect.cleandoc(str(after.value.value))
    return found


def entries(cls: type = Config, prefix: str = "") -> list[Entry]:
    """All fields of the configuration, groups flattened, in order."""
    texts = field_help(inspect.getsourcefile(cls) or "")[cls.__name__]
    hints = typing.get_type_hints(cls)
    defaults = cls()
    found = []
    for field in dataclasses.fields(cls):
        if dataclasses.is_dataclass(hints[field.name]):
            found += entries(hints[field.name], f"{field.name}.")
        else:
            default = getattr(defaults, field.name)
            group = prefix.rstrip(".") or "run"
            found.append(Entry(prefix + field.name, group, hints[field.name], default, texts.get(field.name, "")))
    return found


def flag_name(key: str) -> str:
    """``loss.isometry_weight`` to ``--loss.isometry-weight``."""
    return "--" + key.replace("_", "-")


def _attribute(key: str) -> str:
    return key.replace(".", "__")


def _flag_fields() -> list[tuple[str, Any, Any]]:
    groups: dict[str, Group] = {}
    made = []
    for entry in entries():
        title = "Configuration" if entry.group == "run" else f"Configuration: {entry.group}"
        group = groups.setdefault(entry.group, Group(title, sort_key=10 + len(groups)))
        names = [flag_name(entry.key)] + ([ALIASES[entry.key]] if entry.key in ALIASES else [])
        shown = "" if entry.default == "" else f" Default: {entry.default}."
        parameter = Parameter(
            name=names, group=group, help=entry.help + shown, allow_leading_hyphen=entry.key in HYPHENATED
        )
        made.append((_attribute(entry.key), Annotated[entry.hint | None, parameter], dataclasses.field(default=None)))
    return made


if TYPE_CHECKING:
    ConfigFlags = Any  # its fields are made from the configuration when it runs
else:
    # Without a module of its own the class would count as built in, and Cyclopts would not look inside it.
    ConfigFlags = Parameter(name="*")(
        dataclasses.make_dataclass(
            "ConfigFlags", _flag_fields(), namespace={"__module__": __name__}, frozen=True, kw_only=True
        )
    )
"""The flags that were given; the others are None. Use as the type of a command's parameter."""


def resolve_config(preset_name: str, config_file: Path | None, flags: Any | None) -> Config:
    """Preset, then the file's values over it, then the flags over both.

    Args:
        preset_name: ``default`` or ``paper``.
        config_file: a TOML file in the form of a run folder's ``config.toml``; None for none.
        flags: an instance of ``ConfigFlags``; None for none.

    Raises:
        ConfigError: an unknown preset, key or value, or a missing file.
    """
    config = preset(preset_name)
    if config_file is not None:
        from warpdef.files.config_file import load_config

        config = load_config(config_file, config)
    if flags is None:
        return config
    changed: dict[str, Any] = {}
    nested: dict[str, dict[str, Any]] = {}
    for entry in entries():
        value = getattr(flags, _attribute(entry.key))
        if value is not None:
            group, _, name = entry.key.rpartition(".")
            (nested.setdefault(group, {}) if group else changed)[name] = value
    for group, values in nested.items():
        changed[group] = dataclasses.replace(getattr(config, group), **values)
    return dataclasses.replace(config, **changed)
