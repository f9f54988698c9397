"""Limbs looked for in many poses at once where one camera saw them: what no bending from pose to pose finds.

A finger that folds leaves its points, and the mesh finds others near by. So every limb is put into some hundreds of
poses as a chain (``limb_chains``) about the body as it was found. A pose is worth the points that it covers, less those
that others cover too, and less what of it the camera would have seen and did not. Limbs are chosen one after the other,
the best choices so far kept (a beam), and the best of all are made finer by small random turns, then bent onto the
cloud and judged (``bending``). With the limbs in place the body lies better, and about it limbs are looked for again:
from the least fault so far that this was not yet done from.

Distances are those of ``bending``, in (x, FACING s n), s the point spacing. What it costs is small: a limb is some
vertices, the cloud some points, and what the camera saw a table.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np

from warpdef.fit.bending import BETTER, FACING, FAULTLESS, HALF, Bending, SeenCloud
from warpdef.fit.embedded import Pose
from warpdef.fit.limb_chains import LimbChain, LimbChains
from warpdef.geometry.viewpoint import Picture

TILTS, TILTED = 16.0, 100.0
"""Degrees between directions of a limb that are tried, and from how it stands at rest."""
CURLS, CURLS_ON = (0.0, 40.0, 80.0), 0.6
"""Degrees by which it bends in its second joint, and share of them in its third."""
COVER = 3.0
"""Distance in point spacings at which a point is covered by 1/e."""
DOUBLE, ALONE, TURNED = 0.7, 0.7, 1.0
"""What a point costs that two cover, a vertex that stands where the camera saw nothing, and a radian of bending."""
CLEAR = 5.0
"""Distance in point spacings from which a vertex stands so."""
COVERED = 0.6
"""Share of a point that the body covers, from which no limb is asked for it."""
ASKED = 300
"""Points that limbs are asked for."""
KEPT, BEAM = 150, 64
"""Poses of a limb, and choices of all limbs so far, that are followed."""
FINER = ((14.0, 2.5), (7.0, 2.0), (4.0, 1.6))
"""Degrees of random turns, and the distance ``COVER`` with them."""
TRIES, SWEEPS = 24, 2
"""Random turns of a limb at a time, and times that all limbs have their turn."""
UNLIKE = 0.6
"""Radians by which a limb differs in two choices that are not the same."""
FIRST, AGAIN, TURNS = 4, 3, 4
"""Choices that are bent onto the cloud at first, and each time again; and how often limbs are looked for at most."""
WORTHWHILE = 2
"""Times after which nothing is looked for again, where no fault is less yet."""
BODY_SCHEDULE = ((5.0, 0.3, 5), (3.0, 0.1, 5))
"""Reach, rigidity and steps by which the body alone is laid onto the cloud, before."""
_AROUND = 12  # spacings around the picture that its table reaches
_AT_ONCE = 32  # poses

Worth = Callable[[int, np.ndarray, float], tuple[np.ndarray, np.ndarray]]


class LimbSearch:
    """The limbs of a mesh that is bent."""

    def __init__(self, bending: Bending) -> None:
        self._bending = bending
        self._limbs = LimbChains(bending.rest, bending.faces, bending.edges, bending.graph, bending.matched)

    @cached_property
    def _tried(self) -> list[np.ndarray]:
        return [tried_turns(chain) for chain in self._limbs.chains]

    def better(self, cloud: SeenCloud, found: Pose, fault: float) -> tuple[Pose, float]:
        """The pose of least fault with limbs elsewhere, and that fault; that found, where there is no limb or camera.

        Args:
            cloud: of one camera. found: pose that the mesh was bent to, of this ``fault``.
        """
        bending, limbs, still = self._bending, self._limbs, self._bending.still()
        if not limbs.chains or cloud.picture is None:
            return found, fault
        rng = np.random.default_rng(0)
        start = limbs.put(found, [limbs.turns_of(chain, still) for chain in limbs.chains])
        pool = [(np.inf, bending.by_part(cloud, start, limbs.body, BODY_SCHEDULE))]
        best, least = found, fault
        for turn in range(TURNS):
            if not pool or least < min(HALF * fault, FAULTLESS):
                break
            if turn == WORTHWHILE and least > BETTER * fault:
                break
            pool.sort(key=lambda tried: tried[0])
            body = pool.pop(0)[1]
            for pose in self._choices(cloud, body, (found, still), FIRST if turn == 0 else AGAIN, rng):
                settled = bending.settled(cloud, pose)
                left = bending.fault(cloud, settled)
                pool.append((left, settled))
                if left < least:
                    best, least = settled, left
        return best, least

    def _choices(
        self, cloud: SeenCloud, pose: Pose, others: tuple[Pose, ...], count: int, rng: np.random.Generator
    ) -> list[Pose]:
        """Poses with the body as in one and limbs elsewhere, the best first."""
        limbs, placed = self._limbs, self._bending.place(pose)
        turned = FACING * cloud.spacing * self._bending.facing(placed)
        body = np.concatenate([placed[limbs.body], turned[limbs.body]], axis=1)
        field, bases = LimbField(cloud, body), [limbs.base(chain, pose) for chain in limbs.chains]
        if not field.points:
            return []

        def worth(which: int, turns: np.ndarray, cover: float) -> tuple[np.ndarray, np.ndarray]:
            chain = limbs.chains[which]
            places, normals = limbs.place(chain, turns, bases[which])
            alone = chain.standing * field.alone(places, normals).sum(axis=1)
            cost = ALONE * alone + TURNED * np.linalg.norm(turns, axis=2).sum(axis=1)
            return field.covered(places, normals, cover), cost / field.standing

        given = [[limbs.turns_of(chain, p) for p in (pose, *others)] for chain in limbs.chains]
        tried = [np.concatenate(pair) for pair in zip(given, self._tried, strict=True)]
        found = _beam(tried, field.by_body(COVER), worth, count)
        return [limbs.put(pose, _finer(turns, field, worth, rng)) for turns in found]


def _beam(tried: list[np.ndarray], body: np.ndarray, worth: Worth, count: int) -> list[list[np.ndarray]]:
    """The best choices of one pose each of all limbs, unlike one another; ``tried``: poses (h, 3, 3) of each."""
    covered, score, chosen, kept = body[None], np.zeros(1), np.zeros((1, 0), dtype=int), []
    for which, turns in enumerate(tried):
        value, cost = worth(which, turns, COVER)
        alone = np.maximum(value - body, 0.0).sum(axis=1) - cost
        first = np.argsort(-alone, kind="stable")[:KEPT]
        value, cost = value[first], cost[first]
        kept.append(turns[first])
        twice = np.stack([np.minimum(so_far, value).sum(axis=1) for so_far in covered])
        total = score[:, None] + value.sum(axis=1) - (1.0 + DOUBLE) * twice - cost
        best = np.argsort(-total, axis=None, kind="stable")[:BEAM]
        before, now = np.unravel_index(best, total.shape)
        covered, score = np.maximum(covered[before], value[now]), total.ravel()[best]
        chosen = np.column_stack([chosen[before], now])
    found: list[list[np.ndarray]] = []
    for row in chosen:
        turns = [of[k] for of, k in zip(kept, row, strict=True)]
        if all(any(np.linalg.norm(a - b) > UNLIKE for a, b in zip(turns, o, strict=True)) for o in found):
            found.append(turns)
        if len(found) == count:
            break
    return found


def _finer(turns: list[np.ndarray], field: LimbField, worth: Worth, rng: np.random.Generator) -> list[np.ndarray]:
    """The same choice after small random turns, of one limb at a time."""
    turns = list(turns)
    scale = np.array([1.0, 0.7, 0.7])[:, None]
    for degrees, cover in FINER:
        body = field.by_body(cover)
        now = [worth(which, own[None], cover)[0][0] for which, own in enumerate(turns)]
        for _ in range(SWEEPS):
            for which, own in enumerate(turns):
                some = own + np.radians(degrees) * scale * rng.normal(size=(TRIES, 3, 3))
                some[0] = own
                value, cost = worth(which, some, cover)
                others = np.max([body, *(v for k, v in enumerate(now) if k != which)], axis=0)
                gain = value.sum(axis=1) - (1.0 + DOUBLE) * np.minimum(value, others).sum(axis=1) - cost
                best = int(gain.argmax())
                turns[which], now[which] = some[best], value[best]
    return turns


class LimbField:
    """Points of a cloud that its body, places beside turned normals (b, 6), leaves to the limbs, and its picture.

    points: how many are asked, evenly. standing: points that each of them stands for.
    """

    def __init__(self, cloud: SeenCloud, body: np.ndarray) -> None:
        assert cloud.picture is not None
        self._spacing, self._picture = cloud.spacing, cloud.picture
        seen = np.concatenate([cloud.points, FACING * cloud.spacing * cloud.normals], axis=1)
        gap = closest_sq(body[None], seen)[0] if len(body) else np.full(len(seen), np.inf)
        free = np.flatnonzero(self._share(gap, COVER) < COVERED)
        some = free[np.linspace(0, len(free) - 1, min(len(free), ASKED)).astype(int)]
        self._seen, self._gap, self.points = seen[some], gap[some], len(some)
        self.standing = len(free) / max(len(some), 1)
        self._table = _picture_table(cloud.picture, cloud.spacing)

    def _share(self, gap: np.ndarray, cover: float) -> np.ndarray:
        return np.exp(-gap / (cover * self._spacing) ** 2)

    def by_body(self, cover: float) -> np.ndarray:
        """How far the body covers each point, (P,), 0 to 1."""
        return self._share(self._gap, cover)

    def covered(self, places: np.ndarray, normals: np.ndarray, cover: float) -> np.ndarray:
        """How far vertices, (h, m, 3) with normals (h, m, 3), cover each point: (h, P)."""
        beside = np.concatenate([places, FACING * self._spacing * normals], axis=2)
        return self._share(closest_sq(beside, self._seen), cover)

    def alone(self, places: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Which of them face the camera where it saw nothing, or saw through them, by the table: (h, m) bool."""
        picture, (low, beside, depth) = self._picture, self._table
        flat, towards = places.reshape(-1, 3), picture.eye - picture.centre
        distance = float(np.linalg.norm(towards))
        cell = np.rint((picture.across(picture.eye, picture.centre, flat) - low) / self._spacing)
        x, y = np.clip(cell, 0, np.array(beside.shape) - 1).astype(int).T
        before = depth[x, y] - distance + (flat - picture.centre) @ (towards / distance)
        lost = (beside[x, y] > CLEAR * self._spacing) | (before > CLEAR * self._spacing)
        return lost.reshape(places.shape[:2]) & ((normals * (picture.eye - places)).sum(axis=2) > 0.0)


def _picture_table(picture: Picture, cell: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Its corner (2,), and by cell how far the nearest point is in the picture, and that point's depth."""
    flat = picture.tree.data
    low = flat.min(axis=0) - _AROUND * cell
    shape = np.ceil((flat.max(axis=0) + _AROUND * cell - low) / cell).astype(int) + 1
    at = low + cell * np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1)
    beside, nearest = picture.tree.query(at)
    return low, beside, picture.depth[nearest]


def closest_sq(samples: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Least squared distance of each of P points (P, 6) to the samples of each of h poses (h, m, 6): (h, P)."""
    middle = points.mean(axis=0)
    samples, points = (samples - middle).astype(np.float32), (points - middle).astype(np.float32)
    found = np.empty((len(samples), len(points)))
    for first in range(0, len(samples), _AT_ONCE):
        some = samples[first : first + _AT_ONCE]
        products = some.reshape(-1, some.shape[2]) @ (-2.0 * points.T)
        products += (some**2).sum(axis=2).reshape(-1, 1)
        found[first : first + _AT_ONCE] = products.reshape(*some.shape[:2], -1).min(axis=1)
    return np.maximum(found + (points**2).sum(axis=1), 0.0)


def tried_turns(chain: LimbChain) -> np.ndarray:
    """Poses of a limb that are tried, rotation vectors of its links (h, 3, 3): directions by curls about some axes."""
    across, found = np.cross(chain.normal, chain.axis), []
    for direction in _cone(chain.axis):
        sine = np.cross(chain.axis, direction)
        angle = float(np.arctan2(np.linalg.norm(sine), chain.axis @ direction))
        tilt = angle * sine / max(float(np.linalg.norm(sine)), 1e-300)
        about = [across, -across] if angle < 0.3 else [across, -across, tilt / angle]
        for curl in np.radians(CURLS):
            found += [(tilt, curl * axis, CURLS_ON * curl * axis) for axis in (about if curl else about[:1])]
    return np.array(found)


def _cone(axis: np.ndarray) -> np.ndarray:
    """Unit vectors up to ``TILTED`` from an axis (3,), about ``TILTS`` apart."""
    step = np.radians(TILTS)
    one = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    one /= np.linalg.norm(one)
    other, found = np.cross(axis, one), [axis[None]]
    for ring in range(1, int(TILTED // TILTS) + 1):
        tilt = ring * step
        count = max(6, round(2.0 * np.pi * np.sin(tilt) / step))
        turn = 2.0 * np.pi * (np.arange(count) + 0.5 * (ring % 2)) / count
        sideways = np.cos(turn)[:, None] * one + np.sin(turn)[:, None] * other
        found.append(np.cos(tilt) * axis + np.sin(tilt) * sideways)
    return np.concatenate(found)
