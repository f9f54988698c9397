"""A ball with two legs that may swing past each other's place between two frames, and clouds of it."""

from __future__ import annotations

import numpy as np
from synthetic import icosphere, sample_surface

from warpdef.fit.recover import Cloud

DEGREE = np.pi / 180
LEGS = (20 * DEGREE, -20 * DEGREE)


def body(swings: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """A ball with two legs in the x-y plane, swung about z by these angles; the same vertices for all swings."""
    direction, faces = icosphere(4)
    heading = np.arctan2(direction[:, 0], -direction[:, 1])
    aside = np.arcsin(np.clip(direction[:, 2], -1, 1))
    vertices = np.full((len(direction), 1), 0.35) * direction
    turn = np.zeros(len(direction))
    for leg, swing in zip(LEGS, swings, strict=True):
        off = np.sqrt((heading - leg) ** 2 + aside**2)
        vertices += (0.9 * np.exp(-((off / (11 * DEGREE)) ** 2)))[:, None] * direction
        turn += swing * np.exp(-((off / (17 * DEGREE)) ** 4))
    c, s = np.cos(turn), np.sin(turn)
    x, y, z = vertices.T
    return np.column_stack([c * x - s * y, s * x + c * y, z]), faces


def cloud_of(vertices: np.ndarray, faces: np.ndarray, seed: int, oriented: bool = True) -> Cloud:
    rng = np.random.default_rng(seed)
    points, normals = sample_surface(vertices, faces, 3000, rng)
    if not oriented:
        normals = normals * rng.choice([-1.0, 1.0], size=(len(normals), 1))
    return Cloud(points, normals, oriented, oriented)
