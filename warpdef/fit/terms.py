"""The terms of the objective: a class each, with its buffers, its tasks, its loss and the gradient of it.

A term on the template's vertices adds the gradient of its weighted loss to one of two sums over all such terms, each of
shape (T, V): ``weighed``, which the confidence of a frame weighs, or ``plain``. Its tasks are spans of frames or spans
of vertices over all frames. A new one is a kernel, a class here that ``VERTEX_TERMS`` names, and its weight in
``config.LossConfig``. The input term moves points of its own, and adds to the nodes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
import warp as wp

from warpdef.device import Way
from warpdef.fit.chain import Chain
from warpdef.fit.correspondences import Correspondences
from warpdef.fit.pool import VECTOR
from warpdef.fit.problem import Problem
from warpdef.kernels.cells import PointGrid
from warpdef.kernels.chamfer import BOTH_SIDES, fixed_to_moving, moving_to_fixed
from warpdef.kernels.isometry import isometry, isometry_of_vertices, lay_paths, path_width
from warpdef.kernels.motion import adj_move_points, move_points
from warpdef.kernels.vectors import clear_columns, clear_losses, clear_vectors
from warpdef.kernels.ways import VERTICES_PER_TASK

# How far apart a point and its partner's partner may be where a cloud shows part of the surface (``chamfer``): about as
# far as on a surface that both sets cover. Twice that, and the rim of what is seen draws the unseen over, bit by bit.
_REACH_SPACINGS = 1.0
_REACH_EDGES = 0.25
_REACH_CLOUDS = 0.75
_WHOLE = 2.0  # the same in multiples of that, where a cloud seems to show all of the surface


Spans = Literal["frames", "vertices"]


@dataclass(frozen=True)
class Sums:
    """Gradients of all terms on vertices, added up, each shape (T, V) vec3: weighed by the confidence, and as it is."""

    weighed: wp.array
    plain: wp.array

    def clear(self, first: int, last: int) -> None:
        """Those of vertices ``first .. last``, in all frames."""
        for array in (self.weighed, self.plain):
            clear_columns(first, last - first, array)


class VertexTerm(Protocol):
    """A loss on the vertices of all frames.

    owner: under which the pool counts its buffers.
    spans: what a task of it covers: ``frames`` (first, last), or ``vertices`` (first, last) in all frames.
    weighed: whether the confidence weighs it; says which of the sums ``run`` adds to.
    """

    owner: str
    spans: Spans
    weighed: bool

    def moved(self, first: int, last: int) -> None:
        """Vertices ``first .. last`` have been moved, in all frames, by this task: what else there is to lay out."""

    def run(self, first: int, last: int) -> None:
        """Loss of a span, anew, and its gradient, added."""

    def losses(self, confidence: np.ndarray) -> dict[str, float]:
        """Weighted, as it enters the objective, by the names under which it is told."""
        ...


class InputTerm:
    """Robust Chamfer distance between a moved cloud and the next one, a loss a transition.

    loss: unweighted, shape (S,) float64. rotation, points: of the moved clouds, (N,) vec3. adj_points: their gradient.
    """

    def __init__(self, problem: Problem, grid: PointGrid, chain: Chain, adj_nodes: wp.array) -> None:
        p, config, sample = problem, problem.config.loss, problem.sample
        self._problem, self._chain, self._adj_nodes = p, chain, adj_nodes
        transitions, ends = len(p.transitions), p.transitions
        self.rotation, self.points, self.adj_points = p.pool.own("input term", wp.vec3, *[len(p.origin)] * 3)
        (self.loss,) = p.pool.own("input term", wp.float64, transitions)
        self.correspondences = Correspondences(
            p, sample, grid, self.points, p.moved_sizes, p.moved_target, p.sample_transition
        )
        self._factor = config.input_weight / transitions
        self._weight = p.numbers(np.full(transitions, self._factor))
        self._robust = (config.robust_alpha, config.robust_power, config.tangential)
        self._shares = _shares(p, p.moved_sizes), _shares(p, sample.sizes[ends.target])
        # Fewer points on the same surface stand farther apart.
        spacing = p.measures.spacing * np.sqrt(p.cloud_sizes / sample.sizes)
        self._floor = self._floors(spacing)
        searches, self._sides = self.correspondences, (BOTH_SIDES, BOTH_SIDES)
        if not p.measures.complete.all():
            reach = _REACH_CLOUDS * (spacing[ends.source] + spacing[ends.target])
            self._sides = (
                (searches.back.index, _one_sided(p, reach, ends.target, np.inf)),
                (searches.forth.index, _one_sided(p, reach, ends.source, np.inf)),
            )

    def run(self, first: int, last: int) -> None:
        """Move the clouds of transitions ``first .. last``, compare, and leave the gradient in their nodes."""
        p, c, sample = self._problem, self.correspondences, self._problem.sample
        groups, frames = (first, last), p.transitions.targets(first, last)
        (begin, count), (met_begin, met_count) = c.spans(groups, frames)
        chain = self._chain
        clear_losses(first, last - first, self.loss)
        clear_vectors(begin, count, self.adj_points)
        move_points(begin, count, chain.nodes, chain.levels, p.origin, p.moved_transition, self.rotation, self.points)
        c.find(groups, frames)
        results = (self._weight, self._robust, self.loss, self.adj_points)
        moving_to_fixed(
            begin, count, self.points, p.moved_transition, c.forth.index, sample.points, sample.normals,
            self._shares[0], *results, self._sides[0],
        )  # fmt: skip
        fixed_to_moving(
            met_begin, met_count, sample.points, sample.normals, p.sample_transition, c.back.index, self.points,
            self._shares[1], *results, self._sides[1],
        )  # fmt: skip
        adj_move_points(
            begin, count, chain.levels, p.origin, p.moved_transition, self.rotation, self.adj_points, self._adj_nodes
        )

    def _floors(self, spacing: np.ndarray) -> np.ndarray:
        """The loss of a transition between two samplings of one plane, shape (S,); 0 where a frame shows less than all.

        Of points thrown at random, the nearest of another throw lies at a mean square of 4 / pi times the square of
        the spacing (the mean distance to the nearest fellow), all of it along the surface.
        """
        p, ends = self._problem, self._problem.transitions
        forth, back = (share.numpy().astype(float) for share in self._shares)
        forth *= p.moved_sizes * spacing[ends.target] ** 2
        back *= p.sample.sizes[ends.target] * spacing[ends.source] ** 2
        whole = p.measures.complete[ends.source] & p.measures.complete[ends.target]
        return np.where(whole, 4.0 / np.pi * p.config.loss.tangential * (forth + back), 0.0)

    def arrived(self, bound: float) -> np.ndarray:
        """Which transitions leave no more than ``bound`` times what two samplings of one surface do, shape (S,)."""
        return self.loss.numpy() <= bound * self._floor

    def losses(self) -> dict[str, float]:
        """As it enters the objective."""
        return {"input": self._problem.config.loss.input_weight * float(self.loss.numpy().sum()) / len(self.loss)}


class TransformTerm:
    """Robust Chamfer distance between the vertices of a frame and its cloud; at the keyframe it is the mesh term.

    loss: unweighted, shape (T,) float64. correspondences: vertices and clouds, a group a frame.
    sides: which pairs of a vertex with its nearest point count (``chamfer``).
    """

    owner = "transform term"
    spans: Spans = "frames"
    weighed = True

    def __init__(self, problem: Problem, grid: PointGrid, chain: Chain, adjoint: wp.array) -> None:
        p, config = problem, problem.config.loss
        self._problem, self._vertices, self._adjoint = p, chain.vertices.flatten(), adjoint.flatten()
        frames = p.frame_count
        sizes = np.full(frames, p.vertex_count)
        self.correspondences = Correspondences(p, p.clouds, grid, self._vertices, sizes, p.vertex_frame, p.cloud_frame)
        (self.loss,) = p.pool.own(self.owner, wp.float64, frames)
        self._factors = np.full(frames, config.transform_weight / len(p.transitions))
        self._factors[p.transitions.keyframe] = config.mesh_weight
        self._weight = p.numbers(self._factors)
        self._robust = (config.robust_alpha, config.robust_power, config.tangential)
        self._shares = _shares(p, sizes), _shares(p, p.cloud_sizes)
        measures = p.measures
        self.sides = BOTH_SIDES
        if not measures.complete.all() or np.isfinite(_whole(p)):
            reach = _REACH_SPACINGS * measures.spacing + _REACH_EDGES * p.edge_length
            self.sides = self.correspondences.back.index, _one_sided(p, reach, np.arange(frames), _whole(p))

    def moved(self, first: int, last: int) -> None:
        """Nothing."""

    def run(self, first: int, last: int) -> None:
        """Compare the vertices of frames ``first .. last`` with their clouds."""
        p, c = self._problem, self.correspondences
        (begin, count), (met_begin, met_count) = c.spans((first, last), (first, last))
        clear_losses(first, last - first, self.loss)
        c.find((first, last), (first, last))
        results = (self._weight, self._robust, self.loss, self._adjoint)
        moving_to_fixed(
            begin, count, self._vertices, p.vertex_frame, c.forth.index, p.cloud, p.normals,
            self._shares[0], *results, self.sides,
        )  # fmt: skip
        fixed_to_moving(
            met_begin, met_count, p.cloud, p.normals, p.cloud_frame, c.back.index, self._vertices,
            self._shares[1], *results,
        )  # fmt: skip

    def losses(self, confidence: np.ndarray) -> dict[str, float]:
        """The keyframe's, and those of all other frames."""
        p, config = self._problem, self._problem.config.loss
        key, loss = p.transitions.keyframe, self.loss.numpy() * confidence
        others = float(np.delete(loss, key).sum()) / len(p.transitions)
        return {"mesh": config.mesh_weight * float(loss[key]), "transform": config.transform_weight * others}


class IsometryTerm:
    """Change of edge lengths from frame to frame, mean over edges and transitions.

    loss: unweighted, shape (parts, T) float64, a part a task, to be summed over parts.
    """

    owner = "isometry term"
    spans: Spans = "vertices"
    weighed = False

    def __init__(self, problem: Problem, chain: Chain, sums: Sums) -> None:
        p = self._problem = problem
        self._vertices, self._adjoint = chain.vertices, sums.plain
        self._factor, self._share = p.config.loss.isometry_weight, 1.0 / (len(p.transitions) * len(p.edges))
        parts = p.vertex_spans()
        self._part = {first: part for part, (first, _) in enumerate(parts)}
        (self.loss,) = p.pool.own(self.owner, wp.float64, (len(parts), p.frame_count))
        self._by_vertex = p.way is Way.SPANS
        if self._by_vertex:
            shape = (p.vertex_count, 3, path_width(p.frame_count))
            (self._paths,) = p.pool.own(self.owner, wp.float32, shape)
            self._mesh = p.integers(p.mesh.row), p.integers(p.mesh.column)

    @staticmethod
    def bytes_of(frames: int, vertices: int) -> int:
        """Paths, and a loss a task."""
        return VECTOR * vertices * path_width(frames) + 8 * frames * -(-vertices // VERTICES_PER_TASK)

    def moved(self, first: int, last: int) -> None:
        """Lay the paths of these vertices, which a register reads sixteen frames at a time."""
        if self._by_vertex and self._factor:
            lay_paths(first, last - first, self._vertices, self._paths)

    def run(self, first: int, last: int) -> None:
        """Compare the edges around vertices ``first .. last``, or all edges, in all frames."""
        if not self._factor:
            return
        p, part, flat = self._problem, self._part[first], self.loss.flatten()
        clear_losses(part * p.frame_count, p.frame_count, flat)
        factors = (self._share, self._factor)
        if self._by_vertex:
            results = (part, self.loss, self._adjoint)
            isometry_of_vertices(first, last - first, self._paths, *self._mesh, *factors, *results)
            return
        isometry(0, p.frame_count * len(p.edges), self._vertices, p.edges, *factors, flat, self._adjoint)

    def losses(self, confidence: np.ndarray) -> dict[str, float]:
        """As it enters the objective."""
        return {"isometry": self._factor * float(self.loss.numpy().sum())}


class ListedTerm(VertexTerm, Protocol):
    """A term that asks for nothing but the vertices, and says beforehand what its buffers take."""

    def __init__(self, problem: Problem, chain: Chain, sums: Sums) -> None: ...

    @staticmethod
    def bytes_of(frames: int, vertices: int) -> int:
        """Of what it owns in the pool, at most."""
        ...


VERTEX_TERMS: tuple[type[ListedTerm], ...] = (IsometryTerm,)
"""All terms on vertices but the transform term, which others ask for by name."""


def _shares(p: Problem, sizes: np.ndarray) -> wp.array:
    """Factor of a point's residual by slot, for a mean over points or a sum."""
    return p.numbers(1.0 / sizes if p.config.loss.reduction == "mean" else np.ones(len(sizes)))


def _whole(p: Problem) -> float:
    """How much farther vertices reach in frames that seem to show all; without end in the paper's descent.

    What a frame shows is known vertex by vertex, not frame by frame: even whole bodies hide their folds. Clouds that
    meet clouds have no such bound: a fast step would be out of reach.
    """
    return np.inf if p.config.optimiser.chain else _WHOLE


def _one_sided(p: Problem, reach: np.ndarray, answered_by: np.ndarray, whole: float) -> wp.array:
    """Reach by slot, ``whole`` times as far where the answering frame seems to show all of the surface; infinite where
    every pair counts."""
    return p.numbers(np.where(p.measures.complete[answered_by], whole, 1.0) * reach)
