"""Which frame the template is built on (sec. Keyframe Selection)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from warpdef.config import KeyframeConfig
from warpdef.errors import InputError


@dataclass(frozen=True)
class KeyframeCandidate:
    """A frame that may carry the template.

    frame:           index from 0
    occupied_voxels: cells of the grid over [-1, 1]^3 that hold a point
    weight:          Gaussian of the distance to the temporal middle, 0 to 1
    score:           occupied_voxels * weight
    why:             one sentence for the report
    """

    frame: int
    occupied_voxels: int
    weight: float
    score: float
    why: str


def rank_keyframes(clouds: Sequence[np.ndarray], config: KeyframeConfig) -> list[KeyframeCandidate]:
    """Candidates, best first: all frames for ``auto``, one for ``first``, ``middle`` or an index.

    The score is |G(P_t)| exp(-gamma (t - T/2)^2), T the last frame's index, so that the weight is 1 in the true middle.
    Equal scores go to the frame nearer the middle, then to the earlier one.

    Args:
        clouds: one array a frame, each (N_t, 3), cube units.
        config: the choice, the grid and gamma.

    Raises:
        InputError: an index that is not a frame of the sequence.
    """
    frame_count = len(clouds)
    middle = (frame_count - 1) / 2
    named = {"first": 0, "middle": int(middle)}
    if config.choice == "auto":
        frames = list(range(frame_count))
    else:
        frame = named[config.choice] if config.choice in named else int(config.choice)
        if frame >= frame_count:
            raise InputError(
                f"--keyframe: expected auto, first, middle or a frame in 0..{frame_count - 1}, got {frame}; "
                f"the sequence has {frame_count} frames, counted from 0"
            )
        frames = [frame]

    scored = []
    for frame in frames:
        occupied = occupied_voxels(clouds[frame], config.voxels)
        weight = float(np.exp(-config.gamma * (frame - middle) ** 2))
        scored.append((frame, occupied, weight, occupied * weight))
    scored.sort(key=lambda s: (-s[3], abs(s[0] - middle), s[0]))
    return [
        KeyframeCandidate(*s, why=_why(config.choice, rank, len(scored), s[1], s[2])) for rank, s in enumerate(scored)
    ]


def occupied_voxels(points: np.ndarray, voxels: int) -> int:
    """Number of cells of a ``voxels``^3 grid over [-1, 1]^3 that hold at least one of the points (N, 3)."""
    cell = np.floor((np.asarray(points) + 1.0) * (voxels / 2.0)).astype(np.int64)
    x, y, z = np.clip(cell, 0, voxels - 1).T
    return len(np.unique((x * voxels + y) * voxels + z))


def _why(choice: str, rank: int, count: int, occupied: int, weight: float) -> str:
    if choice in ("first", "middle"):
        return f"the {choice} frame, as asked"
    if choice != "auto":
        return "the frame asked for"
    place = "best" if rank == 0 else f"number {rank + 1}"
    return f"{place} of {count} frames by coverage: {occupied} occupied voxels times {weight:.3f} for its place in time"
