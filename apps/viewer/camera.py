"""Where the camera stands: far enough that nothing of the motion leaves the picture."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np

VIEW_ANGLE = 30.0
"""Vertical opening of the camera, degrees."""
LIFT = 0.07
"""How far the scene is raised, in halves of the height: slider and colour bar stand below it, the title above."""
MARGIN = 1.2
"""Room around the box."""
AZIMUTH, ELEVATION = 25.0, 12.0
"""The usual place, degrees."""


@dataclass(frozen=True)
class Camera:
    """position, focus: points in input units (3,); up: unit vector (3,); distance: between the two points."""

    position: np.ndarray
    focus: np.ndarray
    up: np.ndarray
    distance: float


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


def box_extent(bounds: tuple[np.ndarray, np.ndarray], up: str, azimuth: float) -> list[float]:
    """Half the width, height and depth of a box seen from an azimuth, in its own units."""
    import numpy as np

    half = (bounds[1] - bounds[0]) / 2.0
    return [float(np.abs(axis) @ half) for axis in camera_axes(up, azimuth)]


def fit_camera(
    bounds: tuple[np.ndarray, np.ndarray], up: str, aspect: float, *, turn: float = 0.0, all_round: bool = False
) -> Camera:
    """A camera that sees the whole box.

    Args:
        bounds: low and high corner of all frames.
        up: "y" or "z".
        aspect: width over height of a pane.
        turn: degrees about the up axis from the usual place.
        all_round: stand so far that the box fits from every side, for a turntable.
    """
    centre = (bounds[0] + bounds[1]) / 2.0
    opening = math.tan(math.radians(VIEW_ANGLE / 2.0))
    distance = 0.0
    for azimuth in range(0, 360, 15) if all_round else (AZIMUTH + turn,):
        width, height, depth = box_extent(bounds, up, azimuth)
        distance = max(distance, depth + max(height / opening, width / (opening * aspect)) * MARGIN)
    distance = distance or 1.0
    _, above, back = camera_axes(up, AZIMUTH + turn)
    return Camera(centre + distance * back, centre, above, distance)
