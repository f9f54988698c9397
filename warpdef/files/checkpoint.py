"""A run's state on disk: written whole or not at all, and believed only if its checksum holds.

    warpdef checkpoint FORMAT\\n, length of the header (8 bytes), header (JSON), arrays (raw), BLAKE2b of it all (32)

The header holds the run's facts and the name, type and shape of every array, in order. Nothing in it is ever executed.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from warpdef.errors import InputError, WarpdefError
from warpdef.files.disk import must_exist, read_bytes, reason, replacing, settle_names

FORMAT = 9
"""Raise it with every change of what a run keeps: a fact or array that is new, gone, renamed, or of another meaning."""

_BEGIN = re.compile(rb"warpdef checkpoint ([0-9]{1,9})\n")
_MAGIC = b"warpdef checkpoint %d\n" % FORMAT
_DIGEST = 32
_TYPES = ("<f4", "<f8", "<i4", "<i8")


@dataclass(frozen=True)
class Checkpoint:
    """What a run left behind.

    facts:  plain values: configuration, digests of the input, template, counters, loss curve, warnings
    arrays: the state, by name; read-only
    path:   the file
    """

    facts: dict[str, Any]
    arrays: dict[str, np.ndarray]
    path: Path

    def part(self, prefix: str) -> dict[str, np.ndarray]:
        """The arrays whose names begin with ``prefix.``, without it."""
        return {name[len(prefix) + 1 :]: a for name, a in self.arrays.items() if name.startswith(f"{prefix}.")}


def write_checkpoint(path: Path, facts: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> None:
    """Write a checkpoint; an older one at ``path`` is replaced only once the new one is on the disk.

    Args:
        facts: anything that JSON can say; floats come back bit for bit.
        arrays: float32, float64, int32 or int64.

    Raises:
        InputError: it cannot be written; whatever stood at ``path`` is untouched.
    """
    data = {name: np.ascontiguousarray(a) for name, a in arrays.items()}
    listed = [[name, a.dtype.str, list(a.shape)] for name, a in data.items()]
    header = json.dumps({"facts": facts, "arrays": listed}, default=_plain).encode("utf-8")
    digest = hashlib.blake2b(digest_size=_DIGEST)
    with replacing(path) as stream:
        for piece in (
            _MAGIC,
            len(header).to_bytes(8, "little"),
            header,
            *(a.reshape(-1).view("u1").data for a in data.values()),
        ):
            digest.update(piece)
            stream.write(piece)
        stream.write(digest.digest())
        # Renamed before the data are on the disk, it could be whole in name only after a power failure.
        stream.flush()
        os.fsync(stream.fileno())
    with suppress(OSError):  # the older one is as good
        settle_names(path.parent)


def _plain(value: Any) -> Any:
    """A NumPy number as Python's own."""
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"a checkpoint cannot hold {type(value).__name__}")


def read_checkpoint(path: Path | str) -> Checkpoint:
    """Read a checkpoint back.

    Raises:
        InputError: missing, not a checkpoint, of another format, truncated, or damaged.
    """
    path = Path(path)
    must_exist(path)
    data = read_bytes(path)
    begun = _BEGIN.match(data)
    if not begun:
        raise InputError(f"{path}: expected a checkpoint of this warpdef, got something else; start the run anew")
    if hashlib.blake2b(data[:-_DIGEST], digest_size=_DIGEST).digest() != data[-_DIGEST:]:
        raise InputError(f"{path}: the checksum does not hold: truncated or damaged; start the run anew")
    if int(begun[1]) != FORMAT:
        raise InputError(
            f"{path}: expected a checkpoint of format {FORMAT}, got format {int(begun[1])}, of another warpdef; go on "
            "with the one that began the run, or start it anew"
        )
    with understood(path):
        return _parsed(data, path)


@contextmanager
def understood(path: Path) -> Iterator[None]:
    """Refuse, in one sentence, what is whole but has another content than its reader expects.

    Raises:
        InputError: the block raised what comes of a missing, superfluous or unlike value.
    """
    try:
        yield
    except (LookupError, TypeError, ValueError, AttributeError, OverflowError, RecursionError) as error:
        if isinstance(error, WarpdefError) and str(path) in str(error):
            raise
        raise InputError(
            f"{path}: a checkpoint of another warpdef: {type(error).__name__} ({reason(error):.120}); go on with the "
            "one that began the run, or start it anew"
        ) from None


def _parsed(data: bytes, path: Path) -> Checkpoint:
    begin = len(_MAGIC) + 8
    length = int.from_bytes(data[len(_MAGIC) : begin], "little")
    header = json.loads(data[begin : begin + length])
    arrays, offset = {}, begin + length
    for name, kind, shape in header["arrays"]:
        if kind not in _TYPES or any(type(n) is not int or n < 0 for n in shape):
            raise ValueError(f"array {name!r:.40} of type {kind!r:.20} and shape {shape!r:.40}")
        count = math.prod(shape)
        arrays[name] = np.frombuffer(data, dtype=kind, count=count, offset=offset).reshape(shape)
        offset += arrays[name].nbytes
    if offset != len(data) - _DIGEST:
        raise ValueError(f"arrays end at byte {offset} of {len(data) - _DIGEST}")
    return Checkpoint(dict(header["facts"]), arrays, path)


def digests(points: Sequence[np.ndarray], normals: Sequence[np.ndarray | None]) -> list[str]:
    """A short digest of every frame: of its points' and normals' bytes, T hexadecimal strings."""

    def digest(p: np.ndarray, n: np.ndarray | None) -> str:
        found = hashlib.blake2b(np.ascontiguousarray(p).view("u1").data, digest_size=12)
        found.update(b"" if n is None else np.ascontiguousarray(n).view("u1").data)
        return found.hexdigest()

    return [digest(p, n) for p, n in zip(points, normals, strict=True)]
