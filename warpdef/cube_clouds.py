"""The clouds in the cube, and what is known of how they were measured: by one camera, with noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from warpdef.cleaning.wide_noise import noise_facts, without_wide_noise
from warpdef.config import Config
from warpdef.geometry.cloud_planes import pca_normals
from warpdef.geometry.denoise import Scattered
from warpdef.geometry.viewpoint import camera_place, seen_normals, viewing_direction
from warpdef.sequence import PointSequence, Similarity


@dataclass(frozen=True)
class CubeClouds:
    """Clouds of T frames, on their way into the fit.

    into:      the similarity that takes input units into the cube
    measured:  the clouds used, input units
    calm:      the same, of wide noise the surfaces that points scatter around; input units
    scattered: noisy clouds as they were measured, cube units; None where ``calm`` is ``measured``
    view:      direction in which one camera looked, (3,); None if there was no such camera
    eye:       its place, cube units, (3,); None where its place is not known
    noise:     what is told of noisy clouds, plain values; None where ``calm`` is ``measured``
    """

    into: Similarity
    measured: PointSequence
    calm: PointSequence
    scattered: list[Scattered] | None
    view: np.ndarray | None
    eye: np.ndarray | None
    noise: dict[str, float | int | str] | None = None

    @classmethod
    def of(cls, sequence: PointSequence, config: Config) -> CubeClouds:
        """Of clouds as they were cleaned (Implementation Details: one similarity takes all into the cube)."""
        into = Similarity.into_cube(sequence.points, config.fill)
        view = eye = scattered = None
        calm = sequence
        if any(n is None for n in sequence.normals):
            points = [into.to_cube(p) for p in sequence.points]
            view = viewing_direction(points)
            eye = None if view is None else camera_place(points, view)
        if view is None and not config.optimiser.chain:
            scattered, calm = without_wide_noise(sequence, into, config.template.neighbours, config.trust_normals)
        noise = None
        if scattered is not None:
            noise = noise_facts(scattered, sequence, calm, into, config.trust_normals)
        return cls(into, sequence, calm, scattered, view, eye, noise)

    def points(self) -> list[np.ndarray]:
        """Those of ``calm``, T arrays (N_t, 3), cube units; made anew each time, as nothing needs them for long."""
        return [self.into.to_cube(p) for p in self.calm.points]

    def points_of_all(self) -> list[np.ndarray]:
        """The same numbered as in the input: a frame without usable points is an empty cloud."""
        return [self.into.to_cube(p) for p in self.calm.all_frames()]

    def normals(self, points: list[np.ndarray], config: Config, device: wp.Device) -> list[np.ndarray] | None:
        """Unit normals of ``points``: given ones, else of local planes, whose side is open but where one camera saw
        all; None where nothing asks for them."""
        if config.loss.tangential == 1.0 and not config.refine.iterations:
            return None
        neighbours, given = config.template.neighbours, zip(points, self.calm.normals, strict=True)
        if self.view is not None:
            return [seen_normals(p, self.view, neighbours, device) if n is None else n for p, n in given]
        return [pca_normals(p, neighbours, device) if n is None else n for p, n in given]

    def oriented(self) -> list[bool]:
        """Of every frame, whether its normals are known to point outwards."""
        return [n is not None or self.view is not None for n in self.calm.normals]
