"""Smooth bone weights on a mesh and dual-quaternion skinning, in NumPy."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from warpdef.geometry.triangles import unique_edges
from warpdef.mesh import TriMesh


def smooth_weights(mesh: TriMesh, bone_of_vertex: np.ndarray, bone_count: int, smoothing: float) -> np.ndarray:
    """Blend a hard assignment of vertices to bones over the surface.

    Solves (I + smoothing L) w = indicator twice, L the combinatorial Laplacian of the mesh's edges, so that a weight
    reaches about 2 sqrt(smoothing) edges across a joint and never jumps through the air to a nearby limb.

    Args:
        mesh: V vertices.
        bone_of_vertex: shape (V,), bone indices.
        bone_count: B.
        smoothing: weight of the Laplacian, in edges squared.

    Returns:
        Weights, shape (V, B), not negative, each row summing to 1.
    """
    from scipy.sparse import coo_matrix, diags, identity
    from scipy.sparse.linalg import splu

    count = len(mesh.vertices)
    i, j = unique_edges(mesh.faces).T
    ones = np.ones(2 * len(i))
    adjacency = coo_matrix((ones, (np.concatenate([i, j]), np.concatenate([j, i]))), shape=(count, count)).tocsr()
    laplacian = diags(np.asarray(adjacency.sum(axis=1)).ravel()) - adjacency
    solve = splu((identity(count) + smoothing * laplacian).tocsc()).solve
    weights = np.zeros((count, bone_count))
    weights[np.arange(count), bone_of_vertex] = 1.0
    # Rounded, so that the solver's last bits, which depend on the number of threads, do not reach the result.
    weights = np.round(np.maximum(solve(solve(weights)), 0.0), 6)
    return weights / weights.sum(axis=1, keepdims=True)


def _multiply(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Quaternion product, real part last, shapes (..., 4)."""
    vector = a[..., 3:] * b[..., :3] + b[..., 3:] * a[..., :3] + np.cross(a[..., :3], b[..., :3])
    real = a[..., 3] * b[..., 3] - np.einsum("...i,...i->...", a[..., :3], b[..., :3])
    return np.concatenate([vector, real[..., None]], axis=-1)


def skin(vertices: np.ndarray, weights: np.ndarray, rotations: np.ndarray, translations: np.ndarray) -> np.ndarray:
    """Move vertices by blended rigid motions x -> R_b x + t_b (Kavan et al. 2007, dual-quaternion linear blending).

    Blending dual quaternions keeps every vertex's motion rigid, so joints do not collapse as with blended matrices.

    Args:
        vertices: rest positions, shape (V, 3).
        weights: shape (V, B), rows summing to 1.
        rotations: shape (B, 3, 3).
        translations: shape (B, 3).

    Returns:
        Moved positions, shape (V, 3) float64.
    """
    from scipy.spatial.transform import Rotation

    real = Rotation.from_matrix(rotations).as_quat()
    # q and -q are the same rotation; blending needs neighbours on one side. Bone 0 is the root.
    real *= np.where(real @ real[0] < 0.0, -1.0, 1.0)[:, None]
    dual = 0.5 * _multiply(np.concatenate([translations, np.zeros((len(real), 1))], axis=1), real)
    # einsum, not a matrix product: the same bits for any number of threads.
    real, dual = np.einsum("vb,bi->vi", weights, real), np.einsum("vb,bi->vi", weights, dual)
    length = np.linalg.norm(real, axis=1, keepdims=True)
    real, dual = real / length, dual / length
    conjugate = real * [-1.0, -1.0, -1.0, 1.0]
    shift = 2.0 * _multiply(dual, conjugate)[:, :3]
    axis, cosine = real[:, :3], real[:, 3:]
    turned = vertices + 2.0 * np.cross(axis, np.cross(axis, vertices) + cosine * vertices)
    return turned + shift


def chain_motions(
    parents: Sequence[int], joints: np.ndarray, local: np.ndarray, root: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Rigid motion of every bone from the rest pose: forward kinematics.

    Args:
        parents: B parent indices, -1 for the root; a parent comes before its children.
        joints: rest position about which a bone turns, shape (B, 3).
        local: rotation of a bone relative to its parent, shape (B, 3, 3).
        root: where the root's joint goes, shape (3,).

    Returns:
        Rotations (B, 3, 3) and translations (B, 3), x -> R x + t on rest positions.
    """
    rotations, translations = np.empty_like(local), np.empty_like(joints)
    for bone, parent in enumerate(parents):
        rotations[bone] = local[bone] if parent < 0 else rotations[parent] @ local[bone]
        at = root if parent < 0 else rotations[parent] @ joints[bone] + translations[parent]
        translations[bone] = at - rotations[bone] @ joints[bone]
    return rotations, translations
