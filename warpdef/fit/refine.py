"""The vertex stage: what the grids cannot express, fitted on the mesh itself (beyond the paper).

The finest grid has a node every tenth of the cube; wrinkles are smaller. After the grids every vertex of every frame
moves on its own, by Gauss-Newton on

    E = sum_t sum_pairs w r^2 + rigidity sum_t sum_(i,j) | (x_i - x_j) - (R_i + R_j)/2 (y_i - y_j) |^2

with symmetric point-to-plane residuals r both ways, a rotation R a vertex and frame, and one rest shape y for all
frames. y is an unknown like the others: what one frame's points leave open, the points of all others fill in. The
noisier the clouds (measured by how thick they are locally), the stiffer, and the less their own normals count. The
border of an open mesh reaches for where the points end (``kernels.borders``); what a frame does not show is held by the
frames around it (``kernels.unseen``).

A round is three phases: every frame pairs, solves for its moves and fits its rotations; every vertex asks the frames
that show all of the surface for its edges, or all frames if none does; the shape is solved for. Where an incomplete
frame is held, a phase before them says where its vertices are expected. Part of the way through, frames that lost a
limb are fitted again (``recover``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
import warp as wp

from warpdef.config import RefineConfig
from warpdef.device import Way, frame_of, on_host
from warpdef.fit.objective import Objective
from warpdef.fit.problem import span
from warpdef.fit.recover import Cloud, recover
from warpdef.fit.sobolev import SolveReport, note_solve
from warpdef.fit.workers import Iteration, Phase, Team
from warpdef.kernels.block_cg import BlockSolver
from warpdef.kernels.borders import cloud_borders, vertex_borders
from warpdef.kernels.cg import ConjugateGradients
from warpdef.kernels.pairs import pairs_of
from warpdef.kernels.planes import cloud_planes, vertex_normals, vertex_planes
from warpdef.kernels.rigidity import fit_rotations, rest_pull, rigid_pull
from warpdef.kernels.unseen import expected_places, hold_unseen
from warpdef.kernels.vectors import add_scaled, blend, copy_vectors

_SHAPE_TOLERANCE = 1e-4
_SHAPE_ITERATIONS = 200
_OPPOSED_MAX = 0.01  # share of given normals against the mesh that is taken for contact, not for flips
_NOISE_MAX = 1.25  # rigidity grows no further
_BORDER = 0.1  # weight of a residual across the border against one plane: a border is sampled sparsely, hence noisy
_BORDER_GAP = 0.9  # from the border to the nearest point, in mean point spacings
_HOLD = 0.05  # weight of the place expected of an unseen vertex against one plane
_SETTLED = 8  # rounds after which a frame shows whether it lost a limb


def _noise(thickness: float, config: RefineConfig) -> float:
    """0 for clean clouds, 1 at ``noisy_thickness``, at most 1.25."""
    above = (thickness - config.clean_thickness) / (config.noisy_thickness - config.clean_thickness)
    return float(np.clip(above, 0.0, _NOISE_MAX))


class Refinement:
    """Vertices of all frames, refined in place.

    Args:
        objective: grids fitted; its ``vertices``, shape (T, V), are the start and the result.
        team: CPU threads. capture: on CUDA, run a round as one graph.
    """

    def __init__(self, objective: Objective, team: Team, capture: bool = True) -> None:
        p = self.problem = objective.problem
        self.objective, self.config = objective, p.config.refine
        self.done = 0
        device, frames, count = p.device, p.frame_count, p.vertex_count
        self._row, self._column = p.integers(p.mesh.row), p.integers(p.mesh.column)
        self._lay_faces()
        self._normals = wp.zeros((frames, count), dtype=wp.vec3, device=device)
        self._rotation = wp.zeros((frames, count), dtype=wp.mat33, device=device)
        self._matrix = wp.zeros((frames, count), dtype=wp.mat33, device=device)
        borrow = p.pool.borrower()
        self._pull, self._move = (borrow(wp.vec3, (frames, count)) for _ in range(2))
        self._rest = wp.clone(frame_of(objective.vertices, p.transitions.keyframe))
        self._shape_pull, self._shape = (wp.zeros(count, dtype=wp.vec3, device=device) for _ in range(2))
        c = self.config
        self._solver = BlockSolver(p.mesh, frames, c.tolerance, c.iterations_max, device)
        stiff = replace(p.mesh, weight=np.array([c.shape_smoothness], dtype=np.float32))
        self._shape_solver = ConjugateGradients(stiff, wp.vec3, _SHAPE_TOLERANCE, _SHAPE_ITERATIONS, device)
        self.noise = _noise(p.measures.thickness, c)
        self.rigidity = c.rigidity * (c.rigidity_noisy / c.rigidity) ** self.noise
        self._lay_pairs()
        self._lay_borders()
        self._lay_times()
        # Where an incomplete frame shows nothing, its mesh is a guess from the shape: asked only if no frame shows all.
        self._telling = p.integers(np.flatnonzero(p.measures.complete | ~p.measures.complete.any()))
        self.solves = SolveReport("block cg")
        # Whether a frame's normals were given sides by the mesh; this and the next belong to the state: on the device.
        self._doubtful = p.integers(~p.oriented)
        self._given_normals = p.normals.numpy().copy()
        # By frame: 1 fitted again, 2 lost all the same.
        self._fate = p.integers(np.zeros(frames))
        self._round = Iteration(self._phases(), device, team, capture)

    def _lay_faces(self) -> None:
        p = self.problem
        corner = np.argsort(p.faces.ravel(), kind="stable")
        counts = np.bincount(p.faces.ravel(), minlength=p.vertex_count)
        self._faces = wp.array(p.faces, dtype=wp.int32, ndim=2, device=p.device)
        self._face_row = p.integers(np.concatenate([[0], np.cumsum(counts)]))
        self._face_of = p.integers(corner // 3)

    def _lay_pairs(self) -> None:
        """Pairs met by vertices, and those asked for by cloud points."""
        p, o, c = self.problem, self.objective, self.config
        share = max(1.0 - self.noise, 0.0)
        pairing = (c.agreement * share, share, p.numbers(c.reach * p.measures.spacing))
        mesh, cloud = (o.vertices.flatten(), self._normals.flatten()), (p.cloud, p.normals)
        self._met = pairs_of(
            pairing, *mesh, p.vertex_frame, o.transform.correspondences.forth.index, *cloud, o.transform.sides
        )
        self._asked = pairs_of(pairing, *mesh, p.cloud_frame, o.transform.correspondences.back.index, *cloud)

    def _lay_borders(self) -> None:
        p, self._border = self.problem, None
        if p.border is not None:
            border = wp.array(p.border.astype(np.int32), dtype=wp.int32, ndim=2, device=p.device)
            self._border, self._border_gap = border, p.numbers(_BORDER_GAP * p.measures.spacing)

    def _lay_times(self) -> None:
        """From which frames the unseen part of an incomplete one is expected: those around it, if there are two."""
        p, self._expected = self.problem, None
        if p.measures.complete.all() or p.frame_count < 3:
            return
        t = np.arange(p.frame_count)
        near, far = t - 1, t + 1
        near[0], far[0], near[-1], far[-1] = 1, 2, t[-2], t[-3]
        between = np.ones(p.frame_count)
        between[[0, -1]] = 0
        # A guess from guesses is none: one of the frames around must show all, at either end the nearer one.
        held = ~p.measures.complete & (p.measures.complete[near] | (p.measures.complete[far] & (between == 1)))
        self._times = p.integers(near), p.integers(far), p.integers(between)
        self._hold = p.numbers(np.where(held, _HOLD, 0.0))
        if held.any():
            self._expected = wp.zeros_like(self.objective.vertices)

    def prepare(self) -> None:
        """CPU: record all commands, which compiles what they need."""
        if self.problem.way is Way.SPANS:
            self._round.prepare()

    def start(self) -> None:
        """Take the vertices as they are: the shape is the keyframe's, normals of doubtful side get the mesh's side."""
        p, o = self.problem, self.objective
        self.take_shape()
        everything = p.frame_count * p.vertex_count
        fit_rotations(0, everything, self._row, self._column, self._rest, o.vertices, self._rotation)
        vertex_normals(0, everything, self._faces, self._face_row, self._face_of, o.vertices, self._normals)
        o.transform.correspondences.grid.build()
        o.transform.correspondences.back.run()
        self._choose_sides()

    def _choose_sides(self) -> None:
        """Turn normals over to the mesh's side, in frames of unknown side and where too many given ones oppose it."""
        p = self.problem
        normals, nearest = p.normals.numpy(), on_host(self.objective.transform.correspondences.back.index)
        facing = on_host(self._normals).reshape(-1, 3)[nearest]
        opposed = (normals * facing).sum(axis=1) < 0
        share = np.add.reduceat(opposed, p.cloud_offsets[:-1]) / p.cloud_sizes
        # A few always do: between two surfaces that touch, the nearest vertex may belong to the other one.
        doubtful = ~p.oriented | (share > _OPPOSED_MAX)
        self._doubtful.assign(doubtful.astype(np.int32))
        turned = opposed & np.repeat(doubtful, p.cloud_sizes)
        normals[turned] *= -1.0
        p.normals.assign(normals)

    def step(self) -> None:
        """One round; before one of them, frames that lost a limb are fitted again."""
        chain, settled = self.problem.config.optimiser.chain, min(_SETTLED, self.config.iterations // 2)
        if self.config.recover and chain and self.done == settled:
            self._recover()
        self._round.run()
        self.done += 1

    def _recover(self) -> None:
        p, o = self.problem, self.objective
        vertices = o.vertices.numpy().astype(np.float64)
        points, normals = p.by_frame(p.cloud.numpy()), p.by_frame(self._given_normals)
        clouds = [Cloud(*frame) for frame in zip(points, normals, p.oriented, self._doubtful.numpy() == 0, strict=True)]
        # Of an incomplete frame what is seen need not hang together: it says nothing of limbs lost.
        judged = np.flatnonzero(p.measures.complete | (np.arange(p.frame_count) == p.transitions.keyframe))
        chosen, keyframe = vertices[judged], int(np.searchsorted(judged, p.transitions.keyframe))
        recovered, lost = recover(chosen, [clouds[t] for t in judged], p.faces, p.edges.numpy(), keyframe)
        vertices[judged] = chosen
        fate = np.zeros(p.frame_count, dtype=np.int32)
        fate[judged[recovered]], fate[judged[lost]] = 1, 2
        self._fate.assign(fate)
        if recovered:
            o.vertices.assign(vertices.astype(np.float32))
            p.normals.assign(self._given_normals)
            self.start()

    @property
    def frames_recovered(self) -> list[int]:
        """Frames that lost a limb and were fitted again."""
        return np.flatnonzero(self._fate.numpy() == 1).tolist()

    @property
    def frames_lost(self) -> list[int]:
        """Frames a part of whose points the mesh does not cover."""
        return np.flatnonzero(self._fate.numpy() == 2).tolist()

    def take_shape(self) -> None:
        """The keyframe's vertices are the shape."""
        copy_vectors(frame_of(self.objective.vertices, self.problem.transitions.keyframe), self._rest)

    def settle(self, frame: int, neighbour: int, rounds: int) -> None:
        """Fit one frame alone to its cloud and the shape as they are; frames may be settled at the same time.

        Rotations are looked for from those of a neighbour, already settled.
        """
        o, count = self.objective, self.problem.vertex_count
        wp.copy(frame_of(self._rotation, frame), frame_of(self._rotation, neighbour))
        if self._expected is not None:
            # What is not seen goes with its neighbour's step.
            copy_vectors(frame_of(o.vertices, frame), frame_of(self._expected, frame))
        fit_rotations(frame * count, count, self._row, self._column, self._rest, o.vertices, self._rotation)
        for _ in range(rounds):
            self._fit_frames(frame, frame + 1)

    def look(self) -> None:
        """Note what the linear solves of the last round did, in ``solves``. Waits for the device."""
        for solver, tolerance in ((self._solver, self.config.tolerance), (self._shape_solver, _SHAPE_TOLERANCE)):
            note_solve(self.solves, int(solver.iterations.numpy().max()), solver.residual.numpy(), tolerance)

    def state(self) -> dict[str, wp.array]:
        """What a round leaves for the next, by name: the arrays themselves. Searches remember more, but are exact."""
        arrays = {"vertices": self.objective.vertices, "rest": self._rest, "rotation": self._rotation}
        arrays |= {"doubtful": self._doubtful, "fate": self._fate}
        return {**arrays, "normals": self.problem.normals, "shape_start": self._shape_solver.start}

    def restore(self, state: Mapping[str, wp.array | np.ndarray], done: int) -> None:
        """Go on after ``done`` rounds from copies of what ``state`` gave, here or in another run, without ``start``."""
        for name, array in self.state().items():
            array.assign(state[name])
        self.done = done

    def as_dict(self) -> dict:
        """Plain values for ``report.json``."""
        thickness = self.problem.measures.thickness
        measured = {"thickness": thickness, "noise": self.noise, "rigidity": self.rigidity}
        return {"rounds": self.done, **measured, "frames_partial": int((~self.problem.measures.complete).sum())}

    # Tasks.

    def _fit_frames(self, first: int, last: int) -> None:
        p, o, c = self.problem, self.objective, self.config
        begin, count = first * p.vertex_count, (last - first) * p.vertex_count
        met_begin, met_count = span(p.cloud_offsets, first, last)
        mesh = (self._row, self._column)
        vertex_normals(begin, count, self._faces, self._face_row, self._face_of, o.vertices, self._normals)
        o.transform.correspondences.find((first, last), (first, last))

        sums = (self._matrix.flatten(), self._pull.flatten())
        vertex_planes(begin, count, self._met, *sums)
        cloud_planes(met_begin, met_count, self._asked, *sums)
        if self._border is not None:
            vertex_borders(begin, count, self._met, self._border, _BORDER, self._border_gap, *sums)
            cloud_borders(met_begin, met_count, self._asked, self._border, _BORDER, *sums)
        if self._expected is not None:
            hold_unseen(begin, count, self._met, self._expected.flatten(), self._hold, *sums)
        rigid_pull(begin, count, self.rigidity, *mesh, self._rest, self._rotation, o.vertices, self._pull)
        self._solver.solve(first, last, self.rigidity, c.damping, self._matrix, self._pull, self._move)
        add_scaled(begin, count, 1.0, self._move.flatten(), o.vertices.flatten())
        fit_rotations(begin, count, *mesh, self._rest, o.vertices, self._rotation)

    def _expect(self, begin: int, count: int) -> None:
        assert self._expected is not None  # else it is no phase
        expected_places(begin, count, *self._times, self.objective.vertices, self._rotation, self._expected)

    def _ask_frames(self, begin: int, count: int) -> None:
        mesh = (self._row, self._column)
        rest_pull(begin, count, self._telling, *mesh, self._rotation, self.objective.vertices, self._shape_pull)

    def _fit_shape(self) -> None:
        """(I + s L) y = y_old + s pull: the optimum L y = pull, at the cost of s^-1 of staying."""
        p, c = self.problem, self.config
        copy_vectors(self._rest, self._shape)
        add_scaled(0, p.vertex_count, c.shape_smoothness, self._shape_pull, self._shape)
        self._shape_solver.solve(self._shape, self._shape_pull, 0, 1)
        blend(c.shape_step, self._shape_pull, self._rest)

    def _phases(self) -> list[Phase]:
        p = self.problem
        frames, runs = p.frame_spans(), p.vertex_spans()
        phases: list[tuple[str, list[Callable[[], None]]]] = [
            ("frames", [partial(self._fit_frames, a, b) for a, b in frames]),
            ("edges", [partial(self._ask_frames, a, b - a) for a, b in runs]),
            ("shape", [self._fit_shape]),
        ]
        if self._expected is not None:
            count = p.vertex_count
            phases.insert(0, ("expect", [partial(self._expect, a * count, (b - a) * count) for a, b in frames]))
        return [Phase(name, tasks) for name, tasks in phases]
