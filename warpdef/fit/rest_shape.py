"""One rest shape for all frames: what one frame's points leave open, the points of all others fill in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import warp as wp

from warpdef.device import frame_of
from warpdef.fit.problem import Problem
from warpdef.fit.sobolev import SolveReport, note_solve
from warpdef.kernels.cg import ConjugateGradients
from warpdef.kernels.fairing import towards_mean
from warpdef.kernels.rigidity import rest_rhs, trusted_rest_rhs
from warpdef.kernels.vectors import add_scaled, blend, copy_vectors

_TOLERANCE = 1e-4
_ITERATIONS = 200
_STAYING = 0.05  # weight of the shape as it is against a frame, where parts are seen
_BORDER_FAIRINGS = 2  # of what one camera saw, a round: its border is where seeing ended, not a shape of its own
_FAIRINGS = 4  # double steps of fairing a round at noise 1: what is as fine as the edges is noise


class RestShape:
    """The shape y that the edges of all frames, turned back, fit best.

    Args:
        vertices: of all frames, shape (T, V) vec3. rotation: theirs, from the shape, (T, V) mat33.
        noise: see ``pairing.noise_of``.
        trust: how well a frame shows a vertex, shape (T, V) float32; None where complete frames are asked alone.

    places: y, shape (V,) vec3. start: of its next solve, the last solution.
    """

    def __init__(
        self, problem: Problem, vertices: wp.array, rotation: wp.array, noise: float, trust: wp.array | None = None
    ) -> None:
        p, self._config = problem, problem.config.refine
        self._vertices, self._rotation = vertices, rotation
        self._keyframe = frame_of(vertices, p.transitions.keyframe)
        self._edges = p.integers(p.mesh.row), p.integers(p.mesh.column)
        # Where an incomplete frame shows nothing, its mesh is a guess from the shape: asked only if no frame shows all.
        self._telling = p.integers(np.flatnonzero(p.measures.complete | ~p.measures.complete.any()))
        self.places = wp.clone(self._keyframe)
        self._rhs, self._right_side = (wp.zeros(p.vertex_count, dtype=wp.vec3, device=p.device) for _ in range(2))
        stiff = replace(p.mesh, weight=np.array([self._config.shape_smoothness], dtype=np.float32))
        self._solver = ConjugateGradients(stiff, wp.vec3, _TOLERANCE, _ITERATIONS, p.device)
        self.start = self._solver.start
        border = np.full((p.vertex_count, 1), -1) if p.border is None else p.border
        self._trust, self._border = trust, None
        if p.seen and p.border is not None:
            self._border = _along(p, border), p.integers(np.all(border < 0, axis=1))
        self._still, self._fairings = p.integers(np.any(border >= 0, axis=1)), round(_FAIRINGS * noise)

    def take(self) -> None:
        """The keyframe's vertices are the shape."""
        copy_vectors(self._keyframe, self.places)

    def note(self, solves: SolveReport) -> None:
        """Note the last solve. Waits for the device."""
        iterations = int(self._solver.iterations.numpy().max())
        note_solve(solves, iterations, self._solver.residual.numpy(), _TOLERANCE)

    # Tasks.

    def ask(self, first: int, last: int) -> None:
        """What the frames say of the edges of vertices ``first .. last``."""
        count, moved = last - first, (self._rotation, self._vertices, self._rhs)
        if self._trust is None:
            rest_rhs(first, count, self._telling, *self._edges, *moved)
        else:
            trusted_rest_rhs(first, count, _STAYING, *self._edges, self.places, self._trust, *moved)

    def solve(self) -> None:
        """(I + s L) y = y_old + s b: the optimum L y = b of the right-hand side b, at the cost of s^-1 of staying."""
        c, count = self._config, len(self.places)
        copy_vectors(self.places, self._right_side)
        add_scaled(0, count, c.shape_smoothness, self._rhs, self._right_side)
        self._solver.solve(self._right_side, self._rhs, 0, 1)
        blend(c.shape_step, self._rhs, self.places)
        self._fair(self._fairings, self._edges, self._still)
        if self._border is not None:
            self._fair(_BORDER_FAIRINGS, *self._border)

    def _fair(self, steps: int, edges: tuple[wp.array, wp.array], still: wp.array) -> None:
        count = len(self.places)
        for _ in range(steps):
            towards_mean(0, count, 0.5, *edges, still, self.places, self._rhs)
            towards_mean(0, count, -0.53, *edges, still, self._rhs, self.places)


def _along(problem: Problem, border: np.ndarray) -> tuple[wp.array, wp.array]:
    """Border vertices' neighbours on the border, from ``measures.border_of`` (V, 3): rows and columns as of a graph."""
    on = border[:, 0] >= 0
    return problem.integers(np.concatenate([[0], np.cumsum(2 * on)])), problem.integers(border[on, :2].ravel())
