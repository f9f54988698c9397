"""A mesh that a few hundred nodes move (embedded deformation), on the CPU: its vertices, and steps of the nodes.

A vertex x with nodes j of weight w_j goes to sum_j w_j (R_j (x - g_j) + g_j + t_j), in double precision.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from warpdef.kernels.embedding_serial import BlockOrder, place_vertices, step_nodes_serially
from warpdef.kernels.launching import launch


class EmbeddedMesh:
    """A mesh of V vertices and the n nodes that move it, on the CPU; all of float64 and int32, as SciPy leaves them.

    Args:
        rest: shape (V, 3). index, weight: nodes of each vertex, shape (V, 4). link: pairs of nodes, shape (e, 2).
        anchor: places of the nodes at rest, shape (n, 3). order: of their elimination.
    """

    def __init__(
        self,
        rest: np.ndarray,
        index: np.ndarray,
        weight: np.ndarray,
        link: np.ndarray,
        anchor: np.ndarray,
        order: BlockOrder,
    ) -> None:
        self._rest, self._anchor, self._weight = _vectors(rest), _vectors(anchor), _on_host(weight, wp.float64)
        self._index, self._link = (_on_host(a, wp.int32) for a in (index, link))
        tables = order.place, order.start, order.row, order.of_vertices, order.of_links
        self._order = [_on_host(a, wp.int32) for a in tables]

    def place(self, rotation: np.ndarray, shift: np.ndarray) -> np.ndarray:
        """All vertices, (V, 3), with nodes turned (n, 3, 3) and shifted (n, 3)."""
        count = len(self._rest)
        placed = wp.empty(count, dtype=wp.vec3d, device="cpu")
        nodes = [self._anchor, _on_host(rotation, wp.mat33d), _vectors(shift)]
        launch(place_vertices, count, [0, self._rest, self._index, self._weight, *nodes, placed], placed.device)
        return placed.numpy()

    def step(
        self,
        rotation: np.ndarray,
        shift: np.ndarray,
        chosen: np.ndarray,
        goal: np.ndarray,
        normal: np.ndarray,
        weight: np.ndarray,
        tangential: float,
        stiffness: float,
        usual: np.ndarray | None = None,
    ) -> np.ndarray:
        """The small rotation of each node and its shift, (n, 6), that minimise the linearised

            sum_i w_i ((n_i . r_i)^2 + tangential |r_i|^2) + stiffness sum_(j,k) |b_jk - usual_jk|^2

        with r_i the vertex ``chosen[i]`` minus its ``goal`` (m, 3), n its unit ``normal`` (m, 3), w its ``weight``
        (m,), and b what links differ by from a rigid motion of their first node.
        """
        move = wp.empty((len(self._anchor), 6), dtype=wp.float64, device="cpu")
        matches = [_on_host(chosen, wp.int32), _vectors(goal), _vectors(normal), _on_host(weight, wp.float64)]
        mesh = [self._rest, self._index, self._weight, self._link, self._anchor, *self._order]
        nodes = [_on_host(rotation, wp.mat33d), _vectors(shift)]
        how = [tangential, stiffness, None if usual is None else _vectors(usual)]
        launch(step_nodes_serially, 1, [*mesh, *nodes, *matches, *how, move], move.device)
        return move.numpy()


def _on_host(values: np.ndarray, dtype: type) -> wp.array:
    number = np.int32 if dtype is wp.int32 else np.float64
    # Shared where there is something: of nothing Warp makes strides of 0.
    return wp.array(np.ascontiguousarray(values, dtype=number), dtype=dtype, device="cpu", copy=not len(values))


def _vectors(values: np.ndarray) -> wp.array:
    return _on_host(values, wp.vec3d)
