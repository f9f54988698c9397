"""Where compiled kernels are kept: Warp's own place, or a temporary one where nothing can be written there."""

from __future__ import annotations

import atexit
import contextlib
import logging
import os
import secrets
import shutil
import tempfile
from pathlib import Path

import warp as wp

_PROBE = bytes(1 << 20)  # of the size of a module: a full disk must not look like a free one
_told: list[str] = []


def cache_warnings() -> list[str]:
    """What there was to say of the cache in this process, for reports."""
    return list(_told)


def ensure_cache() -> None:
    """Before Warp is initialised: see that kernels can be compiled, in a temporary place if nowhere else.

    What Warp's own place holds already is used from there. The warning goes to the logger ``warpdef``.
    """
    if wp.config.kernel_cache_dir is not None:  # chosen by the program, or Warp runs already
        return
    folder = _default()
    trouble = _trouble(folder)
    if not trouble:
        return
    instead = Path(tempfile.mkdtemp(prefix="warpdef-kernels-"))
    atexit.register(shutil.rmtree, instead, ignore_errors=True)
    _link_contents(folder, instead / wp.config.version)
    wp.config.kernel_cache_dir = str(instead)
    _told.append(
        f"kernels cannot be kept in {folder} ({trouble}): those that it lacks are compiled anew in every process; set "
        "WARP_CACHE_PATH to a folder that can be written"
    )
    logging.getLogger("warpdef").warning("warpdef: warning: %s", _told[-1])


def _default() -> Path:
    """Where Warp would keep them, on POSIX systems."""
    chosen = os.environ.get("WARP_CACHE_PATH")
    if chosen:
        return Path(os.path.realpath(chosen)) / wp.config.version
    home = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    return Path(home) / "warp" / wp.config.version


def _trouble(folder: Path) -> str:
    """Why nothing can be written there; empty if it can."""
    if os.name != "posix":
        return ""
    if not folder.is_absolute():
        return "there is no home folder"
    probe = folder / f"probe-{os.getpid():x}-{secrets.token_hex(4)}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe.write_bytes(_PROBE)
        return ""
    except OSError as error:
        return error.strerror or type(error).__name__
    finally:
        with contextlib.suppress(OSError):
            probe.unlink(missing_ok=True)


def _link_contents(source: Path, target: Path) -> None:
    with contextlib.suppress(OSError):
        target.mkdir()
        for kept in source.iterdir():
            if kept.is_dir():
                (target / kept.name).symlink_to(kept)
