"""What is measured on clouds and template before a fit: spacing, thickness, what a frame shows, where a mesh ends."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import warp as wp

from warpdef.geometry.coverage import AREA_NEIGHBOURS, area_of_discs, complete_frames
from warpdef.geometry.edges import edge_lengths
from warpdef.geometry.nearby import Fellows
from warpdef.quality.shape import STRETCHED

_LEAST = 1e-30  # of an edge's length: its logarithm is asked for
_ASKED = 10_000  # points of a cloud that speak for all: every n-th on the way through space


class CloudMeasures:
    """The local shape of the clouds of T frames, and which of them show all of a surface.

    Args:
        clouds: T arrays (N_t, 3), along a curve that fills space (``morton``).
        surface_area: of the template, in the square of their unit.
        share: of the fullest frame's area, from which a frame is complete. measured: the same clouds with their noise,
            where ``clouds`` are without.
        device: where neighbours are looked for; None: on the host, without Warp.
    """

    def __init__(
        self,
        clouds: list[np.ndarray],
        surface_area: float,
        share: float,
        device: wp.Device | None = None,
        measured: list[np.ndarray] | None = None,
    ) -> None:
        self._device = device
        self._clouds, self._surface_area, self._share = clouds, surface_area, share
        self._sizes = np.array([len(c) for c in clouds])
        self._measured = measured

    @cached_property
    def spacing(self) -> np.ndarray:
        """Mean distance of a cloud's points to their nearest fellow, shape (T,)."""
        return self._local_shape[0]

    @cached_property
    def thickness(self) -> float:
        """Thickness over width of the clouds' neighbourhoods, median over points, then frames: what noise adds to."""
        return float(np.median(self._local_shape[1]))

    @cached_property
    def complete(self) -> np.ndarray:
        """Which frames show all of the surface, by their area, shape (T,) bool."""
        return complete_frames(self._local_shape[2], self._sizes, self._share, self._surface_area)

    @cached_property
    def _local_shape(self) -> np.ndarray:
        """Spacing, thickness and area of every frame, shape (3, T)."""
        found = np.array([self._shape_of(cloud) for cloud in self._clouds]).T
        if self._measured is not None:
            found[1] = [self._shape_of(cloud)[1] for cloud in self._measured]
        self._clouds, self._measured = [], None  # nothing else is asked of them
        return found

    def _shape_of(self, cloud: np.ndarray) -> tuple[float, float, float]:
        near = Fellows(cloud, AREA_NEIGHBOURS, -(-len(cloud) // _ASKED), self._device)
        distance, (thin, wide, _) = near.distance, np.sqrt(np.median(near.planes()[1], axis=0))
        area = area_of_discs(distance) * len(cloud) / len(distance)
        return distance[:, 1].mean(), thin / max(wide, 1e-12), area


def border_of(faces: np.ndarray, vertex_count: int) -> np.ndarray | None:
    """Border vertices' neighbours before and after on the border, and one inside; -1 elsewhere. (V, 3).

    None for a closed mesh. A vertex at which several borders meet has neighbours of one of them.
    """
    a, b, c = (np.roll(faces, -k, axis=1).ravel().astype(np.int64) for k in range(3))
    alone = ~np.isin(a * vertex_count + b, b * vertex_count + a)
    if not alone.any():
        return None
    border = np.full((vertex_count, 3), -1)
    border[a[alone], 1], border[a[alone], 2], border[b[alone], 0] = b[alone], c[alone], a[alone]
    border[(border < 0).any(axis=1)] = -1
    return border


def mean_edge_length(vertices: np.ndarray, edges: np.ndarray) -> float:
    """Of vertices (V, 3) and edges (E, 2), in the vertices' unit."""
    ends = vertices[edges]
    return float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).mean())


def stretched_share(vertices: np.ndarray, edges: np.ndarray, lengths: np.ndarray) -> float:
    """Share of the edges (E, 2) of vertices (V, 3) that are half as long again as their lengths (E,), or shorter by as
    much."""
    ratio = np.log(np.maximum(edge_lengths(vertices, edges), _LEAST) / np.maximum(lengths, _LEAST))
    return float(np.mean(np.abs(ratio) > np.log(STRETCHED)))
