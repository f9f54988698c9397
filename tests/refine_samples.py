"""Scenes for the vertex stage, and rounds of it from any start."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import synthetic
import warp as wp

from warpdef.config import Config
from warpdef.fit.optimise import Optimiser
from warpdef.fit.problem import Problem
from warpdef.fit.refine import Refinement
from warpdef.fit.workers import Team
from warpdef.geometry.denoise import Scattered

AXES = np.array([0.6, 0.45, 0.35])


@dataclass(frozen=True)
class MovingEllipsoid:
    """An exact ellipsoid that turns and drifts: a mesh whose vertices lie on it, and clouds that see part of it or all.

    turn, shift: pose of each frame, (T, 3, 3) and (T, 3). body: vertices before posing, (V, 3). axis: their normals.
    """

    turn: np.ndarray
    shift: np.ndarray
    body: np.ndarray
    axis: np.ndarray
    faces: np.ndarray
    clouds: list[np.ndarray]
    normals: list[np.ndarray]

    @classmethod
    def make(
        cls, frames: int, points: int, rng: np.random.Generator, subdivisions: int = 2, seen=None
    ) -> MovingEllipsoid:
        """``seen(t, body points)``: which points the cloud of frame t keeps."""
        sphere, faces = synthetic.icosphere(subdivisions)
        turn = np.stack([synthetic.turn_about([0.3, 0.2, 1.0], 0.15 * t) for t in range(frames)])
        shift = np.array([[0.03 * t, 0, 0] for t in range(frames)])
        clouds, normals = [], []
        for t in range(frames):
            direction = units(rng.normal(size=(points, 3)))
            if seen is not None:
                direction = direction[seen(t, direction * AXES)]
            clouds.append(direction * AXES @ turn[t].T + shift[t])
            normals.append(units(direction / AXES) @ turn[t].T)
        return cls(turn, shift, sphere * AXES, units(sphere / AXES), faces, clouds, normals)

    @property
    def vertices(self) -> np.ndarray:
        return self.posed(np.tile(self.body, (len(self.turn), 1, 1)))

    def posed(self, bodies: np.ndarray) -> np.ndarray:
        """Bodies of each frame, (T, V, 3), to where the frames are."""
        return np.einsum("tab,tvb->tva", self.turn, bodies) + self.shift[:, None]

    def off_surface(self, vertices: np.ndarray) -> np.ndarray:
        """Distance of each vertex to the ellipsoid to first order, (T, V): |f| / |grad f| with f = |x / axes| - 1."""
        scaled = np.einsum("tba,tvb->tva", self.turn, vertices - self.shift[:, None]) / AXES
        length = np.linalg.norm(scaled, axis=2)
        return np.abs(length - 1) * length / np.linalg.norm(scaled / AXES, axis=2)

    def waves(self, count: int, size: float, rng: np.random.Generator) -> np.ndarray:
        """Bodies displaced along their normals by smooth noises, ``size`` root mean square, (count, V, 3)."""
        x, y, z = (self.body / AXES).T
        smooth = np.stack([x * y, y * z, z * x, x * x - y * y, 3 * z * z - 1, x, y, z], axis=1)
        height = np.einsum("vs,ts->tv", smooth, rng.normal(size=(count, smooth.shape[1])))
        height *= size / np.sqrt((height**2).mean(axis=1, keepdims=True))
        return self.body + height[..., None] * self.axis


def units(a: np.ndarray) -> np.ndarray:
    return a / np.linalg.norm(a, axis=-1, keepdims=True)


def mean_square(a: np.ndarray, axis=None) -> np.ndarray:
    """Root of the mean square."""
    return np.sqrt((a**2).mean(axis=axis))


class Rounds:
    """Rounds of the stage from these vertices, in the template's order. ``normals``: None for those of the scene."""

    def __init__(
        self,
        scene: MovingEllipsoid,
        vertices: np.ndarray,
        device: str,
        rounds: int,
        keyframe: int = 1,
        threads: int = 1,
        capture: bool = True,
        prepare: bool = False,
        normals: list[np.ndarray] | None = None,
        oriented: list[bool] | None = None,
        times: list[int] | None = None,
        scattered: list[Scattered] | None = None,
        **refine,
    ) -> None:
        config = Config()
        config = replace(config, grid=replace(config.grid, levels=2), refine=replace(config.refine, **refine))
        normals, on = normals or scene.normals, wp.get_device(device)
        self.problem = p = Problem(
            scene.clouds, normals, vertices[keyframe], scene.faces, keyframe, config, on, oriented, times=times,
            scattered=scattered,
        )  # fmt: skip
        team = Team(threads)
        try:
            # The stage takes over where the grids end; here they never began.
            self.objective = Optimiser(p, 1, team).objective
            place = np.argsort(p.place)
            self.objective.vertices.assign(np.asarray(vertices, np.float32)[:, place])
            self.stage = Refinement(self.objective, team, capture)
            if prepare:
                self.stage.prepare()
            self.stage.start()
            for _ in range(rounds):
                self.stage.run_round()
            self.vertices = self.objective.placed_vertices()
            self.rest = self.stage.shape.places.numpy()[p.place]
            self.rotation = self.stage.rotation.numpy()[:, p.place]
        finally:
            team.close()
