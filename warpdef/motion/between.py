"""Times between frames: the motions are interpolated, not the places, so that what swings goes on an arc.

From a frame to the next a point takes part in a rigid motion: a rotation by an angle a about an axis, and a way d, of
which d = along + across that axis. The share s of that screw motion takes it

    s along + sin(s a/2) / sin(a/2) R(axis, (s - 1) a/2) across

which is the whole way at s = 1 and the straight one where nothing turns; the screw's own axis, which is far away and
unknown where it hardly turns, is not needed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from warpdef.errors import InputError
from warpdef.motion.rotations import about, inverse, local_rotations, multiply, smoothed, turn

# A long way must not swing by the turn of a single fold: rotations are averaged over this share of the largest side.
# Every second frame left out and put back, change of edge lengths against straight ways: crane 0.0054 (0.0058), horse
# 0.023 (0.032), walking figure 0.0007 (0.0027); without averaging 0.0065, 0.045, 0.0010.
_SPREAD = 0.07


def steps_of(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """How a moving mesh turns from each frame to the next, shape (T - 1, V, 4) quaternions, smooth over the surface."""
    vertices = np.asarray(vertices, dtype=np.float64)
    steps = local_rotations(vertices[:-1], vertices[1:], faces)
    corners = vertices[0][faces]
    edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean()
    side = (vertices[0].max(axis=0) - vertices[0].min(axis=0)).max()
    return smoothed(steps, faces, _SPREAD * side / edge) if edge > 0.0 else steps


def between(points: np.ndarray, steps: np.ndarray, times: Sequence[float] | np.ndarray) -> np.ndarray:
    """Points that turn as they go, at any times.

    Args:
        points: shape (T, N, 3). steps: rotations from each frame to the next, quaternions, shape (T - 1, N, 4).
        times: counted in frames from 0, shape (n,); 2.5 is halfway between frames 2 and 3.

    Returns:
        Shape (n, N, 3), in the type of ``points``; at whole times those points themselves.

    Raises:
        InputError: a time outside 0 .. T - 1.
    """
    times = check_times(times, len(points))
    placed = np.empty((len(times), *points.shape[1:]), dtype=points.dtype)
    for k, (t, share) in enumerate(_parts(times)):
        if share == 0.0:
            placed[k] = points[t]
            continue
        way = points[t + 1].astype(np.float64) - points[t]
        axis, angle = _axis_angle(steps[t])
        along = (axis * way).sum(axis=1, keepdims=True) * axis
        turning = angle > 1e-6
        whole = np.where(turning, np.sin(angle / 2.0), 1.0)
        ratio = np.where(turning, np.sin(share * angle / 2.0) / whole, share)[:, None]
        arc = turn(about(axis, (share - 1.0) * angle / 2.0), way - along)
        placed[k] = points[t] + share * along + ratio * arc
    return placed


def turns_between(turns: np.ndarray, times: Sequence[float] | np.ndarray) -> np.ndarray:
    """Rotations, shape (T, N, 4), at any times, shape (n, N, 4): the shorter way round between two frames."""
    times = check_times(times, len(turns))
    turned = np.empty((len(times), *turns.shape[1:]))
    for k, (t, share) in enumerate(_parts(times)):
        turned[k] = turns[t]
        if share > 0.0:
            axis, angle = _axis_angle(multiply(turns[t + 1], inverse(turns[t])))
            turned[k] = multiply(about(axis, share * angle), turned[k])
    return turned


def mesh_between(vertices: np.ndarray, faces: np.ndarray, times: Sequence[float] | np.ndarray) -> np.ndarray:
    """A moving mesh, shape (T, V, 3), at other times, shape (n, V, 3), as in ``between``; it turns as ``steps_of``."""
    times = check_times(times, len(vertices))
    if (times % 1.0 == 0.0).all():
        return vertices[times.astype(int)]
    return between(vertices, steps_of(vertices, faces), times)


def check_times(times: Sequence[float] | np.ndarray, frame_count: int) -> np.ndarray:
    """Times as float64, shape (n,).

    Raises:
        InputError: none, no numbers, or one outside 0 .. T - 1.
    """
    try:
        times = np.atleast_1d(np.asarray(times, dtype=np.float64))
    except (TypeError, ValueError):
        raise InputError("the times: expected numbers, counted in frames, got something else") from None
    if times.ndim != 1 or not len(times) or not ((times >= 0.0) & (times <= frame_count - 1)).all():
        got = f"{times.min():g} .. {times.max():g}" if times.ndim == 1 and len(times) else f"shape {times.shape}"
        raise InputError(f"the times: expected numbers from 0 to {frame_count - 1}, counted in frames, got {got}")
    return times


def _parts(times: Sequence[float] | np.ndarray) -> list[tuple[int, float]]:
    return [(int(time), float(time - int(time))) for time in times]


def _axis_angle(turns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit axes (N, 3) and angles (N,) from 0 to half a turn; the axis of none is 0."""
    turns = turns * np.where(turns[:, 3:] < 0.0, -1.0, 1.0)
    sine = np.linalg.norm(turns[:, :3], axis=1)
    axis = turns[:, :3] / np.where(sine > 0.0, sine, 1.0)[:, None]
    return axis, 2.0 * np.arctan2(sine, turns[:, 3])
