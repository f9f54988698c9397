"""The deformation grids of a finished run, small enough to be kept: where they take any point of space.

A run's motion is two things: these grids, and the mesh that the vertex stage moved on from there. ``deform`` joins
them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from warpdef.errors import InputError
from warpdef.sequence import Similarity

_STEPS = np.iinfo(np.int16).max  # either side of 0
_VALUES = 6  # of a node: Cayley vector, translation


@dataclass(frozen=True)
class GridMotion:
    """Deformation grids between the fitted ones of T frames, and the way into their cube.

    nodes:       values in units of ``step``: Cayley vector, translation   (S, 6, M) int16
    step:        what one unit stands for; values are exact to half of it
    coarsest:    first level of the grids
    finest:      last level
    keyframe:    frame from which the steps lead away
    into:        input units to cube units
    frames:      numbers of the fitted frames, S + 1 of them, in the order in which the steps lead from one to the next
    frame_count: frames of the input, T; more where some had no points
    """

    nodes: np.ndarray
    step: float
    coarsest: int
    finest: int
    keyframe: int
    into: Similarity
    frames: tuple[int, ...]
    frame_count: int

    def __post_init__(self) -> None:
        shape = (_VALUES, sum((2 * level - 1) ** 3 for level in range(self.coarsest, self.finest + 1)))
        if self.nodes.dtype != np.int16 or self.nodes.ndim != 3 or self.nodes.shape[1:] != shape:
            raise InputError(
                f"the motion's grids: expected int16 of shape (S, {shape[0]}, {shape[1]}) for levels "
                f"{self.coarsest} to {self.finest}, got {self.nodes.dtype} of {self.nodes.shape}"
            )
        numbers = [self.step, self.into.scale, *np.ravel(self.into.centre)]
        if not np.isfinite(numbers).all() or not (self.step > 0.0 and self.into.scale > 0.0 and len(numbers) == 5):
            raise InputError("the motion's grids: expected a step and a scale above 0 and a finite centre")
        known = len(set(self.frames)) == len(self.frames) and all(0 <= t < self.frame_count for t in self.frames)
        if len(self.frames) != len(self.nodes) + 1 or not known or self.keyframe not in self.frames:
            raise InputError(
                f"the motion's grids: expected {len(self.nodes) + 1} different frames below {self.frame_count} with "
                f"the keyframe among them, got {self.frames} and keyframe {self.keyframe}"
            )

    @classmethod
    def from_nodes(
        cls,
        nodes: np.ndarray,
        levels: tuple[int, int],
        keyframe: int,
        into: Similarity,
        frames: Sequence[int] | None = None,
        frame_count: int | None = None,
    ) -> GridMotion:
        """Keep node values to 16 bits: to 2.5e-6 where the largest is 0.16.

        Args:
            nodes: shape (S, M, 6 or 8) float32. levels: the first and the last.
            frames, frame_count: as the fields; all of S + 1 frames if not given.
        """
        values = np.moveaxis(np.asarray(nodes)[..., :_VALUES], -1, 1)
        step = max(float(np.abs(values).max(initial=0.0)) / _STEPS, 1e-9)
        frames = tuple(int(frame) for frame in (range(len(nodes) + 1) if frames is None else frames))
        count = len(frames) if frame_count is None else frame_count
        return cls(np.rint(values / step).astype(np.int16), step, *levels, int(keyframe), into, frames, count)

    def __len__(self) -> int:
        """Frames T."""
        return self.frame_count

    def arrays(self) -> dict[str, np.ndarray]:
        """What an .npz of it holds."""
        return {
            "nodes": self.nodes,
            "step": np.array(self.step, dtype=np.float64),
            "levels": np.array([self.coarsest, self.finest]),
            "keyframe": np.array(self.keyframe),
            "centre": np.asarray(self.into.centre, dtype=np.float64),
            "scale": np.array(self.into.scale, dtype=np.float64),
            "frames": np.array(self.frames),
            "frame_count": np.array(self.frame_count),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray]) -> GridMotion:
        """The way back from ``arrays``.

        Raises:
            InputError: they do not fit each other.
        """
        try:
            coarsest, finest = (int(level) for level in arrays["levels"])
            into = Similarity(np.asarray(arrays["centre"], dtype=np.float64), float(arrays["scale"]))
            frames = tuple(int(frame) for frame in arrays["frames"])
            nodes, step, keyframe = arrays["nodes"], float(arrays["step"]), int(arrays["keyframe"])
            count = int(arrays["frame_count"])
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"the motion's grids: something is missing or of another shape ({error})") from None
        return cls(nodes, step, coarsest, finest, keyframe, into, frames, count)

    def carry(self, points: np.ndarray) -> np.ndarray:
        """Where the chain of grids takes points of the keyframe (paper, sec. Transformation Parameterization).

        Args:
            points: shape (N, 3), input units, at the keyframe. Outside the cube the field goes on as at its border.

        Returns:
            Their places in all frames, shape (T, N, 3) float64, input units; at the keyframe the points themselves.
        """
        import warp as wp

        from warpdef.device import find_device
        from warpdef.kernels.levels import LevelTable, node8
        from warpdef.kernels.motion import move_points
        from warpdef.motion.gaps import fill_gaps
        from warpdef.transitions import Transitions

        points = np.asarray(points, dtype=np.float64)
        start = self.frames.index(self.keyframe)
        count, ends = len(points), Transitions.away_from(start, len(self.frames))
        placed = np.empty((len(self.frames), count, 3))
        placed[start] = points
        levels = LevelTable.build(self.coarsest, self.finest).to_device(find_device("cpu"))
        padded = np.zeros((1, self.nodes.shape[2], 8), dtype=np.float32)
        first = wp.zeros(count, dtype=wp.int32, device="cpu")
        rotation, moved = (wp.zeros(count, dtype=wp.vec3, device="cpu") for _ in range(2))
        inside = self.into.to_cube(points).astype(np.float32)
        for steps in (ends.forward, ends.backward):
            at = wp.array(inside, dtype=wp.vec3, device="cpu")
            for s in steps:
                padded[0, :, :_VALUES] = self.nodes[s].T * np.float32(self.step)
                nodes = wp.array(padded, dtype=node8, device="cpu")
                move_points(0, count, nodes, levels, at, first, rotation, moved)
                at, moved = moved, at
                placed[ends.target[s]] = self.into.from_cube(at.numpy())
        return fill_gaps(placed, self.frames, self.frame_count)
