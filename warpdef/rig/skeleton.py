"""The bones of a rig as a tree of joints, and their motion as each joint's within its parent's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warpdef.rig.decompose import Rig

_HOLD = 0.05  # pull of a joint towards the seam of its two bones, against how far the bones move apart there


@dataclass(frozen=True)
class Skeleton:
    """Joints of B bones in a tree. A joint's frame stands unturned at ``places`` in the rest shape.

    parents:      index of each joint's parent, which comes before it; -1 for the root   (B,) int64
    order:        the rig's bone that each joint moves                                   (B,) int64
    places:       where the joints are in the rest shape, input units                    (B, 3) float64
    rotations:    of a joint in its parent's frame, quaternions x y z w without jumps    (T, B, 4) float64
    translations: of a joint in its parent's frame, input units                          (T, B, 3) float64
    """

    parents: np.ndarray
    order: np.ndarray
    places: np.ndarray
    rotations: np.ndarray
    translations: np.ndarray

    @property
    def names(self) -> tuple[str, ...]:
        """What the joints are called."""
        return tuple(f"bone_{b:02d}" for b in range(len(self.parents)))


def build_skeleton(rig: Rig) -> Skeleton:
    """Join the bones of a rig: those that share most of their vertices, by a tree of largest sum (Prim 1957).

    A joint is put where its bone and its parent move apart least over all frames, near the seam between them:

        min_c  mean_t | (R_tb c + s_tb) - (R_tp c + s_tp) |^2  +  hold |c - seam|^2

    The root is the bone that moves most of the mesh.
    """
    number = rig.bone_count
    table = np.zeros((len(rig.rest), number))
    np.add.at(table, (np.arange(len(rig.rest))[:, None], rig.joints), rig.weights)
    shared = table.T @ table
    centers = (table.T @ rig.rest) / np.maximum(table.sum(axis=0), 1e-12)[:, None]
    parents, order = _tree(shared, centers, int(np.diag(shared).argmax()))
    places = np.empty((number, 3))
    for joint, parent in enumerate(parents):
        b = int(order[joint])
        places[joint] = centers[b] if parent < 0 else _joint(rig, table, b, int(order[parent]), centers)
    return Skeleton(parents, order, places, *_local(rig.bones[:, order], places, parents))


def _tree(shared: np.ndarray, centers: np.ndarray, root: int) -> tuple[np.ndarray, np.ndarray]:
    """Parents in the order in which bones are reached from the root, and that order, both (B,)."""
    apart = np.linalg.norm(centers[:, None] - centers[None], axis=2)
    # Where two share nothing the nearer one counts, and always less than what is shared.
    tie = shared - 1e3 * apart / max(float(apart.max()), 1e-300) * (shared <= 1e-9)
    order, parents = [root], [-1]
    best, best_parent = tie[root].copy(), np.zeros(len(shared), dtype=np.int64)
    best[root] = -np.inf
    while len(order) < len(shared):
        b = int(best.argmax())
        order.append(b)
        parents.append(int(best_parent[b]))
        better = tie[b] > best
        best_parent[better] = len(order) - 1
        best = np.where(better, tie[b], best)
        best[order] = -np.inf
    return np.array(parents), np.array(order)


def _joint(rig: Rig, table: np.ndarray, bone: int, parent: int, centers: np.ndarray) -> np.ndarray:
    both = table[:, bone] * table[:, parent]
    seam = both @ rig.rest / both.sum() if both.sum() > 1e-9 else (centers[bone] + centers[parent]) / 2.0
    gap = rig.bones[:, bone] - rig.bones[:, parent]
    turn, shift = gap[:, :, :3], gap[:, :, 3]
    square = np.einsum("tki,tkj->ij", turn, turn) / len(gap) + _HOLD * np.eye(3)
    right = _HOLD * seam - np.einsum("tki,tk->i", turn, shift) / len(gap)
    return np.linalg.solve(square, right)


def _local(bones: np.ndarray, places: np.ndarray, parents: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotations (T, B, 4) and translations (T, B, 3) of joints in their parents' frames, from motions of the rest."""
    from scipy.spatial.transform import Rotation

    turns = bones[..., :3]
    origins = np.einsum("tbij,bj->tbi", turns, places) + bones[..., 3]
    root = parents < 0
    up = np.where(root[None, :, None, None], np.eye(3), turns[:, parents])
    above = np.where(root[None, :, None], 0.0, origins[:, parents])
    local = up.transpose(0, 1, 3, 2) @ turns
    shifts = np.einsum("tbji,tbj->tbi", up, origins - above)
    quaternions = Rotation.from_matrix(local.reshape(-1, 3, 3)).as_quat().reshape(*local.shape[:2], 4)
    for t in range(1, len(quaternions)):
        # q and -q turn alike; a jump from one to the other would spin a joint between two frames.
        back = (quaternions[t] * quaternions[t - 1]).sum(axis=1, keepdims=True) < 0.0
        quaternions[t] = np.where(back, -quaternions[t], quaternions[t])
    return quaternions, shifts
