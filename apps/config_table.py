"""All flags as tables: ``python -m warpdef.apps.config_table .github/CONFIGURATION.md`` renews them in place.

One table is the configuration, which two commands share; then every command's own flags.
"""

from __future__ import annotations

import inspect
import re
import sys
import typing
from functools import cache
from pathlib import Path

from docstring_parser import parse

from warpdef.apps.config_flags import entries, flag_name
from warpdef.apps.main import COMMANDS, build_app
from warpdef.config import Config
from warpdef.presets import preset

PARTS = ("configuration", "commands")


def config_table() -> str:
    """A Markdown table: flags, default, the paper preset's value where it differs, and what the field is."""
    paper = preset("paper")
    lines = ["| flag | `default` | `paper` | what it is |", "| --- | --- | --- | --- |"]
    for entry in entries():
        published = value_of(paper, entry.key)
        shown = "" if published == entry.default else f"`{published}`"
        default = "" if entry.default == "" else f"`{entry.default}`"
        text = " ".join(entry.help.split()).replace("``", "`").replace("|", "\\|")
        names = ", ".join(f"`{name}`" for name in flag_names(entry.key))
        lines.append(f"| {names} | {default} | {shown} | {text} |")
    return "\n".join(lines)


def command_tables() -> str:
    """A Markdown table a command, of the flags that are no configuration."""
    app, configured = build_app(), {flag_name(entry.key) for entry in entries()}
    tables = []
    for command in COMMANDS:
        lines = [f"### `warpdef {command}`", "", "| flag | default | what it is |", "| --- | --- | --- |"]
        function = app[command].default_command
        assert function is not None
        texts = {entry.arg_name: entry.description or "" for entry in parse(function.__doc__ or "").params}
        for argument in app[command].assemble_argument_collection():
            shared = "flags" in inspect.signature(function).parameters and argument.names[0] in configured
            if shared or not argument.names[0].startswith("-"):
                continue
            default = argument.field_info.default
            shown = "" if default in (None, "", ()) or argument.required else f"`{default}`"
            text = " ".join(texts[argument.field_info.name].split()).replace("|", "\\|")
            choices = typing.get_args(argument.hint) if typing.get_origin(argument.hint) is typing.Literal else ()
            text += f" One of {', '.join(f'`{choice}`' for choice in choices)}." if choices else ""
            text += " Must be given." if argument.required else ""
            lines.append(f"| {', '.join(f'`{name}`' for name in argument.names)} | {shown} | {text} |")
        tables.append("\n".join(lines))
    return "\n\n".join(tables)


def flag_names(key: str) -> tuple[str, ...]:
    """All flags that set the value at a dotted key: the long one, then the short one and the one that switches it off.

    Asked of the command line itself: it writes ``--refine.no-recover``, but ``--no-drop-strays``.
    """
    return _names_of_reconstruct()[flag_name(key)]


@cache
def _names_of_reconstruct() -> dict[str, tuple[str, ...]]:
    arguments = build_app()["reconstruct"].assemble_argument_collection()
    return {argument.names[0]: tuple(argument.names) for argument in arguments}


def value_of(config: Config, key: str) -> object:
    """The value at a dotted key."""
    value: object = config
    for name in key.split("."):
        value = getattr(value, name)
    return value


def with_tables(text: str) -> str:
    """``text`` with the tables between their marks.

    Raises:
        ValueError: marks are not there.
    """
    for part, table in zip(PARTS, (config_table(), f"\n{command_tables()}\n"), strict=True):
        begin, end = f"<!-- {part}: begin -->", f"<!-- {part}: end -->"
        made = re.compile(f"{begin}.*?{end}", re.DOTALL)
        if not made.search(text):
            raise ValueError(f"expected the marks {begin} and {end} around the table, got none; put them back")
        text = made.sub(lambda _, whole=f"{begin}\n{table}\n{end}": whole, text, count=1)
    return text


if __name__ == "__main__":
    for name in sys.argv[1:]:
        path = Path(name)
        path.write_text(with_tables(path.read_text(encoding="utf-8")), encoding="utf-8")
