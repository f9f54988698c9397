"""What an experiment consists of, and the sizes it is run at."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from warpdef.apps.experiments.run import ExperimentRun, TruthSource, frame_text, with_values
from warpdef.config import Config
from warpdef.config_values import parse_slice
from warpdef.errors import InputError


@dataclass(frozen=True)
class PlanSize:
    """How large an experiment is; ``QUICK`` only shows that everything runs."""

    frames: int = 17
    points: int = 5000
    samples: int = 100_000
    lengths: tuple[int, ...] = (10, 20, 40, 60, 80)
    memory_lengths: tuple[int, ...] = (17, 75, 150, 300)
    factors: tuple[float, ...] = (0.5, 1.0, 2.0)
    accuracy_length: int = 80


FULL = PlanSize()
QUICK = PlanSize(4, 500, 2000, (3, 5), (3, 6), (1.0, 2.0), 6)
QUICK_ITERATIONS, QUICK_ROUNDS = 6, 2


@dataclass(frozen=True)
class Setting:
    """One row of a table: the same change on every sequence.

    name: unique within the experiment; published numbers are found by it
    x:    its place on the plot's axis; None where settings are kinds, not numbers
    runs: one a sequence
    about: what it changes, in words
    """

    name: str
    runs: tuple[ExperimentRun, ...]
    x: float | None = None
    about: str = ""


@dataclass(frozen=True)
class Experiment:
    """A table to be filled."""

    name: str
    title: str
    settings: tuple[Setting, ...]
    axis: str = ""
    notes: tuple[str, ...] = ()

    def runs(self) -> list[ExperimentRun]:
        """All runs, each once, in the order of the table."""
        return list({run.key: run for setting in self.settings for run in setting.runs}.values())


@dataclass(frozen=True)
class Plan:
    """From what an experiment is made: sequences, base configuration, size.

    frames: replaces each sequence's own choice of frames, start:stop:step
    meshes: folder of meshes given from outside, for ``initialization``
    folder: the data, for clouds that lie beside the sequences
    """

    sequences: tuple[TruthSource, ...]
    config: Config = field(default_factory=Config)
    size: PlanSize = FULL
    frames: str = ""
    meshes: Path | None = None
    folder: Path | None = None

    def run(self, source: TruthSource, values: dict[str, Any] | None = None, **changes: Any) -> ExperimentRun:
        """One run of ``source`` with its usual frames; ``values`` go into the configuration, ``changes`` into it."""
        config = with_values(self.config, values or {})
        usual = {"frames": self.usual_frames(source), "points": self.size.points, "samples": self.size.samples}
        return ExperimentRun(source=source, config=config, **{**usual, **changes})

    def usual_frames(self, source: TruthSource) -> tuple[int, ...]:
        """Those asked for; else as many as the size says, from where the sequence's benchmark begins.

        Raises:
            InputError: fewer than 2 frames.
        """
        if self.frames:
            frames = tuple(range(source.frames))[parse_slice(self.frames)]
        else:
            first = benchmark(source).get("first_frame", 0)
            frames = tuple(range(source.frames))[first : first + self.size.frames]
        if len(frames) < 2:
            raise InputError(
                f"{source.name}: expected at least 2 of its {source.frames} frames, got {len(frames)}; widen --frames"
            )
        return frames

    def reference(self) -> TruthSource:
        """The sequence on which a single change is shown: the first with a benchmark's note, else the first."""
        return next((s for s in self.sequences if benchmark(s)), self.sequences[0])

    def each(self, values: dict[str, Any] | None = None, **changes: Any) -> tuple[ExperimentRun, ...]:
        """The same run on every sequence."""
        return tuple(self.run(source, values, **changes) for source in self.sequences)


def benchmark(source: TruthSource) -> dict[str, Any]:
    """What ``meta.json`` beside a sequence says of the benchmark it belongs to; empty where it says nothing.

    ``{"dynosurf": {"first_frame": 10, "frames": 17, "scale": s, "translation": [x, y, z]}}``: the benchmark's clouds
    are samples of frames 10 to 26, with every coordinate x as s x + translation.
    """
    beside = source.path if source.path.is_dir() else source.path.parent
    try:
        note = json.loads((beside / "meta.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    found = note.get("dynosurf") if isinstance(note, dict) else None
    return found if isinstance(found, dict) and isinstance(found.get("first_frame"), int) else {}


def label(run: ExperimentRun) -> str:
    """``crane 10:27``: sequence and frames."""
    return f"{run.source.name} {frame_text(run.frames)}"


def settings(plan: Plan, rows: Sequence[tuple[str, float | None, dict[str, Any]]]) -> tuple[Setting, ...]:
    """Settings that only change the configuration, on every sequence."""
    return tuple(Setting(name, plan.each(values), x) for name, x, values in rows)


def descent(config: Config) -> dict[str, Any]:
    """Values that turn a configuration to the paper's descent, the only one that terms on vertices act in.

    A chain takes three times the iterations of grids that only guide.
    """
    if config.optimiser.chain:
        return {}
    return {"optimiser.chain": True, "optimiser.points": 0, "optimiser.iterations": 3 * config.optimiser.iterations}


Builder = Callable[[Plan], Experiment]
