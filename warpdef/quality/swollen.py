"""Limbs whose surface is larger than in the shape: drawn over points of another limb, or over what lies between.

A finger that lies on points of two, or bends where none bends, covers them all and leaves none; but its surface grows
by that, and skin does not. Single edges say nothing of it, as noise changes them, and all of the surface next to
nothing, as a finger is a hundredth of it.
"""

from __future__ import annotations

import numpy as np

from warpdef.geometry.limbs import find_limbs
from warpdef.geometry.triangles import face_areas

LEAST_SHARE, MOST_SHARE = 0.01, 0.3
"""Share of the surface from which a limb says something, and up to which it is a limb and not the body."""


class LimbAreas:
    """The limbs of a shape, and how large they are.

    Args:
        vertices: shape (V, 3) float64. faces: shape (F, 3). edges: each once, shape (E, 2).
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, edges: np.ndarray) -> None:
        areas = face_areas(vertices, faces)
        surface = float(areas.sum())
        self._on: list[np.ndarray] = []
        self._area: list[float] = []
        for limb in find_limbs(vertices, edges):
            inside = np.zeros(len(vertices), dtype=bool)
            inside[limb.vertex] = True
            on = inside[faces].mean(axis=1)
            if LEAST_SHARE * surface < (area := float(areas @ on)) < MOST_SHARE * surface:
                self._on.append(on)
                self._area.append(area)

    def most_grown(self, areas: np.ndarray, growth: float) -> float:
        """By which share the limb that has grown most is larger in a frame, 0 if there are none or none has grown.

        Args:
            areas: of the frame's faces (F,). growth: of all lengths, taken off.
        """
        most = max((float(areas @ on) / area for on, area in zip(self._on, self._area, strict=True)), default=0.0)
        return max(most / growth**2 - 1.0, 0.0)
