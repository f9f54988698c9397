"""Sparse triangular factors and the sweeps through them, on the CPU."""

from __future__ import annotations

import numpy as np
import pytest
import reference
import synthetic
import warp as wp

from warpdef.fit.sobolev import factorise
from warpdef.geometry.triangles import unique_edges
from warpdef.kernels.cholesky import CholeskySolver, Factor
from warpdef.kernels.graphs import mesh_graph


def solve(factor: Factor, rhs: np.ndarray, in_place: bool = False) -> np.ndarray:
    b = wp.array(rhs.astype(np.float32), dtype=wp.vec3, device="cpu")
    x = b if in_place else wp.full(len(rhs), wp.vec3(7.0, 7.0, 7.0), dtype=wp.vec3, device="cpu")
    CholeskySolver(factor, wp.get_device("cpu")).solve(b, x)
    return x.numpy()


def sphere(weight: float, subdivisions: int = 2) -> tuple[Factor, np.ndarray]:
    """Factor and dense matrix of a sphere's edges."""
    vertices, faces = synthetic.icosphere(subdivisions)
    edges = unique_edges(faces)
    dense = reference.smoother(edges, len(vertices), weight)
    return factorise(mesh_graph(edges, len(vertices), weight)), dense


@pytest.mark.parametrize("weight", [0.0, 0.25, 16.0, 1e4])
def test_factors_multiply_to_the_matrix(weight: float) -> None:
    factor, dense = sphere(weight)
    lower = np.eye(len(dense))
    place = np.repeat(np.arange(len(dense)), np.diff(factor.row))
    assert (factor.column < place).all()
    lower[place, factor.column] = factor.value
    np.testing.assert_array_equal(np.sort(factor.order), np.arange(len(dense)))
    expected = dense[np.ix_(factor.order, factor.order)]
    np.testing.assert_allclose(lower * factor.pivot @ lower.T, expected, rtol=0, atol=1e-12 * (1 + weight))
    assert (factor.pivot > 0).all()


@pytest.mark.parametrize("in_place", [False, True])
@pytest.mark.parametrize("weight", [0.0, 0.25, 16.0, 1e3])
def test_it_solves(weight: float, in_place: bool, rng: np.random.Generator) -> None:
    factor, dense = sphere(weight)
    for scale in (1e-7, 1.0, 1e5):
        rhs = scale * rng.normal(size=(len(dense), 3)).astype(np.float32)
        found = solve(factor, rhs, in_place)
        assert np.linalg.norm(dense @ found - rhs) <= 2e-6 * (1 + weight) ** 0.5 * np.linalg.norm(rhs)
        expected = np.linalg.solve(dense, rhs.astype(np.float64))
        np.testing.assert_allclose(found, expected, rtol=0, atol=5e-6 * np.abs(expected).max())


def test_its_own_adjoint(rng: np.random.Generator) -> None:
    factor, _ = sphere(16.0)
    a, b = rng.normal(size=(2, len(factor.order), 3))
    assert np.vdot(solve(factor, a), b) == pytest.approx(np.vdot(a, solve(factor, b)), rel=1e-5)


def test_parts_without_edges_between_them_and_lone_vertices(rng: np.random.Generator) -> None:
    edges = np.array([[0, 5], [5, 2], [1, 3]])  # 4 and 6 stand alone
    dense = reference.smoother(edges, 7, 3.0)
    rhs = rng.normal(size=(7, 3))
    found = solve(factorise(mesh_graph(edges, 7, 3.0)), rhs)
    np.testing.assert_allclose(found, np.linalg.solve(dense, rhs), rtol=0, atol=1e-6)
    np.testing.assert_allclose(found[[4, 6]], rhs[[4, 6]], rtol=1e-7)


def test_nothing_is_asked_and_what_is_no_number(rng: np.random.Generator) -> None:
    factor, dense = sphere(16.0, 1)
    np.testing.assert_array_equal(solve(factor, np.zeros((len(dense), 3))), 0)
    rhs = rng.normal(size=(len(dense), 3))
    rhs[5, 0] = np.nan
    found = solve(factor, rhs)
    assert np.isnan(found[:, 0]).all() and np.isfinite(found[:, 1:]).all()


def test_arrays_of_another_shape_are_refused() -> None:
    factor, dense = sphere(16.0, 1)
    count = len(dense)
    with pytest.raises(ValueError, match=rf"rhs: expected shape \({count},\), got \({count - 1},\)"):
        solve(factor, np.zeros((count - 1, 3)))
    solver, right = CholeskySolver(factor, wp.get_device("cpu")), wp.zeros(count, dtype=wp.vec3, device="cpu")
    with pytest.raises(TypeError, match="solution_out: expected dtype vec3"):
        solver.solve(right, wp.zeros(count, dtype=wp.vec4, device="cpu"))
