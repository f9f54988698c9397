"""The material, learnt from all frames: what strains most, as skin over a joint does, is held least."""

from __future__ import annotations

import numpy as np
import warp as wp

from warpdef.kernels.material import strains

_LEARNT = (0.2, 0.4, 0.6)  # shares of the rounds after which it is learnt anew, from what frames have come to by then
_NO_STRAIN = 0.06  # of an edge's length: what points' noise and triangles themselves leave of strain
_SPAN = 2.0  # times softer or stiffer than the middle at most: very soft places get rough


class Material:
    """Stiffness of every vertex, shape (V,) float32: a part of a round.

    Args:
        edges: neighbours, as in ``Graph``: rows and columns.
        moving: the shape, (V,) vec3, the vertices of all frames, (T, V) vec3, and their rotations, (T, V) mat33.
        rounds: how many there will be.
    """

    def __init__(
        self, edges: tuple[wp.array, wp.array], moving: tuple[wp.array, wp.array, wp.array], rounds: int
    ) -> None:
        self._edges, self._moving = edges, moving
        self._after = {round(share * rounds) for share in _LEARNT}
        self.stiffness = wp.ones(len(moving[0]), dtype=wp.float32, device=moving[0].device)
        self._strain = wp.zeros_like(self.stiffness)

    def learn(self, done: int) -> None:
        """After ``done`` rounds: one over the root of the mean square strain, the middle 1. Waits for the device.

        So squares of strains become sizes (iteratively reweighted least squares), of a vertex over all frames together.
        """
        if done in self._after:
            self.measure()
            self.stiffness.assign(stiffness_of(self._strain.numpy()))

    def measure(self) -> None:
        """The mean square strain, as the vertices are."""
        places, vertices, rotation = self._moving
        strains(0, len(places), *self._edges, places, rotation, vertices, self._strain)


def stiffness_of(strain_sq: np.ndarray) -> np.ndarray:
    """Stiffness by mean square strain, both (V,); 1 in the middle, from 1/2 to 2."""
    softness = np.sqrt(strain_sq.astype(np.float64) + _NO_STRAIN**2)
    return np.clip(np.median(softness) / softness, 1 / _SPAN, _SPAN).astype(np.float32)
