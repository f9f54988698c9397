"""The template's vertices on their way from the keyframe to all frames, and their gradients on the way back."""

from __future__ import annotations

import numpy as np
import warp as wp

from warpdef.device import Way
from warpdef.fit.problem import Problem
from warpdef.kernels.chains import adj_move_chains, move_chains, routes_of
from warpdef.kernels.levels import node8
from warpdef.kernels.motion import adj_move_vertices, move_vertices, place_vertices, scatter_vertices


class Chain:
    """Vertices of all frames, shape (T, V), cube units, Morton order; moved by the transitions one after the other.

    Args:
        nodes, adj_nodes: shape (S, M) node8, the optimiser's: read, and added to.

    carry: shape (T + 1, V), the gradient that reaches a frame from those beyond it. Row T is the backward chain's at
    the keyframe, which two chains reach. Where no gradient is asked for (``optimiser.chain`` false) nothing is kept for
    one: ``carry`` and all that is of a transition have no rows.
    """

    def __init__(self, problem: Problem, nodes: wp.array, adj_nodes: wp.array) -> None:
        p = self._problem = problem
        self.nodes, self._adj_nodes = nodes, adj_nodes
        self.levels = p.levels.to_device(p.device)
        self._differentiable = p.config.optimiser.chain
        frames, count = p.frame_count, p.vertex_count
        transitions, carried = (len(p.transitions), frames + 1) if self._differentiable else (0, 0)
        self.vertices, self.carry, self.rotation = p.pool.own(
            "chain", wp.vec3, (frames, count), (carried, count), (transitions, count)
        )
        (self.jacobian,) = p.pool.own("chain", wp.mat33, (transitions, count))
        (self.adj_motion,) = p.pool.own("chain", node8, (transitions, count))
        ends = p.transitions
        self._routes = routes_of(ends.forward, ends.backward, ends.source, ends.target, p.device)
        self.vertices.assign(np.tile(p.template.astype(np.float32), (frames, 1, 1)))

    def move(self, begin: int, count: int) -> None:
        """Vertices ``begin .. begin + count`` from the keyframe to both ends."""
        ends = self._problem.transitions
        if self._problem.way is Way.WHOLE and self._differentiable:
            places = (self.vertices, self.rotation, self.jacobian)
            move_chains(self._routes, self.nodes, self.levels, *places)
            return
        for s in (*ends.forward, *ends.backward):
            self.move_one(s, begin, count)

    def move_one(self, transition: int, begin: int, count: int) -> None:
        """The same vertices over one transition, from its source to its target."""
        ends = self._problem.transitions
        source, target = int(ends.source[transition]), int(ends.target[transition])
        if not self._differentiable:
            place_vertices(begin, count, transition, source, target, self.nodes, self.levels, self.vertices)
            return
        places = (self.vertices, self.rotation, self.jacobian)
        move_vertices(begin, count, transition, source, target, self.nodes, self.levels, *places)

    def adj_move(self, begin: int, count: int, confidence: wp.array, weighed: wp.array, plain: wp.array) -> None:
        """Adjoint of ``move`` from the sums of the terms' gradients: six numbers a vertex and transition, and carry."""
        if self._problem.way is Way.WHOLE:
            forces = (confidence, weighed, plain, self.carry, self.adj_motion)
            adj_move_chains(self._routes, self.vertices, self.rotation, self.jacobian, *forces)
            return
        ends, spare = self._problem.transitions, self._problem.frame_count
        for transitions in (ends.forward, ends.backward):
            for s in reversed(transitions):
                source, target = int(ends.source[s]), int(ends.target[s])
                to = spare if source == ends.keyframe and transitions is ends.backward else source
                adj_move_vertices(
                    begin, count, s, source, target, target, to, self.vertices, self.rotation, self.jacobian,
                    confidence, weighed, plain, self.carry, self.adj_motion,
                )  # fmt: skip

    def scatter(self, first: int, last: int) -> None:
        """Add what ``adj_move`` left to the nodes of transitions ``first .. last``."""
        count = self._problem.vertex_count
        arrays = (self._routes.source, self.vertices, self.adj_motion, self._adj_nodes)
        scatter_vertices(first * count, (last - first) * count, self.levels, *arrays)
