"""Points drawn from surfaces: what a scanner would see of a known mesh."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from warpdef.errors import InputError
from warpdef.mesh import MeshSequence, TriMesh
from warpdef.sequence import MIN_POINTS, PointSequence

NORMALS = ("auto", "true", "estimated", "none")


def sample_surface(
    vertices: np.ndarray, faces: np.ndarray, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Independent points, uniform by area.

    Args:
        vertices: shape (V, 3).
        faces: shape (F, 3).
        count: number of points N.
        rng: source of randomness; the same state gives the same points.

    Returns:
        Points (N, 3) float64 in the vertices' units, unit face normals (N, 3), face indices (N,) int64, and barycentric
        coordinates (N, 3).

    Raises:
        InputError: ``count`` below 1, or a surface without area.
    """
    if count < 1:
        raise InputError(f"surface samples: expected at least 1 point, got {count}")
    corners = np.asarray(vertices, dtype=np.float64)[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    double_area = np.linalg.norm(normals, axis=1)
    total = double_area.sum()
    if not total > 0.0:
        raise InputError("surface samples: expected a surface with an area above 0, got only degenerate triangles")
    # A face without area owns an empty interval and is never drawn.
    face = np.searchsorted(np.cumsum(double_area), rng.random(count) * total, side="right")
    face = np.minimum(face, np.flatnonzero(double_area)[-1])
    root, second = np.sqrt(rng.random(count)), rng.random(count)
    barycentric = np.column_stack([1.0 - root, root * (1.0 - second), root * second])
    points = np.einsum("nk,nki->ni", barycentric, corners[face])
    return points, normals[face] / double_area[face, None], face, barycentric


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
            from warpdef.template.normals import estimate_normals

            cloud_normals.append(estimate_normals(cloud, neighbours=16))
        else:
            cloud_normals.append(face_normals if normals == "true" else None)
    return PointSequence.from_arrays(clouds, cloud_normals)
