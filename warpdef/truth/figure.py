"""The built-in example: a smooth figure that walks and turns, with exact truth."""

from __future__ import annotations

import numpy as np

from warpdef.errors import InputError
from warpdef.mesh import MeshSequence

WEIGHT_SMOOTHING = 16.0
"""Reach of the blend across joints, in edges squared."""


def walking_figure(frames: int = 17) -> MeshSequence:
    """A human-like figure walking on a curve to its left, the same triangles in every frame.

    About 10,000 vertices and 20,000 nearly equilateral triangles, closed, one component; metres, y up, 1.75 tall. Each
    frame continues the one before, so a longer sequence walks further. The same call gives the same numbers.

    Args:
        frames: number of frames T, at least 2.

    Returns:
        Vertices (T, V, 3) float64 and faces (F, 3).

    Raises:
        InputError: fewer than 2 frames.
        MissingPackageError: gpytoolbox cannot be imported.
    """
    from warpdef.truth.body import body_mesh, nearest_bone
    from warpdef.truth.gait import BONES, walk_motions
    from warpdef.truth.skinning import skin, smooth_weights

    if frames < 2:
        raise InputError(f"the built-in figure: expected at least 2 frames, got {frames}")
    rest = body_mesh()
    bone_of_vertex = np.array([BONES.index(name) for name in nearest_bone(rest.vertices)])
    weights = smooth_weights(rest, bone_of_vertex, len(BONES), WEIGHT_SMOOTHING)
    poses = [skin(rest.vertices, weights, *motion) for motion in walk_motions(frames)]
    return MeshSequence(np.stack(poses), rest.faces)
