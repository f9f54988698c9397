"""A reader of .glb that is not ours: after the glTF 2.0 specification, sections 3.6.2, 3.11 and 4.4."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np

TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
COLUMNS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class Glb:
    """One file: ``json``, and arrays by the index of their accessor."""

    def __init__(self, path: Path) -> None:
        data = path.read_bytes()
        magic, version, length = struct.unpack_from("<4sII", data)
        assert (magic, version, length) == (b"glTF", 2, len(data))
        size, kind = struct.unpack_from("<I4s", data, 12)
        assert kind == b"JSON" and size % 4 == 0
        self.json = json.loads(data[20 : 20 + size])
        rest, kind = struct.unpack_from("<I4s", data, 20 + size)
        assert kind == b"BIN\0" and rest == self.json["buffers"][0]["byteLength"]
        self.binary = data[28 + size :]
        assert len(self.binary) == rest

    def array(self, index: int) -> np.ndarray:
        """The numbers as they are stored, shape (N, columns)."""
        accessor = self.json["accessors"][index]
        view = self.json["bufferViews"][accessor["bufferView"]]
        columns, kind = COLUMNS[accessor["type"]], np.dtype(TYPES[accessor["componentType"]])
        row = view.get("byteStride", columns * kind.itemsize)
        assert row % 4 == 0 or view.get("target") != 34962
        table = np.frombuffer(self.binary, "u1", accessor["count"] * row, view["byteOffset"])
        values = table.reshape(-1, row)[:, : columns * kind.itemsize].copy().view(kind)
        if "min" in accessor:
            np.testing.assert_array_equal(accessor["min"], values.min(axis=0))
            np.testing.assert_array_equal(accessor["max"], values.max(axis=0))
        return values

    def numbers(self, index: int) -> np.ndarray:
        """What the numbers mean: whole ones that are normalised as fractions of their largest."""
        values = self.array(index)
        if not self.json["accessors"][index].get("normalized"):
            return values.astype(np.float64)
        return np.maximum(values / float(np.iinfo(values.dtype).max), -1.0)

    def transform(self, node: int) -> np.ndarray:
        """A node's own matrix, shape (4, 4): scaled, turned, then moved."""
        found = self.json["nodes"][node]
        x, y, z, w = found.get("rotation", [0.0, 0.0, 0.0, 1.0])
        turn = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )
        matrix = np.eye(4)
        matrix[:3, :3] = turn * found.get("scale", [1.0, 1.0, 1.0])
        matrix[:3, 3] = found.get("translation", [0.0, 0.0, 0.0])
        return matrix
