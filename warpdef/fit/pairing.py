"""Points and mesh paired both ways, on the side of the surface that the mesh says, and the planes that pairs ask for.

A vertex pairs with its nearest cloud point, and a cloud point with its nearest vertex (``kernels.pairs``): by the angle
of their normals, by their distance against the reach (a multiple of the cloud's spacing), and of a vertex by the way
back. The noisier the clouds (measured by how thick they are locally), the less their own normals count. The border of
an open mesh reaches for where the points end (``kernels.borders``). Points whose
noise is wider than their spacing have no one partner (``kernels.mixture``).
"""

from __future__ import annotations

import numpy as np
import warp as wp

from warpdef.config import RefineConfig
from warpdef.device import on_host
from warpdef.fit.objective import Objective
from warpdef.fit.problem import Problem, span
from warpdef.kernels.borders import cloud_borders, vertex_borders
from warpdef.kernels.mixture import clear_sums, mixture_planes, mixture_sums
from warpdef.kernels.pairs import pairs_of
from warpdef.kernels.planes import cloud_planes, vertex_normals, vertex_planes

_OPPOSED_MAX = 0.01  # share of given normals against the mesh that is taken for contact, not for flips
_POINT = 4.0  # weight of a noisy point, which all vertices around share, against one plane
_NOISE_MAX = 1.25  # rigidity grows no further
_FOLDED = 0.05  # weight of a vertex in a fold that a complete frame does not have, against one plane
_BORDER = 0.1  # weight of a residual across the border against one plane: a border is sampled sparsely, hence noisy
_BORDER_GAP = 0.9  # from the border to the nearest point, in mean point spacings


def noise_of(thickness: float, config: RefineConfig) -> float:
    """0 for clean clouds, 1 at ``noisy_thickness``, at most 1.25."""
    above = (thickness - config.clean_thickness) / (config.noisy_thickness - config.clean_thickness)
    return float(np.clip(above, 0.0, _NOISE_MAX))


class Pairing:
    """Vertices and clouds of all frames, found and paired again wherever the vertices are.

    Args:
        objective: whose vertices and searches are used. noise: see ``noise_of``.

    met, asked: pairs met by vertices, and those asked for by cloud points.
    doubtful: shape (T,) int32, whether a frame's normals were given sides by the mesh.
    given_normals: of the clouds, before any were turned over, (N, 3) float32.
    """

    def __init__(self, objective: Objective, noise: float) -> None:
        p = self._problem = objective.problem
        self._vertices, self._correspondences = objective.vertices, objective.transform.correspondences
        self._faces = _faces_around(p)
        self._normals = wp.zeros((p.frame_count, p.vertex_count), dtype=wp.vec3, device=p.device)
        c, share = p.config.refine, max(1.0 - noise, 0.0)
        reach, folded = c.reach * p.measures.spacing, np.where(p.measures.complete, _FOLDED, 0.0)
        pairing = (c.agreement * share, share, p.numbers(reach), p.numbers(folded))
        mesh, cloud = (self._vertices.flatten(), self._normals.flatten()), (p.cloud, p.normals)
        forth, back = (search.index for search in (self._correspondences.forth, self._correspondences.back))
        self.met = pairs_of(pairing, *mesh, p.vertex_frame, forth, *cloud, objective.transform.sides)
        self.asked = pairs_of(pairing, *mesh, p.cloud_frame, back, *cloud)
        self._border: tuple[wp.array, wp.array] | None = None
        if p.border is not None:
            border = wp.array(p.border.astype(np.int32), dtype=wp.int32, ndim=2, device=p.device)
            self._border = border, p.numbers(_BORDER_GAP * p.measures.spacing)
        self._mixture: tuple[wp.array, wp.array, wp.array] | None = None
        if p.scattered is not None:
            self._mixture = p.scattered.points, p.scattered_frame, p.deviation
        self.doubtful = p.integers(~p.oriented)
        self.given_normals = p.normals.numpy().copy()

    def choose_sides(self) -> None:
        """Turn normals over to the mesh's side, in frames of unknown side and where too many given ones oppose it."""
        p = self._problem
        vertex_normals(0, p.frame_count * p.vertex_count, *self._faces, self._vertices, self._normals)
        self._correspondences.grid.build()
        self._correspondences.back.run()
        normals, nearest = p.normals.numpy(), on_host(self._correspondences.back.index)
        facing = on_host(self._normals).reshape(-1, 3)[nearest]
        opposed = (normals * facing).sum(axis=1) < 0
        share = np.add.reduceat(opposed, p.cloud_offsets[:-1]) / p.cloud_sizes
        # A few always do: between two surfaces that touch, the nearest vertex may belong to the other one.
        certain = p.seen or p.config.trust_normals
        doubtful = ~p.oriented | (False if certain else share > _OPPOSED_MAX)
        self.doubtful.assign(doubtful.astype(np.int32))
        turned = opposed & np.repeat(doubtful, p.cloud_sizes)
        normals[turned] *= -1.0
        p.normals.assign(normals)

    def forget_sides(self) -> None:
        """Clouds have the normals again that were given."""
        self._problem.normals.assign(self.given_normals)

    # Tasks.

    def find(self, first: int, last: int) -> None:
        """Pairs of frames ``first .. last``, their vertices as they are."""
        p = self._problem
        begin, count = first * p.vertex_count, (last - first) * p.vertex_count
        vertex_normals(begin, count, *self._faces, self._vertices, self._normals)
        self._correspondences.find((first, last), (first, last))

    def scattered(self, first: int, last: int, matrix_out: wp.array, rhs_out: wp.array) -> None:
        """The same of noisy clouds as they were measured: every point asks all vertices that it may come from."""
        p = self._problem
        assert p.scattered is not None and self._mixture is not None
        vertices = first * p.vertex_count, (last - first) * p.vertex_count
        points, normals = span(p.scattered.offsets, first, last), self._normals.flatten()
        clear_sums(*vertices, rhs_out)
        mixture_sums(*points, _POINT, *self._mixture, self._correspondences.grid.targets, normals, rhs_out)
        mixture_planes(*vertices, normals, rhs_out, matrix_out)
        self._across_borders(vertices, span(p.cloud_offsets, first, last), matrix_out, rhs_out)

    def equations(self, first: int, last: int, matrix_out: wp.array, rhs_out: wp.array) -> None:
        """What the pairs of frames ``first .. last`` ask for: normal equations, written, not added.

        Args:
            matrix_out: shape (T V,) mat33. rhs_out: shape (T V,) vec3. See ``kernels.planes``.
        """
        p = self._problem
        vertices = first * p.vertex_count, (last - first) * p.vertex_count
        points, sums = span(p.cloud_offsets, first, last), (matrix_out, rhs_out)
        vertex_planes(*vertices, self.met, *sums)
        cloud_planes(*points, self.asked, *sums)
        self._across_borders(vertices, points, *sums)

    def _across_borders(
        self, vertices: tuple[int, int], points: tuple[int, int], matrix_out: wp.array, rhs_out: wp.array
    ) -> None:
        if self._border is not None:
            (border, gap), sums = self._border, (matrix_out, rhs_out)
            vertex_borders(*vertices, self.met, border, _BORDER, gap, *sums)
            cloud_borders(*points, self.asked, border, _BORDER, *sums)


def _faces_around(problem: Problem) -> tuple[wp.array, wp.array, wp.array]:
    """Faces, and those around each vertex in compressed rows, see ``kernels.planes.vertex_normals``."""
    p = problem
    corner = np.argsort(p.faces.ravel(), kind="stable")
    counts = np.bincount(p.faces.ravel(), minlength=p.vertex_count)
    faces = wp.array(p.faces, dtype=wp.int32, ndim=2, device=p.device)
    return faces, p.integers(np.concatenate([[0], np.cumsum(counts)])), p.integers(corner // 3)
