"""Everything before the method: what is asked for, checked, and the clouds that it begins with, cleaned."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import warp as wp

from warpdef.cleaning.coarse_steps import tell_coarse_steps
from warpdef.cleaning.crop import crop
from warpdef.cleaning.far_points import drop_far
from warpdef.cleaning.frame_sides import turn_to_one_side
from warpdef.cleaning.mixed_units import require_one_unit
from warpdef.cleaning.odd_frames import leave_out_odd
from warpdef.cleaning.order import put_in_order
from warpdef.cleaning.static_parts import tell_static_parts
from warpdef.cleaning.static_planes import cut_static_planes
from warpdef.cleaning.strays import drop_strays
from warpdef.cleaning.useless_normals import leave_out_useless_normals
from warpdef.config import Config
from warpdef.config_values import parse_slice
from warpdef.device import find_device
from warpdef.errors import InputError
from warpdef.files import read_clouds, read_mesh
from warpdef.files.landmarks import Landmarks, read_landmarks
from warpdef.fit.saving import Saved
from warpdef.memory import MemoryEstimate, require_memory
from warpdef.mesh import TriMesh
from warpdef.progress import Clock
from warpdef.sequence import PointSequence
from warpdef.shortage import explained_shortage
from warpdef.template.keyframe import require_keyframe

READ_FACTOR = 20
"""Points of a frame kept while reading, times those that the method is to use."""


@dataclass(frozen=True)
class Safeguards:
    """How a run keeps what it has done, and when it ends early; nothing of it changes what an unbroken run computes.

    checkpoint:         file that the state is written to now and then; it is the caller's to remove; None: none
    checkpoint_seconds: least time between two
    resume:             checkpoint to go on from, on the same input, with its own configuration and the shape of its own
                        template (whose colours come back with ``template``): on the CPU to the same bits
    notes:              kept in the checkpoint for whoever resumes
    seconds_max:        time after which the best state so far is returned; some of it goes to the vertex stage
    memory_limit:       GiB that the run may be estimated to need; None: what is free; 0: no limit
    """

    checkpoint: Path | None = None
    checkpoint_seconds: float = 60.0
    resume: Saved | Path | None = None
    notes: Mapping[str, str] = field(default_factory=dict)
    seconds_max: float | None = None
    memory_limit: float | None = None


@dataclass(frozen=True)
class Prepared:
    """What the method begins with.

    sequence: the clouds used, cleaned, input units
    template: a mesh of the user's own, input units, or None
    config:   the whole configuration
    device:   where the fit runs
    saved:    the checkpoint to go on from, or None
    estimate: memory that the run will need
    clock:    begun before any of it
    """

    sequence: PointSequence
    template: TriMesh | None
    config: Config
    device: wp.Device
    saved: Saved | None
    estimate: MemoryEstimate
    clock: Clock
    landmarks: Landmarks | None = None


def prepare(
    sequence: PointSequence | np.ndarray | Sequence[np.ndarray],
    config: Config | None,
    template: TriMesh | None,
    device: str,
    safeguards: Safeguards,
) -> Prepared:
    """Check what is asked for and clean the clouds; arguments as ``pipeline.reconstruct``.

    Raises:
        InputError: clouds, template or checkpoint are not usable, or the run does not fit into memory.
        DeviceError: no such device, or its memory ran out.
    """
    saved = Saved(safeguards.resume) if isinstance(safeguards.resume, Path) else safeguards.resume
    if saved is not None and config not in (None, saved.config):
        raise InputError(f"{saved.path}: a run goes on with its own configuration; leave config out")
    config = saved.config if saved is not None else config or Config()
    clock = Clock(saved.facts["seconds"] if saved is not None else None)
    target = find_device(device)
    if not isinstance(sequence, PointSequence):
        sequence = PointSequence.from_arrays(sequence)
    sequence = sequence.select(parse_slice(config.frames))
    require_keyframe(config.keyframe, sequence.frame_count)
    if template is None and saved is None and config.template.mesh:
        template = read_mesh(Path(config.template.mesh))

    landmarks = read_landmarks(config.landmarks) if config.landmarks else None
    if saved is not None:
        saved.require_landmarks(landmarks)

    # Before anything costly is done with the points.
    sizes = [min(len(p), config.points or len(p)) for p in sequence.points]
    vertex_count = len(template.vertices) if template else saved.vertex_count if saved is not None else None
    estimate = require_memory(sizes, vertex_count, config, target, safeguards.memory_limit)

    with clock.phase("clean"), explained_shortage(estimate, target):
        sequence = clean(sequence, config, target)
    if saved is not None:
        saved.require_input(sequence)
    return Prepared(sequence, template, config, target, saved, estimate, clock, landmarks)


def read_input(path: Path, config: Config, strict: bool = False) -> PointSequence:
    """The frames ``config.frames`` of the clouds at ``path``, not cleaned; arguments as ``read_clouds``.

    Raises:
        InputError, MissingPackageError: as ``read_clouds``.
    """
    # Of a frame far larger than asked for only a part is held; the method draws from it.
    kept = READ_FACTOR * config.points
    return read_clouds(
        path, parse_slice(config.frames), strict=strict, points=kept, seed=config.seed, columns=config.columns
    )


def clean(sequence: PointSequence, config: Config, device: wp.Device | None = None) -> PointSequence:
    """The points that the method uses: of the object, on its surface, in frames that belong together; then drawn from.

    Each step says in a note what it left out. What is far goes first, as all else takes its scale from the rest.
    Neighbours are looked for on ``device``; None: on the host, without Warp.

    Raises:
        InputError: frames in other units than the rest.
    """
    if config.crop:
        sequence = crop(sequence, config.crop)
    if config.drop_strays:
        sequence = drop_far(sequence)
    whole = sequence
    if config.cut_static:
        sequence = cut_static_planes(sequence)
    if config.drop_strays:
        sequence = drop_strays(sequence, device, scene=sequence is not whole)
    sequence = tell_coarse_steps(sequence)
    if not config.trust_normals:
        sequence = turn_to_one_side(leave_out_useless_normals(sequence), config.template.neighbours)
    if config.order == "auto":
        sequence = put_in_order(sequence)
    if config.drop_odd_frames and not sequence.order:
        sequence = leave_out_odd(sequence)
    require_one_unit(sequence)
    if config.cut_static:
        sequence = tell_static_parts(sequence)  # of frames that belong together: a scale of its own hides all motion
    return sequence.subsample(config.points, config.seed) if config.points else sequence
