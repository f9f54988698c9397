"""E57 files of terrestrial scanners (ASTM E2807), all scans of a file together, by pye57: the extra ``warpdef[e57]``.

Positions, each scan in the place that its pose says, and colours where all scans have some.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from warpdef.cloud import byte_colors
from warpdef.errors import InputError, MissingPackageError
from warpdef.files.disk import Unpacking, read_bytes, reason
from warpdef.files.surface import Surface

_COLORS = ("colorRed", "colorGreen", "colorBlue")


def read_e57(path: Path) -> Surface:
    """Positions and colours of all scans of a file.

    Raises:
        InputError: not an E57 file, damaged, or without points.
        MissingPackageError: pye57 is not installed.
    """
    if not read_bytes(path).startswith(b"ASTM-E57"):
        raise InputError(f"{path}: expected an E57 file, got one that does not start as one; check its suffix")
    try:
        import pye57  # pyright: ignore[reportMissingImports] - the extra [e57], which checks need not have
    except ImportError as error:
        raise MissingPackageError(
            f"{path}: .e57 needs pye57 ({error}); install it: pip install 'warpdef[e57]', or convert to .ply"
        ) from error
    try:
        file = pye57.E57(str(path))
        try:
            scans = range(file.scan_count)
            # Packed by bits: a coordinate may take one.
            Unpacking(path, "convert it to .ply", times=64).take(
                24 * sum(file.get_header(i).point_count for i in scans)
            )
            fields = [set(file.get_header(i).point_fields) for i in scans]
            colored = all(set(_COLORS) <= given for given in fields)
            found = [file.read_scan(i, colors=colored, ignore_missing_fields=True, transform=True) for i in scans]
        finally:
            file.close()
        axes = ("cartesianX", "cartesianY", "cartesianZ")
        clouds = [np.stack([scan[axis] for axis in axes], axis=1).astype(np.float64) for scan in found]
        colors = [np.stack([scan[name] for name in _COLORS], axis=1) for scan in found] if colored else []
    except InputError:
        raise
    except Exception as error:  # of the library's own kinds, which have no common base
        raise InputError(f"{path}: cannot be read as .e57 ({reason(error):.120}); write it again") from None
    if not sum(map(len, clouds)):
        raise InputError(f"{path}: expected points, got none; export the scan again")
    shades = byte_colors(np.concatenate(colors), whole=True) if colors else None
    passed = ("intensity",) if any("intensity" in given for given in fields) else ()
    return Surface(np.concatenate(clouds), colors=shades, passed=passed)
