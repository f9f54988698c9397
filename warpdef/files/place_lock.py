"""One run at a time into one place: a lock beside it, ``.NAME.lock``, that names who holds it.

The holder keeps an advisory lock of the operating system on the file, which ends with its process, however that ends:
a file left behind by one that was killed is taken over. Where the file system knows no such locks, or the file is
another machine's, the file itself counts.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from warpdef.errors import InputError
from warpdef.files.disk import is_alive

try:
    import fcntl
except ImportError:  # not POSIX
    fcntl = None

_TRIES = 100


@contextlib.contextmanager
def claimed(place: Path | str) -> Iterator[None]:
    """Hold the place of a result for the block. Where no lock can be written there is none: nor can there be a result.

    Folders above the place are made where they are missing, and removed again where nothing came into them.

    Raises:
        InputError: another process holds it; the message names it.
    """
    try:
        path = Path(os.path.realpath(place))
        lock = path.with_name(f".{path.name}.lock")
        made = [p for p in path.parents if not p.exists()]
        os.makedirs(path.parent, exist_ok=True)
        descriptor = _take(lock, place)
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        lock, made, descriptor = None, [], None
    try:
        yield
    finally:
        if lock is not None and descriptor is not None:
            with contextlib.suppress(OSError):
                lock.unlink()  # before others can have it
            os.close(descriptor)
        with contextlib.suppress(OSError):
            for folder in made:
                folder.rmdir()


def _take(lock: Path, place: Path | str) -> int:
    """A descriptor that holds the lock."""
    for _ in range(_TRIES):
        descriptor = os.open(lock, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            state = _try_lock(descriptor)
            holder = _holder(descriptor)
            here = holder.get("host") == socket.gethostname()
            gone = here and (state == "free" or not is_alive(int(holder["process"])))
            if state == "taken" or (holder and not gone):
                raise InputError(_refusal(place, lock, holder, here))
            # Between opening and locking the holder may have ended and removed it: then the name is free.
            if os.path.samestat(os.fstat(descriptor), os.stat(lock)):
                _sign(descriptor)
                return descriptor
        except FileNotFoundError:
            pass
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)
    raise OSError(errno.EAGAIN, "the lock changes hands all the time")


def _try_lock(descriptor: int) -> str:
    """``free`` (and now ours), ``taken``, or ``unknown`` where the file system has no locks."""
    if fcntl is None:
        return "unknown"
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return "taken" if error.errno in (errno.EAGAIN, errno.EACCES) else "unknown"
    return "free"


def _sign(descriptor: int) -> None:
    since = time.strftime("%Y-%m-%d %H:%M:%S")
    text = json.dumps({"process": os.getpid(), "host": socket.gethostname(), "since": since})
    os.ftruncate(descriptor, 0)
    os.pwrite(descriptor, text.encode(), 0)


def _holder(descriptor: int) -> dict[str, Any]:
    """What the holder wrote; empty for a file that no one has signed."""
    try:
        told = json.loads(os.pread(descriptor, 4096, 0))
        return {"process": int(told["process"]), "host": str(told["host"]), "since": str(told["since"])}
    except (ValueError, TypeError, KeyError):
        return {}


def _refusal(place: Path | str, lock: Path, holder: dict[str, Any], here: bool) -> str:
    who = "another process"
    if holder:
        who = f"process {holder['process']} on {holder['host']}, since {holder['since']}"
    instead = "wait for it, or choose another place"
    if not here and holder:
        instead += f"; if it is no more, delete {lock}"
    return f"{place}: expected no other run into this place, got that of {who}; {instead}"
