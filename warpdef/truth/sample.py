"""Points drawn from surfaces: what a scanner would see of a known mesh."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from warpdef.errors import InputError
from warpdef.geometry.sampling import sample_surface
from warpdef.mesh import MeshSequence, TriMesh
from warpdef.sequence import MIN_POINTS, PointSequence

NORMALS = ("auto", "true", "estimated", "none")


def sample_sequence(
    truth: MeshSequence | Sequence[TriMesh],
    points: int,
    noise: float = 0.0,
    seed: int = 0,
    normals: Literal["auto", "true", "estimated", "none"] = "auto",
) -> PointSequence:
    """Clouds sampled from every frame of a known sequence, independently of each other: no correspondences.

    Args:
        truth: a moving mesh, or one mesh a frame.
        points: points a frame.
        noise: standard deviation of the Gaussian noise in each coordinate, as a fraction of the diagonal of that
            frame's own bounding box; 0 for none.
        seed: frame t draws from a generator seeded with (seed, t).
        normals: ``true``: those of the sampled faces; ``estimated``: from the (noisy) cloud itself; ``none``; or
            ``auto``: ``true`` without noise, ``estimated`` with it.

    Returns:
        The clouds in the truth's units, one a frame.

    Raises:
        InputError: fewer than 10 points, a noise that is negative or not finite, a negative seed, an unknown choice of
            normals, fewer than 2 frames, or a frame whose surface has no area.
    """
    if points < MIN_POINTS:
        raise InputError(f"--points: expected at least {MIN_POINTS} points a frame, got {points}")
    if not (np.isfinite(noise) and noise >= 0.0):
        raise InputError(f"--noise: expected a fraction of the bounding-box diagonal from 0, as 0.005, got {noise}")
    if seed < 0:
        raise InputError(f"--seed: expected 0 or more, got {seed}")
    if normals not in NORMALS:
        raise InputError(f"--normals: expected auto, true, estimated or none, got {normals!r}")
    if normals == "auto":
        normals = "estimated" if noise > 0.0 else "true"
    clouds: list[np.ndarray] = []
    cloud_normals: list[np.ndarray | None] = []
    for frame in range(len(truth)):
        mesh = truth[frame]
        rng = np.random.default_rng([seed, frame])
        try:
            cloud, face_normals, _, _ = sample_surface(mesh.vertices, mesh.faces, points, rng)
        except InputError as error:
            raise InputError(f"frame {frame}: {error}") from None
        if noise > 0.0:
            diagonal = np.linalg.norm(np.ptp(mesh.vertices, axis=0))
            cloud = cloud + rng.normal(0.0, noise * diagonal, cloud.shape)
        clouds.append(cloud)
        if normals == "estimated":
            from warpdef.geometry.cloud_normals import estimate_normals

            cloud_normals.append(estimate_normals(cloud, neighbours=16))
        else:
            cloud_normals.append(face_normals if normals == "true" else None)
    return PointSequence.from_arrays(clouds, cloud_normals)
