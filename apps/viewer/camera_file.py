"""A camera kept in a file: where it stands in the input's units, so that other results of one input are seen alike."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING

from warpdef.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from warpdef.apps.viewer.camera import Camera

_PLACES = ("position", "focus", "up")


def save_camera(path: Path, camera: Camera, origin: np.ndarray) -> None:
    """Write it as JSON.

    Args: origin: what was taken off all places of the view, shape (3,).

    Raises:
        InputError: the file cannot be written.
    """
    from warpdef.files.disk import replacing

    content = {"position": camera.position + origin, "focus": camera.focus + origin, "up": camera.up}
    lists = {name: [float(x) for x in value] for name, value in content.items()}
    with replacing(path) as stream:
        stream.write((json.dumps({**lists, "lift": camera.lift}, indent=2) + "\n").encode())


def load_camera(path: Path, origin: np.ndarray) -> Camera:
    """Read it back.

    Raises:
        InputError: no such file, or not a camera.
    """
    import numpy as np

    from warpdef.apps.viewer.camera import Camera
    from warpdef.files.disk import read_bytes

    try:
        content = json.loads(read_bytes(path))
        position, focus, up = (np.array([float(x) for x in content[name]]) for name in _PLACES)
        lift = float(content.get("lift", 0.0))
    except (ValueError, TypeError, KeyError, AttributeError):
        position = focus = up = np.zeros(0)
        lift = math.nan
    shapes = [x.shape == (3,) and bool(np.isfinite(x).all()) for x in (position, focus, up)]
    # It must look somewhere, and up must be another direction.
    if not all(shapes) or not abs(lift) < 1.0 or not np.linalg.norm(np.cross(position - focus, up)) > 0.0:
        raise InputError(
            f"{path}: expected a camera as the key k of a view's window writes it, with three numbers each for "
            f"{', '.join(_PLACES)}, got something else; write it anew"
        )
    distance = float(np.linalg.norm(position - focus))
    return Camera(position - origin, focus - origin, up / np.linalg.norm(up), distance, lift)
