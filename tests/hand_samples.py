"""A flat hand of four fingers, whose surface is a sheet."""

from __future__ import annotations

import numpy as np

from warpdef.geometry.triangles import unique_edges

STEP = 0.05
FINGERS = ((0.0, 0.3), (0.55, 0.85), (1.1, 1.4), (1.65, 1.95))
"""From where to where they are wide; 1.2 long, on a palm of 2 by 2."""


def hand() -> tuple[np.ndarray, np.ndarray]:
    """A flat hand of four fingers that point along y, the palm below 0."""
    x, y = np.meshgrid(np.arange(0.0, 2.0, STEP), np.arange(-2.0, 1.2, STEP), indexing="ij")
    i = np.arange(x.size).reshape(x.shape)
    a, b, c, d = (k.ravel() for k in (i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]))
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    middle = vertices[a] + 0.5 * STEP * np.array([1.0, 1.0, 0.0])
    there = middle[:, 1] < 0.0
    for low, high in FINGERS:
        there |= (middle[:, 0] > low) & (middle[:, 0] < high)
    faces = np.concatenate([np.stack([a, b, c], 1)[there], np.stack([a, c, d], 1)[there]])
    # A little uneven, so that no two ways are of the same length.
    vertices[:, :2] += np.random.default_rng(0).uniform(-0.02 * STEP, 0.02 * STEP, (len(vertices), 2))
    used, faces = np.unique(faces, return_inverse=True)
    return vertices[used], faces.reshape(-1, 3).astype(np.int32)


VERTICES, FACES = hand()
EDGES = unique_edges(FACES)


def finger(which: int) -> np.ndarray:
    """Whether vertices are on it."""
    low, high = FINGERS[which]
    return (VERTICES[:, 1] > 0.0) & (VERTICES[:, 0] > low - STEP) & (VERTICES[:, 0] < high + STEP)
