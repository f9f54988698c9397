"""Does a template of the user's own lie on its keyframe? And if not: how large, how far, how turned it is.

A template in another pose, or a cloud that shows only a part of it, is a user's right: a template is judged only where
many of the keyframe's points are far from it. Then it is refused if its size differs by more than ``SIZE``, if it lies
more than ``AWAY`` sizes away, or if it would fit far better once it is turned. ``align`` brings it there: one rotation,
one shift and one scale for all vertices, by iterated closest points with the similarity of Umeyama (1991), from the 24
rotations that map axes to axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from warpdef.errors import InputError
from warpdef.mesh import TriMesh

FAR_OFF = 0.2  # share of the keyframe's points far from the template from which its place is questioned
SIZE = 1.8
AWAY = 0.6
TURNED = 0.4  # distance after turning over that before
UNITS = (10.0, 100.0, 1000.0, 2.54, 25.4, 3.281, 30.48, 304.8, 39.37, 12.0)  # metric, inches and feet
SAMPLES = 800
COARSE, FINE, FINALISTS = 6, 40, 4  # rounds of closest points for all starts, and for the best of them


@dataclass(frozen=True)
class Placement:
    """x -> scale * rotation @ x + shift, and the mean distance that it leaves, both ways."""

    scale: float
    rotation: np.ndarray
    shift: np.ndarray
    distance: float

    def apply(self, points: np.ndarray) -> np.ndarray:
        """Points (N, 3), placed."""
        return self.scale * np.asarray(points, dtype=np.float64) @ self.rotation.T + self.shift

    def told(self) -> str:
        """In words."""
        cosine = (np.trace(self.rotation) - 1.0) / 2.0
        degrees = float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
        return f"moved, scaled by {self.scale:.4g} and turned by {degrees:.0f} degrees"


def require_place(mesh: TriMesh, points: np.ndarray, missed_share: float, seed: int) -> None:
    """Refuse a template that lies elsewhere, has other units or is turned.

    Args:
        mesh: the template. points: its keyframe, shape (N, 3), the same units.
        missed_share: share of the points far from it, as the quality gate measured it.

    Raises:
        InputError: it is one of these; the message says which, and by how much.
    """
    if missed_share <= FAR_OFF:
        return
    surface, cloud = _samples(mesh, points, seed)
    (middle, radius), (there, its_radius) = _ball(cloud), _ball(surface)
    larger = its_radius / radius
    align = "put it there by hand, or have it placed with --align-template"
    if not 1.0 / SIZE < larger < SIZE:
        factor, what = (larger, "large") if larger > 1 else (1.0 / larger, "small")
        raise InputError(
            f"--template: expected a template on its keyframe, got one {_round(factor)} times as {what} as its points: "
            f"are the units others? {align}"
        )
    away = float(np.linalg.norm(there - middle)) / (2.0 * radius)
    if away > AWAY:
        raise InputError(
            f"--template: expected a template on its keyframe, got one that lies elsewhere, {away:.2g} times its size "
            f"away: is it another frame or another coordinate system? {align}"
        )
    best = find_placement(mesh, points, seed)
    if best.distance < TURNED * _distance(surface, cloud):
        raise InputError(
            f"--template: expected a template on its keyframe, got one that would lie on it if {best.told()}: are the "
            f"axes others? {align}"
        )


def align(mesh: TriMesh, points: np.ndarray, seed: int) -> tuple[TriMesh, str]:
    """The template placed on its keyframe, and in words what was done to it."""
    best = find_placement(mesh, points, seed)
    return TriMesh(best.apply(mesh.vertices), mesh.faces), best.told()


def find_placement(mesh: TriMesh, points: np.ndarray, seed: int) -> Placement:
    """The similarity that brings a template nearest to a cloud (N, 3)."""
    surface, cloud = _samples(mesh, points, seed)
    (middle, radius), (there, its_radius) = _ball(cloud), _ball(surface)
    unit = (surface - there) / its_radius
    target = (cloud - middle) / radius
    starts = [_closest_points(unit, target, Placement(1.0, turn, np.zeros(3), np.inf), COARSE) for turn in _turns()]
    finalists = sorted(starts, key=lambda p: p.distance)[:FINALISTS]
    best = min((_closest_points(unit, target, p, FINE) for p in finalists), key=lambda p: p.distance)
    # Back from both unit balls.
    scale = best.scale * radius / its_radius
    shift = middle + radius * best.shift - scale * best.rotation @ there
    return Placement(scale, best.rotation, shift, best.distance * radius)


def _closest_points(source: np.ndarray, target: np.ndarray, start: Placement, rounds: int) -> Placement:
    from scipy.spatial import cKDTree

    tree, placed = cKDTree(target), start
    for _ in range(rounds):
        moved = placed.apply(source)
        # Both ways, so that neither may shrink into the other.
        to, back = tree.query(moved)[1], cKDTree(moved).query(target)[1]
        placed = _similarity(np.concatenate([source, source[back]]), np.concatenate([target[to], target]))
    moved = placed.apply(source)
    return Placement(placed.scale, placed.rotation, placed.shift, _distance(moved, target))


def _similarity(source: np.ndarray, target: np.ndarray) -> Placement:
    """Least squares over pairs (N, 3), Umeyama (1991)."""
    from_mean, to_mean = source.mean(axis=0), target.mean(axis=0)
    a, b = source - from_mean, target - to_mean
    u, strength, v = np.linalg.svd(b.T @ a)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(v))])
    rotation = (u * sign) @ v
    scale = float((strength * sign).sum() / max((a**2).sum(), 1e-300))
    return Placement(scale, rotation, to_mean - scale * rotation @ from_mean, np.inf)


def _turns() -> list[np.ndarray]:
    """The 24 rotations that map axes to axes."""
    made = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        turn = np.zeros((3, 3))
        turn[range(3), order] = signs
        if np.linalg.det(turn) > 0:
            made.append(turn)
    return made


def _samples(mesh: TriMesh, points: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    from warpdef.geometry.sampling import sample_surface

    rng = np.random.default_rng(seed)
    cloud = points if len(points) <= SAMPLES else points[rng.choice(len(points), SAMPLES, replace=False)]
    return sample_surface(mesh.vertices, mesh.faces, SAMPLES, rng)[0], np.asarray(cloud, dtype=np.float64)


def _ball(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Middle, and root mean square distance from it."""
    middle = points.mean(axis=0)
    return middle, float(np.sqrt(((points - middle) ** 2).sum(axis=1).mean()))


def _distance(a: np.ndarray, b: np.ndarray) -> float:
    from scipy.spatial import cKDTree

    return float(cKDTree(a).query(b)[0].mean() + cKDTree(b).query(a)[0].mean()) / 2


def _round(factor: float) -> str:
    """The factor between two usual units where it is one within what samples differ."""
    unit = next((unit for unit in UNITS if abs(factor / unit - 1.0) < 0.06), None)
    return f"{unit if unit is not None else factor:.4g}" if unit is not None or factor < 1e4 else f"{factor:.2g}"
