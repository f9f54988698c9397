"""Where the nodes of a multi-resolution grid lie in memory (paper, sec. Multi-Resolution Transformation Grid).

Level l has n = 2l - 1 nodes an axis over [-1, 1]^3, nodes on the corners. All levels of one transition stand behind
each other, x slowest and z fastest; all transitions together are one array of shape (S, M). A node holds six numbers,
rotation (Cayley) then translation, padded to eight so that it is one SIMD register on the CPU and two 16-byte loads on
the GPU. The two pads stay zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

node8 = wp.types.vector(length=8, dtype=wp.float32)


@dataclass(frozen=True)
class LevelTable:
    """The levels in use, coarsest first.

    resolution: nodes an axis                                   (L,) int32
    offset:     first node of a level in a transition's nodes   (L + 1,) int32; the last entry is M
    """

    resolution: np.ndarray
    offset: np.ndarray

    @classmethod
    def build(cls, coarsest: int, finest: int) -> LevelTable:
        """Levels ``coarsest .. finest``, counted from 1.

        Raises:
            ValueError: not 1 <= coarsest <= finest.
        """
        if not 1 <= coarsest <= finest:
            raise ValueError(f"levels: expected 1 <= coarsest <= finest, got {coarsest} and {finest}")
        resolution = 2 * np.arange(coarsest, finest + 1, dtype=np.int32) - 1
        offset = np.concatenate([[0], np.cumsum(resolution.astype(np.int64) ** 3)]).astype(np.int32)
        return cls(resolution, offset)

    @property
    def count(self) -> int:
        """Number of levels L."""
        return len(self.resolution)

    @property
    def node_count(self) -> int:
        """Nodes of one transition, M."""
        return int(self.offset[-1])

    def node_level(self) -> np.ndarray:
        """Position in this table of every node's level, shape (M,) int32."""
        return np.repeat(np.arange(self.count, dtype=np.int32), np.diff(self.offset))

    def to_device(self, device: wp.Device) -> wp.array:
        """``resolution, offset`` in pairs, shape (2 L,) int32: what the kernels read."""
        pairs = np.stack([self.resolution, self.offset[:-1]], axis=1).ravel()
        return wp.array(pairs, dtype=wp.int32, device=device)
