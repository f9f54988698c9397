"""A result as a run folder, and back: with its configuration, its report and, when asked for, its motion."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdef.appearance import Appearance
from warpdef.config import Config
from warpdef.errors import InputError
from warpdef.files.config_file import load_config
from warpdef.files.disk import must_exist, read_bytes, reason
from warpdef.files.json_text import json_text
from warpdef.files.mesh_files import read_mesh_sequence
from warpdef.files.numpy_files import Npz
from warpdef.files.run_folder import REQUIRED, TEXTURES, RunFolder, write_text
from warpdef.files.texture import read_texture_file
from warpdef.mesh import MeshSequence
from warpdef.result import Moving, Reconstruction

if TYPE_CHECKING:
    from warpdef.motion.grid_motion import GridMotion


@dataclass(frozen=True)
class SavedRun(Moving):
    """A run read back; see ``load_run``.

    meshes:     the result, input units   T frames, V vertices, F faces
    keyframe:   index of the template's frame
    names:      the input's frame names   T strings
    config:     the configuration of the run
    report:     contents of report.json
    appearance: colours of the clouds, or colours and texture of the template given, where they had any
    confidence: of each vertex of each frame, 255 for 1 (T, V) uint8; None for results of earlier versions
    """

    path: Path
    meshes: MeshSequence
    keyframe: int
    names: tuple[str, ...]
    config: Config
    report: dict[str, Any]
    appearance: Appearance = field(default_factory=Appearance)
    confidence: np.ndarray | None = None

    @property
    def vertices(self) -> np.ndarray:
        """Positions, shape (T, V, 3), input units."""
        return self.meshes.vertices

    @property
    def faces(self) -> np.ndarray:
        """Triangles, shape (F, 3) int32."""
        return self.meshes.faces

    @cached_property
    def motion(self) -> GridMotion:
        """The deformation grids, read when first asked for.

        Raises:
            InputError: the folder has none, or they are damaged or of other frames.
        """
        from warpdef.motion.grid_motion import GridMotion

        path = self.path / "motion.npz"
        if not path.is_file():
            raise InputError(
                f"{path}: expected the run's motion, got a result without it (of an earlier version, or not of "
                f"`warpdef reconstruct`); reconstruct again with --config {self.path / 'config.toml'}"
            )
        npz = Npz(path)
        try:
            motion = GridMotion.from_arrays({name: npz.array(name) for name in npz.names})
        except InputError as error:
            raise InputError(error if str(path) in str(error) else f"{path}: {error}; reconstruct again") from None
        if (len(motion), motion.keyframe) != (len(self.meshes), self.keyframe):
            raise InputError(
                f"{path}: expected {len(self.meshes)} frames and keyframe {self.keyframe} as the meshes have, got "
                f"{len(motion)} and {motion.keyframe}; it belongs to another run: reconstruct again"
            )
        return motion


def load_run(path: Path | str) -> SavedRun:
    """Read a run folder back.

    Raises:
        InputError: not a run folder, or one of its files is damaged.
    """
    path = Path(path)
    _require_run(path)
    npz = Npz(path / "sequence.npz")
    meshes = read_mesh_sequence(path)
    keyframe = int(npz.array("keyframe")) if npz.header("keyframe")[0] == () else -1
    names = tuple(npz.texts("names"))
    if len(names) != len(meshes) or not 0 <= keyframe < len(meshes):
        raise InputError(
            f"{npz.path}: expected {len(meshes)} names and a keyframe among them; it is damaged: run again"
        )
    try:
        report = json.loads(read_bytes(path / "report.json"))
    except (ValueError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path / 'report.json'}: not valid JSON ({reason(error)}); run again") from None
    look = {name: npz.array(name) for name in Appearance.NAMES if name in npz}
    try:
        appearance = Appearance.from_arrays(look, meshes.vertices.shape[1], len(meshes.faces))
        if appearance.frame_colors is not None and len(appearance.frame_colors) != len(meshes):
            raise InputError(f"frame_colors: expected {len(meshes)} frames, got {len(appearance.frame_colors)}")
    except InputError as error:
        raise InputError(f"{npz.path}: {error}") from None
    confidence = npz.array("confidence") if "confidence" in npz else None
    if confidence is not None and (confidence.shape, confidence.dtype) != (meshes.vertices.shape[:2], np.uint8):
        raise InputError(
            f"{npz.path}: confidence: expected shape {meshes.vertices.shape[:2]} uint8, got {confidence.shape} "
            f"{confidence.dtype}; it is damaged: run again"
        )
    image = next((path / name for name in TEXTURES if (path / name).is_file()), None)
    if image is not None and (appearance.uv is not None or appearance.corner_uv is not None):
        appearance = replace(appearance, texture=read_texture_file(image))
    return SavedRun(path, meshes, keyframe, names, load_config(path / "config.toml"), report, appearance, confidence)


def save_run(
    result: Reconstruction, path: Path | str, names: Sequence[str] | None = None, *, overwrite: bool = False
) -> Path:
    """Write what ``reconstruct`` returned as a run folder, for ``load_run`` and for every command; whole or not at all.

    Args:
        names: of its T frames, as ``PointSequence.frame_names``; "frame 0", "frame 1", ... if not given.
        overwrite: replace a result that stands there.

    Returns:
        The folder, absolute.

    Raises:
        InputError: something stands there, or it cannot be written.
    """
    return RunFolder.prepare(path, overwrite).save(
        vertices=result.vertices,
        faces=result.faces,
        keyframe=result.keyframe,
        config=result.config,
        report=result.report,
        steps=result.steps,
        names=[f"frame {t}" for t in range(len(result.vertices))] if names is None else names,
        motion=result.motion,
        appearance=result.appearance,
        confidence=result.confidence,
    )


def write_metrics(path: Path | str, metrics: Mapping[str, Any]) -> Path:
    """Put ``metrics.json`` into a run folder, whole or not at all; an older one is replaced. Returns its path.

    Raises:
        InputError: not a run folder, or it cannot be written.
    """
    path = Path(path)
    _require_run(path)
    write_text(path / "metrics.json", json_text(metrics) + "\n")
    return path / "metrics.json"


def _require_run(path: Path) -> None:
    must_exist(path)
    missing = [name for name in REQUIRED if not (path / name).is_file()]
    if missing:
        raise InputError(f"{path}: expected the folder of a warpdef run, got one without {', '.join(missing)}")
