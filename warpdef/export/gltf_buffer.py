"""The binary half of a .glb: arrays with the accessors that describe them, and the container around it all.

Arrays can be packed by meshoptimizer's codecs (EXT_meshopt_compression), without loss: vertex data row by row, and
triangles, of which the first corner may then be another. What the views say they hold lies in a second buffer that is
not there; programs unpack into it.
"""

from __future__ import annotations

import importlib
import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from warpdef.errors import InputError, MissingPackageError

VERTICES, INDICES = 34962, 34963
"""What a view of the buffer is for."""

_COMPONENTS = {"b": 5120, "B": 5121, "h": 5122, "H": 5123, "I": 5125, "f": 5126}
_KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


_STRIDE_MAX = 256  # bytes a row, of meshoptimizer's vertex codec
_PACKED = "EXT_meshopt_compression"


class Buffer:
    """Arrays one after the other, each aligned to 4 bytes, with the accessors that describe them.

    Args:
        meshopt: pack them.

    Raises:
        MissingPackageError: it is asked for and not installed.
    """

    def __init__(self, meshopt: bool = False) -> None:
        self.encode = meshopt_encoder() if meshopt else None
        self.unpacked_size = 0
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
        view = self._add_rows(np.ascontiguousarray(stored, dtype=array.dtype.newbyteorder("<")), target)
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
        self.views.append(self._store(data))
        return len(self.views) - 1

    def _store(self, data: bytes) -> dict[str, Any]:
        """Append bytes, and say where they are."""
        where = {"buffer": 0, "byteOffset": self.size, "byteLength": len(data)}
        data += bytes(-len(data) % 4)
        self.chunks.append(data)
        self.size += len(data)
        return where

    def _add_rows(self, rows: np.ndarray, target: int | None) -> int:
        """Append rows (N, k) as they are or, where the codec takes them, packed; the index of their view."""
        stride = rows.shape[1] * rows.itemsize
        triangles = target == INDICES
        if self.encode is None or not (triangles or (stride % 4 == 0 and stride <= _STRIDE_MAX)):
            return self.add_bytes(rows.tobytes())
        mode = "TRIANGLES" if triangles else "ATTRIBUTES"
        packed = self._store(self.encode(rows, mode)) | {"byteStride": stride, "mode": mode, "count": len(rows)}
        view = {"buffer": 1, "byteOffset": self.unpacked_size, "byteLength": rows.nbytes}
        self.unpacked_size += rows.nbytes + -rows.nbytes % 4
        self.views.append(view | {"extensions": {_PACKED: packed}})
        return len(self.views) - 1

    def write(self, path: Path, document: dict[str, Any]) -> None:
        """Write a .glb of ``document``, which this completes by what the buffer holds.

        Raises:
            InputError: more than the 4 GiB that the format can hold.
        """
        buffers: list[dict[str, Any]] = [{"byteLength": self.size}]
        if self.encode is not None:
            buffers.append({"byteLength": self.unpacked_size, "extensions": {_PACKED: {"fallback": True}}})
            for key in ("extensionsUsed", "extensionsRequired"):
                document[key] = [*document.get(key, []), _PACKED]
        document |= {"accessors": self.accessors, "bufferViews": self.views, "buffers": buffers}
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


def meshopt_encoder() -> Callable[[np.ndarray, str], bytes]:
    """The codec: rows (N, k) and a mode to bytes.

    Raises:
        MissingPackageError: it is not installed.
    """
    try:
        return importlib.import_module("meshopt").encode_gltf_buffer
    except ImportError as error:
        raise MissingPackageError(
            f"--meshopt needs meshopt ({error}); install it: pip install 'warpdef[meshopt]'"
        ) from error
