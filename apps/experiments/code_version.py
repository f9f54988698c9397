"""Which code made a result: results of other code are not taken for finished, and not mixed into one table."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import warpdef

_NO_NUMBERS = ("apps", "export")
"""Folders of the library that change no result of an experiment."""


@cache
def code_version() -> str:
    """The version, and a digest of the library's and the kernels' source files; on every machine the same."""
    # Installed from a checkout the kernels are a folder of their own.
    folders = [_folder(name) for name in ("warpdef", "warpdef.kernels")]
    return f"{warpdef.__version__}+{digest(folders)}"


def _folder(name: str) -> Path:
    spec = find_spec(name)
    assert spec is not None and spec.origin is not None  # it is a package of this program
    return Path(spec.origin).parent


def digest(folders: Sequence[Path]) -> str:
    """Twelve digits over names and contents of all Python files; kernels count once, wherever they are installed."""
    files: dict[str, Path] = {}
    for folder in folders:
        for path in folder.rglob("*.py"):
            parts = path.relative_to(folder).parts
            if parts[0] not in _NO_NUMBERS:
                name = "/".join(parts if parts[0] == "kernels" else (folder.name, *parts))
                files[name] = path
    total = hashlib.sha256()
    for name in sorted(files):
        total.update(f"{name}\0".encode() + files[name].read_bytes() + b"\0")
    return total.hexdigest()[:12]
