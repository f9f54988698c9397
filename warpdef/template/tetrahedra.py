"""The deformable tetrahedral template: signed distances and offsets on a grid, fitted to points and normals.

In the spirit of DMTet (Shen et al. 2021), which DynoSurf (Yao et al. 2024) starts from; an alternative to screened
Poisson for the initialisation table of the paper. Coarse to fine, on each level:

1. Start. On the coarsest grid the winding number of the oriented points says inside or outside, and the nearest points'
   planes say how far (``signed_distance``). Finer grids take over the level before; near the points, where it missed a
   thin limb, the points speak again.
2. Fit. Gradient descent on the nodes in a band around surface and points: robust Chamfer distance, both ways, between
   the marching tetrahedra's vertices and the points, mostly along the points' normals, pairs of opposed sides left out;
   plus the squared Laplacian of the signed distances. Distances and offsets are preconditioned as the paper's grids
   are: x = (I + lambda L)^-1 u, Adam on u.

One CPU thread; the same input gives the same bytes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from warpdef.template.lattice import AXES, DIRECTIONS, Lattice, crossed_cells, edges_within, march, refine
from warpdef.template.signed_distance import OrientedCloud

if TYPE_CHECKING:
    import scipy.sparse
    import warp as wp

LEVELS = 3
CELL_SPACINGS = 2.0  # finest cell, in mean nearest-neighbour distances: about a point a cell
POINTS_RESOLVED = 8_000  # more points make no finer cells: a template has 20,000 faces at most, by default
CELLS_MAX = 160  # along the longest side
MARGIN_CELLS = 4  # of the coarsest level, around the points
HELD_CELLS = 1  # around the cubes that hold a point: nodes beyond are anchored
BAND_CELLS = 2  # beyond the cells that hold the surface or a point
NEAR_CELLS = 1  # around the cubes that hold a point: the points may overrule the coarser level
ITERATIONS = 60  # a level
RATE = 0.1  # cells
EPSILON = 0.05  # of Adam, cells: where nothing pulls, nothing moves
LAMBDA, LAMBDA_NOISY = 0.5, 8.0  # of clean clouds, and of noisy ones, between by the logarithm
THIN, THICK = 0.3, 0.55  # thickness over width of a clean and of a noisy cloud's neighbourhoods
TOLERANCE = 1e-3  # of a solve
SOLVE_ITERATIONS = 60
OFFSET_MAX = 0.3  # cells
REACH = 2.0  # cells; a pair this far apart counts 1/e
TANGENTIAL = 0.1  # weight of a residual's part along the surface
SMOOTHNESS = 0.05  # of the squared Laplacian against one pair
ANCHOR = 0.5  # of the squared change of distances of a cell and more, where no point is near


def fit_surface(points: np.ndarray, normals: np.ndarray, cell: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A closed, outward surface on oriented points, by the deformable tetrahedral grid.

    Args:
        points: shape (N, 3), any units.
        normals: outward unit normals, shape (N, 3).
        cell: finest cell, the points' units; 0: by the points' spacing.

    Returns:
        Vertices (V, 3) float64 in the points' units and faces (F, 3) int32; none where there is no inside.
    """
    cloud = OrientedCloud(points, normals)
    extent = float(np.ptp(cloud.points, axis=0).max())
    by_spacing = CELL_SPACINGS * cloud.spacing * max(1.0, (len(cloud.points) / POINTS_RESOLVED) ** 0.5)
    lattice = _coarsest(cloud.points, max(cell or by_spacing, extent / CELLS_MAX))
    distance = _first_distance(lattice, cloud)
    offset = np.zeros((*lattice.shape, 3), dtype=np.float32)
    noise = np.clip((cloud.thickness() - THIN) / (THICK - THIN), 0.0, 1.0)
    smoothing = float(LAMBDA * (LAMBDA_NOISY / LAMBDA) ** noise)
    for level in range(LEVELS):
        if level:
            lattice, distance, offset = lattice.finer(), 2.0 * refine(distance), refine(offset)
            distance = _overruled_near_points(lattice, distance, cloud)
        _fit(lattice, distance, offset, cloud, smoothing)
    return _surface(lattice, distance, offset)


def _coarsest(points: np.ndarray, finest_cell: float) -> Lattice:
    """A box around the points, with its margin, in cells of the coarsest level."""
    cell = finest_cell * 2 ** (LEVELS - 1)
    low, high = points.min(axis=0), points.max(axis=0)
    cells = np.ceil((high - low) / cell).astype(int) + 2 * MARGIN_CELLS
    x, y, z = (int(n) + 1 for n in cells)
    return Lattice((x, y, z), (low + high - cells * cell) / 2, cell)


def _first_distance(lattice: Lattice, cloud: OrientedCloud) -> np.ndarray:
    """Signed distances on all nodes of the coarsest level, in cells."""
    places = lattice.from_cells(lattice.places(np.arange(np.prod(lattice.shape))))
    distance = np.clip(cloud.signed_distance(places) / lattice.cell, -MARGIN_CELLS, MARGIN_CELLS)
    return _open_sides(distance.astype(np.float32).reshape(lattice.shape))


def _open_sides(distance: np.ndarray) -> np.ndarray:
    """No inside on the lattice's sides, or the surface would not close."""
    for axis in range(3):
        for side in (0, -1):
            face = np.moveaxis(distance, axis, 0)
            face[side] = np.maximum(face[side], 1.0)
    return distance


def _overruled_near_points(lattice: Lattice, distance: np.ndarray, cloud: OrientedCloud) -> np.ndarray:
    """The coarser level's distances, but the points' own where these say the other side nearby."""
    near = np.flatnonzero(_near_points(lattice, cloud, NEAR_CELLS))
    told = (cloud.signed_distance(lattice.from_cells(lattice.places(near))) / lattice.cell).astype(np.float32)
    flat = distance.ravel()
    overruled = (flat[near] < 0) != (told < 0)
    flat[near[overruled]] = told[overruled]
    return flat.reshape(lattice.shape)


def _near_points(lattice: Lattice, cloud: OrientedCloud, cells: int) -> np.ndarray:
    """Nodes of cubes that hold a point, and of those within so many cubes; shape of the lattice, bool."""
    held = np.zeros([n - 1 for n in lattice.shape], dtype=bool)
    at = np.floor(lattice.to_cells(cloud.points)).astype(int)
    held[tuple(at.T)] = True
    return _nodes_around(held, cells)


def _nodes_around(cubes: np.ndarray, cells: int) -> np.ndarray:
    """Corners of the cubes chosen and of those within ``cells`` of them; none on the lattice's sides."""
    from scipy.ndimage import maximum_filter

    nodes = np.zeros([n + 1 for n in cubes.shape], dtype=bool)
    nodes[:-1, :-1, :-1] = cubes
    # A cube's far corners are one node further: a window that reaches one more towards lower numbers.
    size = 2 * cells + 2
    nodes = maximum_filter(nodes.view(np.uint8), size=size, origin=0, mode="constant").view(bool)
    for axis in range(3):
        face = np.moveaxis(nodes, axis, 0)
        face[0] = face[-1] = False
    return nodes


def _fit(lattice: Lattice, distance: np.ndarray, offset: np.ndarray, cloud: OrientedCloud, smoothing: float) -> None:
    """Gradient descent on the nodes of the band; ``distance`` and ``offset`` are changed in place."""
    band = _nodes_around(crossed_cells(distance), BAND_CELLS) | _near_points(lattice, cloud, BAND_CELLS)
    nodes = np.flatnonzero(band)
    compact = np.full(distance.size, -1)
    compact[nodes] = np.arange(len(nodes))
    every_edge = compact[edges_within(lattice, band, DIRECTIONS)]
    axis_edges = compact[edges_within(lattice, band, DIRECTIONS[AXES])]
    oriented = (lattice.to_cells(cloud.points), cloud.normals)
    fit = _Fit(lattice.places(nodes), every_edge, axis_edges, *oriented, smoothing)
    start = np.column_stack([distance.ravel()[nodes], offset.reshape(-1, 3)[nodes]])
    held = ~_near_points(lattice, cloud, HELD_CELLS).ravel()[nodes] & (np.abs(start[:, 0]) > 1.0)
    found = fit.run(start, ITERATIONS, ANCHOR * held)
    distance.ravel()[nodes] = found[:, 0]
    offset.reshape(-1, 3)[nodes] = found[:, 1:]


class _Fit:
    """One level's band; lengths in its cells."""

    def __init__(self, rest, every_edge, axis_edges, points, normals, smoothing: float) -> None:
        import warp as wp

        from warpdef.kernels.cells import PointGrid
        from warpdef.kernels.cg import ConjugateGradients
        from warpdef.kernels.graphs import mesh_graph
        from warpdef.kernels.levels import node8

        self.device = device = wp.get_device("cpu")
        self.count = len(rest)
        self.edges = every_edge
        self.smoothness = _squared_laplacian(axis_edges, self.count)
        self.rest, self.points, self.normals = (_vectors(a) for a in (rest, points, normals))
        self.grid = PointGrid(self.points, [len(points)])
        self.grid.build()
        self.point_group = wp.zeros(len(points), dtype=wp.int32, device=device)
        self.one = wp.ones(1, dtype=wp.float32, device=device)
        graph = mesh_graph(axis_edges, self.count, smoothing)
        forward, backward = (ConjugateGradients(graph, node8, TOLERANCE, SOLVE_ITERATIONS, device) for _ in range(2))
        self.forward, self.backward = forward, backward

    def run(self, start: np.ndarray, iterations: int, anchor: np.ndarray) -> np.ndarray:
        """Signed distances and offsets, (N, 4) float32, after so many iterations from ``start``.

        ``anchor``, shape (N,), holds the distances where they started: nothing else keeps a node far from all points.
        """
        import warp as wp

        from warpdef.kernels.adam import adam
        from warpdef.kernels.levels import node8
        from warpdef.kernels.schedule import SCHEDULE_SIZE, advance

        field, u, gradient, first, second = (wp.zeros(self.count, dtype=node8, device=self.device) for _ in range(5))
        field.numpy()[:, :4] = start
        self.forward.multiply_add(field, field, u, 1.0, 0.0)  # u = (I + lambda L) x
        rate = wp.full(1, RATE, dtype=wp.float32, device=self.device)
        schedule = wp.zeros(SCHEDULE_SIZE, dtype=wp.float32, device=self.device)
        step = wp.zeros(1, dtype=wp.int32, device=self.device)
        betas = (0.9, 0.99)
        self.losses = []
        for _ in range(iterations):
            gradient.zero_()
            self.losses.append(self._add_gradient(field, gradient))
            moved = field.numpy()[:, 0] - start[:, 0]
            # Not by @: BLAS would spread it over threads.
            self.losses[-1] += float(np.sum(anchor * moved * moved))
            gradient.numpy()[:, 0] += 2.0 * anchor * moved
            self.backward.solve(gradient, gradient, 0, 1)
            advance(iterations, True, *betas, step, schedule)
            adam(0, self.count, rate, schedule, betas, EPSILON, gradient, first, second, u)
            self.forward.solve(u, field, 0, 1)
        return field.numpy()[:, :4].copy()

    def _add_gradient(self, field: wp.array, gradient: wp.array) -> float:
        """The loss, and its gradient added."""
        import warp as wp

        from warpdef.kernels.cells import PointGrid
        from warpdef.kernels.chamfer import fixed_to_moving, moving_to_fixed
        from warpdef.kernels.neighbours import NearestSearch
        from warpdef.kernels.tetrahedra import adj_surface_vertices, part_opposed, surface_vertices

        distance = field.numpy()[:, 0]
        bend = self.smoothness @ distance
        gradient.numpy()[:, 0] += 2.0 * SMOOTHNESS * bend
        loss = SMOOTHNESS * float(np.sum(distance * bend))

        inside = distance < 0
        crossed = self.edges[inside[self.edges[:, 0]] != inside[self.edges[:, 1]]]
        count, point_count = len(crossed), len(self.points)
        if count == 0:
            return loss
        edges = wp.array(crossed.astype(np.int32), dtype=wp.int32, device=self.device)
        vertices, outward, adj = (wp.zeros(count, dtype=wp.vec3, device=self.device) for _ in range(3))
        surface_vertices(0, count, edges, self.rest, field, OFFSET_MAX, vertices, outward)

        moving = PointGrid(vertices, [count])
        moving.build()
        group = wp.zeros(count, dtype=wp.int32, device=self.device)
        to_points = NearestSearch(self.grid, vertices, group)
        to_vertices = NearestSearch(moving, self.points, self.point_group)
        to_points.run()
        to_vertices.run()
        part_opposed(0, count, outward, self.normals, to_points.index)
        part_opposed(0, point_count, self.normals, outward, to_vertices.index)

        sums = wp.zeros(1, dtype=wp.float64, device=self.device)
        how = (self.one, self.one, (1.0 / REACH**2, 2, TANGENTIAL), sums, adj)
        fixed = (self.points, self.normals)
        moving_to_fixed(0, count, vertices, group, to_points.index, *fixed, *how)
        fixed_to_moving(0, point_count, *fixed, self.point_group, to_vertices.index, vertices, *how)
        adj_surface_vertices(0, count, edges, self.rest, field, OFFSET_MAX, adj, gradient)
        return loss + float(sums.numpy()[0])


def _vectors(array: np.ndarray) -> wp.array:
    import warp as wp

    return wp.array(np.ascontiguousarray(array, dtype=np.float32), dtype=wp.vec3, device="cpu")


def _squared_laplacian(edges: np.ndarray, count: int) -> scipy.sparse.csr_matrix:
    """L^T W L of the graph, W dropping nodes without all six neighbours: there a plane would count as bent."""
    from scipy.sparse import coo_matrix, diags

    i, j = edges.T
    ones = np.ones(len(edges), dtype=np.float32)
    links = coo_matrix((ones, (i, j)), shape=(count, count))
    degree = np.bincount(edges.ravel(), minlength=count).astype(np.float32)
    laplacian = (diags(degree) - links - links.T).tocsr()
    whole = diags((degree == 6).astype(np.float32))
    return (laplacian.T @ whole @ laplacian).tocsr().astype(np.float32)


def _surface(lattice: Lattice, distance: np.ndarray, offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The level set 0 in the points' units."""
    import warp as wp

    from warpdef.kernels.levels import node8
    from warpdef.kernels.tetrahedra import surface_vertices

    crossed, faces = march(lattice, distance)
    if len(faces) == 0:
        return np.zeros((0, 3)), faces
    nodes, edges = np.unique(crossed, return_inverse=True)
    field = np.zeros((len(nodes), 8), dtype=np.float32)
    field[:, 0] = distance.ravel()[nodes]
    field[:, 1:4] = offset.reshape(-1, 3)[nodes]
    ends = wp.array(edges.reshape(-1, 2).astype(np.int32), dtype=wp.int32, device="cpu")
    rest, values = _vectors(lattice.places(nodes)), wp.array(field, dtype=node8, device="cpu")
    vertices, outward = (wp.zeros(len(crossed), dtype=wp.vec3, device="cpu") for _ in range(2))
    surface_vertices(0, len(crossed), ends, rest, values, OFFSET_MAX, vertices, outward)
    return lattice.from_cells(vertices.numpy()), faces
