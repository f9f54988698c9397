"""The template of all frames, where one shows but a side of the body: one camera, before which the body turns.

How far it turns is measured first, by rigid motions from frame to frame: what counts is the camera's direction as the
body sees it. Where that stays, all frames show the same side, and the template is the keyframe's, as ever. Where it
goes round, the template grows outwards from the keyframe, a frame to either side in turn: the surface known so far
is bent onto the frame (``surfels``), the frame's points are pulled back to the keyframe, and what lies beyond becomes
surface. What came of all frames is averaged across the surface, by trust: how squarely a point was seen, how near
to surface that was known, how few frames from the keyframe. One Poisson over that is the template; where no frame
shows anything it is closed by the smallest surface, as Poisson's own balloons.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from warpdef.config import Config
from warpdef.errors import InputError
from warpdef.fit.embedded import Pose
from warpdef.fit.hidden import bent_as_shown
from warpdef.fit.surfels import MATCHED, SeenFrame, Surfels, nearest_facing
from warpdef.geometry.cloud_planes import unit_vectors
from warpdef.geometry.coverage import area_of_discs
from warpdef.geometry.sampling import mean_spacing, spread_evenly
from warpdef.geometry.triangles import vertex_normals
from warpdef.geometry.viewpoint import seen_normals
from warpdef.mesh import TriMesh
from warpdef.template.build import build, depth_by_spacing
from warpdef.template.choose import ChosenTemplate
from warpdef.template.closing import spanned_smallest
from warpdef.template.keyframe import rank_keyframes
from warpdef.template.quality import judge
from warpdef.template.support import Support
from warpdef.template.trim import find_trimming

TURN_PAYS = 90.0
"""Degrees between the camera's directions, as the body sees them, from which other frames show enough that is new: at
173 of a person it is most of the body, at 89 of a galloping horse what is won is lost again on the way."""
ONE_SIDE = 45.0  # degrees up to which that is called one side
FRAMES_ASKED = 60  # at most, between which the turn is measured
POINTS_LEAST = 200  # of a frame that is asked
KEYFRAME_AREA = 0.6  # least area of a keyframe, over the median frame's
NEW_FACING, NEW_REACH = 0.25, 12.0
"""New surface was seen at least that squarely (cosine), at most so many spacings from known one."""
NEW_LEAST = 0.01  # of the surfels: fewer new ones wait for the next frame
FIRST_SURFELS = 2500  # of the keyframe
EXPLAINED_LEAST = 0.5  # of a frame's points: below, the track is lost
TRUST_REACH = 6.0  # spacings from known surface at which a point counts 1/e^2
TRUST_FADE = 0.26  # share of the frames, from the keyframe, at which it counts 1/e
FACING_LEAST = 0.05
CELL, AVERAGED, WIDTH, NEAR = 1.3, 48, 1.8, 4.0
"""Cells in which one point speaks for all, neighbours averaged at it, Gaussian's deviation, and reach, in spacings."""
SUPPORTED = 0.02  # of the median weight: what has less is left out
SHEET = 0.25  # share of a closed template that no frame shows, from which it is an open one
COARSER = 1  # levels of the octree, as layers of many frames lie a little apart


def measure_turn(frames: dict[int, SeenFrame]) -> float:
    """Most degrees between two directions of the camera as a body sees them that moves from frame to frame.

    Args:
        frames: by number, ascending.
    """
    numbers = sorted(frames)
    if len(numbers) > FRAMES_ASKED:
        numbers = [numbers[i] for i in np.linspace(0, len(numbers) - 1, FRAMES_ASKED).astype(int)]
    turned, seen_from = np.eye(3), [frames[numbers[0]].view]
    for before, after in zip(numbers[:-1], numbers[1:], strict=True):
        turned = frames[before].turned_onto(frames[after]) @ turned
        seen_from.append(turned.T @ frames[after].view)
    directions = np.array(seen_from)
    return float(np.degrees(np.arccos(np.clip(directions @ directions.T, -1.0, 1.0)).max()))


def _seen_frame(points: np.ndarray, given: np.ndarray | None, view: np.ndarray, neighbours: int) -> SeenFrame:
    return SeenFrame(points, seen_normals(points, view, neighbours) if given is None else given, view)


def _sampled_frame(points: np.ndarray, given: np.ndarray | None, view: np.ndarray, neighbours: int) -> SeenFrame:
    """Of it the points that are matched, which are enough for a rigid motion."""
    some = spread_evenly(points, MATCHED)
    sides = seen_normals(points, view, neighbours, asked=some) if given is None else given[some]
    return SeenFrame(points[some], sides, view)


def template_of_all(
    clouds: Sequence[np.ndarray], normals: Sequence[np.ndarray | None], config: Config, view: np.ndarray
) -> tuple[ChosenTemplate | None, str]:
    """The template of all frames that one camera saw, with its places in all of them; and a note on what they show.

    Args:
        clouds: T arrays (N_t, 3), cube units; empty where a frame has no points.
        normals: theirs, unit, on the camera's side; None: estimated. view: unit vector towards the camera, (3,).
        config: the whole configuration.

    Returns:
        None where the body does not turn, or where it is lost on the way; then the note says so.

    Raises:
        InputError: the keyframe asked for does not exist.
        MissingPackageError: the library for the reconstruction is not there.
    """
    asked = [t for t, points in enumerate(clouds) if len(points) >= POINTS_LEAST]
    if len(asked) < 2:
        return None, ""
    how = view, config.template.neighbours
    degrees = measure_turn({t: _sampled_frame(clouds[t], normals[t], *how) for t in asked})
    turns = f"one camera saw all frames, and the body turns by {degrees:.0f} degrees before it"
    if degrees < TURN_PAYS:
        little = "only one side is ever seen" if degrees < ONE_SIDE else "too little for a template of all frames"
        return None, f"{turns}: {little}"
    keyframe, why = _middle_frame(clouds, asked, config)
    frames = {t: _seen_frame(clouds[t], normals[t], *how) for t in asked}
    growth = _Growth(frames, keyframe)
    lost = growth.follow_all()
    if lost is not None:
        return None, (
            f"{turns}, but from keyframe {keyframe} it is lost in frame {lost}: the template is what one frame shows"
        )
    points, sides = growth.fused()
    try:
        chosen, unseen = _template(points, sides, clouds[keyframe], config)
    except InputError as error:
        return None, f"{turns}, but no template came of all frames ({error}): it is what one frame shows"
    note = f"{turns}: the template is made of all frames; none shows {unseen:.0%} of it"
    growth.show_hidden()
    placed = growth.places(chosen.mesh, len(clouds))
    return replace(
        chosen, keyframe=keyframe, why=f"{why}; {note}", warnings=[note, *chosen.warnings], placed=placed
    ), ""


def _middle_frame(clouds: Sequence[np.ndarray], frames: list[int], config: Config) -> tuple[int, str]:
    """The frame from which growth begins, and why: that asked for, else the nearest to the middle that is no scrap."""
    if config.keyframe.choice != "auto":
        asked = rank_keyframes(clouds, config.keyframe)[0]
        return asked.frame, asked.why
    area = {t: _area(clouds[t]) for t in frames}
    least, middle = KEYFRAME_AREA * float(np.median(list(area.values()))), (len(clouds) - 1) / 2
    chosen = min((t for t in frames if area[t] >= least), key=lambda t: (abs(t - middle), t))
    return chosen, "the frame nearest to the middle, from which the surface grows"


def _area(points: np.ndarray) -> float:
    from scipy.spatial import cKDTree

    chosen = points[spread_evenly(points, FIRST_SURFELS)]
    return area_of_discs(cKDTree(chosen).query(chosen, k=min(16, len(chosen)))[0])


class _Growth:
    """The surface known so far, its poses in the frames followed, and what these were pulled back to."""

    def __init__(self, frames: dict[int, SeenFrame], keyframe: int) -> None:
        self.frames, self.keyframe = frames, keyframe
        self.spacing = float(np.mean([frame.spacing for frame in frames.values()]))
        key = frames[keyframe]
        first = spread_evenly(key.points, FIRST_SURFELS)
        self.surfels = Surfels(key.points[first], key.normals[first], self.spacing)
        self.poses: dict[int, Pose] = {keyframe: self.surfels.still()}
        self._points, self._normals = [key.points], [key.normals]
        self._trust = [self._seen_squarely(key) ** 2]

    def follow_all(self) -> int | None:
        """All frames outwards, to either side in turn; the number of the first in which the body is lost, if any."""
        numbers, key = sorted(self.frames), self.keyframe
        later, earlier = [t for t in numbers if t > key], [t for t in numbers if t < key][::-1]
        walks = [[key, *later], [key, *earlier]]
        for i in range(1, max(map(len, walks))):
            for walk in walks:
                if i < len(walk) and not self._follow(*walk[max(i - 2, 0) : i + 1]):
                    return walk[i]
        return None

    def _follow(self, *walk: int) -> bool:
        """The frame that comes last, from the one or two before it; whether it is explained."""
        *_, neighbour, target = walk
        frame, start = self.frames[target], self.poses[neighbour]
        if len(walk) == 3:
            held = self.surfels.supported(self.frames[neighbour], start)
            start = self.surfels.going_on(start, self.poses[walk[0]], held)
        pose = self.surfels.onto(frame, start)
        pulled = self.surfels.pull_back(frame, pose)
        if pulled.explained.mean() < EXPLAINED_LEAST:
            return False
        squarely, reach = self._seen_squarely(frame), self.spacing
        away = np.exp(-((np.minimum(pulled.distance, 100.0 * reach) / (TRUST_REACH * reach)) ** 2))
        fade = np.exp(-abs(target - self.keyframe) / (TRUST_FADE * len(self.frames)))
        self._points.append(pulled.points)
        self._normals.append(pulled.normals)
        self._trust.append((squarely * away) ** 2 * fade)
        self.poses[target] = pose
        known = nearest_facing(self.surfels.points, self.surfels.normals, pulled.points, pulled.normals, reach)[0]
        new = ~pulled.explained & (known > reach) & (pulled.distance < NEW_REACH * reach)
        new = np.flatnonzero(new & (frame.normals @ frame.view > NEW_FACING))
        if len(new):
            # One a cell of the spacing.
            cells = np.floor(pulled.points[new] / reach).astype(np.int64)
            new = new[np.sort(np.unique(cells, axis=0, return_index=True)[1])]
        if len(new) > NEW_LEAST * len(self.surfels.points):
            more = pulled.points[new], pulled.normals[new], pulled.anchor[new]
            self.surfels, self.poses = self.surfels.grown(*more, self.poses)
        return True

    def _seen_squarely(self, frame: SeenFrame) -> np.ndarray:
        return np.clip(frame.normals @ frame.view, FACING_LEAST, 1.0)

    def fused(self) -> tuple[np.ndarray, np.ndarray]:
        """One oriented point a cell and side, (M, 3) both, averaged across the surface over all frames by trust."""
        from scipy.spatial import cKDTree

        points, normals = np.concatenate(self._points), np.concatenate(self._normals)
        trust = np.concatenate(self._trust)
        key = self.frames[self.keyframe].points
        spacing = mean_spacing(key)
        axis = np.abs(normals).argmax(axis=1)
        side = 2 * axis + (np.take_along_axis(normals, axis[:, None], axis=1)[:, 0] > 0)
        cells = np.column_stack([np.floor(points / (CELL * spacing)).astype(np.int64), side])
        order = np.argsort(-trust, kind="stable")
        speaks = order[np.unique(cells[order], axis=0, return_index=True)[1]]
        turned = 2.0 * spacing
        tree = cKDTree(np.column_stack([points, turned * normals]))
        at = np.column_stack([points[speaks], turned * normals[speaks]])
        distance, index = tree.query(at, k=min(AVERAGED, len(points)))
        weight = (distance < NEAR * spacing) * np.exp(-0.5 * (distance / (WIDTH * spacing)) ** 2) * trust[index]
        mean = np.einsum("nk,nki->ni", weight, normals[index])
        mean = unit_vectors(mean)
        off = ((points[index] - points[speaks][:, None]) * mean[:, None]).sum(axis=2)
        total = weight.sum(axis=1)
        kept = total > SUPPORTED * np.median(total)
        across = (weight * off).sum(axis=1)[kept] / total[kept]
        return points[speaks][kept] + across[:, None] * mean[kept], mean[kept]

    def show_hidden(self) -> None:
        """What frames hide, put as the frames around them show it."""
        self.poses = bent_as_shown(self.surfels, self.frames, self.poses, self.keyframe)

    def places(self, mesh: TriMesh, frame_count: int) -> np.ndarray:
        """Where the mesh is in all frames, (T, V, 3) float32; in frames not followed as in the nearest that was."""
        facing = vertex_normals(mesh.vertices, mesh.faces)
        found, followed = [], np.array(sorted(self.poses))
        for t in range(frame_count):
            pose = self.poses[int(followed[np.abs(followed - t).argmin()])]
            found.append(self.surfels.carry(mesh.vertices, facing, pose).astype(np.float32))
        return np.stack(found)


def _template(
    points: np.ndarray, normals: np.ndarray, keyframe: np.ndarray, config: Config
) -> tuple[ChosenTemplate, float]:
    """The mesh through oriented points (M, 3) of all frames, judged; and the share of it that none shows."""
    depth = config.template.depth or max(depth_by_spacing(keyframe) - COARSER, 3)
    asked = replace(config.template, depth=depth)
    closes = replace(asked, surface="closed") if asked.surface == "auto" else asked
    built = build(points, normals, closes, source="seen")
    mesh, unseen = built.mesh, 0.0
    if asked.surface != "open":
        flat, unseen = _closed_flat(mesh, Support.of(points, normals))
        mesh = flat
        if asked.surface == "auto" and unseen > SHEET:
            built = build(points, normals, asked, source="seen")
            mesh, unseen = built.mesh, 0.0
    is_open = built.report.surface == "open"
    gate = judge(mesh, points, asked, config.seed, is_open)
    return ChosenTemplate(mesh, 0, "", built.report, gate, list(built.warnings)), unseen


def _closed_flat(mesh: TriMesh, support: Support) -> tuple[TriMesh, float]:
    """The same with openings of the cloud spanned by a surface that is as small as it can be; and their share."""
    trimming = find_trimming(mesh.vertices, mesh.faces, support)
    free = trimming.level <= 0
    share = trimming.share / (1.0 + trimming.share)
    if not free.any() or free.all():
        return mesh, share
    return TriMesh(spanned_smallest(mesh.vertices, mesh.faces, free), mesh.faces), share
