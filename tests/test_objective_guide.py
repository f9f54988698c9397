"""The objective without a chain: clouds moved by their grids meet the next, all of their points or some."""

from __future__ import annotations

import numpy as np
import pytest
import reference
from gradients import assert_gradients_close, finite_differences
from toy_objective import Toy


@pytest.mark.parametrize("points", [0, 20], ids=["all points", "some points"])
@pytest.mark.parametrize("partial", [(), (0,), (0, 1, 2)])
def test_cloud_to_cloud_alone_matches_the_twin(partial: tuple, points: int, device: str) -> None:
    """Loss and gradient; the vertices and what is compared with them have no say and stay as they were."""
    toy = Toy(device, partial=partial, chain=False, points=points)
    p, o, scene, (pairs, _) = toy.problem, toy.objective, toy.scene, toy.pairs()
    assert p.sample.sizes.tolist() == ([20, 20, 20] if points else [40, 23, 31])

    def values(nodes: np.ndarray, weights: tuple) -> list:
        found = []
        for s in range(2):
            source, target = scene.ends(s)
            moving = reference.move(nodes[s], scene.levels, scene.clouds[source])
            found.append(reference.chamfer(scene, moving, target, pairs[s], weights[s], scene.reach_of_moved(s)))
        return found

    expected, weights = zip(*values(toy.nodes.astype(float), (None, None)), strict=True)
    np.testing.assert_allclose(o.input.loss.numpy(), expected, rtol=1e-5)
    mean = sum(expected) / 2
    assert o.losses() == pytest.approx({"input": mean, "total": mean}, rel=1e-5)
    slopes = finite_differences(lambda n: sum(v for v, _ in values(n, weights)) / 2, toy.nodes, step=1e-5)
    assert_gradients_close(toy.adj_nodes, slopes, elementwise=2e-4, relative=2e-4)
    np.testing.assert_array_equal(o.vertices.numpy(), np.tile(toy.template.astype(np.float32), (3, 1, 1)))
    assert not o.transform.loss.numpy().any() and not o.sums.weighed.numpy().any()


def test_clouds_seen_in_part_count_less_in_a_guide(device: str) -> None:
    full, partial = (Toy(device, chain=False, partial=p).objective.input.loss.numpy() for p in ((), (0, 1, 2)))
    assert (partial < full).all()


def test_vertices_are_fitted_to_all_points_whatever_grids_are_fitted_to(device: str) -> None:
    p = Toy(device, chain=False, points=20).problem
    assert p.clouds.sizes.tolist() == p.cloud_sizes.tolist() == [40, 23, 31] and len(p.cloud) == 94
    chosen, normals = (np.split(a.numpy(), p.sample.offsets[1:-1]) for a in (p.sample.points, p.sample.normals))
    for t, (cloud, sides) in enumerate(zip(p.by_frame(p.cloud.numpy()), p.by_frame(p.normals.numpy()), strict=True)):
        where = (chosen[t][:, None] == cloud.astype(np.float32)).all(axis=2)
        assert (where.sum(axis=1) == 1).all() and len(set(where.argmax(axis=1))) == 20
        np.testing.assert_array_equal(normals[t], sides[where.argmax(axis=1)].astype(np.float32))


def test_points_that_grids_are_fitted_to_are_evenly_spread(device: str) -> None:
    """No point of a cloud is far from all of them, as it were if those that come first were taken."""
    p = Toy(device, chain=False, points=20).problem
    for cloud, chosen in zip(p.by_frame(p.cloud.numpy()), np.split(p.sample.points.numpy(), [20, 40]), strict=True):
        apart = [np.linalg.norm(cloud[:, None] - some, axis=2).min(axis=1).max() for some in (chosen, cloud[:20])]
        assert apart[0] < 0.7 * apart[1]


def test_vertices_reach_twice_as_far_where_a_frame_seems_to_show_all(device: str) -> None:
    """Only what follows the grids has such a bound, not the paper's descent."""
    whole, partial = (Toy(device, chain=False, partial=t).objective.transform.sides for t in ((), (0, 1, 2)))
    assert whole[1] is not None and partial[1] is not None
    np.testing.assert_allclose(whole[1].numpy(), 2.0 * partial[1].numpy())
    assert np.isfinite(partial[1].numpy()).all()
    assert Toy(device).objective.transform.sides[1] is None
