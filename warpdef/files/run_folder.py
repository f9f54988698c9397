"""The folder of one run: complete or not there, never half, and nothing of anyone else's is ever deleted.

    sequence.npz   vertices (T, V, 3) in input units, float32 (far from the origin float64), faces (F, 3) int32,
                   keyframe, names (T,), confidence (T, V) uint8; vertex_colors (V, 3) or (V, 4) uint8, sRGB, of
                   coloured clouds or a template given, frame_colors (T, V, 3) uint8 where each frame has its own, and
                   of a template uv (V, 2) or corner_uv (F, 3, 2), where it has any
    texture.png    the image on that template, or texture.jpg, byte for byte
    motion.npz     the deformation grids, for `warpdef deform`
    meshes/        0000.ply, 0001.ply, ...: the same, one mesh a frame
    config.toml    the configuration, whole
    report.json    what happened
    steps.jsonl    the loss curve, a line an iteration
    metrics.json   added by an evaluation

It is written under a hidden name beside its place and renamed at the end. Beside it, while a run is unfinished, lies
its checkpoint, ``.NAME.checkpoint``, and while it runs a lock (``place_lock``). ``saved_run`` reads it back.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdef.appearance import Appearance
from warpdef.config import Config
from warpdef.errors import InputError
from warpdef.files.config_file import config_to_toml
from warpdef.files.disk import abandoned, reason, replacing, settle, settle_names, sibling
from warpdef.files.json_text import json_text
from warpdef.files.numpy_files import write_npz
from warpdef.files.ply import write_ply
from warpdef.mesh import MeshSequence, float32_where_exact
from warpdef.texture import Texture

if TYPE_CHECKING:
    from warpdef.motion.grid_motion import GridMotion

REQUIRED = ("sequence.npz", "config.toml", "report.json")
TEXTURES = tuple(f"texture.{kind}" for kind in Texture.KINDS)
_OWN = {*REQUIRED, *TEXTURES, "motion.npz", "steps.jsonl", "metrics.json", "meshes"}
# Left behind by file browsers, of no one's making.
_LITTER = {".DS_Store", "Thumbs.db", "desktop.ini"}


@dataclass(frozen=True)
class RunFolder:
    """A place for a result, found free and writable by ``RunFolder.prepare``."""

    path: Path
    overwrite: bool

    @property
    def checkpoint(self) -> Path:
        """Where an unfinished run keeps its state."""
        return self.path.with_name(f".{self.path.name}.checkpoint")

    @classmethod
    def prepare(cls, path: Path | str, overwrite: bool = False, resume: bool = False) -> RunFolder:
        """Check, before the long computation, that a result can be put at ``path``; leaves nothing behind.

        With ``resume`` the place is that of an unfinished run that now goes on: its files are its own to replace.

        Raises:
            InputError: something stands there and ``overwrite`` is false, an unfinished run included, or it is not a
                warpdef result, or the place cannot be written.
        """
        overwrite = overwrite or resume
        try:
            # A link is followed once, now, so that its target is what is judged and replaced.
            folder = cls(Path(os.path.realpath(path)), overwrite)
            folder._clear_up()
            _check_place(folder.path, overwrite)
            if not overwrite and folder.checkpoint.exists():
                raise InputError(
                    f"{path}: an unfinished run is kept beside it; go on with --resume {path}, "
                    "or begin anew with --overwrite"
                )
            ground = next(p for p in folder.path.parents if p.exists())
            probe = sibling(ground / folder.path.name, "partial")
            probe.mkdir()
            probe.rmdir()
        except (OSError, ValueError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{path!s:.200}: cannot be created ({reason(error)}); choose another place") from None
        return folder

    def _clear_up(self) -> None:
        """Mend what processes that were killed while writing here have left."""
        for old in abandoned(self.path, "old"):
            if not os.path.lexists(self.path):  # killed between two renames: the older result still stands
                os.rename(old, self.path)
            shutil.rmtree(old, ignore_errors=True)
        for half in abandoned(self.path, "partial"):
            shutil.rmtree(half, ignore_errors=True)
        for half in abandoned(self.checkpoint, "partial"):
            half.unlink(missing_ok=True)

    def save(
        self,
        *,
        vertices: np.ndarray,
        faces: np.ndarray,
        keyframe: int,
        config: Config,
        report: Mapping[str, Any] | Callable[[], Mapping[str, Any]],
        steps: Iterable[Mapping[str, Any]],
        names: Sequence[str],
        motion: GridMotion | None = None,
        appearance: Appearance | None = None,
        confidence: np.ndarray | None = None,
    ) -> Path:
        """Write the whole result and move it into place.

        Args:
            vertices: shape (T, V, 3), input units; stored as float32, or float64 where that would lose some shape.
            faces: shape (F, 3).
            keyframe: index of the template's frame.
            config: the resolved configuration.
            report: for report.json; a function is called after everything else is written, so that it can
                tell how long the writing took.
            steps: for steps.jsonl, a mapping an iteration.
            names: T names of the input's frames.
            motion: the deformation grids; None: the run cannot be used by ``deform``.
            appearance: colours and texture of the mesh.
            confidence: shape (T, V) uint8, of each vertex of each frame; see ``quality.confidence``.

        Returns:
            The folder, absolute.

        Raises:
            InputError: shapes that do not fit, or the folder cannot be written; then nothing is left behind and
                an older result still stands. The result is then kept among the temporary files, or beside its place
                if that was taken meanwhile, and the message says where.
        """
        sequence = MeshSequence(float32_where_exact(np.asarray(vertices)), faces)
        if len(names) != len(sequence) or not 0 <= keyframe < len(sequence):
            raise InputError(
                f"{self.path}: expected {len(sequence)} frame names and a keyframe among them, "
                f"got {len(names)} names and keyframe {keyframe}"
            )
        if confidence is not None and confidence.shape != sequence.vertices.shape[:2]:
            raise InputError(
                f"{self.path}: confidence: expected shape {sequence.vertices.shape[:2]}, got {confidence.shape}"
            )
        if appearance is not None and appearance.frame_colors is not None:
            if len(appearance.frame_colors) != len(sequence):
                raise InputError(f"{self.path}: expected colours of {len(sequence)} frames, got others")
        arrays = {"vertices": sequence.vertices, "faces": sequence.faces}
        arrays |= {"keyframe": np.array(keyframe, dtype=np.int64), "names": np.array(names, dtype=np.str_)}
        arrays |= {} if appearance is None else appearance.arrays()
        arrays |= {} if confidence is None else {"confidence": confidence}

        def write(folder: Path) -> None:
            (folder / "meshes").mkdir(parents=True)
            write_npz(folder / "sequence.npz", arrays)
            if appearance is not None and appearance.texture is not None:
                (folder / f"texture.{appearance.texture.kind}").write_bytes(appearance.texture.data)
            if motion is not None:
                write_npz(folder / "motion.npz", motion.arrays())
            for frame, positions in enumerate(sequence.vertices):
                shades = None if appearance is None else appearance.colors_of(frame)
                write_ply(folder / "meshes" / f"{frame:04d}.ply", positions, sequence.faces, shades)
            write_text(folder / "config.toml", config_to_toml(config))
            write_text(folder / "steps.jsonl", "".join(json_text(step, None) + "\n" for step in steps))
            write_text(folder / "report.json", json_text(report() if callable(report) else report) + "\n")
            # Its checkpoint may go as soon as this returns: until then, a power failure must find one of the two.
            settle(folder)

        temporary = sibling(self.path, "partial")
        try:
            try:
                write(temporary)
            except (OSError, InputError) as error:
                shutil.rmtree(temporary, ignore_errors=True)
                why = f"{self.path}: cannot be written ({reason(error)}); choose another place or free space"
                why = str(error) if isinstance(error, InputError) else why
                kept = _write_elsewhere(write, self.path.name)
                raise InputError(why + (f". The finished result is in {kept}" if kept else "")) from None
            place = _move_into_place(temporary, self.path, self.overwrite)
            settle_names(place.parent)
            return place
        except OSError as error:
            raise InputError(
                f"{self.path}: cannot be written ({reason(error)}); choose another place or free space"
            ) from None
        finally:
            # Gone already after success; after anything else, Ctrl-C included, no half result may stay.
            shutil.rmtree(temporary, ignore_errors=True)


def _write_elsewhere(write: Callable[[Path], None], name: str) -> Path | None:
    """A result whose own place is full or gone, among the temporary files, so that it is not lost; None: nor there."""
    folder = None
    try:
        folder = Path(tempfile.mkdtemp(prefix="warpdef-"))
        write(folder / name)
    except (OSError, InputError):
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)
        return None
    return folder / name


def write_text(path: Path, text: str) -> None:
    """Write a file of a run, whole or not at all."""
    with replacing(path) as stream:
        # A file name of bytes that are no UTF-8 must not cost the result: a question mark stands for each.
        stream.write(text.encode("utf-8", errors="replace"))


def _check_place(path: Path, overwrite: bool) -> None:
    """Raise ``InputError`` unless ``path`` is free, or is a result that may be replaced."""
    if not os.path.lexists(path):
        return
    if not overwrite:
        raise InputError(f"{path}: already exists; choose another place, or replace it with --overwrite")
    foreign = _foreign(path)
    if foreign:
        raise InputError(f"{path}: --overwrite replaces only warpdef results, but {foreign}; choose another place")


def _foreign(path: Path) -> str:
    """Why what stands at ``path`` must not be deleted; empty if it is a warpdef result and nothing else."""
    if not path.is_dir():
        return "it is a file"
    names = {p.name for p in path.iterdir()}
    if not names:
        return ""
    for name in REQUIRED:
        if not (path / name).is_file():
            return f"it has no {name}"
    meshes = path / "meshes"
    if meshes.is_symlink() or (meshes.exists() and not meshes.is_dir()):
        return "its meshes are elsewhere"
    others = names - _OWN - _LITTER
    if meshes.is_dir():
        own_mesh = {f"{frame:04d}.ply" for frame in range(len(os.listdir(meshes)))}
        others |= {f"meshes/{name}" for name in set(os.listdir(meshes)) - own_mesh - _LITTER}
    return f"it holds '{min(others)}', which is not of a run" if others else ""


def _move_into_place(new: Path, place: Path, overwrite: bool) -> Path:
    """Rename ``new`` to ``place``; what stood there goes only after ``new`` is in place."""
    try:
        _check_place(place, overwrite)
    except InputError as error:
        # Taken during the computation: a finished result is not thrown away for that.
        kept = next(p for k in range(1, 10**6) if not os.path.lexists(p := place.with_name(f"{place.name}-{k}")))
        os.rename(new, kept)
        raise InputError(f"{error}. The finished result is in {kept}") from None
    if not os.path.lexists(place):
        os.rename(new, place)
        return place
    old = sibling(place, "old")
    try:
        os.rename(place, old)
        os.rename(new, place)
    except BaseException:
        if old.exists() and not os.path.lexists(place):
            os.rename(old, place)
        raise
    shutil.rmtree(old, ignore_errors=True)
    return place
