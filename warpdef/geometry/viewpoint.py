"""Where clouds were seen from: the place of the one depth camera that stood still, if there was one.

Seen from its camera a cloud has one layer: of points that lie side by side in the picture few differ in depth. All
around a body there are two, whatever the direction. A camera in front and one behind would see the same layers; but
what is seen of a body bulges towards who sees it. The direction fixes the side of every normal, where a field made for
closed bodies (``cloud_normals``) has to guess, and does so from frame to frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdef.geometry.cloud_planes import pca_normals, turned_to

if TYPE_CHECKING:
    import warp as wp

FRAMES = 5  # asked, spread over the sequence
POINTS_ASKED = 2000  # points of each
VIEWS = 32  # over half of the sphere, 20 degrees apart; then finer ones around the best
BESIDE = 6  # neighbours in the picture
STEP = 3.0  # least depth between two of them that lie on two layers, in their distance there or the spacing there, ...
APART = 4.0  # ... and least distance, in spacings: a steep place is no step
LAYERED_MAX = 0.1
"""Share of steps up to which a cloud has one layer: 0.00 to 0.09 from one camera, 0.12 from two, 0.35 all around."""
PLAUSIBLE = 0.15  # the same for the nearest of the first directions
AROUND = 32  # neighbours against whose middle a point bulges
EVEN = 8  # neighbours in the picture that tell its density there
TRIES = 70  # places of the camera
NEAREST, FARTHEST = 1.25, 25.0  # of the camera, in the longest side of what it saw
NEARBY = 0.05  # least depth in a picture, in the distance of its centre
AROUND_GAP = 3.0  # times its distance to the nearest point in the picture within which points lie around a place
BULGE_MIN = 0.1  # mean over points, in units of the mean size: a sheet, waved about, has no outside


def viewing_direction(clouds: Sequence[np.ndarray]) -> np.ndarray | None:
    """Unit vector towards the camera that saw all clouds, shape (3,); None if they do not look so.

    Args:
        clouds: T arrays (N_t, 3), any units. Some frames and points speak for all.
    """
    chosen = np.unique(np.linspace(0, len(clouds) - 1, min(FRAMES, len(clouds))).round().astype(int))
    samples = [_sample(clouds[t]) for t in chosen]
    middle = samples[len(samples) // 2]
    half = half_sphere(VIEWS)
    apart = [_apart(s) for s in samples]
    layered = [layered_share(middle, d, apart[len(samples) // 2]) for d in half]
    if min(layered) > PLAUSIBLE:
        return None
    best = half[int(np.argmin(layered))]
    for reach in (0.2, 0.1):
        around = best + reach * np.concatenate([np.zeros((1, 3)), *_across(best)])
        around /= np.linalg.norm(around, axis=1, keepdims=True)
        best = around[int(np.argmin([np.mean(_layered_shares(samples, d, apart)) for d in around]))]
    if max(_layered_shares(samples, best, apart)) > LAYERED_MAX:
        return None
    bulge = float(np.mean([_bulge(s, best) for s in samples]))
    if abs(bulge) < BULGE_MIN:
        return None
    return best if bulge > 0 else -best


def seen_normals(
    points: np.ndarray,
    view: np.ndarray,
    neighbours: int,
    device: wp.Device | None = None,
    asked: np.ndarray | None = None,
) -> np.ndarray:
    """Unit normals of local planes, shape (N, 3), on the side of ``view``, shape (3,); arguments as ``pca_normals``."""
    normals = pca_normals(points, neighbours, device, asked)
    return turned_to(normals, np.broadcast_to(view, normals.shape))


def camera_place(clouds: Sequence[np.ndarray], direction: np.ndarray) -> np.ndarray:
    """Where the camera stands that saw all clouds from a rough direction, shape (3,), the clouds' units.

    A camera has a pixel for each point, so that in its picture they lie equally dense, however steep or far a surface
    is; from anywhere else what is steep is dense. The place of the most even density is looked for, by Nelder and
    Mead's simplex. A camera farther away than ``FARTHEST`` times the clouds' size is put there.

    Args:
        clouds: T arrays (N_t, 3). Some frames and points speak for all. direction: see ``viewing_direction``.
    """
    from scipy.optimize import minimize
    from scipy.spatial import cKDTree

    chosen = np.unique(np.linspace(0, len(clouds) - 1, min(FRAMES, len(clouds))).round().astype(int))
    samples = [_sample(clouds[t]) for t in chosen]
    flat = np.concatenate(samples)
    centre, size = flat.mean(axis=0), float(np.ptp(flat, axis=0).max())
    across = _across(direction)[0][:2]

    def place(x: np.ndarray) -> np.ndarray:
        towards = direction + x[:2] @ across
        return centre + towards / np.linalg.norm(towards) * size / np.clip(x[2], 1.0 / FARTHEST, 1.0 / NEAREST)

    def unevenness(x: np.ndarray) -> float:
        eye = place(x)
        spread = 0.0
        for points in samples:
            picture = Picture.across(eye, centre, points)
            around = cKDTree(picture).query(picture, k=[min(EVEN + 1, len(points))])[0][:, 0]
            # Beyond the borders of what is seen there is nothing: there the density is low, from wherever.
            low, high = np.quantile(np.maximum(around, np.finfo(float).tiny), (0.1, 0.8))
            spread += float(np.log(high / low))
        return spread + 10.0 * max(1.0 / FARTHEST - x[2], x[2] - 1.0 / NEAREST, 0.0)

    start = np.array([0.0, 0.0, 0.5 / NEAREST])
    simplex = start + np.array([[0.0, 0.0, 0.0], [0.15, 0.0, 0.0], [0.0, 0.15, 0.0], [0.0, 0.0, 0.3 / NEAREST]])
    options = {"initial_simplex": simplex, "maxfev": TRIES, "xatol": 0.005, "fatol": 1e-4}
    return place(minimize(unevenness, start, method="Nelder-Mead", options=options).x)


@dataclass(frozen=True)
class Picture:
    """What a camera saw of some points, N of them. Lengths in it are those at the depth of ``centre``.

    eye, centre: (3,). tree: of the points in the picture. depth: from the camera's plane (N,).
    """

    eye: np.ndarray
    centre: np.ndarray
    tree: Any
    depth: np.ndarray

    @classmethod
    def of(cls, points: np.ndarray, eye: np.ndarray) -> Picture:
        """Of points (N, 3), seen from ``eye`` (3,)."""
        from scipy.spatial import cKDTree

        centre = points.mean(axis=0)
        view, distance = _view(eye, centre)
        return cls(eye, centre, cKDTree(cls.across(eye, centre, points)), distance - (points - centre) @ view)

    @staticmethod
    def across(eye: np.ndarray, centre: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Places (m, 3) in the picture, (m, 2); what lies in or behind the camera's plane is taken to be before it."""
        view, distance = _view(eye, centre)
        depth = np.maximum(distance - (places - centre) @ view, NEARBY * distance)
        return (places - centre) @ np.asarray(_across(view)[0][:2]).T * (distance / depth)[:, None]

    def contradicts(self, places: np.ndarray, room: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Places (m, 3) that it would have shown and did not: beside all points or before them by more than ``room``.

        Returns:
            Which they are (c,), places near them out of sight, behind the nearest point by half of the room, and the
            directions there, (c, 3) each.
        """
        view, distance = _view(self.eye, self.centre)
        picture, beside, nearest, depth = self._beside(places)
        before = self.depth[nearest] - depth
        which = np.flatnonzero((beside > room) | (before > room))
        # First across at its own depth, then along the ray there.
        sideways = np.where(beside > room, 1.0, 0.0)[:, None] * (self.tree.data[nearest] - picture)
        there = places + (sideways * (depth / distance)[:, None]) @ np.asarray(_across(view)[0][:2])
        there += (there - self.eye) * (np.maximum(before + 0.5 * room, 0.0) / depth)[:, None]
        way = (there - places)[which]
        return which, there[which], way / np.linalg.norm(way, axis=1, keepdims=True)

    def in_gaps(self, places: np.ndarray, reach: float, room: float, widest: float) -> np.ndarray:
        """Which places (m, 3) lie in a gap between points, (m,) bool: beside all by more than ``reach``, as deep as the
        nearest up to ``room``, and in no angle of ``widest`` radians, seen from there, without points near by."""
        picture, beside, nearest, depth = self._beside(places)
        found = (beside * depth > reach * _view(self.eye, self.centre)[1]) & (
            np.abs(self.depth[nearest] - depth) <= room
        )
        for i in np.flatnonzero(found):
            x, y = (self.tree.data[self.tree.query_ball_point(picture[i], AROUND_GAP * beside[i])] - picture[i]).T
            angle = np.sort(np.arctan2(y, x))
            found[i] = max(np.diff(angle).max(initial=0.0), angle[0] + 2.0 * np.pi - angle[-1]) < widest
        return found

    def _beside(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Places in the picture, how far beside the nearest point there, which it is, and how deep they are."""
        view, distance = _view(self.eye, self.centre)
        picture = self.across(self.eye, self.centre, places)
        beside, nearest = self.tree.query(picture)
        return picture, beside, nearest, distance - (places - self.centre) @ view


def _view(eye: np.ndarray, centre: np.ndarray) -> tuple[np.ndarray, float]:
    """Unit vector from a place towards the camera, and how far it is."""
    towards = eye - centre
    distance = float(np.linalg.norm(towards))
    return towards / distance, distance


def half_sphere(count: int) -> np.ndarray:
    """Directions spread evenly over half of the sphere, shape (count, 3): a spiral of the golden angle."""
    i = np.arange(count) + 0.5
    z, angle = i / count, np.pi * (1.0 + 5.0**0.5) * i
    r = np.sqrt(1.0 - z * z)
    return np.column_stack([r * np.cos(angle), r * np.sin(angle), z])


def _layered_shares(samples: list[np.ndarray], direction: np.ndarray, apart: list[float]) -> list[float]:
    return [layered_share(s, direction, a) for s, a in zip(samples, apart, strict=True)]


def _apart(points: np.ndarray) -> float:
    """Least distance between two points (N, 3) of two layers, by their spacing."""
    from scipy.spatial import cKDTree

    count = min(BESIDE, len(points) - 1)
    around = cKDTree(points).query(points, k=[count + 1])[0][:, 0]
    return float(APART * np.median(around) / np.sqrt(count))


def layered_share(points: np.ndarray, direction: np.ndarray, least: float | None = None) -> float:
    """Share of neighbours in the picture along ``direction`` (3,) of points (N, 3) that lie on another layer.

    ``least``: distance between two layers, where it is known from another direction.
    """
    from scipy.spatial import cKDTree

    u, v = _across(direction)[0][:2]
    picture, depth = points @ np.column_stack([u, v]), points @ direction
    count = min(BESIDE, len(points) - 1)
    distance, index = cKDTree(picture).query(picture, k=count + 1)
    # The spacing of a picture all over, by its own area: two layers must not make it finer.
    apart = np.maximum(distance[:, 1:], np.median(distance[:, -1]) / np.sqrt(count))
    step = np.abs(depth[index[:, 1:]] - depth[:, None]) > STEP * apart
    away = np.linalg.norm(points[index[:, 1:]] - points[:, None], axis=2)
    return float(np.mean(step & (away > (_apart(points) if least is None else least))))


def _bulge(points: np.ndarray, direction: np.ndarray) -> float:
    """Mean height over the middle of the points around, along normals on the side of ``direction``; -1 to 1."""
    from scipy.spatial import cKDTree

    normals = seen_normals(points, direction, 16)
    index = cKDTree(points).query(points, k=min(AROUND + 1, len(points)))[1]
    height = ((points - points[index].mean(axis=1)) * normals).sum(axis=1)
    return float(height.mean() / max(np.abs(height).mean(), 1e-300))


def _across(direction: np.ndarray) -> list[np.ndarray]:
    """Unit vectors across a direction: two at a right angle, between them, and all of these turned round; (8, 3)."""
    u = np.cross(direction, np.eye(3)[int(np.abs(direction).argmin())])
    u /= np.linalg.norm(u)
    v = np.cross(direction, u)
    slant = np.sqrt(0.5)
    ring = np.array([u, v, slant * (u + v), slant * (u - v)])
    return [ring, -ring]


def _sample(points: np.ndarray) -> np.ndarray:
    if len(points) <= POINTS_ASKED:
        return points
    return points[np.random.default_rng(0).choice(len(points), POINTS_ASKED, replace=False)]
