"""LZF, the compression inside PCD files: runs of literal bytes, and copies of what came up to 8 KiB before.

The format is that of LibLZF (Marc Lehmann). A control byte c begins each piece:

    c < 32   the next c + 1 bytes are literal
    else     copy: (c >> 5) + 2 bytes, where c >> 5 == 7 adds the next byte; (c & 31) * 256 + next byte + 1 back
"""

from __future__ import annotations


def lzf_decompress(data: bytes, size: int) -> bytes:
    """Unpack ``data`` to exactly ``size`` bytes.

    Raises:
        ValueError: the data end early, point before their start, or give another size.
    """
    out = bytearray()
    at, end = 0, len(data)
    try:
        while at < end:
            control = data[at]
            at += 1
            if control < 32:
                out += data[at : at + control + 1]
                at += control + 1
                continue
            length = control >> 5
            if length == 7:
                length += data[at]
                at += 1
            length += 2
            distance = ((control & 31) << 8) + data[at] + 1
            at += 1
            start = len(out) - distance
            if start < 0 or len(out) + length > size:
                break
            if distance >= length:
                out += out[start : start + length]
            else:
                # The copy overlaps what it writes: the last bytes repeat.
                out += (out[start:] * (length // distance + 1))[:length]
    except IndexError:
        pass
    if at != end or len(out) != size:
        raise ValueError(f"compressed data of {len(data)} bytes do not unpack to the {size} bytes declared")
    return bytes(out)
