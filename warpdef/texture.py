"""The image on a mesh, kept as the file it came as: PNG or JPEG, which every program that shows meshes can read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from warpdef.errors import InputError

_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8\xff"
_SIZE_MARKERS = (0xC0, 0xC1, 0xC2)  # baseline, extended, progressive: what browsers and engines read
_SCAN, _RESTART = 0xDA, range(0xD0, 0xD8)


@dataclass(frozen=True)
class Texture:
    """An image file, byte for byte.

    data: contents of the file; never decoded, its pieces are looked at only
    kind: what it is, and its suffix   "png" or "jpg"
    """

    KINDS: ClassVar[dict[str, str]] = {"png": "image/png", "jpg": "image/jpeg"}
    """Media types by kind."""

    data: bytes
    kind: str

    @classmethod
    def from_bytes(cls, data: bytes) -> Texture:
        """Take an image whose first bytes say what it is, whatever its name.

        Raises:
            InputError: neither PNG nor JPEG, or damaged or cut off.
        """
        if data.startswith(_PNG):
            kind, whole = "png", _is_whole_png(data)
        elif data.startswith(_JPEG):
            kind, whole = "jpg", _is_whole_jpeg(data)
        else:
            raise InputError("expected a PNG or JPEG image, got something else; convert it")
        if not whole:
            raise InputError(f"expected a whole {kind.upper()} image, got one damaged or cut off; write it again")
        return cls(data, kind)


def _is_whole_png(data: bytes) -> bool:
    """Whether its chunks lead from a header with a size by pixels to its end (PNG specification, section 5)."""
    at, has_pixels = len(_PNG), False
    if data[at : at + 8] != b"\0\0\0\rIHDR" or not (any(data[at + 8 : at + 12]) and any(data[at + 12 : at + 16])):
        return False
    while at + 12 <= len(data):
        kind = data[at + 4 : at + 8]
        if kind == b"IEND":
            return has_pixels
        has_pixels |= kind == b"IDAT"
        at += 12 + int.from_bytes(data[at : at + 4], "big")
    return False


def _is_whole_jpeg(data: bytes) -> bool:
    """Whether its segments lead by a size to pixels, and an end follows (ITU-T T.81, annex B)."""
    at, has_size = 2, False
    while at + 4 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker == 0xFF:  # filling
            at += 1
            continue
        if marker == 0x01 or marker in _RESTART:
            at += 2
            continue
        if marker in _SIZE_MARKERS:
            has_size = any(data[at + 5 : at + 7]) and any(data[at + 7 : at + 9])
        if marker == _SCAN:
            return has_size and data.rfind(b"\xff\xd9") > at
        at += 2 + max(2, int.from_bytes(data[at + 2 : at + 4], "big"))
    return False
