"""Which rows of an array are points: a truth value a row, for clouds padded to one length and images of points.

Only names that can mean one thing are taken (``valid``). A ``mask`` is not: it may mark the points, or what is none.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from warpdef.errors import InputError
from warpdef.files.numpy_files import NUMBERS, Npz

VALID_NAMES = ("valid", "valids", "is_valid", "valid_mask", "validity")
UNCLEAR_NAMES = ("mask", "masks", "point_mask", "points_mask", "invalid")


def read_valid(npz: Npz, names: Sequence[str], shapes: Sequence[tuple[int, ...]]) -> np.ndarray | None:
    """The first array of those names that the archive holds, as truth values; None where it holds none.

    Args:
        shapes: those that it may have.

    Raises:
        InputError: another shape, or values that are neither true nor false.
    """
    name = next((name for name in names if name in npz), "")
    if not name:
        return None
    valid = npz.array(name, NUMBERS + "b")
    if valid.shape not in shapes:
        expected = " or ".join(map(str, dict.fromkeys(shapes)))
        raise InputError(f"{npz.path}: {name}: expected shape {expected}, a value a point, got {valid.shape}")
    if valid.dtype.kind != "b" and not np.isin(valid, (0, 1)).all():
        raise InputError(
            f"{npz.path}: {name}: expected true or false, 1 or 0, got other numbers; compare them with a bound, as in "
            f"{name} > 0.5, or leave the array out"
        )
    return valid.astype(bool)


def mask_notes(npz: Npz, valid: np.ndarray | None) -> list[str]:
    """Warnings: how many rows a mask leaves out, and masks that are not applied as they could mean either."""
    notes = []
    if valid is not None and not valid.all():
        notes.append(f"{1 - valid.mean():.1%} of the rows of points left out, as 'valid' says")
    unclear = [name for name in UNCLEAR_NAMES if name in npz]
    if unclear and valid is None:
        notes.append(
            f"the array '{unclear[0]}' is not applied: it may mark the points, or what is none; save it as 'valid', "
            "true for points"
        )
    return notes
