"""The bones' rigid motions and the rest shape of a rig, by least squares with the weights as they are."""

from __future__ import annotations

import numpy as np

from warpdef.geometry.rotations import nearest_rotation

_TINY = 1e-12


def fit_rigid(rest: np.ndarray, moved: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The rigid motions that take points to their places best, in every frame (Kabsch 1976; Umeyama 1991).

    Args:
        rest: shape (N, 3). moved: shape (T, N, 3). weights: of the squared distances, shape (N,), not all 0.

    Returns:
        R and s side by side, x = R y + s, shape (T, 3, 4).
    """
    share = weights / weights.sum()
    center, centers = share @ rest, np.einsum("n,tni->ti", share, moved)
    spread = moved.transpose(0, 2, 1) @ (share[:, None] * (rest - center))
    return _rigid(spread, center, centers)


def _rigid(spread: np.ndarray, center: np.ndarray, centers: np.ndarray) -> np.ndarray:
    rotation = nearest_rotation(spread)
    return np.concatenate([rotation, (centers - rotation @ center)[:, :, None]], axis=2)


def skin(rest: np.ndarray, joints: np.ndarray, weights: np.ndarray, bones: np.ndarray) -> np.ndarray:
    """Linear blend skinning: where bones take a rest shape, shape (T, V, 3).

    Args:
        rest: shape (V, 3). joints, weights: shape (V, K). bones: shape (T, B, 3, 4).
    """
    moved = np.zeros((len(bones), len(rest), 3))
    place = np.concatenate([rest, np.ones((len(rest), 1))], axis=1)
    for b in np.unique(joints):
        who, which = np.nonzero((joints == b) & (weights > 0.0))
        moved[:, who] += (weights[who, which, None] * place[who]) @ bones[:, b].transpose(0, 2, 1)
    return moved


def update_bones(
    rest: np.ndarray, moved: np.ndarray, joints: np.ndarray, weights: np.ndarray, bones: np.ndarray
) -> np.ndarray:
    """One round over the bones: each takes the rigid motion that is best while the others stay (Le and Deng 2012, sec.
    4.3); those that no vertex follows stay as they are.

        min_R,s  sum_i | q_ti - w_ib (R y_i + s) |^2,    q = x without what the other bones say

    Args:
        rest: shape (V, 3). moved: shape (T, V, 3). joints, weights: shape (V, K). bones: shape (T, B, 3, 4).

    Returns:
        The new bones, shape (T, B, 3, 4).
    """
    bones = bones.copy()
    left = moved - skin(rest, joints, weights, bones)
    for b in range(bones.shape[1]):
        who, which = np.nonzero((joints == b) & (weights > 0.0))
        w = weights[who, which]
        if len(who) < 3 or not (w**2).sum() > _TINY:
            continue
        y = rest[who]
        own = y @ bones[:, b, :, :3].transpose(0, 2, 1) + bones[:, b, None, :, 3]
        goal = left[:, who] + w[:, None] * own
        # |q - w p|^2 = w^2 |q / w - p|^2: sums of w^2 (q / w) are sums of w q.
        total = (w**2).sum()
        center, centers = (w**2) @ y / total, np.einsum("n,tni->ti", w, goal) / total
        spread = goal.transpose(0, 2, 1) @ (w[:, None] * (y - center))
        bones[:, b] = _rigid(spread, center, centers)
        new = y @ bones[:, b, :, :3].transpose(0, 2, 1) + bones[:, b, None, :, 3]
        left[:, who] = goal - w[:, None] * new
    return bones


def update_rest(
    start: np.ndarray,
    moved: np.ndarray,
    joints: np.ndarray,
    weights: np.ndarray,
    bones: np.ndarray,
    hold: float = 0.01,
) -> np.ndarray:
    """The rest shape that explains all frames best; shape (V, 3).

        min_y  sum_t | A_t y + a_t - x_t |^2 + hold T |y - y_0|^2,    A_t = sum_b w_b R_tb,  a_t = sum_b w_b s_tb

    Args:
        start: y_0, shape (V, 3). moved: shape (T, V, 3). joints, weights: shape (V, K). bones: shape (T, B, 3, 4).
    """
    square = np.tile(hold * len(bones) * np.eye(3), (len(start), 1, 1))
    right = hold * len(bones) * start
    for t, frame in enumerate(bones):
        blend = np.einsum("vk,vkij->vij", weights, frame[joints])
        turn = blend[:, :, :3]
        square += turn.transpose(0, 2, 1) @ turn
        right = right + np.einsum("vij,vi->vj", turn, moved[t] - blend[:, :, 3])
    return np.linalg.solve(square, right[:, :, None])[:, :, 0]
