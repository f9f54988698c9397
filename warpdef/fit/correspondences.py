"""Who is nearest to whom: moving points and the clouds that they meet, both ways, found again as the points move."""

from __future__ import annotations

import numpy as np
import warp as wp

from warpdef.fit.problem import Clouds, Problem, span
from warpdef.kernels.cells import PointGrid
from warpdef.kernels.neighbours import NearestSearch


def cloud_grid(problem: Problem, clouds: Clouds) -> PointGrid:
    """Clouds of all frames, sorted once: they stay where they are."""
    grid = PointGrid(clouds.points, clouds.sizes, problem.box)
    grid.build()
    return grid


class Correspondences:
    """Groups of moving points, each with the one cloud that it meets.

    Args:
        clouds: those met. grid: they, sorted, see ``cloud_grid``.
        moving: shape (N,) vec3, cube units, groups behind each other.
        sizes: points in each group.
        meets: shape (N,) int32, the frame whose cloud a moving point meets.
        met_by: shape (cloud points,) int32, the group that a cloud point is met by; negative for none.

    forth, back: ``index`` of each holds the nearest cloud point of every moving point, and the other way round.
    """

    def __init__(
        self,
        problem: Problem,
        clouds: Clouds,
        grid: PointGrid,
        moving: wp.array,
        sizes: np.ndarray,
        meets: wp.array,
        met_by: wp.array,
    ) -> None:
        self._offsets = np.concatenate([[0], np.cumsum(sizes)]).astype(int)
        self._cloud_offsets = clouds.offsets
        self.clouds, self.grid = grid, PointGrid(moving, sizes, problem.box)
        self.forth = NearestSearch(grid, moving, meets)
        self.back = NearestSearch(self.grid, clouds.points, met_by)

    def spans(self, groups: tuple[int, int], frames: tuple[int, int]) -> tuple[tuple[int, int], tuple[int, int]]:
        """Begin and count of the moving points of these groups, and of the points of these frames' clouds."""
        return span(self._offsets, *groups), span(self._cloud_offsets, *frames)

    def find(self, groups: tuple[int, int], frames: tuple[int, int]) -> None:
        """Sort the moving points of ``groups`` and answer both ways; ``frames`` are those whose clouds they meet."""
        moving, cloud = self.spans(groups, frames)
        self.grid.build(*groups)
        self.forth.run(*moving)
        self.back.run(*cloud)

    def forget(self) -> None:
        """Let every search begin anew, after positions that were no numbers."""
        for part in (self.forth, self.back, self.clouds, self.grid):
            part.forget()
