"""The two ways in which every file is touched: read whole, and written so that no half file ever stands."""

from __future__ import annotations

import errno
import os
import re
import secrets
import socket
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from warpdef.errors import InputError

TEXT_BLOCK = 1 << 20
"""Bytes of text that become numbers at once."""
_LFS_POINTER = b"version https://git-lfs.github.com/spec/"


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
        raise InputError(f"{path!s:.200}: expected a file or folder, got nothing there; {_what_to_check(str(path))}")


def _what_to_check(path: str) -> str:
    """Where nothing stands: what the path looks like."""
    if "*" in path or "?" in path:
        return "give the folder itself, not a pattern"
    if path.startswith("~"):
        return "the shell did not put a home folder in place of '~': leave the quotes out"
    if os.sep == "/" and re.match(r"[A-Za-z]:[\\/]|[^/]*\\", path):
        return "write / between folders, not \\; under WSL C: is /mnt/c"
    if re.match(r"\w+:/", path):
        return "give a path on this machine, not an address"
    return "check the path"


class Unpacking:
    """How much a compressed file may unpack to: a small file must not fill the memory.

    All that is unpacked, as it is and as float64, may take ``times`` the file's size and 64 MiB.
    """

    def __init__(self, path: Path, instead: str, times: int = 9) -> None:
        self.path, self.instead = path, instead
        self.allowed = times * path.stat().st_size + (64 << 20)
        self.left = self.allowed

    def take(self, size: int) -> None:
        """Count ``size`` bytes as unpacked, before they are.

        Raises:
            InputError: it is more than the file's size allows.
        """
        self.left -= size
        if self.left < 0:
            raise InputError(
                f"{self.path}: expected at most {self.allowed >> 20} MiB of numbers in a compressed file of its size, "
                f"got {(self.allowed - self.left) >> 20} MiB; if it is not damaged, {self.instead}"
            )


def read_bytes(path: Path) -> bytes:
    """The whole file.

    Raises:
        InputError: missing, empty, not a file, or not readable.
    """
    try:
        # Anything else, a pipe for one, may have no end.
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: expected a file, got something else; check the path")
        data = path.read_bytes()
    except InputError:
        raise
    except (OSError, ValueError, MemoryError) as error:
        raise InputError(f"{path}: cannot be read ({reason(error)}); check the path and its permissions") from None
    if not data:
        raise InputError(f"{path}: the file is empty; expected data; write it again")
    refuse_pointer(data, path)
    return data


def refuse_pointer(start: bytes, path: Path) -> None:
    """Raise ``InputError`` where a file's first bytes say that it stands for data that were not fetched."""
    if start.startswith(_LFS_POINTER):
        raise InputError(f"{path}: expected data, got a pointer of Git LFS in their place; fetch them: git lfs pull")


def sibling(path: Path, ending: str) -> Path:
    """A fresh hidden name beside ``path``, so that a rename to ``path`` stays within one file system."""
    return path.with_name(f".{path.name}.{_machine()}-{os.getpid():x}-{secrets.token_hex(4)}.{ending}")


def abandoned(path: Path, ending: str) -> list[Path]:
    """Siblings of ``path`` that a process of this machine made which is no more: killed before it could clean up."""
    if os.name != "posix" or not path.parent.is_dir():
        return []
    pattern = re.compile(rf"\.{re.escape(path.name)}\.{_machine()}-([0-9a-f]+)-[0-9a-f]{{8}}\.{ending}")
    found = [(p, pattern.fullmatch(p.name)) for p in path.parent.glob(f".*.{ending}")]
    return [p for p, match in found if match and not is_alive(int(match[1], 16))]


def _machine() -> str:
    return f"{zlib.crc32(socket.gethostname().encode()) & 0xFFFF:04x}"


def is_alive(process: int) -> bool:
    """Whether a process of this number runs on this machine."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        pass
    return True


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


def settle(folder: Path) -> None:
    """Have everything in ``folder``, and it itself, on the disk: what is renamed or deleted afterwards comes later.

    Raises:
        OSError: it could not be written after all.
    """
    for base, _, names in os.walk(folder):
        for name in names:
            _settle_one(Path(base) / name)
        settle_names(Path(base))


def settle_names(folder: Path) -> None:
    """Have the names in ``folder`` on the disk, after a renaming."""
    if os.name == "posix":
        try:
            _settle_one(folder)
        except OSError as error:
            # Not every file system can do that with a folder, and not every folder may be read.
            if error.errno in (errno.EIO, errno.ENOSPC, errno.EDQUOT):
                raise


def _settle_one(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
