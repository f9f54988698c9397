"""The configuration as the README's table: ``python -m warpdef.apps.config_table README.md`` renews it in place."""

from __future__ import annotations

import re
import sys
from pathlib import Path

from warpdef.apps.config_flags import entries, flag_name
from warpdef.config import Config
from warpdef.presets import preset

BEGIN, END = "<!-- configuration: begin -->", "<!-- configuration: end -->"


def config_table() -> str:
    """A Markdown table: flag, default, the paper preset's value where it differs, and what the field is."""
    paper = preset("paper")
    lines = ["| flag | `default` | `paper` | what it is |", "| --- | --- | --- | --- |"]
    for entry in entries():
        published = value_of(paper, entry.key)
        shown = "" if published == entry.default else f"`{published}`"
        default = "" if entry.default == "" else f"`{entry.default}`"
        text = entry.help.replace("``", "`").replace("|", "\\|")
        lines.append(f"| `{flag_name(entry.key)}` | {default} | {shown} | {text} |")
    return "\n".join(lines)


def value_of(config: Config, key: str) -> object:
    """The value at a dotted key."""
    value: object = config
    for name in key.split("."):
        value = getattr(value, name)
    return value


def with_table(text: str) -> str:
    """``text`` with the table between the two marks."""
    return re.sub(f"{BEGIN}.*?{END}", lambda _: f"{BEGIN}\n{config_table()}\n{END}", text, count=1, flags=re.DOTALL)


if __name__ == "__main__":
    for name in sys.argv[1:]:
        path = Path(name)
        path.write_text(with_table(path.read_text(encoding="utf-8")), encoding="utf-8")
