"""What a view shows: panes side by side, each a moving mesh, clouds, or both. No drawing here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from warpdef.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from warpdef.apps.viewer.judged import Judged
    from warpdef.mesh import MeshSequence, TriMesh
    from warpdef.vertex_measures import VertexMeasures

INPUT_FILES, TRUTH_FILES = ("clouds.npz",), ("truth.npz",)
"""What a demo leaves beside its result, taken where nothing else is named."""
OUTLINE_POINTS = 50000
"""About as many of all points as the camera is fitted to."""


@dataclass
class Pane:
    """One picture of a view.

    title:     shown above it
    meshes:    the moving mesh; or one mesh a frame, of any triangles; or nothing
    clouds:    point clouds over it                               T arrays (N_t, 3)
    cloud_colors: of a pane of clouds alone, where they have any  T arrays (N_t, 3) uint8 or None
    colors:    of the vertices, where there are any of their own  (V, 3) uint8, or (T, V, 3) of every frame
    colouring: the measures that the mesh can be coloured by
    keyframe:  frame that the mesh was built on
    against:   what the error is the distance to
    rest:      places that the colours of the material come from; None: the keyframe's   (V, 3)
    """

    title: str
    meshes: MeshSequence | Sequence[TriMesh] | None = None
    clouds: Sequence[np.ndarray] | None = None
    colors: np.ndarray | None = None
    colouring: VertexMeasures | None = None
    keyframe: int = 0
    against: str = ""
    rest: np.ndarray | None = None
    cloud_colors: Sequence[np.ndarray | None] | None = None

    def surface(self, frame: int) -> tuple[np.ndarray, np.ndarray] | None:
        """Vertices (V, 3) and faces (F, 3) of a frame."""
        if self.meshes is None:
            return None
        mesh = self.meshes[frame]
        return mesh.vertices, mesh.faces

    @property
    def moving(self) -> MeshSequence | None:
        """The mesh, where its triangles are the same in all frames."""
        from warpdef.mesh import MeshSequence

        return self.meshes if isinstance(self.meshes, MeshSequence) else None


@dataclass
class Content:
    """All panes of a view, and what they share.

    names: what the frames are called     T strings
    up:    the axis that points up        "y" or "z"
    unit:  what lengths are given in
    origin: what was taken off all places   (3,)
    judged: what the report of the first result says of the frames; None: nothing
    bounds: low and high corner of all frames
    outline: places that the camera is to see: the utmost and some of the others     (N, 3)

    Drawing is in float32: data far from its origin is to be brought near it first, as ``load_content`` does.
    """

    panes: list[Pane]
    names: tuple[str, ...]
    up: str = "y"
    unit: str = "input units"
    origin: np.ndarray = field(default_factory=lambda: _nowhere())
    judged: list[Judged] | None = None
    bounds: tuple[np.ndarray, np.ndarray] = field(init=False)
    outline: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        import numpy as np

        parts = []
        for pane in self.panes:
            if pane.moving is not None:
                parts.append(pane.moving.vertices.reshape(-1, 3))
            elif pane.meshes is not None:
                parts += [mesh.vertices for mesh in pane.meshes]
            # Single stray points must not push the camera away.
            parts += [_without_strays(points) for points in pane.clouds or ()]
        self.bounds = (
            np.min([p.min(axis=0) for p in parts], axis=0).astype(float),
            np.max([p.max(axis=0) for p in parts], axis=0).astype(float),
        )
        stride = 1 + sum(map(len, parts)) // OUTLINE_POINTS
        utmost = [p[np.concatenate([p.argmin(axis=0), p.argmax(axis=0)])] for p in parts]
        self.outline = np.concatenate([*utmost, *(p[::stride] for p in parts)]).astype(float)

    def __len__(self) -> int:
        return len(self.names)

    @property
    def measures(self) -> list[str]:
        """Measures that any pane can be coloured by."""
        found = [pane.colouring.measures for pane in self.panes if pane.colouring is not None]
        return list(dict.fromkeys(name for names in found for name in names))


def _nowhere() -> np.ndarray:
    import numpy as np

    return np.zeros(3)


def load_content(
    output: Path,
    *,
    clouds: Path | None = None,
    truth: Path | None = None,
    truth_frames: slice | None = None,
    compare: Path | None = None,
    side_by_side: bool = False,
    frames: slice | None = None,
    up: str = "y",
    unit: str = "input units",
) -> Content:
    """Read a run and what belongs to it.

    Args:
        output: the run folder.
        clouds: its input; the run's own frames of it are taken. None: clouds.npz in the run folder, where there is one.
        truth: true meshes; None: truth.npz in the run folder, where there is one.
        truth_frames: the truth's frames that the run was made from.
        compare: another run of the same frames, shown beside.
        side_by_side: input, reconstruction and truth in panes of their own.
        frames: frames of the run to show.

    Raises:
        InputError: something is missing or damaged, or numbers of frames do not fit.
    """
    from warpdef.apps.viewer.judged import judged_frames
    from warpdef.config_values import parse_slice
    from warpdef.export.origin import choose_origin
    from warpdef.files import read_clouds, read_mesh_frames, same_triangles
    from warpdef.files.frame_files import select_frames
    from warpdef.files.saved_run import load_run

    run = load_run(output)
    clouds, truth = clouds or _beside(output, INPUT_FILES), truth or _beside(output, TRUTH_FILES)
    chosen = select_frames(range(len(run.meshes)), frames, 1, run.path)
    origin = choose_origin(run.meshes.vertices)
    points = true_meshes = None
    shades: list[np.ndarray | None] = []
    if clouds is not None:
        sequence = read_clouds(clouds, parse_slice(run.config.frames))
        read, shades = sequence.all_frames(), sequence.all_colors()
        _same_count(len(read), run, clouds, "choose the clouds that it was made from with --input")
        points = [read[t] - origin for t in chosen]
    if truth is not None:
        read_meshes = read_mesh_frames(truth, truth_frames)
        _same_count(
            len(read_meshes), run, truth, "pick the frames it was made from with --truth-frames start:stop:step"
        )
        picked = [_shifted(read_meshes[t], origin) for t in chosen]
        true_meshes = same_triangles(picked) or picked
    beside = (chosen, origin, points, true_meshes)
    panes = [_run_pane(output, run, "reconstruction" if compare is None else str(output), *beside)]
    if compare is not None:
        other = load_run(compare)
        _same_count(len(other.meshes), run, compare, "compare runs of the same frames")
        panes.append(_run_pane(compare, other, str(compare), *beside))
    if side_by_side:
        if points is None and true_meshes is None and compare is None:
            raise InputError("--side-by-side: expected something to show beside; give --input, --truth or --compare")
        if true_meshes is not None:
            panes.append(_truth_pane(true_meshes, panes[0]))
        if points is not None:
            own = [shades[t] for t in chosen] if any(c is not None for c in shades) else None
            panes.insert(0, Pane("input", clouds=points, cloud_colors=own))
    names = tuple(run.names[t] for t in chosen)
    return Content(panes, names, up, unit, origin, judged_frames(run.report, chosen, len(run.meshes)))


def _without_strays(points: np.ndarray) -> np.ndarray:
    """The points between the 0.5th and the 99.5th percentile of each axis; all, where none are."""
    import numpy as np

    low, high = np.percentile(points, (0.5, 99.5), axis=0)
    kept = points[((points >= low) & (points <= high)).all(axis=1)]
    return kept if len(kept) else points


def _beside(output: Path, names: Sequence[str]) -> Path | None:
    return next((output / name for name in names if (output / name).is_file()), None)


def _same_count(count: int, run, path: Path, advice: str) -> None:
    if count != len(run.meshes):
        raise InputError(f"{path}: expected the {len(run.meshes)} frames of {run.path}, got {count}; {advice}")


def _shifted(mesh: TriMesh, origin: np.ndarray) -> TriMesh:
    from dataclasses import replace

    return replace(mesh, vertices=mesh.vertices - origin) if origin.any() else mesh


def _run_pane(path: Path, run, title: str, chosen: list[int], origin: np.ndarray, points, truth) -> Pane:
    import numpy as np

    from warpdef.apps.viewer.texture import shown_colors
    from warpdef.mesh import MeshSequence
    from warpdef.vertex_measures import VertexMeasures

    colors = run.appearance.frame_colors
    if colors is None:
        colors = shown_colors(run.appearance, run.meshes.faces, run.meshes.vertices.shape[1])
    else:
        colors = colors[chosen]
    vertices = run.meshes.vertices[chosen]
    meshes = MeshSequence(vertices - origin if origin.any() else vertices, run.meshes.faces)
    # The keyframe may not be among the frames shown; the nearest one takes its part.
    keyframe = int(np.abs(np.array(chosen) - run.keyframe).argmin())
    confidence = None if run.confidence is None else run.confidence[chosen]
    colouring = VertexMeasures(meshes, keyframe, points, truth, confidence)
    against = "the truth" if truth is not None else "the input's points" if points is not None else ""
    return Pane(title, meshes, points, colors, colouring, keyframe, against)


def _truth_pane(true_meshes: MeshSequence | Sequence[TriMesh], beside: Pane) -> Pane:
    """The truth, coloured at the same frame as the reconstruction beside it; its error is the way back, to that one.

    A limb that the reconstruction lacks is far from it only seen from here.
    """
    from warpdef.vertex_measures import VertexMeasures

    colouring = VertexMeasures(true_meshes, beside.keyframe, truth=beside.meshes)
    return Pane("truth", true_meshes, colouring=colouring, keyframe=beside.keyframe, against=f"the {beside.title}")
