"""What reading takes: CPU seconds and memory for a sequence of clouds in each format, a process a format.

    python tests/reading_times.py --frames 100 --points 100000

One frame with colours is written and linked under the numbers of all others, so that the disk holds one frame a format;
nothing is left behind. The table goes to standard output.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

KINDS = ("npz", "npz of unequal frames", "npy", "ply", "ply ascii", "pcd", "las", "obj", "off", "xyz", "csv", "stl")


def write_frame(kind: str, path: Path, points: np.ndarray, colors: np.ndarray) -> None:
    """One frame at ``path``, whose suffix is that of the kind."""
    shades = [("red", "u1"), ("green", "u1"), ("blue", "u1")]
    rows = np.zeros(len(points), [(axis, "<f4") for axis in "xyz"] + shades)
    for column, name in enumerate(rows.dtype.names or ()):
        rows[name] = points[:, column] if column < 3 else colors[:, column - 3]
    table = np.column_stack([points, colors])
    if kind == "npy":
        np.save(path, points)
    elif kind in ("ply", "ply ascii"):
        form = "ascii" if kind == "ply ascii" else "binary_little_endian"
        head = f"ply\nformat {form} 1.0\nelement vertex {len(points)}\n"
        head += "".join(f"property float {a}\n" for a in "xyz") + "".join(f"property uchar {n}\n" for n, _ in shades)
        body = text(table).encode() if form == "ascii" else rows.tobytes()
        path.write_bytes(head.encode() + b"end_header\n" + body)
    elif kind == "pcd":
        packed = (colors.astype(np.uint32) << np.array([16, 8, 0], dtype=np.uint32)).sum(axis=1, dtype=np.uint32)
        head = f"FIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F U\nWIDTH {len(points)}\nHEIGHT 1\nDATA binary\n"
        path.write_bytes(head.encode() + np.column_stack([points.view(np.uint32), packed]).tobytes())
    elif kind == "las":
        las = np.zeros(len(points), [("xyz", "<i4", 3), ("rest", "u1", 8), ("rgb", "<u2", 3)])
        las["xyz"], las["rgb"] = np.rint(points * 1e4), colors.astype(np.uint16) * 257
        head = bytearray(227)
        head[:4], head[24:26] = b"LASF", b"\1\2"
        head[94:104] = np.array([227], "<u2").tobytes() + np.array([227, 0], "<u4").tobytes()
        head[104:111] = b"\2" + np.array([las.itemsize], "<u2").tobytes() + np.array([len(points)], "<u4").tobytes()
        head[131:179] = np.array([1e-4, 1e-4, 1e-4, 0, 0, 0]).tobytes()
        path.write_bytes(bytes(head) + las.tobytes())
    elif kind == "off":
        path.write_text(f"OFF\n{len(points)} 0 0\n" + text(points))
    elif kind == "obj":
        path.write_text("v " + text(np.column_stack([points, colors / 255.0])).replace("\n", "\nv ", len(points) - 1))
    elif kind == "stl":
        corners = points[: len(points) // 3 * 3].reshape(-1, 9)
        faces = np.zeros(len(corners), [("normal", "<f4", 3), ("corners", "<f4", 9), ("rest", "<u2")])
        faces["corners"] = corners
        path.write_bytes(bytes(80) + np.array([len(faces)], "<u4").tobytes() + faces.tobytes())
    else:
        path.write_text(text(table, "," if kind == "csv" else " "))


def text(table: np.ndarray, between: str = " ") -> str:
    """A row a line, seven digits a number."""
    line = between.join(["%.7g"] * table.shape[1]) + "\n"
    return line * len(table) % tuple(table.ravel().tolist())


def write_sequence(kind: str, folder: Path, frames: int, count: int) -> Path:
    """A sequence of that kind in a folder; returns what is to be read."""
    rng = np.random.default_rng(0)
    points = rng.normal(size=(count, 3))
    points = (points / np.linalg.norm(points, axis=1, keepdims=True)).astype(np.float32)
    colors = rng.integers(0, 256, size=(count, 3)).astype(np.uint8)
    if kind == "npz":
        stack = np.broadcast_to(points, (frames, count, 3)), np.broadcast_to(colors, (frames, count, 3))
        np.savez(folder / "a.npz", points=stack[0], colors=stack[1])
        return folder / "a.npz"
    if kind == "npz of unequal frames":
        arrays = {f"points_{t:04d}": points[t:] for t in range(frames)}
        arrays |= {f"colors_{t:04d}": colors[t:] for t in range(frames)}
        np.savez(folder / "a.npz", **arrays)
        return folder / "a.npz"
    suffix = kind.split()[0]
    write_frame(kind, folder / f"0000.{suffix}", points, colors)
    for t in range(1, frames):
        os.link(folder / f"0000.{suffix}", folder / f"{t:04d}.{suffix}")
    return folder


def read(path: Path) -> None:
    """In a process of its own: one line with CPU seconds, MB, and whether colours came along."""
    from warpdef.files import read_clouds

    before, started = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    sequence = read_clouds(path)
    seconds = time.process_time() - started
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(f"{seconds:.1f} {(after - before) / 1024:.0f} {'yes' if sequence.colors else 'no'}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--points", type=int, default=100_000)
    parser.add_argument("--only", nargs="*", default=KINDS)
    parser.add_argument("--read", type=Path)
    how = parser.parse_args()
    if how.read:
        read(how.read)
        return
    print("| format | MB a frame | CPU s | peak MB | colours |\n| --- | --- | --- | --- | --- |", flush=True)
    for kind in how.only:
        with tempfile.TemporaryDirectory() as folder:
            path = write_sequence(kind, Path(folder), how.frames, how.points)
            size = path.stat().st_size / how.frames if path.is_file() else next(path.iterdir()).stat().st_size
            command = [sys.executable, __file__, "--read", str(path)]
            done = subprocess.run(command, capture_output=True, text=True, check=True)
            print(f"| {kind} | {size / 1e6:.1f} | {' | '.join(done.stdout.split()[-3:])} |", flush=True)


if __name__ == "__main__":
    main()
