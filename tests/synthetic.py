"""Tiny sequences whose motion is known: a turning ellipsoid and a bending bar, as meshes and as clouds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np


@dataclass(frozen=True)
class Synthetic:
    """The same triangles in every frame, and samples of them, within the cube [-1, 1]^3.

    vertices: (T, V, 3). faces: (F, 3) int32, outward. clouds, normals: T arrays (N, 3), samples that do not correspond.
    """

    vertices: np.ndarray
    faces: np.ndarray
    clouds: list[np.ndarray]
    normals: list[np.ndarray]


def icosphere(subdivisions: int) -> tuple[np.ndarray, np.ndarray]:
    """Unit sphere of 20 * 4^subdivisions triangles: vertices (V, 3), faces (F, 3)."""
    golden = (1 + 5**0.5) / 2
    corners = [(a, b * golden, 0) for a in (-1, 1) for b in (-1, 1)]
    vertices = np.array([np.roll(c, shift) for shift in range(3) for c in corners], dtype=np.float64)
    # Edges of this icosahedron are 2 long; its faces are all triples of neighbours.
    close = np.isclose(np.linalg.norm(vertices[:, None] - vertices[None], axis=2), 2.0)
    faces = np.array([t for t in combinations(range(12), 3) if all(close[a, b] for a, b in combinations(t, 2))])
    faces = _outward(vertices, faces)
    vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
    for _ in range(subdivisions):
        vertices, faces = _subdivide(vertices, faces)
        vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
    return vertices, faces.astype(np.int32)


def _outward(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    inward = (np.cross(b - a, c - a) * (a + b + c)).sum(axis=1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return faces


def _subdivide(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges, of = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True)
    ab, bc, ca = (of.reshape(3, -1)[i] + len(vertices) for i in range(3))
    a, b, c = faces.T
    new = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([vertices, vertices[edges].mean(axis=1)]), np.concatenate([np.stack(f, axis=1) for f in new])


def sample_surface(
    vertices: np.ndarray, faces: np.ndarray, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Area-uniform samples and their unit normals, both (count, 3)."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1)
    chosen = rng.choice(len(faces), count, p=area / area.sum())
    root, v = np.sqrt(rng.random(count))[:, None], rng.random(count)[:, None]
    points = (1 - root) * a[chosen] + root * (1 - v) * b[chosen] + root * v * c[chosen]
    return points, normal[chosen] / area[chosen, None]


def turn_about(axis: Sequence[float] | np.ndarray, angle: float) -> np.ndarray:
    """Rotation matrix by Rodrigues' formula."""
    x, y, z = np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def turning_ellipsoid(frames: int, points: int, rng: np.random.Generator, subdivisions: int = 2) -> Synthetic:
    """Half axes 0.6, 0.35, 0.2; turns by 0.15 rad a frame about a skew axis and drifts by 0.03 a frame along x."""
    sphere, faces = icosphere(subdivisions)
    body = sphere * [0.6, 0.35, 0.2]
    middle = (frames - 1) / 2
    moved = [
        body @ turn_about([0.3, 0.2, 1.0], 0.15 * (t - middle)).T + [0.03 * (t - middle), 0, 0] for t in range(frames)
    ]
    return _sampled(np.stack(moved), faces, points, rng)


def bending_bar(frames: int, points: int, rng: np.random.Generator, subdivisions: int = 2) -> Synthetic:
    """A flat rounded bar along x, 1.4 x 0.2 x 0.4, bent in the x-y plane to an arc of growing curvature."""
    sphere, faces = icosphere(subdivisions)
    bar = sphere * [0.7, 0.1, 0.2]
    moved = []
    for t in range(frames):
        curvature = 0.01 + 0.25 * t
        angle, radius = curvature * bar[:, 0], 1 / curvature - bar[:, 1]
        moved.append(np.stack([radius * np.sin(angle), 1 / curvature - radius * np.cos(angle), bar[:, 2]], axis=1))
    return _sampled(np.stack(moved), faces, points, rng)


def _sampled(vertices: np.ndarray, faces: np.ndarray, points: int, rng: np.random.Generator) -> Synthetic:
    samples = [sample_surface(v, faces, points, rng) for v in vertices]
    return Synthetic(vertices, faces, [p for p, _ in samples], [n for _, n in samples])
