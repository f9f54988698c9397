"""The walking figure without any meshing library: marching tetrahedra on its implicit surface, then evened out.

For machines that have NumPy, SciPy and Warp alone. Motion and skinning are those of ``warpdef.truth.figure``; the
triangles are others, and none of them is promised to be a good one.
"""

from __future__ import annotations

import numpy as np

from warpdef.geometry.triangles import unique_edges
from warpdef.mesh import MeshSequence
from warpdef.template.lattice import Lattice, march
from warpdef.truth.body import _onto_surface, body_distance, nearest_bone
from warpdef.truth.gait import BONES, walk_motions
from warpdef.truth.skinning import skin, smooth_weights

_LOW, _HIGH = np.array([-0.72, -0.06, -0.20]), np.array([0.72, 1.83, 0.24])
_CELL = 0.0271  # gives about 10,000 vertices
_EVENINGS = 6  # rounds in which vertices go half of the way to the middle of their neighbours, and back to the surface


def bare_figure(frames: int, cell: float = _CELL) -> MeshSequence:
    """The figure's walk: vertices (T, V, 3), metres, and faces. ``cell``: of the lattice marched on."""
    rest, faces = bare_body(cell)
    bone_of_vertex = np.array([BONES.index(name) for name in nearest_bone(rest)])
    mesh = MeshSequence(rest[None], faces)[0]
    weights = smooth_weights(mesh, bone_of_vertex, len(BONES), 16.0)
    return MeshSequence(np.stack([skin(rest, weights, *motion) for motion in walk_motions(frames)]), faces)


def bare_body(cell: float = _CELL) -> tuple[np.ndarray, np.ndarray]:
    """Rest pose: vertices (V, 3), metres, and faces (F, 3); closed, outward."""
    x, y, z = (int(n) for n in np.ceil((_HIGH - _LOW) / cell).astype(int) + 1)
    lattice = Lattice((x, y, z), _LOW, cell)
    nodes = lattice.from_cells(lattice.places(np.arange(x * y * z)))
    distance = body_distance(nodes).reshape(lattice.shape)
    edges, faces = march(lattice, distance)
    near, far = distance.ravel()[edges].T
    share = (near / (near - far))[:, None]
    vertices = (1.0 - share) * nodes[edges[:, 0]] + share * nodes[edges[:, 1]]
    sides = unique_edges(faces)
    both = np.concatenate([sides, sides[:, ::-1]])
    degree = np.bincount(both[:, 0], minlength=len(vertices))[:, None]
    for _ in range(_EVENINGS):
        middle = np.zeros_like(vertices)
        np.add.at(middle, both[:, 0], vertices[both[:, 1]])
        vertices = _onto_surface(0.5 * (vertices + middle / degree), 1)
    return _onto_surface(vertices, 2), faces
