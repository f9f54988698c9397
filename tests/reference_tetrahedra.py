"""Marching tetrahedra's vertices and winding numbers in float64 NumPy, as they stand in the kernels' docstrings."""

from __future__ import annotations

import numpy as np

STEEPNESS_MIN = 1e-4


def vertices(edges: np.ndarray, rest: np.ndarray, field: np.ndarray, bound: float) -> np.ndarray:
    """(E, 3); field (N, 4): signed distance, offset."""
    i, j = edges.T
    x = rest + bound * np.tanh(field[:, 1:4])
    steep = np.abs(field[i, 0] - field[j, 0]) >= STEEPNESS_MIN
    t = np.where(steep, field[i, 0] / np.where(steep, field[i, 0] - field[j, 0], 1.0), 0.5)[:, None]
    return (1 - t) * x[i] + t * x[j]


def adj_vertices(edges: np.ndarray, rest: np.ndarray, field: np.ndarray, bound: float, adj: np.ndarray) -> np.ndarray:
    """(N, 4): what ``adj`` (E, 3) asks of the nodes."""
    i, j = edges.T
    x = rest + bound * np.tanh(field[:, 1:4])
    s_i, s_j = field[i, 0], field[j, 0]
    steep = np.abs(s_i - s_j) >= STEEPNESS_MIN
    d = np.where(steep, s_i - s_j, 1.0)
    t = np.where(steep, s_i / d, 0.5)[:, None]
    along = np.where(steep, ((x[j] - x[i]) * adj).sum(axis=1) / d**2, 0.0)
    slope = bound * (1 - np.tanh(field[:, 1:4]) ** 2)
    out = np.zeros_like(field)
    np.add.at(out, i, np.column_stack([-s_j * along, slope[i] * (1 - t) * adj]))
    np.add.at(out, j, np.column_stack([s_i * along, slope[j] * t * adj]))
    return out


def winding(points: np.ndarray, area_normals: np.ndarray, places: np.ndarray) -> np.ndarray:
    """(K,)."""
    d = points - places[:, None]
    r = np.linalg.norm(d, axis=2)
    return ((area_normals * d).sum(axis=2) / r**3).sum(axis=1) / (4 * np.pi)
