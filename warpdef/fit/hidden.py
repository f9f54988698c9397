"""A limb that a frame hides, put as the frames around it show it.

Pieces that no point holds go back to how they are at rest: an arm behind the body to where the keyframe has it. So
every link between two pieces is asked in which frames it is shown; where it is not, it is bent as on the way between
the nearest two that show it, or as in the nearest one. How a link is bent is told in the frame of its first piece, so
a limb goes with the part of the body from which it hangs. What lies beside shown pieces went with them, for pieces are
rigid: other frames may ask it, too. Else the inside of an elbow would remember another time than its outside.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from warpdef.fit.embedded import DeformationGraph, Pose
from warpdef.fit.surfels import STAGES, SeenFrame, Surfels

RIGIDITIES, STEPS = (1.0, 0.1, 0.1), 5
"""Of the rounds, each on what the one before it shows, and Gauss-Newton steps of a round at most: stiff first, so that
whole limbs arrive."""
_LEAST = 1e-9  # length, cube units


def bent_as_shown(
    surfels: Surfels, frames: Mapping[int, SeenFrame], poses: Mapping[int, Pose], keyframe: int
) -> dict[int, Pose]:
    """The poses of all frames but the keyframe, with links that a frame does not show bent as others show them.

    Args:
        surfels: all of the surface that is known.
        frames, poses: by number, of the same frames.
        keyframe: one of them, whose pose stays.
    """
    numbers, graph, found = sorted(poses), surfels.graph, dict(poses)
    one, other = graph.link.T
    apart = surfels.points[graph.node[other]] - surfels.points[graph.node[one]]
    for rigidity in RIGIDITIES:
        held = [surfels.supported(frames[t], found[t]) for t in numbers]
        known = np.stack([h[one] & h[other] for h in (_with_beside(h, graph) for h in held)])
        bends = np.stack([graph.bend(surfels.points, found[t]) for t in numbers])
        expected = apart - as_others_show(apart - bends, known, np.array(numbers))
        for i, t in enumerate(numbers):
            if t != keyframe:
                hidden = ~(held[i][one] & held[i][other])
                bend = expected[i] * hidden[:, None]
                found[t] = surfels.settled(frames[t], found[t], (STAGES[-1][0], rigidity, STEPS), bend)
    return found


def as_others_show(vectors: np.ndarray, known: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Vectors (T, e, 3) as those known (T, e) bool at other times (T,) tell: on the straight way from the nearest
    before to the nearest after, with lengths between theirs; before the first and behind the last as these are. What
    no other time knows stays.
    """
    count, links = known.shape
    order, none = np.arange(count)[:, None], np.zeros((1, links), dtype=int)
    before = np.maximum.accumulate(np.where(known, order, -1), axis=0)
    before = np.concatenate([none - 1, before[:-1]])
    after = np.minimum.accumulate(np.where(known, order, count)[::-1], axis=0)[::-1]
    after = np.concatenate([after[1:], none + count])
    first, last = np.where(before < 0, after, before), np.where(after == count, before, after)
    never = (before < 0) & (after == count)
    first, last = np.where(never, order, first), np.where(never, order, last)
    share = (times[order] - times[first]) / np.maximum(times[last] - times[first], 1)
    begin, end = vectors[first, np.arange(links)], vectors[last, np.arange(links)]
    length = (1.0 - share) * np.linalg.norm(begin, axis=2) + share * np.linalg.norm(end, axis=2)
    mixed = (1.0 - share[..., None]) * begin + share[..., None] * end
    return mixed * (length / np.maximum(np.linalg.norm(mixed, axis=2), _LEAST))[..., None]


def _with_beside(held: np.ndarray, graph: DeformationGraph) -> np.ndarray:
    """Nodes held (n,), and those that a link joins to them."""
    one, other = graph.link.T
    more = held.copy()
    more[other[held[one]]] = True
    return more
