"""The npz of an animation: what a result holds, and how to read it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from warpdef.export.animation import Animation


def write_npz_animation(animation: Animation, path: Path) -> None:
    """The arrays of a result, with what says how to read them; and where given ``vertex_colors``, ``uv``,
    ``normals``, ``frame_colors``."""
    arrays = {"vertices": animation.places, "faces": animation.faces, "fps": np.float64(animation.fps)}
    arrays |= {"names": np.array(animation.names, dtype=np.str_), "up": np.array(animation.up)}
    arrays["metres_per_unit"] = np.float64(animation.metres_per_unit)
    optional = {"vertex_colors": animation.colors, "uv": animation.uv, "normals": animation.normals}
    optional["frame_colors"] = animation.frame_colors
    arrays |= {name: array for name, array in optional.items() if array is not None}
    if animation.measured is not None:
        arrays[animation.measured.name] = animation.measured.values
    with open(path, "wb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)
