"""What a compiled CUDA binary says of its kernels: registers a thread, and bytes of stack, where spilt ones go.

A cubin is an ELF file of 64 bits. Its section ``.nv.info`` is a row of records: a format, an attribute, the bytes that
follow, and for those asked for here two numbers, a symbol and a value.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

_SIZED, _STACK, _REGISTERS = 4, 0x11, 0x2F


@dataclass(frozen=True)
class Resources:
    """Of a thread. registers: of 32 bits. stack: bytes of local memory."""

    registers: int
    stack: int


def resources(binary: Path) -> dict[str, Resources]:
    """Of every kernel in a cubin, by the name of its symbol."""
    data = binary.read_bytes()
    (first,), (size, count, names) = struct.unpack_from("<Q", data, 40), struct.unpack_from("<HHH", data, 58)
    headers = [struct.unpack_from("<IIQQQQ", data, first + i * size) for i in range(count)]

    def text(table: int, at: int) -> str:
        begin = headers[table][4] + at
        return data[begin : data.index(b"\0", begin)].decode()

    place = {text(names, header[0]): i for i, header in enumerate(headers)}
    found: dict[int, dict[int, int]] = {_STACK: {}, _REGISTERS: {}}
    at, end = headers[place[".nv.info"]][4], sum(headers[place[".nv.info"]][4:6])
    while at < end:
        form, attribute, length = struct.unpack_from("<BBH", data, at)
        if form == _SIZED and attribute in found:
            symbol, value = struct.unpack_from("<II", data, at + 4)
            found[attribute][symbol] = value
        at += 4 + (length if form == _SIZED else 0)
    symbols, strings = headers[place[".symtab"]][4], place[".strtab"]
    named = {
        symbol: text(strings, struct.unpack_from("<I", data, symbols + 24 * symbol)[0]) for symbol in found[_STACK]
    }
    return {named[k]: Resources(value, found[_STACK][k]) for k, value in found[_REGISTERS].items()}
