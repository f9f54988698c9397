"""What is measured on clouds before a fit: of large ones some points speak for all."""

from __future__ import annotations

import numpy as np
import pytest
import synthetic

from warpdef.fit import measures
from warpdef.fit.measures import CloudMeasures
from warpdef.fit.morton import morton_order


def test_some_points_of_a_large_cloud_speak_for_all(monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator) -> None:
    """Means over independent places err by their spread over the root of the count: 0.52 for the distance to the
    nearest, 0.26 for the area of the disc to the 15th neighbour; five standard errors are allowed."""
    moving = synthetic.turning_ellipsoid(3, 12_000, rng, 3)
    clouds = [cloud[morton_order(cloud)] for cloud in moving.clouds]
    whole = CloudMeasures(clouds, 1.0, 0.8)
    assert whole.thickness > 0
    monkeypatch.setattr(measures, "_ASKED", 3_000)
    few = CloudMeasures(clouds, 1.0, 0.8)
    error = 5.0 / np.sqrt(3_000)
    np.testing.assert_allclose(few.spacing, whole.spacing, rtol=0.52 * error)
    np.testing.assert_allclose(few._local_shape[2], whole._local_shape[2], rtol=0.26 * error)
    assert few.spacing[0] != whole.spacing[0]
    assert few.thickness == pytest.approx(whole.thickness, rel=0.1)


def test_clouds_are_not_kept(rng: np.random.Generator) -> None:
    found = CloudMeasures([rng.normal(size=(200, 3))], 1.0, 0.8)
    assert found.spacing.shape == (1,) and found._clouds == []
