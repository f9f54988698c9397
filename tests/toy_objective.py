"""A three-frame toy of the objective, evaluated once, with the float64 twin beside it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import reference
import reference_refine as twin_refine
import synthetic
import warp as wp
import witness
from descent import chained

from warpdef.config import Config
from warpdef.device import on_host
from warpdef.fit.objective import Objective
from warpdef.fit.problem import Problem
from warpdef.kernels.levels import node8
from warpdef.kernels.motion import template_gradient
from warpdef.kernels.schedule import DELTA, SCHEDULE_SIZE

# Chosen so that every term has a say: on sums, isometry at 250 would be a few per cent of a toy's loss.
LOSS = {
    "as configured": {},
    "mean, power 4, plain distance": {
        "reduction": "mean",
        "robust_power": 4,
        "tangential": 1.0,
        "isometry_weight": 1.0,
    },
    "no confidence": {"confidence": False, "mesh_weight": 0.5, "input_weight": 2.0, "transform_weight": 3.0},
    "no isometry, along normals": {"isometry_weight": 0.0, "tangential": 0.0, "confidence_bound": "mean"},
}


class Toy:
    """A turning ellipsoid in three frames of unequal clouds, evaluated once at random nodes.

    partial: frames that are taken to show part of the surface. off: how far the template is moved off its cloud.
    chain: the paper's descent, else cloud to cloud. points: of each frame that grids are then fitted to; 0: all.
    """

    def __init__(
        self,
        device: str,
        keyframe: int = 1,
        levels: int = 2,
        warmup: bool = False,
        partial: tuple = (),
        off: float = 0.0,
        chain: bool = True,
        points: int = 0,
        **loss,
    ) -> None:
        rng = np.random.default_rng(5)
        moving = synthetic.turning_ellipsoid(3, 40, rng, subdivisions=1)
        sizes = [40, 23, 31]
        clouds, normals = ([a[:n] for a, n in zip(s, sizes, strict=True)] for s in (moving.clouds, moving.normals))
        config = replace(Config(), grid=replace(Config().grid, levels=levels), loss=replace(Config().loss, **loss))
        optimiser = replace(config.optimiser, points=points)
        config = chained(config) if chain else replace(config, optimiser=optimiser)
        self.device, self.config, self.levels = device, config, reference.resolutions(1, levels)
        template = moving.vertices[keyframe] + 0.02 * rng.normal(size=moving.vertices[0].shape) + [off, 0.0, 0.0]
        self.problem = p = Problem(clouds, normals, template, moving.faces, keyframe, config, wp.get_device(device))
        p.measures.complete = ~np.isin(np.arange(3), partial)
        self.nodes = (rng.normal(size=(2, p.levels.node_count, 6)) * 0.08).astype(np.float32)
        self.template = p.template.astype(np.float32).astype(np.float64)
        self.evaluate(self.nodes, warmup)

    def evaluate(self, nodes: np.ndarray, warmup: bool = False) -> None:
        p = self.problem
        on_device = wp.array(witness.pad(nodes), dtype=node8, ndim=2, device=self.device)
        self._adj_nodes = wp.zeros_like(on_device)
        schedule = np.zeros(SCHEDULE_SIZE, dtype=np.float32)
        schedule[DELTA] = 0.7
        self.objective = o = Objective(p, on_device, self._adj_nodes, p.numbers(schedule))
        for phase in o.phases(warmup):
            for task in phase.tasks:
                task()
        if not warmup and self.config.optimiser.chain:
            for first, last in p.transition_spans():
                o.chain.scatter(first, last)

    @property
    def adj_nodes(self) -> np.ndarray:
        """Gradient of the nodes, (S, M, 6)."""
        found = self._adj_nodes.numpy()
        np.testing.assert_array_equal(found[..., 6:], 0)
        return found[..., :6]

    def adj_template(self, follow: bool) -> np.ndarray:
        o, found = self.objective, self.problem.vectors(np.zeros_like(self.template))
        template_gradient(self.problem.transitions.keyframe, follow, o.sums.weighed, o.sums.plain, o.chain.carry, found)
        return found.numpy()

    @property
    def trust(self) -> np.ndarray:
        return self.objective.confidence.numpy().astype(np.float64)

    # The twin, at the same float32 positions.

    @property
    def scene(self) -> reference.TwinScene:
        p, loss = self.problem, self.config.loss
        split = p.sample.offsets[1:-1]
        clouds = np.split(p.sample.points.numpy().astype(np.float64), split)
        # Fewer points on the same surface stand farther apart, by the root of their number.
        spacing = np.array([twin_refine.spacing(c) for c in p.by_frame(p.cloud.numpy())])
        spacing *= np.sqrt(p.cloud_sizes / p.sample.sizes)
        ends = p.template[on_host(p.edges)]
        source, target = p.transitions.source, p.transitions.target
        between = 0.75 * (spacing[source] + spacing[target])
        vertex_reach = spacing + 0.25 * np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).mean()
        return reference.TwinScene(
            moved_reach=np.where(p.measures.complete[target], np.inf, between),
            met_reach=np.where(p.measures.complete[source], np.inf, between),
            vertex_reach=np.where(p.measures.complete, np.inf, vertex_reach),
            clouds=clouds,
            normals=np.split(p.sample.normals.numpy().astype(np.float64), split),
            edges=p.edges.numpy(),
            levels=self.levels,
            keyframe=p.transitions.keyframe,
            alpha=loss.robust_alpha,
            power=loss.robust_power,
            tangential=loss.tangential,
            share_mean=loss.reduction == "mean",
            mesh_weight=loss.mesh_weight,
            input_weight=loss.input_weight,
            transform_weight=loss.transform_weight,
            isometry_weight=loss.isometry_weight,
        )

    def pairs(self) -> tuple[list[reference.NearestPairs], list[reference.NearestPairs]]:
        """The kernel's neighbours: of moved clouds, of vertices."""
        p, o, count = self.problem, self.objective, self.problem.vertex_count
        first, moved_offsets = p.sample.offsets, p.moved_offsets
        forth, back = o.input.correspondences.forth.index.numpy(), o.input.correspondences.back.index.numpy()
        moved = []
        for s, t in enumerate(p.transitions.target):
            there, here = slice(*moved_offsets[s : s + 2]), slice(*first[t : t + 2])
            moved.append(reference.NearestPairs(forth[there] - first[t], back[here] - moved_offsets[s]))
        forth, back = o.transform.correspondences.forth.index.numpy(), o.transform.correspondences.back.index.numpy()
        first = p.cloud_offsets
        met = [
            reference.NearestPairs(
                forth[t * count : (t + 1) * count] - first[t], back[first[t] : first[t + 1]] - t * count
            )
            for t in range(p.frame_count)
        ]
        return moved, met

    def twin(
        self, nodes: np.ndarray | None = None, template: np.ndarray | None = None, weights=None
    ) -> reference.Terms:
        nodes = self.nodes.astype(np.float64) if nodes is None else nodes
        template = self.template if template is None else template
        return reference.terms(self.scene, nodes, template, *self.pairs(), weights)

    def twin_total(self):
        """The twin's objective of nodes and template; all that the gradient takes for constant is frozen."""
        scene, pairs, trust = self.scene, self.pairs(), self.trust
        weights = self.twin().weights

        def total(nodes: np.ndarray, template: np.ndarray) -> float:
            return reference.total(scene, reference.terms(scene, nodes, template, *pairs, weights), trust)

        return total


def toy_faces() -> np.ndarray:
    return synthetic.icosphere(1)[1]
