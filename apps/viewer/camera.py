"""Where the camera stands: far enough that nothing of the motion leaves the picture."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np

VIEW_ANGLE = 30.0
"""Vertical opening of the camera, degrees."""
AZIMUTH, ELEVATION = 25.0, 12.0
"""The usual place, degrees."""


@dataclass(frozen=True)
class Stand:
    """Where the camera stands: degrees about the up axis and above the ground, and how much nearer than fitted."""

    azimuth: float = AZIMUTH
    elevation: float = ELEVATION
    zoom: float = 1.0


@dataclass(frozen=True)
class Room:
    """Parts of a pane's height above and below the motion, where something is written, and of its width beside it."""

    top: float = 0.06
    bottom: float = 0.16
    side: float = 0.03

    @property
    def lift(self) -> float:
        """How far the motion's middle is above the pane's, in halves of the height."""
        return self.bottom - self.top


@dataclass(frozen=True)
class Camera:
    """position, focus: points in input units (3,); up: unit vector (3,); distance: between the two points; lift: how
    far the focus is above the picture's middle, in halves of its height."""

    position: np.ndarray
    focus: np.ndarray
    up: np.ndarray
    distance: float
    lift: float = 0.0


def camera_axes(up: str, azimuth: float, elevation: float = ELEVATION) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit vectors to the right, upwards and from the scene to the camera, for angles in degrees.

    Azimuth 0 looks along -z where y is up, and along +y where z is up.
    """
    import numpy as np

    a, e = math.radians(azimuth), math.radians(elevation)
    right = np.array([math.cos(a), 0.0, -math.sin(a)])
    back = np.array([math.sin(a) * math.cos(e), math.sin(e), math.cos(a) * math.cos(e)])
    above = np.cross(back, right)
    if up == "z":  # y up turned a quarter about x
        right, above, back = (np.array([v[0], -v[2], v[1]]) for v in (right, above, back))
    return right, above, back


def fit_camera(
    points: np.ndarray,
    up: str,
    aspect: float,
    *,
    stand: Stand | None = None,
    room: Room | None = None,
    turn: float = 0.0,
    all_round: bool = False,
) -> Camera:
    """The nearest camera that sees all points, each in its own depth, with room around them.

    A point (x, y, z) in the camera's axes is within the opening k of a camera at (cx, cy, cz) if
    |x - cx| <= k (cz - z); so cz >= (max(x + k z) + max(-x + k z)) / (2 k), and cx halves what is over.

    Args:
        points: what is to be seen, in input units, shape (N, 3).
        up: "y" or "z".
        aspect: width over height of a pane.
        stand: None: the usual one.
        room: None: the usual one.
        turn: degrees about the up axis from there.
        all_round: stand so far that the points are seen from every side, about one focus, for a turntable.
    """
    import numpy as np

    stand, room = stand or Stand(), room or Room()
    opening = math.tan(math.radians(VIEW_ANGLE / 2.0))
    openings = (opening * aspect * (1.0 - 2.0 * room.side), opening * (1.0 - room.top - room.bottom))
    centre = (points.min(axis=0) + points.max(axis=0)) / 2.0
    distance, aside = 0.0, np.zeros(2)
    angles = [float(a) for a in range(0, 360, 15)] if all_round else [stand.azimuth + turn]
    for azimuth in angles:
        axes = camera_axes(up, azimuth, stand.elevation)
        x, y, z = ((points - centre) @ axis for axis in axes)
        # Nothing may lie behind the camera, flat things seen along their plane neither.
        distance = max(distance, float(z.max()) + 0.1 * float(np.ptp(points, axis=0).max()))
        for k, (across, slope) in enumerate(zip((x, y), openings, strict=True)):
            plus, minus = float((across + slope * z).max()), float((slope * z - across).max())
            if all_round:
                distance = max(distance, max(plus, minus) / slope)
            else:
                distance, aside[k] = max(distance, (plus + minus) / (2.0 * slope)), (plus - minus) / 2.0
    distance = (distance or 1.0) / stand.zoom
    right, above, back = camera_axes(up, stand.azimuth + turn, stand.elevation)
    focus = centre + aside[0] * right + aside[1] * above
    return Camera(focus + distance * back, focus, above, distance, room.lift)


def turned(camera: Camera, up: str, degrees: float) -> Camera:
    """The camera gone around its focus, about the axis that points up."""
    import numpy as np

    a = math.radians(degrees)
    turn = np.array([[math.cos(a), 0.0, math.sin(a)], [0.0, 1.0, 0.0], [-math.sin(a), 0.0, math.cos(a)]])
    if up == "z":
        swap = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # z up to y up
        turn = swap.T @ turn @ swap
    position = camera.focus + turn @ (camera.position - camera.focus)
    return Camera(position, camera.focus, turn @ camera.up, camera.distance, camera.lift)


def pixels_per_length(distance: float, height: int) -> float:
    """How many pixels of a picture of that height a length of 1 has at that distance from the camera."""
    return height / (2.0 * distance * math.tan(math.radians(VIEW_ANGLE / 2.0)))


def seen_aspect(points: np.ndarray, up: str, stand: Stand, room: Room) -> float:
    """Width over height of the narrowest pane in which points, shape (N, 3), are as large as in any wider one."""
    # Wider than all of it, the height alone says where the camera stands.
    wide = fit_camera(points, up, 100.0, stand=stand, room=room).distance
    low, high = 0.01, 100.0
    while high - low > 0.005 * low:
        middle = math.sqrt(low * high)
        fits = fit_camera(points, up, middle, stand=stand, room=room).distance <= wide * 1.001
        low, high = (low, middle) if fits else (middle, high)
    return high
