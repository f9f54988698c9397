"""Finished runs on disk: one JSON file each, whole or not there, so that a second call goes on where one ended."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from warpdef.apps.experiments.run import ExperimentRun
from warpdef.errors import InputError
from warpdef.files.disk import replacing
from warpdef.files.json_text import json_text


class Store:
    """Results under ``folder/runs``, shared by all experiments written to that folder.

    Raises:
        InputError: the folder cannot be made.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._runs = folder / "runs"
        try:
            self._runs.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{folder}: cannot be made ({error.strerror}); choose another folder") from None

    def path(self, run: ExperimentRun) -> Path:
        """Where a run's result lies or will lie."""
        return self._runs / f"{run.key}.json"

    def find(self, run: ExperimentRun) -> dict[str, Any] | None:
        """The result of a finished run, or None.

        Raises:
            InputError: the file is damaged.
        """
        path = self.path(run)
        if not path.is_file():
            return None
        try:
            result = json.loads(path.read_text(encoding="utf-8"))
            complete = result["key"] == run.key and "mean" in result
        except (OSError, ValueError, KeyError, TypeError):
            complete = False
        if not complete:
            raise InputError(f"{path}: expected the result of a run, got something else; remove it to run again")
        return result

    def put(self, run: ExperimentRun, result: dict[str, Any]) -> None:
        """Keep a finished run."""
        write_text(self.path(run), json_text(result) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write a text file, whole or not at all."""
    with replacing(path) as stream:
        stream.write(text.encode("utf-8"))
