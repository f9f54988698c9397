"""The binary half of a .glb: arrays with the accessors that describe them, and the container around it all."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from warpdef.errors import InputError

VERTICES, INDICES = 34962, 34963
"""What a view of the buffer is for."""

_COMPONENTS = {"b": 5120, "B": 5121, "h": 5122, "H": 5123, "I": 5125, "f": 5126}
_KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class Buffer:
    """Arrays one after the other, each aligned to 4 bytes, with the accessors that describe them."""

    def __init__(self) -> None:
        self.accessors: list[dict[str, Any]] = []
        self.views: list[dict[str, Any]] = []
        self.chunks: list[bytes] = []
        self.size = 0

    def add(
        self, array: np.ndarray, *, bounds: bool = False, target: int | None = None, normalized: bool = False
    ) -> int:
        """Append an array (N,), (N, 2..4) or (N, 16) and return the index of its accessor.

        Rows of a vertex attribute begin at multiples of 4 bytes, as the format wants it: short ones are padded.
        """
        table = array.reshape(len(array), -1)
        columns, stored = table.shape[1], table
        row = columns * array.dtype.itemsize
        if target == VERTICES and row % 4:
            stored = np.zeros((len(table), (row + 3) // 4 * 4 // array.dtype.itemsize), dtype=array.dtype)
            stored[:, :columns] = table
        view = self.add_bytes(np.ascontiguousarray(stored, dtype=array.dtype.newbyteorder("<")).tobytes())
        if target is not None:
            self.views[view]["target"] = target
        if stored is not table:
            self.views[view]["byteStride"] = stored.shape[1] * array.dtype.itemsize
        accessor = {
            "bufferView": view,
            "componentType": _COMPONENTS[array.dtype.char],
            "count": len(array),
            "type": _KINDS[columns],
        }
        if normalized:
            accessor["normalized"] = True
        if bounds:
            accessor["min"], accessor["max"] = table.min(axis=0).tolist(), table.max(axis=0).tolist()
        self.accessors.append(accessor)
        return len(self.accessors) - 1

    def add_triangles(self, faces: np.ndarray, vertex_count: int) -> int:
        """Append triangles (F, 3), in 16 bits where those number all vertices."""
        kind = np.uint16 if vertex_count < 2**16 else np.uint32  # 65535 itself would mean something else
        return self.add(faces.reshape(-1).astype(kind), target=INDICES)

    def add_bytes(self, data: bytes) -> int:
        """Append what is no array and return the index of its view."""
        self.views.append({"buffer": 0, "byteOffset": self.size, "byteLength": len(data)})
        data += bytes(-len(data) % 4)
        self.chunks.append(data)
        self.size += len(data)
        return len(self.views) - 1

    def write(self, path: Path, document: dict[str, Any]) -> None:
        """Write a .glb of ``document``, which this completes by what the buffer holds.

        Raises:
            InputError: more than the 4 GiB that the format can hold.
        """
        document |= {"accessors": self.accessors, "bufferViews": self.views, "buffers": [{"byteLength": self.size}]}
        text = json.dumps(document, separators=(",", ":")).encode("utf-8")
        text += b" " * (-len(text) % 4)
        total = 12 + 8 + len(text) + 8 + self.size
        if total >= 2**32:
            raise InputError(
                f"{path.name}: expected less than the 4 GiB that a .glb can hold, got {total / 2**30:.1f} GiB; "
                "export fewer frames with --frames, a rig with --bones auto, or to .usdc"
            )
        with open(path, "wb") as stream:
            stream.write(struct.pack("<4sII", b"glTF", 2, total))
            stream.write(struct.pack("<I4s", len(text), b"JSON") + text)
            stream.write(struct.pack("<I4s", self.size, b"BIN\0"))
            stream.writelines(self.chunks)
