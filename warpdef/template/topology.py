"""Facts about a triangle list, and the few repairs a reconstructed surface needs. NumPy and SciPy only."""

from __future__ import annotations

import numpy as np


def edge_use(faces: np.ndarray) -> np.ndarray:
    """How many faces each undirected edge belongs to, shape (E,); 2 everywhere on a watertight mesh."""
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    return np.unique(edges, axis=0, return_counts=True)[1]


def is_watertight(faces: np.ndarray) -> bool:
    """Each edge in exactly two faces, which pass it in opposite directions."""
    directed = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
    count = int(faces.max()) + 1
    there = np.sort(directed[:, 0] * count + directed[:, 1])
    back = np.sort(directed[:, 1] * count + directed[:, 0])
    return bool((there == back).all() and (np.diff(there) > 0).all())


def face_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Area of each face, shape (F,)."""
    a, b, c = vertices[faces[:, 0]], vertices[faces[:, 1]], vertices[faces[:, 2]]
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def signed_volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Volume enclosed by a closed mesh, above zero where faces are counter-clockwise from outside."""
    # About the centroid: the sum then keeps its digits far from the origin, and means something on open meshes.
    a, b, c = (vertices - vertices.mean(axis=0))[faces].transpose(1, 0, 2)
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6.0)


def euler_number(faces: np.ndarray) -> int:
    """V - E + F over the vertices in use: 2 for a sphere, 2 less for every handle."""
    return len(np.unique(faces)) - len(edge_use(faces)) + len(faces)


def triangle_quality(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Mean over faces of 4 sqrt(3) area / sum of squared edges: 1 for equilateral triangles."""
    edges = vertices[faces[:, [1, 2, 0]]] - vertices[faces]
    edges_sq = np.einsum("fki,fki->f", edges, edges)
    return float((4.0 * np.sqrt(3.0) * face_areas(vertices, faces) / np.maximum(edges_sq, 1e-300)).mean())


def face_components(faces: np.ndarray) -> np.ndarray:
    """Label of the component (joined by shared vertices) that each face belongs to, shape (F,)."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    count = int(faces.max()) + 1
    i = faces[:, [0, 1]].ravel()
    j = faces[:, [1, 2]].ravel()
    graph = coo_matrix((np.ones(len(i), dtype=np.int8), (i, j)), shape=(count, count))
    labels = connected_components(graph, directed=False)[1][faces[:, 0]]
    return np.unique(labels, return_inverse=True)[1]


def largest_component(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """The component with the most area, compacted, and the share of the whole area that was left out."""
    labels = face_components(faces)
    areas = np.bincount(labels, face_areas(vertices, faces))
    best = int(areas.argmax())
    return *compact(vertices, faces[labels == best]), float(1.0 - areas[best] / max(areas.sum(), 1e-300))


def compact(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Drop faces that name a vertex twice, faces on the same three vertices, and vertices not in use."""
    twice = (faces[:, 0] == faces[:, 1]) | (faces[:, 1] == faces[:, 2]) | (faces[:, 2] == faces[:, 0])
    faces = faces[~twice]
    first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)[1]
    faces = faces[np.sort(first)]
    used, inverse = np.unique(faces, return_inverse=True)
    return vertices[used], inverse.reshape(-1, 3).astype(np.int32)
