"""Transitions between neighbouring frames, leading away from the keyframe."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Transitions:
    """Sources and targets of all S transitions.

    source, target: frames                              (S,) int
    of_frame: the transition whose target is a frame    (T,) int; -1 at the keyframe
    forward, backward: transitions from the keyframe outwards
    """

    keyframe: int
    source: np.ndarray
    target: np.ndarray
    of_frame: np.ndarray
    forward: range
    backward: range

    @classmethod
    def away_from(cls, keyframe: int, frame_count: int) -> Transitions:
        s = np.arange(frame_count - 1)
        ahead = s >= keyframe
        source, target = np.where(ahead, s, s + 1), np.where(ahead, s + 1, s)
        of_frame = np.full(frame_count, -1)
        of_frame[target] = s
        backward = range(keyframe - 1, -1, -1)
        return cls(keyframe, source, target, of_frame, range(keyframe, frame_count - 1), backward)

    def __len__(self) -> int:
        return len(self.source)

    def targets(self, first: int, last: int) -> tuple[int, int]:
        """The run of frames that transitions ``first .. last`` lead to; it spans the keyframe if they do."""
        frames = self.target[first:last]
        return int(frames.min()), int(frames.max()) + 1
