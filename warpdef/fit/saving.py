"""What a checkpoint of a run holds: when it is written, and whether it belongs to the run that would go on from it."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np

import warpdef
from warpdef.config import Config
from warpdef.errors import InputError
from warpdef.files.checkpoint import Checkpoint, digests, read_checkpoint, understood, write_checkpoint
from warpdef.files.config_file import config_from_mapping
from warpdef.files.landmarks import Landmarks
from warpdef.files.plain import from_plain
from warpdef.fit.sobolev import SolveReport
from warpdef.mesh import TriMesh
from warpdef.progress import Clock
from warpdef.sequence import PointSequence
from warpdef.template.choose import ChosenTemplate

_SHARE = 0.05  # of the time that writing may take
_FACTS = {
    "version": str,
    "config": dict[str, Any],
    "notes": dict[str, str],
    "digests": list[str],
    "landmarks": str,
    "resumed": list[int],
    "template": dict[str, Any],
    "seconds": dict[str, float],
    "iteration": int,
    "rate_scale": float,
    "undone": int,
    "rounds": int | None,
    "steps": list[dict[str, float]],
    "warnings": list[str],
    "followed": list[int],
    "bent": list[int],
    "solves": list[SolveReport],
}


_ARRAYS = ("mesh", "placed")  # of a template: no facts


class Saver:
    """Writes one run's checkpoint now and then, always to the same place.

    Args:
        path: the file; None: nothing is ever written. seconds: least time between two.
        facts: what does not change during the run. template: the one chosen. clock: of the run.
    """

    def __init__(
        self, path: Path | None, seconds: float, facts: dict[str, Any], template: ChosenTemplate, clock: Clock
    ) -> None:
        self._path, self._seconds, self._facts, self._clock = path, seconds, facts, clock
        self._arrays = {"template.vertices": template.mesh.vertices, "template.faces": template.mesh.faces}
        if template.placed is not None:
            self._arrays["template.placed"] = template.placed
        self._next = clock.begun + seconds
        self._failed = False

    @property
    def digests(self) -> list[str]:
        """Of the clouds of the run, a frame each."""
        return self._facts["digests"]

    def due(self) -> bool:
        """Whether it is time to write one."""
        return self._path is not None and time.perf_counter() >= self._next

    def save(self, facts: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> str:
        """Write one now; returns what is to be told if that failed for the first time. The older one then stands."""
        if self._path is None:
            return ""
        start, trouble = time.perf_counter(), ""
        whole = {**self._facts, **facts, "seconds": self._clock.so_far()}
        try:
            write_checkpoint(self._path, whole, {**self._arrays, **arrays})
        except InputError as error:
            if not self._failed:
                trouble = f"no checkpoint could be written, the run goes on without: {error}"
            self._failed = True
        end = time.perf_counter()
        # A slow disk must not eat the run.
        self._next = end + max(self._seconds, (end - start) / _SHARE)
        return trouble

    def end(self) -> None:
        """Write no more."""
        self._path = None


class Saved:
    """A checkpoint read back, with the questions that a run has for it.

    Raises:
        InputError: missing, damaged, or of another warpdef whose configuration is not this one's.
    """

    def __init__(self, source: Checkpoint | Path | str) -> None:
        checkpoint = source if isinstance(source, Checkpoint) else read_checkpoint(source)
        self.path, self.part = checkpoint.path, checkpoint.part
        with understood(self.path):
            told = {name: from_plain(kind, checkpoint.facts[name], name) for name, kind in _FACTS.items()}
            self.facts: dict[str, Any] = {**checkpoint.facts, **told}
            self.vertex_count = len(self.part("template")["vertices"])
        self.config: Config = config_from_mapping(self.facts["config"], source=str(self.path))

    @property
    def iteration(self) -> int:
        """Iterations of the grid stage done."""
        return self.facts["iteration"]

    def warnings(self) -> list[str]:
        """Why the bits may differ from those of an unbroken run."""
        theirs, ours = self.facts["version"], warpdef.__version__
        return [] if theirs == ours else [f"begun by warpdef {theirs} and continued by {ours}: bits may differ"]

    def require_input(self, sequence: PointSequence) -> None:
        """Check that the clouds are those of the run that left this.

        Raises:
            InputError: another number of frames, or frames that differ; it names the first few.
        """
        theirs, ours = self.facts["digests"], digests(sequence.all_frames(), sequence.all_normals())
        if len(ours) != len(theirs):
            raise InputError(
                f"{self.path}: the run to continue had {len(theirs)} frames, got {len(ours)}; give it the same input"
            )
        with understood(self.path):
            if not all(0 <= t < len(sequence) for t in (*self.facts["followed"], *self.facts["bent"])):
                raise ValueError("frames that are not there")
        other = [t for t, (a, b) in enumerate(zip(theirs, ours, strict=True)) if a != b]
        if other:
            shown = ", ".join(f"{t} ({sequence.frame_names[t]})" for t in other[:3])
            shown += ", ..." if len(other) > 3 else ""
            raise InputError(
                f"{self.path}: expected the input of the run to continue, got other points or normals in "
                f"{len(other)} of {len(ours)} frames: {shown}; give it the same input, or start anew"
            )

    def require_landmarks(self, landmarks: Landmarks | None) -> None:
        """Check that they are those of the run that left this.

        Raises:
            InputError: they are others.
        """
        if self.facts["landmarks"] != ("" if landmarks is None else landmarks.digest()):
            raise InputError(
                f"{self.path}: expected the landmarks of the run to continue, got others in {self.config.landmarks}; "
                "restore the file, or start anew"
            )

    def template(self, given: TriMesh | None, frames: Sequence[int]) -> ChosenTemplate:
        """The template chosen by that run.

        Args:
            given: a mesh of the user's own, cube units, which must be the one that the run began with.
            frames: numbers of the frames that are used, among which its keyframe must be.

        Raises:
            InputError: it is another, or not that of a run on these frames.
        """
        with understood(self.path):
            told, arrays = dict(self.facts["template"]), self.part("template")
            mesh = TriMesh(arrays["vertices"], arrays["faces"])
            hints = {name: kind for name, kind in get_type_hints(ChosenTemplate).items() if name not in _ARRAYS}
            given_facts = {name: from_plain(hints[name], v, name) for name, v in told.items()}
            chosen = ChosenTemplate(mesh, **given_facts, placed=arrays.get("placed"))
            if chosen.keyframe not in frames:
                raise ValueError(f"keyframe {chosen.keyframe}")
        if given is not None and not (
            np.array_equal(given.vertices, mesh.vertices) and np.array_equal(given.faces, mesh.faces)
        ):
            raise InputError(f"{self.path}: the template given is not that of the run to continue; give it the same")
        return chosen


def lasting_facts(
    sequence: PointSequence,
    config: Config,
    chosen: ChosenTemplate,
    notes: Mapping[str, str],
    resumed: list[int],
    landmarks: Landmarks | None = None,
) -> dict[str, Any]:
    """What of a run does not change while it runs: what it computes, from what, and how it came to its template."""
    return {
        "version": warpdef.__version__,
        "config": asdict(config),
        "notes": dict(notes),
        "digests": digests(sequence.all_frames(), sequence.all_normals()),
        "landmarks": "" if landmarks is None else landmarks.digest(),
        "resumed": resumed,
        "template": {
            name: value for name, value in asdict(replace(chosen, placed=None)).items() if name not in _ARRAYS
        },
    }
