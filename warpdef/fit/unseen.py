"""Where vertices are expected that a frame does not show (``kernels.unseen``).

On the way between the frames around it, at its time, where these show all of the surface. Where one camera saw all
frames none does: then it stays where the bent template brought it (``bending``). So the far side of a closed mesh is
rigid and thick, and a sheet ends near the outline of each frame: the one shape of all frames is larger than what any of
them shows, and else the rest of it would stand beside that in full view.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from warpdef.device import frame_of
from warpdef.fit.pairing import Pairing
from warpdef.fit.problem import Problem
from warpdef.kernels.unseen import expected_places, hold_unseen, seen_weights
from warpdef.kernels.vectors import copy_vectors

_HOLD = 0.05  # weight of the place expected of an unseen vertex against one plane
_HOLD_SHEET = 0.005  # the same of a sheet, whose unseen vertices are near its outline: firmer, points lose them


class Unseen:
    """Incomplete frames beside one that shows all of the surface, and the places expected of their vertices.

    Args:
        vertices: of all frames, shape (T, V) vec3. rotation: theirs, from the rest shape, (T, V) mat33.

    frames: those held, ascending; none with fewer than three frames, all of what one camera saw.
    trust: how well a frame shows a vertex, shape (T, V) float32; None where some frame shows all of the surface.
    by_time: whether places are expected by the frames around; else they are those that ``stay`` was told.
    """

    def __init__(self, problem: Problem, vertices: wp.array, rotation: wp.array) -> None:
        p, self._vertices, self._rotation = problem, vertices, rotation
        # Of a sheet only where the template was bent onto its frames; else nothing has told where that brought it.
        bent = p.config.refine.follow > 0 and not p.config.optimiser.chain
        self.by_time = not p.seen or (p.border is not None and not bent)
        self._count = p.vertex_count
        near, far, share = _around(p.times)
        complete = p.measures.complete
        # A guess from guesses is none: one of the frames around must show all, at either end the nearer one.
        held = ~complete & (complete[near] | (complete[far] & (share > 0))) & (p.frame_count >= 3)
        if not self.by_time:
            held[:] = True
        self.frames = np.flatnonzero(held)
        self.trust = None if complete.any() else wp.zeros(vertices.shape, dtype=wp.float32, device=p.device)
        self._around = p.integers(near), p.integers(far), p.numbers(share)
        hold = _HOLD if self.by_time or p.border is None else _HOLD_SHEET
        self._hold = p.numbers(np.where(held, hold, 0.0))
        self._expected = wp.clone(vertices) if len(self.frames) else None

    def __bool__(self) -> bool:
        return len(self.frames) > 0

    # Tasks, only where frames are held.

    def stay(self, frame: int) -> None:
        """What is not seen of a frame is expected where it is."""
        copy_vectors(frame_of(self._vertices, frame), frame_of(self._places(), frame))

    def expect(self, first: int, last: int) -> None:
        """Where the vertices of frames ``first .. last`` are expected, by the frames around them as they are."""
        begin, count = first * self._count, (last - first) * self._count
        expected_places(begin, count, *self._around, self._vertices, self._rotation, self._places())

    def hold(self, first: int, last: int, pairing: Pairing, matrix_out: wp.array, rhs_out: wp.array) -> None:
        """Add what holds vertices that have no pairs to the normal equations; shapes (T V,)."""
        begin, count = first * self._count, (last - first) * self._count
        hold_unseen(begin, count, pairing.met, self._places().flatten(), self._hold, matrix_out, rhs_out)

    def look(self, first: int, last: int, pairing: Pairing) -> None:
        """How well frames ``first .. last`` show the vertices, by their pairs, in ``trust``."""
        assert self.trust is not None
        begin, count = first * self._count, (last - first) * self._count
        seen_weights(begin, count, pairing.met, self.trust.flatten())

    def state(self) -> dict[str, wp.array]:
        """What is expected and does not follow from the vertices, by name."""
        return {} if self.by_time else {"expected": self._places()}

    def _places(self) -> wp.array:
        assert self._expected is not None
        return self._expected


def _around(times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The nearer and the farther of the frames around each, and its share of the way from one to the other; (T,) each.

    The share is below 0 at the ends, which lie before or after both.
    """
    count = len(times)
    t = np.arange(count)
    if count < 3:
        return t, t, np.full(count, 0.5)
    near, far = t - 1, t + 1
    near[0], far[0], near[-1], far[-1] = 1, 2, t[-2], t[-3]
    return near, far, (times - times[near]) / (times[far] - times[near])
