"""What an hour on a device has found so far: kept part by part, so that it can go on, and told as a table."""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

Row = dict[str, Any]
DONE, SKIPPED, FAILED = "done", "skipped", "failed"


class Skip(Exception):
    """A part that has nothing to work with here; the message says what is missing."""


def row(what: str, value: Any, unit: str = "", most: float | None = None) -> Row:
    """One figure; ``most``: what it should not exceed."""
    return {"what": what, "value": value, "unit": unit, **({} if most is None else {"most": most})}


def missed(found: Row) -> bool:
    """Whether a figure is beyond what it should be. No number at all is beyond it, too."""
    value = found["value"]
    return "most" in found and not (isinstance(value, (int, float)) and value <= found["most"])


class Book:
    """Results of parts in ``folder/hour.json``, and the table of them in ``folder/hour.md``.

    Args:
        titles: what each part is, by letter, in order.
        facts: what a result depends on (device, code, ...): those of other facts are not taken for finished.
        run: does a part, given its letter, and returns its rows; raises ``Skip``, or anything else where it fails.
        command: that made all this, for the table.
    """

    def __init__(
        self,
        folder: Path,
        titles: dict[str, str],
        facts: dict[str, Any],
        run: Callable[[str], Sequence[Row]],
        command: str = "",
    ) -> None:
        self.folder, self.titles, self.facts, self._run, self._command = folder, titles, facts, run, command
        self._file = folder / "hour.json"
        self.parts: dict[str, dict[str, Any]] = {}
        if self._file.exists():
            self.parts = json.loads(self._file.read_text(encoding="utf-8"))["parts"]

    def chosen(self, only: str) -> list[str]:
        """The letters of ``a,c`` or ``ac``, in order; all for none.

        Raises:
            ValueError: no such part.
        """
        asked = set(only.replace(",", "").replace(" ", "")) or set(self.titles)
        unknown = sorted(asked - set(self.titles))
        if unknown:
            raise ValueError(f"--only: expected letters of {''.join(self.titles)}, got {''.join(unknown)}")
        return [letter for letter in self.titles if letter in asked]

    def finished(self, letter: str) -> bool:
        """Whether a part is done, under the same facts."""
        kept = self.parts.get(letter, {})
        return kept.get("state") == DONE and kept.get("facts") == self.facts

    def go(self, only: str = "", again: bool = False, tell: Callable[[str], object] = print) -> bool:
        """Do the parts that are not finished; whether none of those asked for failed."""
        letters = self.chosen(only)
        for letter in letters:
            if self.finished(letter) and not again:
                tell(f"{letter}) {self.titles[letter]}: done before")
                continue
            begun = time.perf_counter()
            entry: dict[str, Any] = {"state": DONE, "rows": [], "facts": self.facts}
            try:
                entry["rows"] = list(self._run(letter))
            except Skip as why:
                entry |= {"state": SKIPPED, "why": str(why)}
            except Exception as error:  # the parts after it are worth their time all the same
                entry |= {"state": FAILED, "why": f"{type(error).__name__}: {error}"}
            entry["seconds"] = round(time.perf_counter() - begun, 1)
            self.parts[letter] = entry
            self._keep()
            why = f": {entry['why']}" if "why" in entry else ""
            tell(f"{letter}) {self.titles[letter]}: {entry['state']} in {entry['seconds']:g} s{why}")
        return not any(self.parts[letter]["state"] == FAILED for letter in letters)

    def _keep(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        kept = {letter: self.parts[letter] for letter in sorted(self.parts)}
        text = json.dumps({"command": self._command, "parts": kept}, indent=1, allow_nan=True, default=str)
        for path, content in ((self._file, text), (self.folder / "hour.md", self.table())):
            beside = path.with_suffix(path.suffix + ".new")
            beside.write_text(content + "\n", encoding="utf-8")
            os.replace(beside, path)

    def table(self) -> str:
        """Markdown: a table a part, under a line of what it depended on."""
        lines = [f"`{self._command}`", ""] if self._command else []
        for letter in sorted(self.parts):
            entry = self.parts[letter]
            facts = ", ".join(f"{name} {value}" for name, value in entry["facts"].items() if value)
            lines += [
                f"**{letter}) {self.titles.get(letter, '?')}**: {entry['state']}, {entry['seconds']:g} s ({facts})",
                "",
            ]
            if "why" in entry:
                lines += [f"{entry['why']}", ""]
            if entry["rows"]:
                lines += ["| what | value | at most |", "| --- | --- | --- |", *map(_line, entry["rows"]), ""]
        return "\n".join(lines).rstrip()


def _line(found: Row) -> str:
    most = f"{found['most']:g}" + (" (missed)" if missed(found) else "") if "most" in found else ""
    return f"| {found['what']} | {_shown(found['value'])} {found['unit']}".rstrip() + f" | {most} |"


def _shown(value: Any) -> str:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return str(value).replace("|", "/").replace("\n", " ")
    if isinstance(value, int):
        return str(value)
    return f"{value:.4g}" if math.isfinite(value) else "not finite"
