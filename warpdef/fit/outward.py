"""Long chains held together: where the mesh has left the points, frames are fitted one after the other, outwards.

A chain of grids adds up the errors of its steps. A hundred steps from the keyframe they may be larger than what a
nearest neighbour tells, and every frame behind is lost with the first. But each step's own grid is good: it takes cloud
to cloud without the mesh. So from the first frame on that is not covered, each frame starts from its inner neighbour,
already fitted, moved by the one step between them, and is fitted by a few rounds of the vertex stage before the next.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from warpdef.device import Way
from warpdef.fit.objective import Objective
from warpdef.fit.problem import Problem
from warpdef.fit.recover import Cloud, Matches, Surface, lost_above
from warpdef.fit.refine import Refinement
from warpdef.geometry.cloud_normals import turned_to
from warpdef.geometry.triangles import vertex_normals

ROUNDS = 6
"""Rounds of the vertex stage for a frame before the next starts from it."""


def follow_outwards(
    objective: Objective, refinement: Refinement, threads: int = 1, stopped: Callable[[], object] = bool
) -> list[int]:
    """Fit the frames from the first lost one on, on either side of the keyframe, in place; the others stay as they are.

    Args:
        objective: grids fitted; its ``vertices`` are the start and the result.
        refinement: the vertex stage of the same problem, not yet started.
        threads: with two or more both sides are followed at the same time on the CPU; the result is the same bits.
        stopped: asked before every frame; if true the frames left stay as they are.

    Returns:
        The frames fitted, ascending.
    """
    p, ends = objective.problem, objective.problem.transitions
    vertices = objective.vertices.numpy().astype(np.float64)
    given = p.normals.numpy().copy()
    points, normals = p.by_frame(p.cloud.numpy()), p.by_frame(given)
    surface = Surface.of(p.faces, p.edges.numpy())

    def uncovered(t: int) -> float:
        sided = bool(p.oriented[t])
        return Matches(Cloud(points[t], normals[t], sided, sided), surface).uncovered(vertices[t])

    bound = lost_above(uncovered(ends.keyframe))

    def follow(steps: range) -> list[int]:
        fitted: list[int] = []
        for s in steps:
            target = int(ends.target[s])
            # Of an incomplete frame what is seen need not hang together: it says nothing.
            if not fitted and not (p.measures.complete[target] and uncovered(target) > bound):
                continue
            if stopped():
                break
            objective.chain.move_one(s, 0, p.vertex_count)
            if not p.oriented[target]:
                _choose_sides(p, target, objective.vertices[target].numpy(), points[target], normals[target])
            refinement.settle(target, ROUNDS)
            fitted.append(target)
        return fitted

    refinement.take_shape()
    with ThreadPoolExecutor(2 if threads > 1 and p.way is Way.SPANS else 1) as pool:
        sides = list(pool.map(follow, (ends.forward, ends.backward)))
    p.normals.assign(given)
    return sorted(t for side in sides for t in side)


def _choose_sides(p: Problem, frame: int, vertices: np.ndarray, points: np.ndarray, normals: np.ndarray) -> None:
    """Normals of unknown side to that of the mesh nearest to them, on the device."""
    from scipy.spatial import cKDTree

    facing = vertex_normals(vertices.astype(np.float64), p.faces)[cKDTree(vertices).query(points)[1]]
    begin, end = (int(place) for place in p.cloud_offsets[frame : frame + 2])
    p.normals[begin:end].assign(turned_to(normals, facing).astype(np.float32))
