"""The objective and its gradient, hand-written from end to end (paper, sec. Optimization Objectives).

    L = mesh CD_R(X_k, P_k) + 1/S sum_s input CD_R(M(P_source), P_target)
      + 1/S sum_t transform w(t) CD_R(X_t, P_t) + isometry L_isometry

An evaluation is four phases, each of tasks that write apart from one another:

    move      a transition moves its cloud and compares it with the next; vertices run through all transitions
    compare   the terms on vertices: a frame with its cloud; edges with themselves a frame on
    trust     the confidence of every frame
    return    vertices run back, and leave a six-vector gradient a transition

The gradient of the nodes is then complete but for the vertices' scatter, which is the optimiser's first move.
"""

from __future__ import annotations

from functools import partial

import numpy as np
import warp as wp

from warpdef.fit.chain import Chain
from warpdef.fit.correspondences import cloud_grid
from warpdef.fit.problem import Problem
from warpdef.fit.terms import VERTEX_TERMS, InputTerm, Sums, TransformTerm, VertexTerm
from warpdef.fit.workers import Phase, Task
from warpdef.kernels.confidence import confidence
from warpdef.kernels.vectors import clear_vectors


class Objective:
    """The terms of one problem and the order in which they run. ``nodes`` and ``adj_nodes`` belong to the optimiser.

    chain: the vertices of all frames. terms: those on vertices; ``transform`` is one of them, ``input`` is not.
    confidence: weight of a frame, shape (T,) float32.
    """

    def __init__(self, problem: Problem, nodes: wp.array, adj_nodes: wp.array, schedule: wp.array) -> None:
        p = self.problem = problem
        self._schedule = schedule
        self.chain = Chain(p, nodes, adj_nodes)
        borrow, shape = p.pool.borrower(), (p.frame_count, p.vertex_count)
        self.sums = Sums(borrow(wp.vec3, shape), borrow(wp.vec3, shape))
        clouds = cloud_grid(p, p.clouds)
        sample = clouds if p.sample is p.clouds else cloud_grid(p, p.sample)
        self.input = InputTerm(p, sample, self.chain, adj_nodes)
        self.transform = TransformTerm(p, clouds, self.chain, self.sums.weighed)
        # Without the chain no vertex is moved by the descent: what others ask for alone stays.
        listed = VERTEX_TERMS if p.config.optimiser.chain else ()
        self.terms: list[VertexTerm] = [self.transform, *(term(p, self.chain, self.sums) for term in listed)]
        self.confidence = wp.full(p.frame_count, 1.0, dtype=wp.float32, device=p.device)

    @property
    def vertices(self) -> wp.array:
        """Of all frames, (T, V), cube units, Morton order."""
        return self.chain.vertices

    def placed_vertices(self) -> np.ndarray:
        """Vertices of all frames, (T, V, 3) float32, cube units, in the template's own order."""
        return self.vertices.numpy()[:, self.problem.place]

    def move_all(self) -> None:
        """All vertices of all frames for the nodes as they are."""
        self._move(0, self.problem.vertex_count)

    def forget(self) -> None:
        """Let every search begin anew, after positions that were no numbers."""
        for term in (self.input, self.transform):
            term.correspondences.forget()

    # Tasks. Each is called once to be recorded, or at every iteration on CUDA.

    def _move(self, first: int, last: int) -> None:
        self.sums.clear(first, last)
        self.chain.move(first, last - first)
        for term in self.terms:
            term.moved(first, last)

    def _mesh_term(self) -> None:
        """What of the transform term acts during warm-up."""
        key, count = self.problem.transitions.keyframe, self.problem.vertex_count
        clear_vectors(key * count, count, self.sums.weighed.flatten())
        self.transform.run(key, key + 1)

    def _trust(self) -> None:
        p, loss = self.problem, self.problem.config.loss
        mean = loss.confidence_bound == "mean"
        losses = (self.input.loss, self.transform.loss)
        confidence(loss.confidence, mean, p.transitions.keyframe, self._schedule, *losses, self.confidence)

    def _return(self, first: int, last: int) -> None:
        self.chain.adj_move(first, last - first, self.confidence, self.sums.weighed, self.sums.plain)

    # Phases.

    def phases(self, warmup: bool, guided: list[tuple[int, int]] | None = None) -> list[Phase]:
        """All phases of an evaluation; during warm-up only the input and mesh terms, without a chain the input term.

        ``guided``: spans of transitions that the input term is asked of, all if not given.
        """
        p = self.problem
        clouds = [partial(self.input.run, a, b) for a, b in (p.transition_spans() if guided is None else guided)]
        if not p.config.optimiser.chain:
            return [Phase("move", clouds)]
        if warmup:
            return [Phase("move", [*clouds, self._mesh_term])]
        runs = p.vertex_spans()
        return [
            Phase("move", [*(partial(self._move, a, b) for a, b in runs), *clouds]),
            *self._comparisons(),
            Phase("trust", [self._trust]),
            Phase("return", [partial(self._return, a, b) for a, b in runs]),
        ]

    def _comparisons(self) -> list[Phase]:
        """Terms on vertices. Those that add to one sum in spans of the same kind run in turn, others phase by phase."""
        phases: list[Phase] = []
        left = list(self.terms)
        while left:
            kinds: dict[bool, str] = {}
            for term in left:
                kinds.setdefault(term.weighed, term.spans)
            tasks: list[Task] = []
            for weighed, kind in kinds.items():
                together = [t for t in left if t.weighed == weighed and t.spans == kind]
                left = [t for t in left if t not in together]
                spans = self.problem.frame_spans() if kind == "frames" else self.problem.vertex_spans()
                tasks += [partial(_run_all, together, a, b) for a, b in spans]
            phases.append(Phase("compare", tasks))
        return phases

    def losses(self) -> dict[str, float]:
        """Weighted terms of the last evaluation, as they enter the objective, and their sum."""
        found, trust = self.input.losses(), self.confidence.numpy()
        for term in self.terms if self.problem.config.optimiser.chain else ():
            found |= term.losses(trust)
        return {**found, "total": sum(found.values())}


def _run_all(terms: list[VertexTerm], first: int, last: int) -> None:
    for term in terms:
        term.run(first, last)
