"""Arrays on a device, handed out by type and shape, and their bytes counted.

What a stage keeps it owns. What it needs only while it runs it borrows: stages that never run at the same time are lent
the same memory, and none has to know of another's buffers.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

import warp as wp

VECTOR, MATRIX, NODE, INDEX = 12, 36, 32, 4
"""Bytes of three, nine and eight float32, and of an int32."""

Borrow = Callable[[Any, tuple[int, ...]], wp.array]


class Pool:
    """Arrays of one device.

    bytes: of all arrays handed out, by the owner's name; those lent stand under ``lent``, once for all borrowers.
    """

    def __init__(self, device: wp.Device) -> None:
        self.device = device
        self.bytes: Counter[str] = Counter()
        self._lent: dict[tuple, list[wp.array]] = {}

    def own(self, owner: str, dtype: Any, *shapes: tuple[int, ...] | int) -> list[wp.array]:
        """An array of zeros for each shape, the owner's for good."""
        made = [wp.zeros(shape, dtype=dtype, device=self.device) for shape in shapes]
        self.bytes[owner] += sum(map(_bytes, made))
        return made

    def borrower(self) -> Borrow:
        """A stage's own way to borrow: ``borrow(dtype, shape)``.

        Everything that one borrower is given lies apart. What another is given may be the same memory: contents last
        until some other stage runs, and are anything at the start.
        """
        taken: Counter[tuple] = Counter()

        def borrow(dtype: Any, shape: tuple[int, ...]) -> wp.array:
            key = (dtype, shape)
            there = self._lent.setdefault(key, [])
            taken[key] += 1
            if taken[key] > len(there):
                there += self.own("lent", dtype, shape)
            return there[taken[key] - 1]

        return borrow


def _bytes(array: wp.array) -> int:
    return array.size * wp.types.type_size_in_bytes(array.dtype)
