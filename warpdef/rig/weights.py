"""Weights of skinning: small least-squares problems on the simplex, one a vertex, solved all at once."""

from __future__ import annotations

import numpy as np

INFLUENCES = 4
"""Bones that a vertex may follow; what game engines and glTF's first set of joints take."""

_CANDIDATES = 12  # bones tried for a vertex, those that explain it best alone
_CHUNK = 1 << 24  # numbers of a table of vertices and pairs of bones held at once
_SWEEPS = 150
_PAIRS = np.triu_indices(4)


def bone_errors(rest: np.ndarray, moved: np.ndarray, bones: np.ndarray) -> np.ndarray:
    """Sum over frames of the squared distance from where a bone alone takes a vertex to where it goes; (V, B).

    Args:
        rest: shape (V, 3). moved: shape (T, V, 3). bones: R and s side by side, shape (T, B, 3, 4).
    """
    square = _products(rest) @ _pair_table(bones, True).T
    return np.maximum(square - 2.0 * _cross(rest, moved, bones) + _energy(moved)[:, None], 0.0)


def solve_weights(rest: np.ndarray, moved: np.ndarray, bones: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The weights that explain each vertex best, with the bones as they are.

        min_w  sum_t | sum_b w_b (R_tb y + s_tb) - x_t |^2  =  min_w  w^T D w      on the simplex sum w = 1, w >= 0,
        D_bc = sum_t (p_tb - x_t)^T (p_tc - x_t),   p_tb = R_tb y + s_tb

    D is quadratic in (y, 1): a table over pairs of bones, made once, gives it for every vertex without going through
    the frames again. Solved among the bones that explain a vertex best alone, then among the four of largest weight.

    Args:
        rest: shape (V, 3). moved: shape (T, V, 3). bones: shape (T, B, 3, 4).

    Returns:
        Indices of the bones and weights, both (V, K), K = min(4, B); the largest weight first, rows of sum 1.
    """
    count, number = len(rest), bones.shape[1]
    tries, kept = min(_CANDIDATES, number), min(INFLUENCES, number)
    cross, energy = _cross(rest, moved, bones), _energy(moved)
    table, products = _pair_table(bones, False), _products(rest)
    chosen, weights = np.empty((count, kept), dtype=np.int64), np.empty((count, kept))
    step = max(1, _CHUNK // number**2)
    for start in range(0, count, step):
        part = slice(start, start + step)
        gram = (products[part] @ table.T).reshape(-1, number, number)
        gram += energy[part, None, None] - cross[part, :, None] - cross[part, None, :]
        rows = np.arange(len(gram))[:, None]
        order = np.argsort(np.einsum("vbb->vb", gram), axis=1, kind="stable")[:, :tries]
        small = gram[rows[:, :, None], order[:, :, None], order[:, None, :]]
        first = simplex_least_squares(small)
        best = np.argsort(-first, axis=1, kind="stable")[:, :kept]
        small = small[rows[:, :, None], best[:, :, None], best[:, None, :]]
        final = simplex_least_squares(small)
        largest = np.argsort(-final, axis=1, kind="stable")
        weights[part] = np.take_along_axis(final, largest, axis=1)
        chosen[part] = np.take_along_axis(np.take_along_axis(order, best, axis=1), largest, axis=1)
    return chosen, weights


def simplex_least_squares(gram: np.ndarray) -> np.ndarray:
    """argmin w^T D w over w >= 0, sum w = 1, for many small symmetric D >= 0; shapes (N, K, K) to (N, K).

    Weight goes from one entry to another, always between the pair that promises most (sequential minimal optimisation:
    Platt 1998; the pair of Keerthi et al. 2001), by the exact step of that pair: every round lowers every objective,
    and the weights never leave the simplex.
    """
    number, size, _ = gram.shape
    rows = np.arange(number)
    weights = np.zeros((number, size))
    diagonal = np.einsum("nkk->nk", gram)
    start = diagonal.argmin(axis=1)
    weights[rows, start] = 1.0
    slope = gram[rows, start].copy()
    scale = np.maximum(diagonal.max(axis=1), 1e-300)
    for _ in range(_SWEEPS):
        to = slope.argmin(axis=1)
        frm = np.where(weights > 0.0, slope, -np.inf).argmax(axis=1)
        gain = slope[rows, frm] - slope[rows, to]
        if not (gain > 1e-9 * scale).any():
            break
        bend = diagonal[rows, frm] + diagonal[rows, to] - 2.0 * gram[rows, frm, to]
        move = np.minimum(gain / np.maximum(bend, 1e-12 * scale), weights[rows, frm])
        weights[rows, frm] -= move
        weights[rows, to] += move
        slope += move[:, None] * (gram[rows, to] - gram[rows, frm])
    return weights / weights.sum(axis=1, keepdims=True)


def _products(rest: np.ndarray) -> np.ndarray:
    """The ten products of two entries of (y, 1), shape (V, 10)."""
    place = np.concatenate([rest, np.ones((len(rest), 1))], axis=1)
    return place[:, _PAIRS[0]] * place[:, _PAIRS[1]]


def _pair_table(bones: np.ndarray, diagonal: bool) -> np.ndarray:
    """sum_t p_tb^T p_tc as coefficients of ``_products``: shape (B, 10) for b = c alone, else (B * B, 10)."""
    number = bones.shape[1]
    flat = bones.transpose(1, 3, 0, 2).reshape(number, 4, -1)
    if diagonal:
        square = np.einsum("bim,bjm->bij", flat, flat, optimize=True)
    else:
        wide = flat.reshape(4 * number, -1)
        square = (wide @ wide.T).reshape(number, 4, number, 4).transpose(0, 2, 1, 3).reshape(-1, 4, 4)
    both = square + square.transpose(0, 2, 1)
    i, j = _PAIRS
    return both[:, i, j] * np.where(i == j, 0.5, 1.0)


def _cross(rest: np.ndarray, moved: np.ndarray, bones: np.ndarray) -> np.ndarray:
    """sum_t x_t^T p_tb, shape (V, B)."""
    frames, number = bones.shape[:2]
    flat = bones.transpose(0, 2, 1, 3).reshape(frames * 3, number * 4)
    along = (moved.transpose(1, 0, 2).reshape(len(rest), -1) @ flat).reshape(len(rest), number, 4)
    return np.einsum("vbi,vi->vb", along[:, :, :3], rest) + along[:, :, 3]


def _energy(moved: np.ndarray) -> np.ndarray:
    return np.einsum("tvi,tvi->v", moved, moved)
