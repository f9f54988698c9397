"""The mesh follows the grids: frames are fitted one after the other, outwards from the keyframe.

A chain of grids adds up the errors of its transitions, and a descent through all of them folds what a frame does not
show. But each transition's own grid is good: it takes cloud to cloud without the mesh. So each frame starts from its
inner neighbour, already fitted, moved by the one transition between them, and is fitted by a few rounds of the vertex
stage before the next. Where that leaves points uncovered, the neighbour's mesh is bent by the matches of one connected
part (``recover``); where it still does, or the mesh is stretched to cover them, the template is bent from the
neighbour's pose, coarse to fine (``bending``). A mesh that hangs over the end of its cloud is slid back (``sliding``).
What fits better is kept; what stays lost is tried once more from the frame behind it.

What one camera saw is followed without the grids: the template itself is bent onto one frame after the other
(``bending``), each from the pose of its inner neighbour or from rest, before the vertex stage fits it. What has a fault
then is tried once more from the frame behind, and what still has with its limbs elsewhere (``limb_search``).
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property

import numpy as np

from warpdef.fit.bending import FAULTLESS, Bending, SeenCloud, worth
from warpdef.fit.embedded import Pose
from warpdef.fit.limb_search import LimbSearch
from warpdef.fit.measures import stretched_share
from warpdef.fit.objective import Objective
from warpdef.fit.problem import span
from warpdef.fit.recover import Cloud, ConnectedSurface, Search
from warpdef.fit.refine import Refinement
from warpdef.fit.sliding import END, GAIN, WORTH, Hanging, slide
from warpdef.geometry.cloud_planes import turned_to
from warpdef.geometry.edges import edge_lengths
from warpdef.geometry.nearby import Nearest
from warpdef.geometry.sampling import spread_evenly
from warpdef.geometry.triangles import vertex_normals
from warpdef.kernels.ways import Way

STRETCHED_MAX = 0.02
"""Share of such edges from which a frame went wrong, even if all points are covered."""
SOURCES, LIMB = 4, 0.1
"""Frames that are right from which one that is wrong is tried, at most; and uncovered share of its points up to which
it is: a leg has less; where more is lost, as of two bodies that hide each other, any mesh from afar covers it."""
_ASKED = 20_000  # points of a frame, evenly spread, that tell what is not covered: enough for any limb


def follow(
    objective: Objective,
    refinement: Refinement,
    threads: int = 1,
    stopped: Callable[[], object] = bool,
    starts: np.ndarray | None = None,
) -> tuple[list[int], list[int]]:
    """Fit all frames but the keyframe in place; after the paper's descent those from the first lost one on.

    Args:
        objective: grids fitted; its ``vertices`` are the start and the result.
        refinement: the vertex stage of the same problem, not yet started.
        threads: with two or more both sides are followed at the same time on the CPU; the result is the same bits.
        stopped: asked before every frame; if true the frames left stay as they are.
        starts: where frames of what one camera saw are fitted from, (T, V, 3) in the template's own order; None: there
            the template is bent onto them.

    Returns:
        The frames fitted, and those of them that took a way of their own (bent by matches); both ascending.
    """
    walk = _Walk(objective, refinement, stopped)
    if starts is not None:
        walk.starts = starts[:, np.argsort(objective.problem.place)]
    ends = objective.problem.transitions
    refinement.shape.take()
    with ThreadPoolExecutor(2 if threads > 1 and objective.problem.way is Way.SPANS else 1) as pool:
        seen = objective.problem.seen and not objective.problem.config.optimiser.chain
        way = walk.bent_outwards if seen else walk.outwards
        sides = list(pool.map(way, (ends.forward, ends.backward)))
    objective.problem.normals.assign(walk.given)
    return sorted(t for side in sides for t in side), sorted(walk.bent)


class _Walk:
    """Frames on the way outwards, and what is known of how well each is covered."""

    def __init__(self, objective: Objective, refinement: Refinement, stopped: Callable[[], object]) -> None:
        p = self.problem = objective.problem
        self.objective, self.refinement, self.stopped = objective, refinement, stopped
        self.given, self._places = p.normals.numpy().copy(), p.cloud.numpy()
        clouds = [self._spread_cloud(t) for t in range(p.frame_count)]
        surface = ConnectedSurface.of(p.faces, p.edges.numpy())
        start = objective.vertices.numpy().astype(np.float64)
        self.search = Search(start, clouds, surface, p.transitions.keyframe, p.device, p.scattered is not None)
        self.bent: set[int] = set()
        self.starts: np.ndarray | None = None
        self._clouds, self._edges = clouds, surface.edges
        self._lengths = edge_lengths(p.template, self._edges)

    def _points(self, frame: int) -> tuple[np.ndarray, np.ndarray]:
        """Points of a frame and their normals as given, (N_t, 3) float64 each."""
        begin, count = span(self.problem.cloud_offsets, frame, frame + 1)
        rows = slice(begin, begin + count)
        return self._places[rows].astype(np.float64), self.given[rows].astype(np.float64)

    def _spread_cloud(self, frame: int) -> Cloud:
        """Those of them, evenly spread, that limbs are looked for by."""
        points, normals = self._points(frame)
        chosen, sided = spread_evenly(points, _ASKED), bool(self.problem.oriented[frame])
        return Cloud(points[chosen], normals[chosen], sided, sided)

    @cached_property
    def bending(self) -> Bending:
        """The template and its graph."""
        return Bending(self.problem.template.astype(np.float64), self.problem.faces, self._edges)

    @cached_property
    def limb_search(self) -> LimbSearch:
        """Its limbs."""
        return LimbSearch(self.bending)

    def bent_outwards(self, transitions: range) -> list[int]:
        """Frames of one side, of what one camera saw, in order."""
        ends, fitted = self.problem.transitions, list[int]()
        bending = self.bending if self.starts is None else None
        still = None if bending is None else bending.still()
        poses, usual = {} if still is None else {ends.keyframe: still}, 0.0
        faults: dict[int, float] = {}
        for s in transitions:
            source, target = int(ends.source[s]), int(ends.target[s])
            if self.stopped():
                break
            if bending is not None:
                rest = None if source == ends.keyframe else still
                poses[target], usual = bending.best(self._seen_cloud(target), poses[source], usual, rest)
                faults[target] = usual
                self.objective.vertices[target].assign(bending.place(poses[target]).astype(np.float32))
            else:
                assert self.starts is not None
                self.objective.vertices[target].assign(self.starts[target].astype(np.float32))
            self._lead(target)
            self._settle(target, source)
            fitted.append(target)
        if bending is not None and self.problem.config.refine.recover:
            for inner, outer in _from_behind(fitted):
                if faults[inner] > FAULTLESS and not self.stopped():
                    self._bend_back(inner, outer, poses, faults)
            for frame, inner in zip(fitted, [ends.keyframe, *fitted], strict=False):
                if faults[frame] > FAULTLESS and not self.stopped():
                    self._bend_limbs(frame, inner, poses, faults)
        return fitted

    def _bend_back(self, inner: int, outer: int, poses: dict[int, Pose], faults: dict[int, float]) -> None:
        """A frame that one camera saw from the pose of the one behind it, if what that leaves is worth it."""
        cloud, enough = self._seen_cloud(inner), worth(faults[inner])
        pose, left = self.bending.best(cloud, poses[outer], enough)
        if left < enough:
            poses[inner], faults[inner] = pose, left
            self._bent_anew(inner, outer, pose)

    def _bend_limbs(self, frame: int, neighbour: int, poses: dict[int, Pose], faults: dict[int, float]) -> None:
        """A frame with its limbs looked for elsewhere, if what that leaves is worth it."""
        pose, left = self.limb_search.better(self._seen_cloud(frame), poses[frame], faults[frame])
        if left < worth(faults[frame]):
            poses[frame], faults[frame] = pose, left
            self._bent_anew(frame, neighbour, pose)

    def _bent_anew(self, frame: int, neighbour: int, pose: Pose) -> None:
        """A frame settled from another pose."""
        self.objective.vertices[frame].assign(self.bending.place(pose).astype(np.float32))
        self._settle(frame, neighbour)
        self.bent.add(frame)

    def _seen_cloud(self, frame: int) -> SeenCloud:
        return SeenCloud.of(*self._points(frame), self.problem.eye)

    def outwards(self, transitions: range) -> list[int]:
        """Frames of one side, in order."""
        p, config, ends = self.problem, self.problem.config.refine, self.problem.transitions
        fitted: list[int] = []
        for s in transitions:
            source, target = int(ends.source[s]), int(ends.target[s])
            # Of an incomplete frame what is seen need not hang together: it says nothing of what is lost.
            judged = bool(p.measures.complete[target])
            if p.config.optimiser.chain and not fitted and not (judged and self.search.lost(target)):
                continue
            if self.stopped():
                break
            self.objective.chain.move_one(s, 0, p.vertex_count)
            self._lead(target)
            self._settle(target, source)
            if config.recover and judged:
                self._try_again(target, source)
            fitted.append(target)
        if config.recover and not p.config.optimiser.chain:
            for inner, outer in _from_behind(fitted):
                if p.measures.complete[inner] and not self._wrong(outer):
                    self._try_again(inner, outer)
            self._try_from_afar([t for t in fitted if p.measures.complete[t]])
        return fitted

    def _try_from_afar(self, fitted: list[int]) -> None:
        """Frames of one side that are wrong still, from others than their neighbours, the nearest in time first.

        A limb that two frames show far from where it was may be found from a frame beyond them.
        """
        wrong = {t for t in fitted if self._wrong(t)}
        right = {self.problem.transitions.keyframe, *fitted} - wrong
        tried = {(t, source) for t in wrong for source in right if abs(t - source) == 1}
        limbs = (t for t in wrong if self.search.uncovered(t) < LIMB)
        for frame in sorted(limbs, key=lambda t: (min(abs(t - source) for source in right), t)):
            for source in sorted(right, key=lambda t: (abs(t - frame), t))[:SOURCES]:
                if (frame, source) not in tried and not self.stopped():
                    self._try_again(frame, source)
                    if not self._wrong(frame):
                        right.add(frame)
                        break

    def _lead(self, frame: int) -> None:
        """The start of a frame bent by its landmarks, where that leaves less."""
        if self.refinement.landmarks is not None:
            vertices = self.objective.vertices[frame]
            led = self.refinement.landmarks.led(frame, vertices.numpy().astype(np.float64), self._points(frame)[0])
            if led is not None:
                vertices.assign(led.astype(np.float32))

    def _wrong(self, frame: int) -> bool:
        """Whether points stay uncovered, or the mesh is stretched to cover them."""
        return self.search.lost(frame) or self._stretched(frame) > STRETCHED_MAX

    def _stretched(self, frame: int) -> float:
        """Share of edges that are half as long again as the template's, or shorter by as much."""
        return stretched_share(self.search.vertices[frame], self._edges, self._lengths)

    def _misfit(self, frame: int) -> float:
        """Share of points uncovered, and of edges stretched."""
        return self.search.uncovered(frame) + self._stretched(frame)

    def _try_again(self, frame: int, neighbour: int) -> None:
        """Other ways to a frame from its neighbour, where the one taken went wrong."""
        if self.search.lost(frame):
            self._bend(frame, neighbour)
        if self.problem.config.optimiser.chain:
            return
        if self._wrong(frame):
            self._turn(frame, neighbour)
        self._slide(frame, neighbour)

    def _turn(self, frame: int, neighbour: int) -> None:
        """The template bent onto a frame from its neighbour's pose, and settled; kept if it fits better."""
        cloud, near = self._clouds[frame], self.search.vertices[neighbour]
        if not cloud.oriented:
            cloud = cloud.turned_outwards(near, self.problem.faces)
        start = self.bending.pose_of(near)
        pose = self.bending.onto(SeenCloud.of(cloud.points, cloud.normals), start)
        self._attempt(frame, neighbour, self.bending.place(pose), self._misfit, self._misfit(frame))

    def _slide(self, frame: int, neighbour: int) -> None:
        """A frame whose mesh hangs over its cloud slid back, and settled; kept if it fits better."""
        cloud, vertices = self._clouds[frame], self.search.vertices[frame].copy()
        noise = self.problem.noise_of(frame)
        if self.search.far(frame, END, noise) < WORTH:
            return
        if not self._hanging.told(cloud.points, vertices, self.problem.faces):
            return

        def cost(frame: int) -> float:
            return self._misfit(frame) + self.search.far(frame, END, noise)

        pose = slide(self.bending, SeenCloud.of(cloud.points, cloud.normals), self.bending.pose_of(vertices))
        self._attempt(frame, neighbour, self.bending.place(pose), cost, cost(frame) - GAIN)

    @cached_property
    def _hanging(self) -> Hanging:
        p = self.problem
        keyframe = p.transitions.keyframe
        return Hanging(self._clouds[keyframe].points, p.template.astype(np.float64), p.faces)

    def _settle(self, frame: int, neighbour: int) -> None:
        """Fit a frame from where its vertices are, and measure it."""
        vertices = self.objective.vertices[frame]
        if not self.problem.oriented[frame]:
            self._choose_sides(frame, vertices.numpy())
        self.refinement.settle(frame, neighbour, self.problem.config.refine.follow)
        self.search.place(frame, vertices.numpy().astype(np.float64))

    def _bend(self, frame: int, neighbour: int) -> None:
        """The neighbour's mesh bent onto a frame by matches, and settled; kept if it leaves less uncovered."""
        left = self.search.uncovered(frame)
        if self.search.learn(frame, neighbour):
            self._attempt(frame, neighbour, self.search.vertices[frame], self.search.uncovered, left)

    def _attempt(
        self, frame: int, neighbour: int, start: np.ndarray, cost: Callable[[int], float], least: float
    ) -> None:
        """A frame settled from another start (V, 3); kept if that costs less, else it goes back to where it was."""
        vertices = self.objective.vertices[frame]
        before = vertices.numpy().copy()  # a view on the CPU
        vertices.assign(start.astype(np.float32))
        self._settle(frame, neighbour)
        if cost(frame) < least:
            self.bent.add(frame)
        else:
            vertices.assign(before)
            self.search.place(frame, before.astype(np.float64))

    def _choose_sides(self, frame: int, vertices: np.ndarray) -> None:
        """Normals of unknown side to that of the mesh nearest to them, on the device."""
        p, (points, normals) = self.problem, self._points(frame)
        facing = vertex_normals(vertices.astype(np.float64), p.faces)[Nearest(vertices, p.device).query(points)[1]]
        begin, end = (int(place) for place in p.cloud_offsets[frame : frame + 2])
        p.normals[begin:end].assign(turned_to(normals, facing).astype(np.float32))


def _from_behind(fitted: list[int]) -> list[tuple[int, int]]:
    """Frames of one side in the order of the way, each with the one behind it, the last first."""
    return list(zip(fitted[-2::-1], fitted[:0:-1], strict=True))
