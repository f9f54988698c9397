"""The vertex stage: what the grids cannot express, fitted on the mesh itself (beyond the paper).

The finest grid has a node every tenth of the cube; wrinkles are smaller. After the grids every vertex of every frame
moves on its own, by Gauss-Newton on

    E = sum_t sum_pairs w r^2 + rigidity sum_t sum_(i,j) s_ij | (x_i - x_j) - (R_i + R_j)/2 (y_i - y_j) |^2

with symmetric point-to-plane residuals r both ways, a rotation R a vertex and frame, and one rest shape y for all
frames. y is an unknown like the others (``rest_shape``), and the stiffness s of edges is learnt from all frames
(``material``). The noisier the clouds, the stiffer. Vertices and rotations in turns come to an end slowly, a turn
spreading by an edge at a time; so a round begins farther along the way of the last (heavy ball, Polyak 1964), and with
rotations fitted anew until they have spread. Pairs and their planes come from ``pairing``, in rounds over clouds
whose noise is wide from every point and all vertices around it; what a frame does not show is held by the frames around
it (``unseen``). In the last rounds a second solve draws vertices to places that are smooth in time (``smoothness``).

A round is three phases: every frame pairs, solves for its moves and fits its rotations; every vertex asks the frames
that show all of the surface for its edges, or all frames if none does; the shape is solved for. Where an incomplete
frame is held, a phase before them says where its vertices are expected. Part of the way through, frames that lost a
limb are fitted again (``recover``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
import warp as wp

from warpdef.device import Way, frame_of, load_kernels
from warpdef.fit.landmarks import LandmarkTerm, PlacedLandmarks
from warpdef.fit.material import Material
from warpdef.fit.objective import Objective
from warpdef.fit.pairing import Pairing, noise_of
from warpdef.fit.recover import Cloud, recover
from warpdef.fit.rest_shape import RestShape
from warpdef.fit.smoothness import Smoothness
from warpdef.fit.sobolev import SolveReport, note_solve
from warpdef.fit.unseen import Unseen
from warpdef.fit.workers import Iteration, Phase, Team
from warpdef.kernels.block_cg import BlockSolver
from warpdef.kernels.launching import listing
from warpdef.kernels.rigidity import fit_rotations, rigid_rhs
from warpdef.kernels.vectors import add_scaled, copy_vectors, go_on

_FREE = 0.6  # share of the rounds before places are smoothed in time: what has not arrived yet is not to be held
_FREE_LESS = 0.4  # less at noise 1, where patches settle before vertices do
_TURNS = 3  # fits of rotations where a round goes on: a fit that is tied passes a turn on by one edge
_TIED = 1.2  # edges: noise up to which rotations of neighbours are tied
_SETTLED = 8  # rounds after which a frame shows whether it lost a limb


class Refinement:
    """Vertices of all frames, refined in place.

    Args:
        objective: grids fitted; its ``vertices``, shape (T, V), are the start and the result.
        team: CPU threads. capture: on CUDA, run a round as one graph. landmarks: known correspondences.

    pairing, unseen, landmarks, shape, material: the parts of a round.
    rotation: of every vertex from the shape, shape (T, V) mat33.
    """

    def __init__(
        self, objective: Objective, team: Team, capture: bool = True, landmarks: PlacedLandmarks | None = None
    ) -> None:
        p = self.problem = objective.problem
        self.objective, c = objective, p.config.refine
        self.config, self.done = c, 0
        device, shape = p.device, (p.frame_count, p.vertex_count)
        self.noise = noise_of(p.measures.thickness, c)
        self.rigidity = c.rigidity * (c.rigidity_noisy / c.rigidity) ** self.noise
        # What one camera saw is held by the bent template, and points that scatter widely by patches: neither is tied,
        # nor hurried after its points.
        tied = not p.seen and p.wide_noise <= _TIED * p.edge_length
        self._tie, self._momentum = (c.rotation_smoothness, c.momentum) if tied else (0.0, 0.0)
        # Of a frame alone: points that scatter tell too little, and an open sheet is cloth, whose waves would be
        # held back (a flag's CD 6.1 for 3).
        self._tie_alone = self._tie if p.scattered is None and p.border is None else 0.0
        self.rotation, self._matrix = (wp.zeros(shape, dtype=wp.mat33, device=device) for _ in range(2))
        borrow = p.pool.borrower()
        self._rhs, self._move, *scratch = (borrow(wp.vec3, shape) for _ in range(4))
        self.pairing = Pairing(objective, self.noise)
        self.unseen = Unseen(p, objective.vertices, self.rotation)
        self.landmarks = None if landmarks is None else LandmarkTerm(landmarks, p, objective.vertices)
        self.shape = RestShape(p, objective.vertices, self.rotation, self.noise, self.unseen.trust)
        moving = self.shape.places, objective.vertices, self.rotation
        self.smoothness = Smoothness(p, moving, self.noise, tuple(scratch))
        learnt = c.material and p.scattered is None and not p.seen
        self._edges = p.integers(p.mesh.row), p.integers(p.mesh.column)
        self.material = Material(self._edges, moving, c.iterations) if learnt else None
        self._earlier = wp.clone(objective.vertices)  # before the last round: to go on from, or back to
        self._solver = BlockSolver(p.mesh, p.frame_count, c.tolerance, c.iterations_max, device)
        self.solves = SolveReport("block cg")
        # By frame: 1 fitted again, 2 lost all the same. Part of the state, hence on the device.
        self._fate = p.integers(np.zeros(p.frame_count))
        self._round = Iteration(self._phases(), device, team, capture)
        self._smooth_round = Iteration(self._phases(smooth=True), device, team, capture) if self.smoothness else None

    def kernels(self) -> list[wp.Kernel]:
        """All that rounds, and frames settled alone, launch."""
        with listing() as alone:
            self.shape.take()
            self.objective.chain.move_one(0, 0, self.problem.vertex_count)
            if self.material is not None:
                self.material.measure()
        return [*alone, *(self._smooth_round or self._round).kernels()]

    def prepare(self) -> None:
        """Compile every kernel; on the CPU, record all commands."""
        load_kernels(self.kernels(), self.problem.device)
        if self.problem.way is Way.SPANS:
            self._round.prepare()
            if self._smooth_round is not None:
                self._smooth_round.prepare()

    def start(self) -> None:
        """Take the vertices as they are: the shape is the keyframe's, normals of doubtful side get the mesh's side."""
        self.shape.take()
        self._fit_rotations(0, self.problem.frame_count, self._tie)
        copy_vectors(self.objective.vertices.flatten(), self._earlier.flatten())
        self.pairing.choose_sides()

    def run_round(self) -> None:
        """One round; before one of them, frames that lost a limb are fitted again."""
        chain, settled = self.problem.config.optimiser.chain, min(_SETTLED, self.config.iterations // 2)
        if self.config.recover and chain and self.done == settled:
            self._recover()
        free = (_FREE - _FREE_LESS * min(self.noise, 1.0)) * self.config.iterations
        if self.material is not None:
            self.material.learn(self.done)
        late = self._smooth_round if self.done >= round(free) else None
        (late or self._round).run()
        self.done += 1

    def _recover(self) -> None:
        p, o, pairs = self.problem, self.objective, self.pairing
        vertices = o.vertices.numpy().astype(np.float64)
        points, normals = p.by_frame(p.cloud.numpy()), p.by_frame(pairs.given_normals)
        agree = pairs.doubtful.numpy() == 0
        clouds = [Cloud(*frame) for frame in zip(points, normals, p.oriented, agree, strict=True)]
        # Of an incomplete frame what is seen need not hang together: it says nothing of limbs lost.
        judged = np.flatnonzero(p.measures.complete | (np.arange(p.frame_count) == p.transitions.keyframe))
        chosen, keyframe = vertices[judged], int(np.searchsorted(judged, p.transitions.keyframe))
        recovered, lost = recover(chosen, [clouds[t] for t in judged], p.faces, p.edges.numpy(), keyframe, p.device)
        vertices[judged] = chosen
        fate = np.zeros(p.frame_count, dtype=np.int32)
        fate[judged[recovered]], fate[judged[lost]] = 1, 2
        self._fate.assign(fate)
        if recovered:
            o.vertices.assign(vertices.astype(np.float32))
            pairs.forget_sides()
            self.start()

    @property
    def frames_recovered(self) -> list[int]:
        """Frames that lost a limb and were fitted again."""
        return np.flatnonzero(self._fate.numpy() == 1).tolist()

    @property
    def frames_lost(self) -> list[int]:
        """Frames a part of whose points the mesh does not cover."""
        return np.flatnonzero(self._fate.numpy() == 2).tolist()

    def settle(self, frame: int, neighbour: int, rounds: int) -> None:
        """Fit one frame alone to its cloud and the shape as they are; frames may be settled at the same time.

        Rotations are looked for from those of a neighbour, already settled; so what is not seen goes with its move.
        """
        wp.copy(frame_of(self.rotation, frame), frame_of(self.rotation, neighbour))
        if self.unseen:
            self.unseen.stay(frame)
        self._fit_rotations(frame, frame + 1, 0.0)  # untied: the neighbour's are a step behind
        for _ in range(rounds):
            self._fit_frames(frame, frame + 1)

    def look(self) -> None:
        """Note what the linear solves of the last round did, in ``solves``. Waits for the device."""
        iterations = int(self._solver.iterations.numpy().max())
        note_solve(self.solves, iterations, self._solver.residual.numpy(), self.config.tolerance)
        self.shape.note(self.solves)

    def state(self) -> dict[str, wp.array]:
        """What a round leaves for the next, by name: the arrays themselves. Searches remember more, but are exact."""
        return {
            "vertices": self.objective.vertices,
            "earlier": self._earlier,
            "rest": self.shape.places,
            "rotation": self.rotation,
            "doubtful": self.pairing.doubtful,
            "fate": self._fate,
            "normals": self.problem.normals,
            "shape_start": self.shape.start,
            **self.unseen.state(),
            **({} if self.material is None else {"stiffness": self.material.stiffness}),
        }

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

    @property
    def _stiffness(self) -> wp.array | None:
        return None if self.material is None else self.material.stiffness

    # Tasks.

    def _fit_frames(self, first: int, last: int, together: bool = False) -> None:
        """Pair, solve for the moves that the pairs, the edges and the frames around ask for, and turn with them.

        Of noisy clouds a frame alone meets the surface that its points scatter around, all ``together`` the points.
        """
        o = self.objective
        begin, count = first * self.problem.vertex_count, (last - first) * self.problem.vertex_count
        if together:
            go_on(begin, count, self._momentum, self._earlier.flatten(), o.vertices.flatten())
            if self._momentum > 0:  # without it vertices are as rotations were fitted to them
                for _ in range(_TURNS):
                    self._fit_rotations(first, last, self._tie)
        self.pairing.find(first, last)
        if self.unseen.trust is not None:
            self.unseen.look(first, last, self.pairing)
        sums = (self._matrix.flatten(), self._rhs.flatten())
        if together and self.problem.scattered is not None:
            self.pairing.scattered(first, last, *sums)
        else:
            self.pairing.equations(first, last, *sums)
        if self.unseen:
            self.unseen.hold(first, last, self.pairing, *sums)
        if self.landmarks is not None:
            self.landmarks.hold(first, last, *sums)
        stiffness = self._stiffness if together else None
        moving = self.shape.places, self.rotation, o.vertices
        rigid_rhs(begin, count, self.rigidity, *self._edges, *moving, self._rhs, stiffness)
        self._solve(first, last, self._tie if together else self._tie_alone, stiffness)

    def _smooth_frames(self, first: int, last: int) -> None:
        """Solve for the moves to places that are smooth in time, by the matrix of the pairs just met, and turn."""
        self.smoothness.hold(first, last, self._matrix, self._rhs)
        self._solve(first, last, self._tie, self._stiffness)

    def _solve(self, first: int, last: int, tie: float, stiffness: wp.array | None) -> None:
        """Move by what matrix and right-hand side ask for, and turn, tied to the neighbours."""
        begin, count = first * self.problem.vertex_count, (last - first) * self.problem.vertex_count
        weights = self.rigidity, self.config.damping
        self._solver.solve(first, last, *weights, self._matrix, self._rhs, self._move, stiffness)
        add_scaled(begin, count, 1.0, self._move.flatten(), self.objective.vertices.flatten())
        self._fit_rotations(first, last, tie)

    def _fit_rotations(self, first: int, last: int, tie: float) -> None:
        begin, count = first * self.problem.vertex_count, (last - first) * self.problem.vertex_count
        scratch = (self._rhs, self._move) if tie else None  # neither is needed any more
        moving = self.shape.places, self.objective.vertices, self.rotation
        fit_rotations(begin, count, *self._edges, *moving, tie, scratch)

    def _phases(self, smooth: bool = False) -> list[Phase]:
        frames, runs = self.problem.frame_spans(), self.problem.vertex_spans()
        phases: list[tuple[str, list[Callable[[], None]]]] = [
            ("frames", [partial(self._fit_frames, a, b, True) for a, b in frames]),
            ("edges", [partial(self.shape.ask, a, b) for a, b in runs]),
            ("shape", [self.shape.solve]),
        ]
        if smooth:
            places = [partial(self.smoothness.place, a, b) for a, b in frames]
            phases[1:1] = [("places", places), ("smooth", [partial(self._smooth_frames, a, b) for a, b in frames])]
        if self.unseen and self.unseen.by_time:
            phases.insert(0, ("expect", [partial(self.unseen.expect, a, b) for a, b in frames]))
        return [Phase(name, tasks) for name, tasks in phases]
