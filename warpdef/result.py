"""What a reconstruction returns."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdef.config import Config
from warpdef.errors import InputError

if TYPE_CHECKING:
    from warpdef.appearance import Appearance
    from warpdef.motion.deform import Deformed
    from warpdef.motion.grid_motion import GridMotion


class Moving:
    """What can be done with a result, fresh or read back: it has ``vertices``, ``faces``, ``keyframe``, ``motion``."""

    vertices: np.ndarray
    faces: np.ndarray
    keyframe: int
    motion: GridMotion | None

    def at(self, times: Any) -> np.ndarray:
        """The mesh at any times, shape (n, V, 3), input units.

        Args:
            times: counted in frames from 0: 2.5 is halfway between frames 2 and 3. Every vertex goes on an arc, by the
                rotation of the surface around it.

        Raises:
            InputError: a time outside the frames.
        """
        from warpdef.motion.between import mesh_between

        return mesh_between(self.vertices, self.faces, times)

    def deform(self, points: Any, times: Any = None) -> np.ndarray:
        """Where the motion takes other points: of a denser mesh, of a scan, landmarks.

        Args:
            points: shape (N, 3), input units, where they are at the keyframe.
            times: as in ``at``; all frames if not given.

        Returns:
            Shape (T, N, 3) float64, input units. Points of the mesh's own surface stay on it.

        Raises:
            InputError: points or times are not usable, or the result has no motion.
        """
        moved = self.follow(points)
        return moved.points if times is None else moved.at(times)

    def follow(self, points: Any) -> Deformed:
        """As ``deform``, with the rotations, which turn normals, and the distances from the mesh.

        Raises:
            InputError: points are not usable, or the result has no motion.
        """
        from warpdef.motion.deform import deform

        if self.motion is None:
            raise InputError("deform: expected the run's motion, got a result made without it; reconstruct again")
        return deform(points, self.vertices, self.faces, self.motion)


@dataclass
class Reconstruction(Moving):
    """One mesh that moves.

    vertices: positions in every frame, input units   (T, V, 3) float32; float64 far from the origin
    faces:    the same in every frame                 (F, 3) int32
    keyframe: frame that the template was built on
    config:   the configuration, whole
    report:   versions, device, keyframe and why, template statistics, seconds, losses, solver statistics, warnings
    steps:    the loss curve, one record every few iterations
    motion:   the deformation grids, for ``deform``
    appearance: colours of the clouds, or colours and texture coordinates of a template given, where they have any
    confidence: how far each vertex of each frame can be trusted, 255 for 1   (T, V) uint8
    """

    vertices: np.ndarray
    faces: np.ndarray
    keyframe: int
    config: Config
    report: dict[str, Any] = field(default_factory=dict)
    steps: list[dict[str, float]] = field(default_factory=list)
    motion: GridMotion | None = None
    appearance: Appearance | None = None
    confidence: np.ndarray | None = None
