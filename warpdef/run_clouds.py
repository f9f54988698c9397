"""The clouds that a finished run was made from, read again: from where it says they lay, or from another place."""

from __future__ import annotations

from pathlib import Path

from warpdef.errors import InputError
from warpdef.files.checkpoint import digests
from warpdef.files.saved_run import SavedRun
from warpdef.prepare import clean, read_input
from warpdef.sequence import PointSequence

KEPT = "clouds.npz"
"""Where a demo keeps its clouds, inside the run folder."""


def clouds_of(run: SavedRun, place: Path | None = None) -> PointSequence:
    """The points that the run used: its own frames, cleaned and drawn as by ``pipeline.reconstruct``.

    Args:
        place: where they lie; taken as they are. None: in the run folder, as a demo's do, else where the run says, and
            there they must be what they were.

    Raises:
        InputError: they are gone, of another number of frames, or, in the run's own place, no longer the same.
    """
    told = run.report.get("input") or {}
    if place is not None:
        path, expected = place, None
    elif (run.path / KEPT).is_file():
        path, expected = run.path / KEPT, None  # rounded when they were written
    elif told.get("path"):
        path, expected = Path(told["path"]), told.get("digests")
        if not path.exists():
            raise InputError(f"{path}: the clouds of {run.path} are no longer there; give their place with --clouds")
    else:
        raise InputError(f"{run.path}: where its clouds lie is not known; give their place with --clouds")
    sequence = clean(read_input(path, run.config), run.config)
    if sequence.frame_count != len(run.meshes):
        raise InputError(
            f"{path}: expected {len(run.meshes)} frames as {run.path} has, got {sequence.frame_count}; "
            "give the clouds that it was made from with --clouds"
        )
    if expected is not None:
        found = digests(sequence.all_frames(), sequence.all_normals())
        other = [t for t, (a, b) in enumerate(zip(expected, found, strict=True)) if a != b]
        if other:
            shown = ", ".join(f"{t} ({sequence.frame_names[t]})" for t in other[:3])
            shown += ", ..." if len(other) > 3 else ""
            raise InputError(
                f"{path}: expected the clouds that {run.path} was made from, got others in {len(other)} of "
                f"{len(found)} frames: {shown}; reconstruct again, or give clouds to judge by with --clouds"
            )
    return sequence
