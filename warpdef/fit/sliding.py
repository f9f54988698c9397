"""A mesh that hangs over the end of its cloud, slid back along itself.

A wave that runs along a snake, a flag or a falling cloth looks to nearest points like the whole moving along: planes
let it slide, and at the far end the mesh leaves its points, where nothing draws it back, as it may just not be seen. If
the cloud shows that it ends there (``quality.overhang``), ends pull: surface far from all points to the nearest one,
and points far from the mesh at what is nearest of it, both in their own direction; planes keep the rest on its points,
and stiff pieces of the mesh (``embedded``) carry the pull from one end to the other.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from warpdef.errors import MissingPackageError
from warpdef.fit.bending import STILL, Bending, SeenCloud
from warpdef.fit.embedded import Pose
from warpdef.geometry.sampling import mean_spacing
from warpdef.quality.coverage import Coverage, measure_coverage
from warpdef.quality.overhang import overhang_share, surplus_share

SCHEDULE = ((0.3, 15), (0.1, 15), (0.03, 10))
"""Rigidity, and Gauss-Newton steps with it at most."""
END, ON = 4.0, 6.0
"""Distances, in point spacings: from which surface and points pull as ends do; up to which planes hold them."""
POINT_WEIGHT = 0.5
"""Of a point's plane against a vertex's."""
TANGENTIAL = 0.003
"""Weight along the surface against one across it: what planes leave open, as a sheet's way sidewards, stays."""
HANGING, SURPLUS = 0.003, 0.01
"""Shares of the surface above which a frame is slid: a third of the surplus that makes it doubtful."""
WORTH = 0.003
"""Share of the vertices ``END`` spacings from all points below which neither is asked for."""

GAIN = 0.005
"""Share by which a slide must better a frame to be kept: what hangs over by a hair is not worth its way so far."""


class Hanging:
    """How a frame is told to hang over: by its cloud, and by what the keyframe's shows of the mesh there.

    Args:
        points, vertices, faces: the keyframe's points (N, 3) and mesh, vertices (V, 3).
    """

    def __init__(self, points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> None:
        self._keyframe = points, vertices, faces

    @cached_property
    def keyframe(self) -> Coverage:
        """The keyframe's mesh against its cloud; measured where a frame asks for it."""
        return measure_coverage(*self._keyframe)

    def told(self, points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> bool:
        """Whether the mesh of another frame has surface where its points say that there is none."""
        if far_share(points, vertices) < WORTH:
            return False
        try:
            coverage = measure_coverage(points, vertices, faces)
        except MissingPackageError:  # without exact distances no frame is judged either, and the run says so
            return False
        if overhang_share(points, vertices, faces, coverage) > HANGING:
            return True
        return (surplus_share(coverage, self.keyframe) or 0.0) > SURPLUS


def far_share(points: np.ndarray, vertices: np.ndarray) -> float:
    """Share of vertices (V, 3) farther than ``END`` spacings from all of the points (N, 3)."""
    from scipy.spatial import cKDTree

    tree = cKDTree(points)
    return float(np.mean(tree.query(vertices)[0] > END * mean_spacing(points, tree)))


def slide(bending: Bending, cloud: SeenCloud, start: Pose) -> Pose:
    """The pose whose ends are those of a cloud, looked for from another; the side of its normals is not asked."""
    from scipy.spatial import cKDTree

    tree, s = cKDTree(cloud.points), cloud.spacing
    pose, placed, chosen = start, bending.place(start), bending.matched
    for rigidity, steps in SCHEDULE:
        for _ in range(steps):
            away, nearest = tree.query(placed[chosen])
            left, vertex = cKDTree(placed).query(cloud.points)
            far, beyond = away > END * s, left > END * s
            matches = [
                (chosen, nearest, cloud.normals[nearest], (away < ON * s) * 1.0),
                (vertex, np.arange(len(vertex)), cloud.normals, (left < ON * s) * POINT_WEIGHT),
            ]
            for at, to in ((chosen[far], nearest[far]), (vertex[beyond], np.flatnonzero(beyond))):
                way = cloud.points[to] - placed[at]
                way /= np.linalg.norm(way, axis=1, keepdims=True)
                matches.append((at, to, way, np.ones(len(at))))
            at, to, normal, weight = (np.concatenate(part) for part in zip(*matches, strict=True))
            pose = bending.graph.step(bending.rest, pose, at, cloud.points[to], normal, rigidity, TANGENTIAL, weight)
            before, placed = placed, bending.place(pose)
            if np.abs(placed - before).max() < STILL * s:
                break
    return pose
