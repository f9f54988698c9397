"""The result of a run held against its clouds: what can be known without a truth, frame by frame."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdef.cloud import FramePoints, draw_points
from warpdef.geometry.closest import load_closest
from warpdef.geometry.triangles import is_watertight
from warpdef.quality.astray import astray_lengths
from warpdef.quality.confidence import vertex_confidence
from warpdef.quality.coverage import Coverage, doubled_vertices, measure_coverage
from warpdef.quality.enclosed import inner_share
from warpdef.quality.exposed import exposed_share, spanning_share
from warpdef.quality.frame import FrameQuality
from warpdef.quality.layers import merged_share
from warpdef.quality.overhang import outgrown_shares, overhang_share, surplus_share
from warpdef.quality.shape import ReferenceShape, ShapeChange
from warpdef.quality.slippage import Slippable, slippable_parts
from warpdef.quality.swollen import LimbAreas
from warpdef.quality.temporal import acceleration, flicker
from warpdef.quality.verdict import DOUBTFUL, INNER_WALL, LOST, Verdict, judge
from warpdef.sequence import name_frames

if TYPE_CHECKING:
    import warp as wp

POINTS_JUDGED = 20_000
"""Points of a frame that are looked at; of larger clouds as many are drawn."""
SIDE_BY_SIDE = 8
"""Frames at most that are looked at at the same time: each takes some tens of megabytes meanwhile."""
GUESSED = 0.05
"""Share of a frame's surface far from every point from which it is told that this is a guess."""
LAYERS = ("astray", "inner", "doubled", "layered", "shared", "blur", "exposed", "spanning", "swollen") + (
    "merged",
    "overhang",
    "surplus",
    "outgrown",
)
"""Measures of where surface lies beside that of others, or where none is: fields of ``FrameQuality``."""
_DEVIATION = np.sqrt(0.5 * np.pi)  # standard deviation of a normal distribution over the mean of its absolute values


@dataclass(frozen=True)
class Assessment:
    """All T frames.

    frames:     what was measured
    verdicts:   what follows from it
    confidence: how far each vertex of each frame can be trusted, from 0 to 255   (T, V) uint8
    slippable:  motions of the body that its points do not show
    one_camera: whether one camera saw all clouds, which shows a part of a body at most
    """

    frames: list[FrameQuality]
    verdicts: list[Verdict]
    confidence: np.ndarray
    slippable: list[Slippable]
    one_camera: bool = False

    def as_dict(self) -> dict[str, Any]:
        """``verdicts`` (T of ``good``, ``doubtful``, ``lost``), ``quality`` (a mapping a frame) and ``slippable`` (a
        mapping a motion), for reports.

        Numbers have the four digits that they are good for.
        """
        pairs = zip(self.frames, self.verdicts, strict=True)
        quality = [{**_rounded(asdict(frame)), "reasons": list(verdict.reasons)} for frame, verdict in pairs]
        motions = [motion.as_dict() for motion in self.slippable]
        return {"verdicts": [verdict.name for verdict in self.verdicts], "quality": quality, "slippable": motions}

    def warnings(self) -> list[str]:
        """A line for the lost frames and one for the doubtful ones: their numbers, and the worst reason.

        Frames without points are not named: that they are interpolated is told with the input.
        """
        lines = []
        for name, what in ((LOST, "the mesh is lost in"), (DOUBTFUL, "the mesh is doubtful in")):
            found = [t for t, v in enumerate(self.verdicts) if v.name == name and self.frames[t].points]
            if found:
                worst = max(found, key=lambda t: self.verdicts[t].severity)
                where = f" (frame {worst})" if len(found) > 1 else ""
                lines.append(f"{what} {name_frames(found)}: {self.verdicts[worst].reasons[0]}{where}")
        pairs = zip(self.frames, self.verdicts, strict=True)
        walls = [f for f, v in pairs if f.inner is not None and f.inner > INNER_WALL and v.name != LOST]
        if walls:
            most = max(walls, key=lambda f: f.inner or 0.0)
            where = f" (frame {most.frame})" if len(walls) > 1 else ""
            lines.append(
                f"a wall inside the points, as where surfaces meet or part, in {name_frames([f.frame for f in walls])}"
                f": {most.inner:.0%} of the mesh{where}; its confidence is low"
            )
        pairs = zip(self.frames, self.verdicts, strict=True)
        bare = [f for f, v in pairs if f.far is not None and f.far > GUESSED and v.name != LOST]
        if bare and not self.one_camera:
            most = max(bare, key=lambda f: f.far or 0.0)
            where = f" (frame {most.frame})" if len(bare) > 1 else ""
            lines.append(
                f"{most.far:.0%} of the mesh{where} has no points near it in {name_frames([f.frame for f in bare])}: "
                "there it is a guess, and its confidence is low"
            )
        return lines


def assess(
    clouds: Sequence[np.ndarray],
    vertices: np.ndarray,
    faces: np.ndarray,
    keyframe: int,
    shape: np.ndarray | None = None,
    threads: int = 1,
    eye: np.ndarray | None = None,
    device: wp.Device | None = None,
) -> Assessment:
    """Measure every frame of a result against its cloud and against the shape, and judge it.

    Args:
        clouds: T arrays (N_t, 3), input units; (0, 3) for a frame without points, whose mesh is interpolated.
        vertices: shape (T, V, 3), input units. faces: shape (F, 3).
        keyframe: frame that the mesh was built on.
        shape: shape (V, 3), the shape that all frames should have; the keyframe's mesh if not given, and the keyframe
            itself is then held against the median of all frames' edges.
        threads: frames looked at side by side; the answer is the same.
        eye: place of the one camera that saw all clouds, (3,), input units; None if there was none.
        device: where Warp looks for what is nearest; None: without Warp. The answer is the same but for what float32
            cannot tell.

    Raises:
        MissingPackageError: gpytoolbox cannot be imported.
    """
    # Far from the origin squares would lose the shape.
    centre = vertices[keyframe].mean(axis=0, dtype=np.float64)
    reference = ReferenceShape((vertices[keyframe] if shape is None else shape) - centre, faces)
    limbs = None if eye is None else LimbAreas(reference.vertices, faces, reference.edges)
    usual = None
    if shape is None and len(vertices) > 2:
        usual = np.median([reference.edge_lengths(v - centre) for v in vertices], axis=0)

    calm = flicker(vertices, faces), acceleration(vertices)

    def measure(t: int) -> tuple[FrameQuality, Coverage | None, np.ndarray]:
        points = draw_points(FramePoints(np.asarray(clouds[t], dtype=np.float64)), POINTS_JUDGED, 0, t).points
        placed = vertices[t] - centre
        change = reference.compare(placed, usual if t == keyframe else None)
        coverage = measure_coverage(points - centre, placed, faces, device) if len(points) else None
        layers: dict[str, float | None] = dict.fromkeys(LAYERS)
        if coverage is not None:
            compared = points - centre, placed, faces, coverage
            layers["inner"], layers["overhang"] = inner_share(*compared), overhang_share(*compared)
            layers["merged"], layers["astray"] = merged_share(*compared), astray_lengths(points - centre, coverage)
            if eye is not None:
                layers["exposed"] = exposed_share(*compared, eye - centre)
                layers["spanning"] = spanning_share(*compared, eye - centre)
            if limbs is not None:
                layers["swollen"] = limbs.most_grown(coverage.areas, change.growth)
            # A body that has grown as a whole has grown apart.
            of_vertices = doubled_vertices(coverage, placed, change.growth * reference.vertices, faces)
            for which, found in zip(("doubled", "layered"), of_vertices, strict=True):
                layers[which] = coverage.share(found[faces].mean(axis=1))
            if eye is not None:
                layers["shared"] = layers["layered"]
            if reference.thin is not None:
                layers["blur"] = _noise_around(coverage) / (change.growth * reference.thin)
        quality = _frame(t, points, coverage, change, reference.extent, layers, *(_number(c[t]) for c in calm))
        return quality, coverage, change.stretch

    if device is not None:
        load_closest(device)
    # Trees are built and searched outside of the interpreter's lock.
    with ThreadPoolExecutor(min(threads, SIDE_BY_SIDE)) as pool:
        measured = list(pool.map(measure, range(len(clouds))))
    coverages, stretches = [coverage for _, coverage, _ in measured], [stretch for _, _, stretch in measured]
    frames = [frame for frame, _, _ in measured]
    complete = coverages[keyframe]
    if complete is not None:
        # Borders of what one camera sees move as its view does.
        asked = [None] * len(coverages) if eye is not None else coverages
        outgrown = outgrown_shares(asked, (v - centre for v in vertices), faces, keyframe)
        for t, coverage in enumerate(coverages):
            if coverage is not None:
                frames[t] = replace(frames[t], surplus=surplus_share(coverage, complete), outgrown=outgrown[t])
    confidence = vertex_confidence(coverages, stretches, reference.edges, faces, vertices.shape[1])
    # Where one camera saw a part, that part's border is not the body's.
    whole = eye is None or is_watertight(faces)
    slippable = slippable_parts(vertices[keyframe], faces) if whole else []
    return Assessment(frames, [judge(frame) for frame in frames], confidence, slippable, eye is not None)


def _noise_around(coverage: Coverage) -> float:
    """Noise that the surface bears out. Of sparse points what the body bends between them passes for noise, but a
    surface fitted through them goes where they go: noise wide enough to hide limbs is as wide around the surface."""
    return min(coverage.noise, float(_DEVIATION * coverage.residual.mean()))


def _frame(
    t: int,
    points: np.ndarray,
    coverage: Coverage | None,
    change: ShapeChange,
    extent: float,
    layers: dict[str, float | None],
    frame_flicker: float | None,
    frame_acceleration: float | None,
) -> FrameQuality:
    seen: dict[str, float | None] = dict.fromkeys(
        ("spacing", "noise", "residual_mean", "residual_p95", "residual_mean_percent", "residual_p95_percent")
        + ("misfit", "uncovered", "far", "unseen", "torn")
    )
    if coverage is not None:
        mean, high = float(coverage.residual.mean()), float(np.percentile(coverage.residual, 95.0))
        seen = {
            "spacing": float(np.median(coverage.spacing)),
            "noise": coverage.noise,
            "residual_mean": mean,
            "residual_p95": high,
            "residual_mean_percent": 100.0 * mean / extent,
            "residual_p95_percent": 100.0 * high / extent,
            "misfit": float(np.mean(coverage.residual / coverage.length)),
            "uncovered": coverage.uncovered,
            "far": coverage.far,
            "unseen": coverage.unseen,
            "torn": coverage.share(coverage.far_faces * change.stretched),
        }
    return FrameQuality(
        frame=t,
        points=len(points),
        **seen,
        **layers,
        stretch_p95=float(np.percentile(change.stretch, 95.0)),
        stretch_max=float(change.stretch.max()),
        stretched=change.changed,
        drawn=change.drawn,
        folded=change.folded,
        thickness=change.thickness,
        thinned=change.thinned,
        volume=change.volume,
        flicker=frame_flicker,
        acceleration=frame_acceleration,
    )


def _rounded(values: dict[str, Any]) -> dict[str, Any]:
    return {key: float(f"{value:.4g}") if isinstance(value, float) else value for key, value in values.items()}


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
