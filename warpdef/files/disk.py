"""The two ways in which every file is touched: read whole, and written so that no half file ever stands."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from warpdef.errors import InputError


def reason(error: BaseException) -> str:
    """The operating system's own words where there are any, on one line."""
    text = (error.strerror if isinstance(error, OSError) else None) or str(error) or type(error).__name__
    return " ".join(text.split())


def must_exist(path: Path) -> None:
    """Raise ``InputError`` where nothing stands at ``path``, or where it cannot be a path at all."""
    try:
        found = path.exists()
    except (OSError, ValueError) as error:
        raise InputError(f"{path!s:.200}: cannot be opened ({reason(error)}); check the path") from None
    if not found:
        raise InputError(f"{path!s:.200}: expected a file or folder, got nothing there; check the path")


def read_bytes(path: Path) -> bytes:
    """The whole file.

    Raises:
        InputError: missing, empty, not a file, or not readable.
    """
    try:
        data = path.read_bytes()
    except (OSError, ValueError, MemoryError) as error:
        raise InputError(f"{path}: cannot be read ({reason(error)}); check the path and its permissions") from None
    if not data:
        raise InputError(f"{path}: the file is empty; expected data; write it again")
    return data


def sibling(path: Path, ending: str) -> Path:
    """A fresh hidden name beside ``path``, so that a rename to ``path`` stays within one file system."""
    return path.with_name(f".{path.name}.{secrets.token_hex(4)}.{ending}")


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """Open a temporary sibling for writing; it takes the place of ``path`` only once it is complete.

    Raises:
        InputError: the file cannot be written; whatever stood at ``path`` is untouched.
    """
    temporary = sibling(path, "partial")
    try:
        with open(temporary, "xb") as stream:
            yield stream
        os.replace(temporary, path)
    except (OSError, ValueError) as error:
        temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise InputError(
                f"{path}: cannot be written ({reason(error)}); choose another place or free space"
            ) from None
        raise
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
