"""A human-like body in its rest pose: an implicit surface, and the mesh extracted from it.

Units are metres, y is up, the body faces +z, its left is +x. The arms point 45 degrees down and away from the torso so
that nothing fuses when the surface is extracted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warpdef.errors import MissingPackageError
from warpdef.mesh import TriMesh

EDGE_LENGTH = 0.0141
"""Target edge length of the mesh; gives about 10,000 vertices."""
GRID_SPACING = 0.016
"""Spacing of the grid on which the implicit surface is first evaluated."""

_ARM = np.array([np.sin(np.pi / 4), -np.cos(np.pi / 4), 0.0])
_SHOULDER = np.array([0.172, 1.405, -0.012])
_ELBOW = _SHOULDER + 0.285 * _ARM
_WRIST = _ELBOW + 0.250 * _ARM

JOINTS = {
    "pelvis": np.array([0.0, 0.96, 0.0]),
    "abdomen": np.array([0.0, 1.05, 0.0]),
    "chest": np.array([0.0, 1.19, -0.005]),
    "neck": np.array([0.0, 1.455, -0.02]),
    "head": np.array([0.0, 1.56, 0.0]),
    "upper_arm": _SHOULDER,
    "forearm": _ELBOW,
    "hand": _WRIST,
    "thigh": np.array([0.088, 0.905, 0.0]),
    "shin": np.array([0.101, 0.500, 0.006]),
    "foot": np.array([0.110, 0.085, -0.012]),
}
"""Where a bone starts in the rest pose, metres, shape (3,); paired bones for the left side."""


_Place = np.ndarray | tuple[float, float, float]


@dataclass(frozen=True)
class _RoundCone:
    """Two spheres and the cone tangent to both."""

    bone: str
    start: _Place
    end: _Place
    start_radius: float
    end_radius: float

    def distance(self, p: np.ndarray) -> np.ndarray:
        axis = np.subtract(self.end, self.start)
        length = np.linalg.norm(axis)
        from_start = p - self.start
        along = np.einsum("ij,j->i", from_start, axis / length)
        away = np.sqrt(np.maximum(np.einsum("ij,ij->i", from_start, from_start) - along**2, 0.0))
        slope = (self.start_radius - self.end_radius) / length
        # The nearest point of the medial segment is tilted by the cone's slope.
        at = np.clip(along + away * slope / np.sqrt(1.0 - slope**2), 0.0, length)
        return np.hypot(along - at, away) - (self.start_radius - slope * at)

    def bones(self, p: np.ndarray) -> np.ndarray:
        return np.full(len(p), self.bone)


@dataclass(frozen=True)
class _Ellipsoid:
    bone: str
    centre: tuple[float, float, float]
    radii: tuple[float, float, float]

    def distance(self, p: np.ndarray) -> np.ndarray:
        # First-order approximation; the sign is exact.
        q = (p - self.centre) / self.radii
        level = np.linalg.norm(q, axis=1)
        return level * (level - 1.0) / np.maximum(np.linalg.norm(q / self.radii, axis=1), 1e-9)

    def bones(self, p: np.ndarray) -> np.ndarray:
        return np.full(len(p), self.bone)


@dataclass(frozen=True)
class _Limb:
    """A tube around a straight axis, its radius and its forward offset cubic splines along the axis.

    profile: distance from the start, forward offset, radius (K, 3) metres
    """

    upper: str
    lower: str
    start: np.ndarray
    end: np.ndarray
    joint: float
    profile: tuple[tuple[float, float, float], ...]

    def _along(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        axis = np.subtract(self.end, self.start)
        length = np.linalg.norm(axis)
        return np.clip(np.einsum("ij,j->i", p - self.start, axis / length), 0.0, length), axis / length

    def distance(self, p: np.ndarray) -> np.ndarray:
        from scipy.interpolate import CubicSpline

        knots, forward, radius = np.transpose(self.profile)
        along, axis = self._along(p)
        offset, thickness = CubicSpline(knots, np.column_stack([forward, radius]))(along).T
        centre = self.start + along[:, None] * axis
        centre[:, 2] += offset
        return np.linalg.norm(p - centre, axis=1) - thickness

    def bones(self, p: np.ndarray) -> np.ndarray:
        return np.where(self._along(p)[0] < self.joint, self.upper, self.lower)


def _along_hand(distance: float, forward: float, outward: float = 0.0) -> np.ndarray:
    across = np.array([-_ARM[1], _ARM[0], 0.0])
    return _WRIST + distance * _ARM + [0.0, 0.0, forward] + outward * across


_JOIN_BLEND = 0.045
"""Width over which the seam between two groups of parts is rounded, metres."""
_SOLE_BLEND = 0.020
_MIRROR_BLEND = 0.006

_TRUNK = (
    _Ellipsoid("pelvis", (0.0, 0.955, -0.005), (0.145, 0.100, 0.095)),
    _Ellipsoid("pelvis", (0.070, 0.900, -0.045), (0.078, 0.082, 0.076)),
    _Ellipsoid("abdomen", (0.0, 1.09, 0.0), (0.123, 0.150, 0.086)),
    _Ellipsoid("chest", (0.0, 1.285, -0.012), (0.148, 0.165, 0.098)),
    _Ellipsoid("chest", (0.068, 1.325, 0.040), (0.082, 0.066, 0.044)),
    _RoundCone("chest", (0.02, 1.440, -0.028), (0.150, 1.402, -0.016), 0.046, 0.056),
)
_HEAD = (
    _RoundCone("neck", (0.0, 1.43, -0.024), (0.0, 1.57, 0.0), 0.060, 0.054),
    _Ellipsoid("head", (0.0, 1.652, 0.004), (0.076, 0.100, 0.096)),
    _Ellipsoid("head", (0.0, 1.600, 0.036), (0.054, 0.066, 0.056)),
    _RoundCone("head", (0.0, 1.655, 0.090), (0.0, 1.625, 0.106), 0.008, 0.013),
)
_ARM_PROFILE = (
    (0.000, 0.000, 0.061),
    (0.080, 0.000, 0.057),
    (0.160, 0.003, 0.049),
    (0.230, 0.002, 0.042),
    (0.285, 0.000, 0.039),
    (0.345, 0.000, 0.042),
    (0.430, 0.000, 0.036),
    (0.500, 0.000, 0.028),
    (0.535, 0.000, 0.026),
)
_LEG_PROFILE = (
    (0.000, 0.000, 0.080),
    (0.120, 0.008, 0.081),
    (0.250, 0.012, 0.070),
    (0.340, 0.012, 0.058),
    (0.400, 0.012, 0.053),
    (0.455, 0.002, 0.050),
    (0.530, -0.014, 0.054),
    (0.620, -0.016, 0.046),
    (0.720, -0.008, 0.035),
    (0.790, 0.000, 0.034),
)
_LEFT_ARM = (
    _Limb("upper_arm", "forearm", _SHOULDER, _WRIST, 0.285, _ARM_PROFILE),
    _RoundCone("hand", _WRIST, _along_hand(0.075, 0.020), 0.026, 0.021),
    _RoundCone("hand", _WRIST, _along_hand(0.075, -0.020), 0.026, 0.021),
    _RoundCone("hand", _along_hand(0.075, 0.020), _along_hand(0.158, 0.012), 0.020, 0.014),
    _RoundCone("hand", _along_hand(0.075, -0.020), _along_hand(0.152, -0.014), 0.020, 0.014),
    _RoundCone("hand", _along_hand(0.020, 0.018), _along_hand(0.090, 0.056), 0.020, 0.013),
)
_LEFT_LEG = (
    _Limb("thigh", "shin", JOINTS["thigh"], JOINTS["foot"], 0.405, _LEG_PROFILE),
    _RoundCone("foot", JOINTS["foot"], (0.113, 0.036, -0.034), 0.034, 0.037),
    _RoundCone("foot", (0.110, 0.072, -0.004), (0.126, 0.030, 0.150), 0.040, 0.030),
    _RoundCone("foot", (0.113, 0.034, -0.030), (0.122, 0.034, 0.100), 0.034, 0.038),
)
_GROUPS = ((_TRUNK, 0.060), (_HEAD, 0.030), (_LEFT_ARM, 0.012), (_LEFT_LEG, 0.024))
"""Groups of parts, each with the width over which its own seams are rounded."""
_PARTS = tuple(part for parts, _ in _GROUPS for part in parts)


def _fold(points: np.ndarray) -> np.ndarray:
    """Mirror to the left half; rounded at the middle so that the mirrored surface has no crease there."""
    return np.column_stack([np.sqrt(points[:, 0] ** 2 + _MIRROR_BLEND**2), points[:, 1], points[:, 2]])


def _smooth_minimum(a: np.ndarray, b: np.ndarray, width: float) -> np.ndarray:
    """The smaller of two distances, rounded by a quadratic where they differ by less than ``width``."""
    overlap = np.maximum(width - np.abs(a - b), 0.0)
    return np.minimum(a, b) - 0.25 / width * overlap**2


def body_distance(points: np.ndarray) -> np.ndarray:
    """Signed distance of the rest pose (approximate, negative inside) at points (N, 3) in metres; shape (N,)."""
    folded = _fold(np.asarray(points, dtype=np.float64))
    body = None
    for parts, blend in _GROUPS:
        group = parts[0].distance(folded)
        for part in parts[1:]:
            group = _smooth_minimum(group, part.distance(folded), blend)
        body = group if body is None else _smooth_minimum(body, group, _JOIN_BLEND)
    assert body is not None
    # Flat soles: cut by the ground plane.
    return -_smooth_minimum(-body, folded[:, 1] - 0.001, _SOLE_BLEND)


def nearest_bone(points: np.ndarray) -> list[str]:
    """The bone whose flesh each point (N, 3) is nearest to: N names, paired bones with the suffix ``_l`` or ``_r``."""
    folded = _fold(points)
    best = np.argmin([part.distance(folded) for part in _PARTS], axis=0)
    candidates = np.array([part.bones(folded) for part in _PARTS])
    bones = candidates[best, np.arange(len(points))]
    sides = np.where(points[:, 0] > 0, "_l", "_r")
    return [f"{bone}{side}" if JOINTS[bone][0] > 0 else str(bone) for bone, side in zip(bones, sides, strict=True)]


def _onto_surface(points: np.ndarray, steps: int) -> np.ndarray:
    """Newton steps along the gradient of the implicit function, by central differences."""
    h = 1e-4
    for _ in range(steps):
        shifted = [body_distance(points + h * e) - body_distance(points - h * e) for e in np.eye(3)]
        gradient = np.stack(shifted, axis=1) / (2.0 * h)
        squared = np.maximum(np.einsum("ij,ij->i", gradient, gradient), 0.05)
        points = points - (body_distance(points) / squared)[:, None] * gradient
    return points


def _grid_distance(nodes: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Signed distance on a grid, computed only near the surface; further away a value with the right sign."""
    every = 4
    coarse = body_distance(nodes.reshape(*shape, 3)[::every, ::every, ::every].reshape(-1, 3))
    coarse = coarse.reshape([-(-n // every) for n in shape])
    for axis in range(3):
        coarse = coarse.repeat(every, axis=axis)
    distance = coarse[: shape[0], : shape[1], : shape[2]].ravel()
    # A node is less than sqrt(3) * every spacings from its coarse one; the rest is for the ellipsoids' approximation.
    near = np.abs(distance) < 2.2 * every * GRID_SPACING
    distance[near] = body_distance(nodes[near])
    return distance


def body_mesh() -> TriMesh:
    """The rest pose as one closed mesh of nearly equilateral triangles, about 10,000 vertices, metres.

    Marching cubes, isotropic remeshing (Botsch and Kobbelt), and Newton steps back onto the implicit surface.

    Raises:
        MissingPackageError: gpytoolbox cannot be imported.
    """
    try:
        import gpytoolbox
    except ImportError as error:
        raise MissingPackageError(
            f"the built-in figure needs gpytoolbox to mesh its surface, which failed to import ({error}); "
            "install it: pip install gpytoolbox"
        ) from error
    low, high = np.array([-0.72, -0.06, -0.20]), np.array([0.72, 1.83, 0.24])
    shape = np.ceil((high - low) / GRID_SPACING).astype(int) + 1
    axes = [low[i] + GRID_SPACING * np.arange(shape[i]) for i in range(3)]
    # Node order of gpytoolbox.regular_cube_mesh: y slowest, z fastest; its marching cubes wants the counts as z, y, x.
    y, x, z = np.meshgrid(axes[1], axes[0], axes[2], indexing="ij")
    nodes = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    counts = (int(shape[2]), int(shape[1]), int(shape[0]))
    vertices, faces = gpytoolbox.marching_cubes(_grid_distance(nodes, y.shape), nodes, *counts, 0.0)
    vertices, faces = gpytoolbox.remesh_botsch(_onto_surface(vertices, 2), faces, 5, EDGE_LENGTH, True)
    return TriMesh(_onto_surface(vertices, 3), faces)
