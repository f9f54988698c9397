"""One run of an experiment: sample, reconstruct, compare. Only the public interface is used."""

from __future__ import annotations

import hashlib
import json
import time
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import warpdef
from warpdef.apps.experiments.code_version import code_version
from warpdef.apps.signals import interruption
from warpdef.config import Config
from warpdef.errors import InputError, WarpdefError

if TYPE_CHECKING:
    from warpdef.mesh import MeshSequence, TriMesh
    from warpdef.sequence import PointSequence

TRUTH_TEMPLATE = "truth"
"""In ``ExperimentRun.template``: the true mesh of the keyframe, the best that any outside initialiser could give."""


class TruthSource(Protocol):
    """Where a true sequence comes from; ``warpdef.datasets.TrueSequence`` is one."""

    @property
    def name(self) -> str: ...
    @property
    def kind(self) -> str: ...
    @property
    def frames(self) -> int: ...
    @property
    def vertices(self) -> int: ...
    @property
    def faces(self) -> int: ...
    @property
    def clouds(self) -> Path | None: ...
    @property
    def path(self) -> Path: ...

    def load(self, frames: slice | None = None) -> MeshSequence: ...


@dataclass(frozen=True)
class Figure:
    """The built-in walking figure as a true sequence: for runs without any data."""

    frames: int = 17
    name: str = "walking_figure"
    path: Path = Path()
    kind: str = "figure"
    vertices: int = 0
    faces: int = 0
    clouds: Path | None = None

    def load(self, frames: slice | None = None) -> MeshSequence:
        """The walk's frames of a slice."""
        return _walk(self.frames).select(frames if frames is not None else slice(None))


@lru_cache(maxsize=1)  # making it takes seconds, and every run of an experiment asks
def _walk(frames: int) -> MeshSequence:
    return warpdef.walking_figure(frames)


@dataclass(frozen=True)
class ExperimentRun:
    """Everything that decides the numbers of one run, and nothing else.

    source:   the true sequence
    frames:   its frames used, in order; a frame may come again
    points:   sampled a frame; of given clouds the number kept, 0 for all
    noise:    standard deviation over the diagonal of the frame's bounding box
    config:   the whole configuration; its seed is also that of points, noise and comparison
    samples:  on each surface, in the comparison
    clouds:   file or folder of clouds to take instead of sampling
    scale, translation: of the clouds' coordinates over the truth's
    template: a mesh file from outside, ``TRUTH_TEMPLATE``, or empty
    fresh:    in a process of its own, so that its peak of memory is its own
    """

    source: TruthSource
    frames: tuple[int, ...]
    points: int
    config: Config
    noise: float = 0.0
    samples: int = 100_000
    clouds: Path | None = None
    scale: float = 1.0
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    template: str = ""
    fresh: bool = False

    def describe(self) -> dict[str, Any]:
        """The run as plain values. Places of files are left out: data may move."""
        s = self.source
        return {
            "sequence": s.name,
            "kind": s.kind,
            "size": [s.frames, s.vertices, s.faces],
            "frames": frame_text(self.frames),
            "points": self.points,
            "noise": self.noise,
            "clouds": "" if self.clouds is None else self.clouds.name,
            "scale": self.scale,
            "translation": list(self.translation),
            "template": Path(self.template).name,
            "fresh": self.fresh,
            "samples": self.samples,
            "config": asdict(self.config),
            "code": code_version(),
        }

    @property
    def key(self) -> str:
        """File name of the run's result: readable, and different for runs that differ in anything."""
        text = json.dumps(self.describe(), sort_keys=True)
        plain = "".join(c if c.isalnum() or c in "_.-" else "_" for c in self.source.name)[-60:]
        return f"{plain}-{len(self.frames)}x{self.points}-{hashlib.sha256(text.encode()).hexdigest()[:12]}"


def frame_text(frames: tuple[int, ...]) -> str:
    """``10:27`` for consecutive frames, ``10:27:2`` for even steps; else what a to-and-fro sequence is made of."""
    first, last = frames[0], frames[-1]
    step = frames[1] - first if len(frames) > 1 else 1
    if step > 0 and frames == tuple(range(first, last + 1, step)):
        return f"{first}:{last + 1}" + (f":{step}" if step > 1 else "")
    return f"{min(frames)}:{max(frames) + 1} to and fro, {len(frames)} frames"


def to_and_fro(available: int, count: int) -> tuple[int, ...]:
    """``count`` frames out of ``available``, played forwards and backwards as often as needed; no frame twice in a row.

    Raises:
        InputError: fewer than 2 frames available.
    """
    if available < 2:
        raise InputError(f"a long sequence: expected at least 2 frames to play to and fro, got {available}")
    period = 2 * (available - 1)
    return tuple(min(i % period, period - i % period) for i in range(count))


def execute(
    run: ExperimentRun, device: str = "auto", threads: int | None = None, keep: Path | None = None
) -> dict[str, Any]:
    """Do one run and measure its result.

    Args:
        run: what to do.
        device, threads: as for ``warpdef.reconstruct``; they change the time, on one kind of device not the numbers.
        keep: folder in which to put the result itself, under the run's key.

    Returns:
        Plain values: ``key``, ``run``, ``mean`` and ``frames`` (see ``warpdef.evaluate``), ``worst`` (the largest
        Chamfer distance of a frame), keyframe, template, iterations, seconds, memory, warnings, device.

    Raises:
        WarpdefError: the data or the configuration is not usable.
        KeyboardInterrupt: the optimisation was ended early by a signal; half a result is none.
    """
    truth = load_truth(run)
    clouds = _clouds(run, truth)
    template, config = _template(run, truth, clouds)
    start = time.perf_counter()
    result = warpdef.reconstruct(clouds, config, device=device, threads=threads, template=template)
    middle = time.perf_counter()
    report = result.report
    if report["interrupted"]:
        raise interruption(report)
    metrics = warpdef.evaluate(result, truth, samples=run.samples, seed=run.config.seed)
    if keep is not None:
        _keep(keep / run.key, result, clouds.names, metrics)
    return {
        "key": run.key,
        "run": run.describe(),
        "mean": metrics["mean"],
        "worst": max(frame["chamfer_l2"] for frame in metrics["frames"]),
        "frames": metrics["frames"],
        "keyframe": result.keyframe,
        "template": report["template"],
        "iterations": report["iterations"],
        "reconstruct_s": middle - start,
        "evaluate_s": time.perf_counter() - middle,
        "phases_s": report["seconds"],
        "peak_memory_mb": report["peak_memory_mb"],
        "warnings": report["warnings"],
        "device": report["device"],
        "threads": report["threads"],
        "versions": report["versions"],
    }


def load_truth(run: ExperimentRun) -> MeshSequence:
    """The true frames of a run, in the coordinates of its clouds."""
    import numpy as np

    first, last = min(run.frames), max(run.frames)
    if last >= run.source.frames:
        raise InputError(f"{run.source.name}: expected frames up to {run.source.frames - 1}, got {last}")
    loaded = run.source.load(slice(first, last + 1))
    vertices = loaded.vertices[[i - first for i in run.frames]]
    if run.scale != 1.0 or any(run.translation):
        vertices = vertices.astype(np.float64) * run.scale + np.array(run.translation)
    return warpdef.MeshSequence(vertices, loaded.faces)


def _clouds(run: ExperimentRun, truth: MeshSequence) -> PointSequence:
    if run.clouds is None:
        return warpdef.sample_sequence(truth, run.points, noise=run.noise, seed=run.config.seed)
    clouds = warpdef.read_clouds(run.clouds)
    if len(clouds) < len(truth):
        raise InputError(f"{run.clouds}: expected clouds for {len(truth)} frames, got {len(clouds)}")
    clouds = clouds.select(slice(len(truth)))
    return clouds.subsample(run.points, run.config.seed) if run.points else clouds


def _template(run: ExperimentRun, truth: MeshSequence, clouds: PointSequence) -> tuple[TriMesh | None, Config]:
    """The mesh given from outside, and the configuration, which then names the frame that the mesh belongs to."""
    if not run.template:
        return None, run.config
    from warpdef.sequence import Similarity
    from warpdef.template.keyframe import rank_keyframes

    into = Similarity.into_cube(clouds.points, run.config.fill)
    frame = rank_keyframes([into.to_cube(p) for p in clouds.points], run.config.keyframe)[0].frame
    mesh = truth[frame] if run.template == TRUTH_TEMPLATE else warpdef.read_mesh(Path(run.template))
    return mesh, with_values(run.config, {"keyframe.choice": str(frame)})


def _keep(folder: Path, result: Any, names: tuple[str, ...], metrics: dict[str, Any]) -> None:
    from warpdef.files.run_folder import RunFolder
    from warpdef.files.saved_run import write_metrics

    write_metrics(
        RunFolder.prepare(folder, overwrite=True).save(
            vertices=result.vertices,
            faces=result.faces,
            keyframe=result.keyframe,
            config=result.config,
            report=result.report,
            steps=result.steps,
            names=names,
        ),
        metrics,
    )


def value_of(config: Config, key: str) -> Any:
    """The value under a dotted key, as ``grid.levels``.

    Raises:
        WarpdefError: no such key.
    """
    group, _, name = key.rpartition(".")
    holder = getattr(config, group, None) if group else config
    if not hasattr(holder, name):
        raise WarpdefError(f"configuration: no key {key!r}; see the table of the configuration")
    return getattr(holder, name)


def with_values(config: Config, values: dict[str, Any]) -> Config:
    """A copy with dotted keys replaced: ``{"grid.levels": 4}``. Keys of one group change together.

    Raises:
        ConfigError: a value that its field does not allow. WarpdefError: no such key.
    """
    groups: dict[str, dict[str, Any]] = {}
    for key, value in values.items():
        value_of(config, key)
        group, _, name = key.rpartition(".")
        groups.setdefault(group, {})[name] = value
    top = groups.pop("", {})
    return replace(config, **top, **{group: replace(getattr(config, group), **v) for group, v in groups.items()})
