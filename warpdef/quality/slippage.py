"""Rigid motions in which a whole body slides along itself: a cup that turns about its axis looks as before.

So does a ball beside the body that throws it: closed parts of a mesh are asked each for itself.

Where the body moved so, its points tell nothing of it, and no fit can: the mesh stays and its vertices slide. For all
six rigid motions (Gelfand and Guibas 2004, *Shape Segmentation Using Local Slippage Analysis*, sec. 3), with the turn w
about the centroid and the shift v,

    across = sum_i a_i (n_i . (w x p_i + v))^2      moved = sum_i a_i |w x p_i + v|^2

over the surface, places p_i from its centroid with areas a_i and unit normals n_i. Both are quadratic forms of (w, v);
the eigenvalues of the first by the second are the shares of motions that are across the surface, the least first: 0 for
a ball's turns, 1/3 for its shifts. A border shows what the surface beside it does not: its edges count in ``across`` as
faces of a certain width that face outwards along the surface.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from warpdef.geometry.triangles import border_sides, face_components, face_normals, is_watertight

SLIDES = 0.07
"""Share of a motion across the surface below which it can hardly be seen: 0.1 to 0.2 is the least of people, animals,
hands, faces and cloth, 0.06 that of a cup with a handle about its axis."""
UNSEEN = 0.01
"""The same below which it cannot be seen."""
_PART = 0.02  # share of the surface from which a part is asked for itself
_GAUSS = (0.5 - 0.5 / np.sqrt(3.0), 0.5 + 0.5 / np.sqrt(3.0))
_BORDER = 0.2  # width of a border, in roots of the surface's area
_TURNS = 0.3  # part of a motion of unit length that is a turn, from which it is no shift
_DIGITS = 4  # of numbers told


@dataclass(frozen=True)
class Slippable:
    """A motion of the keyframe's mesh along itself.

    motion:  ``turn`` or ``shift``
    axis:    direction of either, a unit vector
    through: a place on a turn's axis, input units; None for a shift
    seen:    share of the motion that is across the surface
    part:    number of the part of the mesh that moves so, the others need not; None for the whole
    """

    motion: str
    axis: tuple[float, float, float]
    through: tuple[float, float, float] | None
    seen: float
    part: int | None = None

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


def slippable_parts(vertices: np.ndarray, faces: np.ndarray) -> list[Slippable]:
    """What a mesh (V, 3), (F, 3) can do without being seen; if nothing, what each closed part of it can do."""
    if found := slippable_motions(vertices, faces):
        return found
    of_face = face_components(faces)
    areas = face_normals(vertices.astype(np.float64), faces)[1]
    share = np.bincount(of_face, areas) / max(float(areas.sum()), np.finfo(float).tiny)
    parts = np.flatnonzero(share >= _PART) if len(share) > 1 else []
    for number, part in enumerate(parts):
        used, own = np.unique(faces[of_face == part], return_inverse=True)
        own = own.reshape(-1, 3)
        if is_watertight(own):
            found += [replace(motion, part=number) for motion in slippable_motions(vertices[used], own)]
    return found


def slippable_motions(vertices: np.ndarray, faces: np.ndarray) -> list[Slippable]:
    """What a mesh (V, 3), (F, 3) can do without being seen, turns first; three turns for a ball, none as a rule."""
    from scipy.linalg import eigh

    vertices = vertices.astype(np.float64)
    corners = vertices[faces]
    normal, areas = face_normals(vertices, faces)
    if not (surface := float(areas.sum())) > 0.0:
        return []
    # The middles of a face's sides are exact for what is quadratic.
    places, weight = (
        (0.5 * (corners + np.roll(corners, -1, axis=1))).reshape(-1, 3),
        np.repeat(areas / 3.0, 3) / surface,
    )
    centroid = weight @ places
    places -= centroid
    size = float(np.sqrt(weight @ (places**2).sum(axis=1)))
    places /= size
    moved = np.eye(6)
    moved[:3, :3] -= (places * weight[:, None]).T @ places

    face, *ends = border_sides(faces)
    start, end = vertices[ends[0]], vertices[ends[1]]
    length = np.linalg.norm(end - start, axis=1)
    outwards = np.cross(end - start, normal[face]) / np.maximum(length, np.finfo(float).tiny)[:, None]
    on_border = np.concatenate([start + share * (end - start) for share in _GAUSS])
    places = np.concatenate([places, (on_border - centroid) / size])
    normals = np.concatenate([np.repeat(normal, 3, axis=0), outwards, outwards])
    weight = np.concatenate([weight, *[0.5 * _BORDER * length / np.sqrt(surface)] * 2])
    rows = np.concatenate([np.cross(places, normals), normals], axis=1)
    across = (rows * weight[:, None]).T @ rows
    # What lies on one line does not move about it at all.
    seen, motions = eigh(across, moved + 1e-9 * np.eye(6))
    motions = _parted(motions[:, seen < SLIDES])
    shares = np.einsum("ik,ij,jk->k", motions, across, motions) / np.einsum("ik,ij,jk->k", motions, moved, motions)
    return [_named(motion, float(share), centroid, size) for motion, share in zip(motions.T, shares, strict=True)]


def _parted(motions: np.ndarray) -> np.ndarray:
    """Motions (6, k) that span the same, those that turn most first: as they come, of equal share, they are mixed."""
    if not motions.size:
        return motions
    motions = np.linalg.qr(motions)[0]
    return motions @ np.linalg.svd(motions[:3])[2].T


def _named(motion: np.ndarray, seen: float, centroid: np.ndarray, size: float) -> Slippable:
    turn, shift = motion[:3], motion[3:]
    much = float(np.linalg.norm(turn))
    if much < _TURNS:
        return Slippable("shift", _direction(shift), None, seen)
    place = np.round((centroid + size * np.cross(turn, shift) / much**2) / size, _DIGITS) * size
    return Slippable("turn", _direction(turn), _plain(place), seen)


def _direction(vector: np.ndarray) -> tuple[float, float, float]:
    """A unit vector whose largest part is above zero."""
    unit = vector / np.linalg.norm(vector)
    return _plain(np.round(unit * np.sign(unit[np.abs(unit).argmax()]), _DIGITS))


def _plain(vector: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (float(f"{value:.{_DIGITS}g}") + 0.0 for value in vector)
    return x, y, z


def slip_note(motions: list[Slippable]) -> str:
    """One line for the end of a run; empty if there is none of them."""
    if not motions:
        return ""
    names: list[str] = []
    for part in sorted({m.part for m in motions}, key=lambda part: -1 if part is None else part):
        of_part = [m for m in motions if m.part == part]
        turns = [m for m in of_part if m.motion == "turn"]
        if len(turns) == 3:
            names.append(f"any turn about {_text(turns[0].through or turns[0].axis)}")
        else:
            names += [f"a turn about the axis {_text(m.axis)} through {_text(m.through)}" for m in turns if m.through]
        names += [f"a shift along {_text(m.axis)}" for m in of_part if m.motion == "shift"]
    how = "cannot" if max(m.seen for m in motions) < UNSEEN else "can hardly"
    where = "in this shape" if all(m.part is None for m in motions) else "in a part of this shape"
    return f"{' and '.join(names)} {how} be seen {where}: where it moved so, vertices may have slid along it"


def _text(vector: tuple[float, float, float]) -> str:
    return "(" + ", ".join(f"{value:.3g}" for value in vector) + ")"
