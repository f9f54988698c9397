"""Images and textured spheres, made here byte by byte."""

from __future__ import annotations

import io
import struct
import zlib

import numpy as np
import pytest
from synthetic import icosphere

PIXELS = np.random.default_rng(0).integers(0, 256, (5, 7, 3), dtype=np.uint8)
VERTICES, FACES = icosphere(1)
COUNT = len(VERTICES)
COLORS = np.random.default_rng(1).integers(0, 256, (COUNT, 3), dtype=np.uint8)
UV = np.random.default_rng(2).random((COUNT, 2)).astype(np.float32)
MOVING = np.stack([VERTICES, 1.5 * VERTICES]).astype(np.float32)


def png(pixels: np.ndarray = PIXELS) -> bytes:
    """A PNG after its specification: header, rows each without a filter, end."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    height, width, _ = pixels.shape
    rows = b"".join(b"\0" + row.tobytes() for row in pixels)
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def jpg(**how: object) -> bytes:
    image = pytest.importorskip("PIL.Image")
    stream = io.BytesIO()
    image.fromarray(PIXELS).save(stream, "JPEG", **how)
    return stream.getvalue()


PNG = png()
