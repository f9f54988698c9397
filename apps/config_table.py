"""The configuration as a table: ``python -m warpdef.apps.config_table .github/CONFIGURATION.md`` renews it in place."""

from __future__ import annotations

import re
import sys
from functools import cache
from pathlib import Path

from warpdef.apps.config_flags import entries, flag_name
from warpdef.apps.main import build_app
from warpdef.config import Config
from warpdef.presets import preset

BEGIN, END = "<!-- configuration: begin -->", "<!-- configuration: end -->"


def config_table() -> str:
    """A Markdown table: flags, default, the paper preset's value where it differs, and what the field is."""
    paper = preset("paper")
    lines = ["| flag | `default` | `paper` | what it is |", "| --- | --- | --- | --- |"]
    for entry in entries():
        published = value_of(paper, entry.key)
        shown = "" if published == entry.default else f"`{published}`"
        default = "" if entry.default == "" else f"`{entry.default}`"
        text = entry.help.replace("``", "`").replace("|", "\\|")
        names = ", ".join(f"`{name}`" for name in flag_names(entry.key))
        lines.append(f"| {names} | {default} | {shown} | {text} |")
    return "\n".join(lines)


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


def with_table(text: str) -> str:
    """``text`` with the table between the two marks.

    Raises:
        ValueError: the marks are not there.
    """
    made, count = re.subn(
        f"{BEGIN}.*?{END}", lambda _: f"{BEGIN}\n{config_table()}\n{END}", text, count=1, flags=re.DOTALL
    )
    if not count:
        raise ValueError(f"expected the marks {BEGIN} and {END} around the table, got none; put them back")
    return made


if __name__ == "__main__":
    for name in sys.argv[1:]:
        path = Path(name)
        path.write_text(with_table(path.read_text(encoding="utf-8")), encoding="utf-8")
