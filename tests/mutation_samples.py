"""Small valid inputs of every kind that warpdef reads, each with the command that reads it, for ``mutate.py``."""

from __future__ import annotations

import io
import os
import pickle
import struct
import zipfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

_RNG = np.random.default_rng(0)
CLOUDS = [_RNG.normal(size=(40, 3)) + t for t in range(4)]
NORMALS = [n / np.linalg.norm(n, axis=1, keepdims=True) for n in _RNG.normal(size=(4, 40, 3))]
FACES = np.array([[t, (t + 1) % 40, (t + 7) % 40] for t in range(40)])
TRAP = "trap-was-sprung"
"""Name of a file that appears if anything of a file's contents is executed."""


@dataclass(frozen=True)
class Sample:
    """One valid input.

    files:     contents by name, within a folder that is made anew for every try
    victim:    the file that is damaged
    arguments: of the command; ``{in}`` stands for that folder, ``{out}`` for a place of the result
    """

    name: str
    files: dict[str, bytes]
    victim: str
    arguments: tuple[str, ...]
    specials: dict[str, bytes] = field(default_factory=dict)


def saved(save, *args, **arrays) -> bytes:
    """What a NumPy function writes."""
    stream = io.BytesIO()
    save(stream, *args, **arrays)
    return stream.getvalue()


def text(rows: np.ndarray, start: str = "", end: str = "\n") -> str:
    """A line for each row."""
    return "".join(start + " ".join(map(repr, row)) + end for row in np.asarray(rows).tolist())


def ply(points: np.ndarray, normals: np.ndarray | None, form: str, faces: np.ndarray | None = None) -> bytes:
    """A PLY file in any of its three forms."""
    columns = ["x", "y", "z"] + ([] if normals is None else ["nx", "ny", "nz"])
    rows = points if normals is None else np.hstack([points, normals])
    head = ["ply", f"format {form} 1.0", f"element vertex {len(rows)}", *(f"property double {c}" for c in columns)]
    if faces is not None:
        head += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    header = ("\n".join(head) + "\nend_header\n").encode()
    if form == "ascii":
        return header + (text(rows) + ("" if faces is None else text(faces, "3 "))).encode()
    order = ">" if "big" in form else "<"
    body = rows.astype(order + "f8").tobytes()
    if faces is not None:
        body += b"".join(b"\3" + face.astype(order + "i4").tobytes() for face in faces)
    return header + body


def lzf_compress(data: bytes) -> bytes:
    """LZF: literal runs, and copies of the last byte where it repeats; enough to try a reader with."""
    out, at, literal = bytearray(), 0, bytearray()

    def flush() -> None:
        for start in range(0, len(literal), 32):
            piece = literal[start : start + 32]
            out.append(len(piece) - 1)
            out.extend(piece)
        literal.clear()

    while at < len(data):
        run = 1
        while run < 264 and at + run < len(data) and data[at + run] == data[at]:
            run += 1
        if run > 4:
            literal.append(data[at])
            flush()
            length = run - 1
            out.extend([(length - 2) << 5, 0] if length < 9 else [7 << 5, length - 9, 0])
        else:
            literal.extend(data[at : at + run])
        at += run
    flush()
    return bytes(out)


def pcd(points: np.ndarray, normals: np.ndarray | None, form: str, real: str = "8") -> bytes:
    """A PCD file in any of its three forms, with a field to be passed over."""
    names = ["x", "y", "z", "_"] + ([] if normals is None else ["normal_x", "normal_y", "normal_z"])
    kind = f"<f{real}"
    table = np.zeros(len(points), [(n, kind) for n in names])
    for i, name in enumerate("xyz"):
        table[name] = points[:, i]
        if normals is not None:
            table[f"normal_{name}"] = normals[:, i]
    header = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n"
        f"FIELDS {' '.join(names)}\nSIZE {' '.join([real] * len(names))}\nTYPE {' '.join('F' * len(names))}\n"
        f"COUNT {' '.join('1' * len(names))}\nWIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\n"
        f"POINTS {len(points)}\nDATA {form}\n"
    ).encode()
    if form == "ascii":
        return header + text(np.array(table.tolist())).encode()
    if form == "binary":
        return header + table.tobytes()
    body = b"".join(table[name].tobytes() for name in names)
    packed = lzf_compress(body)
    return header + struct.pack("<II", len(packed), len(body)) + packed


def las(
    points: np.ndarray, scale: float = 1e-4, offset: float = 0.0, compressed: bool = False, minor: int = 2
) -> bytes:
    """A LAS file of point format 0, or the same as LAZ, for which lazrs is needed."""
    rows = np.zeros(len(points), [("xyz", "<i4", (3,)), ("rest", "u1", (8,))])
    rows["xyz"] = np.rint(np.clip((points - offset) / scale, -(2**31), 2**31 - 1))
    size = 375 if minor >= 4 else 227
    record = b""
    if compressed:
        import lazrs

        settings = lazrs.LazVlr.new_for_compression(0, 0).record_data()
        record = struct.pack("<2x16sHH32x", b"laszip encoded", 22204, len(settings)) + bytes(settings)
    header = bytearray(size)
    header[:4], header[24:26] = b"LASF", bytes([1, minor])
    struct.pack_into("<HII", header, 94, size, size + len(record), 1 if record else 0)
    struct.pack_into("<BHI", header, 104, 128 if compressed else 0, 20, len(points))
    struct.pack_into("<6d", header, 131, *[scale] * 3, *[offset] * 3)
    if minor >= 4:
        struct.pack_into("<Q", header, 247, len(points))
    if not compressed:
        return bytes(header) + rows.tobytes()
    stream = io.BytesIO(bytes(header) + record)
    stream.seek(0, io.SEEK_END)
    packer = lazrs.LasZipCompressor(stream, lazrs.LazVlr.new_for_compression(0, 0))
    packer.compress_many(np.frombuffer(rows.tobytes(), dtype=np.uint8))
    packer.done()
    return stream.getvalue()


class _Trap:
    """Pickled in place of an array: whoever unpickles it makes the file ``TRAP``."""

    def __reduce__(self):
        return os.mkdir, (TRAP,)


def pickled_npy() -> bytes:
    """An .npy of objects, with a trap."""
    return saved(np.save, np.array([_Trap()] * 3, dtype=object), allow_pickle=True)


def zipped(members: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    """An archive of members with names of any kind."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return stream.getvalue()


def npy_of_zeros(shape: tuple[int, ...], kind: str = "<f4") -> bytes:
    """An .npy whose contents compress to next to nothing."""
    return saved(np.save, np.zeros(shape, kind))


def npz_specials(key: str) -> dict[str, bytes]:
    """Archives made to harm: traps, bombs, names that lead out."""
    npy = saved(np.save, np.stack(CLOUDS))
    bomb = npy_of_zeros((2, 4_000_000, 3))
    lie = npy.replace(b"(4, 40, 3)", b"(4, 4000000000, 3)"[: len(b"(4, 40, 3)")])
    return {
        "pickle": zipped({f"{key}.npy": pickled_npy()}),
        "bare pickle": pickle.dumps(_Trap()),
        "pickle as member": zipped({f"{key}.npy": pickle.dumps(_Trap())}),
        "bomb": zipped({f"{key}.npy": bomb}),
        "bomb small enough": zipped({f"{key}.npy": npy_of_zeros((2, 600_000, 3))}),
        "bombs": zipped({f"{key}_{t:04d}.npy": npy_of_zeros((3_000_000, 3)) for t in range(4)}),
        "bomb of bytes": zipped({f"{key}.npy": npy_of_zeros((2, 20_000_000, 3), "u1")}),
        "names leading out": zipped({"../../escaped.npy": npy, "/tmp/escaped.npy": npy, f"../{key}.npy": npy}),
        "a good one and one out": zipped({f"{key}.npy": npy, "../escaped.npy": npy}),
        "lying header": zipped({f"{key}.npy": lie}, zipfile.ZIP_STORED),
        "twice the same name": zipped({f"{key}.npy": npy}) + zipped({f"{key}.npy": npy}),
        "nested": zipped({f"{key}.npy": zipped({f"{key}.npy": npy})}),
    }


def _folder(suffix: str, frames: list[bytes], specials: dict[str, bytes] | None = None, name: str = "") -> Sample:
    files = {f"c/{t}{suffix}": data for t, data in enumerate(frames)}
    command = ("reconstruct", "{in}/c", "-o", "{out}", "--strict")
    return Sample(name or f"clouds {suffix}", files, f"c/1{suffix}", command, specials or {})


def _npz_clouds(name: str, data: bytes) -> Sample:
    return Sample(name, {"c.npz": data}, "c.npz", ("reconstruct", "{in}/c.npz", "-o", "{out}"), npz_specials("points"))


def _template(suffix: str, data: bytes) -> Sample:
    files = {"c.npz": saved(np.savez, points=np.stack(CLOUDS)), f"t{suffix}": data}
    command = ("reconstruct", "{in}/c.npz", "-o", "{out}", "--template", f"{{in}}/t{suffix}")
    return Sample(f"template {suffix}", files, f"t{suffix}", command)


def _runs() -> list[Sample]:
    from tempfile import TemporaryDirectory

    from warpdef.config import Config
    from warpdef.files.run_folder import RunFolder

    with TemporaryDirectory() as folder:
        path = RunFolder.prepare(Path(folder) / "run").save(
            vertices=np.stack(CLOUDS),
            faces=FACES,
            keyframe=1,
            config=Config(),
            report={"warnings": []},
            steps=[{"iteration": 1}],
            names=["a", "b", "c", "d"],
        )
        files = {f"run/{p.name}": p.read_bytes() for p in path.iterdir() if p.is_file()}
    command = ("export", "{in}/run", "{out}.npz")
    victims = ("run/sequence.npz", "run/report.json", "run/config.toml")
    return [
        Sample(name, files, name, command, npz_specials("vertices") if name.endswith("npz") else {}) for name in victims
    ]


def samples() -> list[Sample]:
    """All of them; those of .laz only where lazrs is installed."""
    from warpdef.config import Config
    from warpdef.files.config_file import config_to_toml

    obj = [(text(p, "v ") + text(n, "vn ")).encode() for p, n in zip(CLOUDS, NORMALS, strict=True)]
    mesh_obj = (text(CLOUDS[0], "v ") + text(FACES + 1, "f ")).encode()
    off = [f"OFF\n40 40 0\n{text(p)}{text(FACES, '3 ')}".encode() for p in CLOUDS]
    rows = [np.hstack(pair) for pair in zip(CLOUDS, NORMALS, strict=True)]
    pairs = list(zip(CLOUDS, NORMALS, strict=True))
    found = [
        *(_folder(".ply", [ply(p, n, form) for p, n in pairs], name=f"clouds .ply {form}") for form in _PLY_FORMS),
        _folder(".ply", [ply(p, None, "binary_little_endian", FACES) for p in CLOUDS], name="clouds .ply with faces"),
        _folder(".obj", obj),
        _folder(".off", off),
        _folder(".off", [f"NOFF\n40 0 0\n{text(r)}".encode() for r in rows], name="clouds .off with normals"),
        _folder(".xyz", [text(r).encode() for r in rows]),
        _folder(".npy", [saved(np.save, r) for r in rows], {"pickle": pickled_npy()}),
        *(
            _folder(".pcd", [pcd(p, n, form) for p, n in pairs], name=f"clouds .pcd {form}")
            for form in ("ascii", "binary", "binary_compressed")
        ),
        _folder(".las", [las(p) for p in CLOUDS]),
        _folder(".las", [las(p, minor=4) for p in CLOUDS], name="clouds .las 1.4"),
        _npz_clouds("clouds .npz", saved(np.savez, points=np.stack(CLOUDS), normals=np.stack(NORMALS))),
        _npz_clouds("clouds .npz compressed", saved(np.savez_compressed, points=np.stack(CLOUDS))),
        _npz_clouds(
            "clouds .npz numbered", saved(np.savez, **{f"points_{t}": p[: 40 - t] for t, p in enumerate(CLOUDS)})
        ),
        _template(".ply", ply(CLOUDS[0], None, "binary_little_endian", FACES)),
        _template(".obj", mesh_obj),
        _template(".off", off[0]),
        *_runs(),
    ]
    meshes = {f"m/{t}.obj": mesh_obj for t in range(3)}
    points = ("--points", "20", "-o", "{out}.npz")
    found.append(Sample("meshes .obj", meshes, "m/1.obj", ("sample", "{in}/m", *points)))
    archive = {"m.npz": saved(np.savez, vertices=np.stack(CLOUDS), faces=FACES)}
    found.append(Sample("meshes .npz", archive, "m.npz", ("sample", "{in}/m.npz", *points), npz_specials("vertices")))
    files = {"c.npz": saved(np.savez, points=np.stack(CLOUDS)), "c.toml": config_to_toml(Config()).encode()}
    command = ("reconstruct", "{in}/c.npz", "-o", "{out}", "--config", "{in}/c.toml")
    found.append(Sample("configuration", files, "c.toml", command))
    try:
        found.append(_folder(".laz", [las(p, compressed=True) for p in CLOUDS]))
    except ImportError:
        pass
    return found


_PLY_FORMS = ("ascii", "binary_little_endian", "binary_big_endian")
