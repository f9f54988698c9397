"""What a test takes for granted to be there: said once, checked, and known to the type checker."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

from warpdef.appearance import Appearance
from warpdef.files import read_mesh

T = TypeVar("T")


def present(value: T | None) -> T:
    """The value itself, which must not be None."""
    assert value is not None
    return value


def look_of(path: Path) -> Appearance:
    """Colours and texture coordinates of a mesh file that has some."""
    return present(read_mesh(path).appearance)
