"""Meshes of the frames that have no points: filled in between their neighbours once the others are fitted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from warpdef.geometry.edges import edge_lengths
from warpdef.geometry.triangles import unique_edges

_LONGEST = 3  # missing frames over which speeds are believed: what they are off adds up
_STRAINED = 1.5  # times the change of edge lengths on even turns: limbs that are too fast for a cubic. Without noise,
# one frame of every three left out, mean error over the extent (even turns): crane 0.0005 (0.0019), walk 0.0001
# (0.0011), gallop 0.0071 (0.0089); three in a row: 0.0018 (0.0060), 0.0008 (0.0032), 0.0131 (0.0234).
_STRAIN_LEAST = 0.02  # of the edges' length: below it nothing looks strained
_NO_LENGTH = 1e-30  # of a sum of lengths


def fill_gaps(
    vertices: np.ndarray,
    numbers: Sequence[int],
    frame_count: int,
    faces: np.ndarray | None = None,
    times: Sequence[float] = (),
) -> np.ndarray:
    """The moving mesh with a mesh for every frame of the input.

    A gap between fitted frames is interpolated at the share of the time that has passed: with faces as in
    ``_mesh_between``, else on straight ways. Before the first and after the last fitted frame all is held.

    Args:
        vertices: of the fitted frames, shape (T, V, 3).
        numbers: their frame numbers, shape (T,), in any order.
        frame_count: frames of the input.
        faces: triangles, shape (F, 3); None: points that belong to no mesh.
        times: of all frames, ascending, (frame_count,); if empty, they are one apart.

    Returns:
        Shape (frame_count, V, 3); the fitted frames unchanged to the bit.
    """
    fitted = np.asarray(numbers)
    if (np.diff(fitted) < 0).any():
        order = np.argsort(fitted)
        vertices, fitted = vertices[order], fitted[order]
    if len(fitted) == frame_count:
        return vertices
    clock = np.asarray(times) if len(times) else np.arange(frame_count)
    filled = np.empty((frame_count, *vertices.shape[1:]), dtype=vertices.dtype)
    filled[fitted] = vertices
    filled[: fitted[0]], filled[fitted[-1] + 1 :] = vertices[0], vertices[-1]
    for t in np.flatnonzero(np.diff(fitted) > 1):
        missing = np.arange(int(fitted[t]) + 1, int(fitted[t + 1]))
        if faces is None:
            begin, end = clock[fitted[t]], clock[fitted[t + 1]]
            share = ((clock[missing] - begin) / (end - begin))[:, None, None]
            filled[missing] = (1.0 - share) * vertices[t] + share * vertices[t + 1]
        else:
            filled[missing] = _mesh_between(vertices, clock[fitted], int(t), clock[missing], faces)
    return filled


def _mesh_between(
    vertices: np.ndarray, times: np.ndarray, t: int, missing: np.ndarray, faces: np.ndarray
) -> np.ndarray:
    """Meshes between frames t and t + 1 of (T, V, 3), at the times ``missing`` (n,): (n, V, 3).

    Vertices leave and arrive at the speeds that the frames to either side tell. Where more than three frames are
    missing, or edges would change their lengths much more than by turning evenly (``motion.between``), they do that.
    """
    from warpdef.motion.between import mesh_between

    begin, end = times[t], times[t + 1]
    share = (missing - begin) / (end - begin)
    turning = mesh_between(vertices[t : t + 2], faces, share)
    if len(missing) > _LONGEST or len(times) < 3:
        return turning
    steady = _hermite(vertices, times, t, share)
    edges = unique_edges(faces)
    ends = [edge_lengths(v.astype(np.float64), edges) for v in vertices[t : t + 2]]

    def strain(meshes: np.ndarray) -> float:
        expected = ((1.0 - s) * ends[0] + s * ends[1] for s in share)
        pairs = zip(meshes, expected, strict=True)
        return float(np.mean([np.abs(edge_lengths(v, edges) - e).sum() / max(e.sum(), _NO_LENGTH) for v, e in pairs]))

    taken = steady if strain(steady) <= max(_STRAINED * strain(turning), _STRAIN_LEAST) else turning
    return taken.astype(vertices.dtype)


def _hermite(vertices: np.ndarray, times: np.ndarray, t: int, share: np.ndarray) -> np.ndarray:
    """Cubics from frame t to t + 1 with the slopes of the parabolas through three frames, (n, V, 3) float64."""
    outer = range(max(t - 1, 0), min(t + 3, len(times)))
    x = {k: vertices[k].astype(np.float64) for k in outer}
    gap = float(times[t + 1] - times[t])
    speed = (x[t + 1] - x[t]) / gap

    def slope(at: int, other: int) -> np.ndarray | None:
        """Of the parabola through t, t + 1 and a frame beyond ``at``, there."""
        if other not in x:
            return None
        step = abs(float(times[at] - times[other]))
        beyond = (x[at] - x[other]) / float(times[at] - times[other])
        return (gap * beyond + step * speed) / (gap + step)

    leave, arrive = slope(t, t - 1), slope(t + 1, t + 2)
    # At an end of the sequence one parabola has both slopes.
    leave = 2.0 * speed - arrive if leave is None else leave
    arrive = 2.0 * speed - leave if arrive is None else arrive
    s = share[:, None, None]
    straight = x[t] + s * (x[t + 1] - x[t])
    return straight + gap * s * (1.0 - s) * ((1.0 - s) * (leave - speed) - s * (arrive - speed))
