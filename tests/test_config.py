"""Every field of the configuration is checked when it is set; presets and frame ranges."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, fields, is_dataclass, replace

import pytest

from warpdef.config import Config, LossConfig, OptimiserConfig
from warpdef.config_values import parse_slice
from warpdef.errors import ConfigError
from warpdef.files.config_file import config_from_mapping
from warpdef.presets import PRESETS, preset

POSITIVE = ([0, -1.0], [1e-6, 3.0])
FROM_ZERO = ([-1e-6], [0, 5.0])
COUNT = ([0, -3], [1, 7])
FREE = ([], [True, False])

# field: values refused, values taken. A new field without an entry fails the test below; weights of the loss are alike.
BOUNDS: dict[str, tuple[list, list]] = {
    "frames": (["3", "a:b", "1:2:0", "1:2:3:4", "1.5:2"], ["", ":", "10:27", "::2", "-5:", "27:10:-1"]),
    "points": ([-1, 1, 9], [0, 10, 5000]),
    "columns": ([], ["", "x,y,z,nx,ny,nz"]),
    "crop": (["1:2", "1:0,:,:", "a:b,:,:", "0:1,0:1", "1,2,3"], ["", ":,:,:", "-1:1,0:2,:1e3"]),
    "landmarks": ([], ["", "known.csv"]),
    "cut_static": FREE,
    "drop_strays": FREE,
    "drop_odd_frames": FREE,
    "trust_normals": FREE,
    "colours": (["", "some"], ["still", "moving", "off"]),
    "order": (["", "pose"], ["auto", "time"]),
    "fill": ([0, -0.5, 1.01], [0.5, 1]),
    "seed": ([-1], [0, 2**40]),
    "keyframe.choice": (["last", "", "-1", "1.5"], ["auto", "first", "middle", "0", "12"]),
    "keyframe.voxels": ([0, 1025], [1, 1024]),
    "keyframe.gamma": FROM_ZERO,
    "keyframe.gamma_fall": ([-0.1, 2.1], [0, 2]),
    "keyframe.coverage_min": ([-0.1, 1.1], [0, 1]),
    "template.mesh": ([], ["", "body.ply"]),
    "template.align": FREE,
    "template.backend": (["open3d", ""], ["auto", "gpytoolbox", "pymeshlab"]),
    "template.method": (["dmtet", ""], ["poisson", "tetrahedra"]),
    "template.surface": (["half", ""], ["auto", "closed", "open"]),
    "template.depth": ([-1, 2, 15], [0, 3, 14]),
    "template.screening": FROM_ZERO,
    "template.faces_max": ([19, 0], [20, 10**6]),
    "template.faces_per_point": POSITIVE,
    "template.faces_sparse": ([-1], [0, 10**6]),
    "template.neighbours": ([3], [4, 40]),
    "template.far_spacings": POSITIVE,
    "template.far_share_max": ([-0.1, 1.1], [0, 1]),
    "template.missed_share_max": ([-0.1, 1.1], [0, 1]),
    "template.attempts": COUNT,
    "template.grow": FREE,
    "template.gather": FREE,
    "grid.levels": ([0, 17], [1, 16]),
    "grid.coarsest": ([0, 11], [1, 10]),
    "grid.prune": FREE,
    "grid.prune_cells": ([-1], [0, 9]),
    "sobolev.enabled": FREE,
    "sobolev.lambda_base": FROM_ZERO,
    "sobolev.lambda_growth": POSITIVE,
    "sobolev.lambda_template": FROM_ZERO,
    "sobolev.unpreconditioned_rate": POSITIVE,
    "sobolev.solver": (["lu", ""], ["auto", "cosine", "cg", "warp"]),
    "sobolev.tolerance": ([0, 1, -1e-3], [1e-8, 0.5]),
    "sobolev.iterations_max": COUNT,
    "loss.reduction": (["max"], ["sum", "mean"]),
    "loss.robust_alpha": FROM_ZERO,
    "loss.robust_power": ([0, 1, 3], [2, 4]),
    "loss.tangential": ([-0.1, 1.1], [0, 1]),
    "loss.confidence": FREE,
    "loss.confidence_bound": (["min"], ["max", "mean"]),
    "loss.template_follows_all": FREE,
    "optimiser.chain": FREE,
    "optimiser.points": ([-1], [0, 5000]),
    "optimiser.iterations": COUNT,
    "optimiser.iterations_per_frame": FROM_ZERO,
    "optimiser.warmup": ([-1], [0, 100]),
    "optimiser.rate": POSITIVE,
    "optimiser.rate_fall": ([-0.1, 1.1], [0, 1]),
    "optimiser.rate_growth": POSITIVE,
    "optimiser.template_rate": FROM_ZERO,
    "optimiser.decay": (["linear"], ["constant", "cosine"]),
    "optimiser.beta1": ([-0.1, 1], [0, 0.99]),
    "optimiser.beta2": ([-0.1, 1], [0, 0.99]),
    "optimiser.epsilon": POSITIVE,
    "refine.iterations": ([-1], [0, 50]),
    "refine.follow": ([-1], [0, 12]),
    "refine.rigidity": POSITIVE,
    "refine.rigidity_noisy": POSITIVE,
    "refine.rotation_smoothness": FROM_ZERO,
    "refine.clean_thickness": ([0, -1], [0.1, 0.5]),
    "refine.noisy_thickness": ([0.3, 0.1], [0.31, 2]),
    "refine.landmark_weight": POSITIVE,
    "refine.time": FROM_ZERO,
    "refine.damping": POSITIVE,
    "refine.reach": POSITIVE,
    "refine.agreement": ([-1.1, 1], [-1, 0, 0.9]),
    "refine.shape_smoothness": POSITIVE,
    "refine.momentum": ([-0.1, 1], [0, 0.95]),
    "refine.shape_step": ([-0.1, 2], [0, 1.9]),
    "refine.tolerance": ([0, 1, -1e-3], [1e-8, 0.5]),
    "refine.iterations_max": COUNT,
    "refine.material": FREE,
    "refine.recover": FREE,
    **{f"loss.{field.name}": FROM_ZERO for field in fields(LossConfig) if field.name.endswith("_weight")},
}


def changed(config: Config, key: str, value) -> Config:
    group, _, name = key.rpartition(".")
    return replace(config, **{group: replace(getattr(config, group), **{name: value})} if group else {name: value})


def all_keys() -> list[str]:
    keys = []
    for f in fields(Config):
        group = getattr(Config(), f.name)
        keys += [f"{f.name}.{g.name}" for g in fields(group)] if is_dataclass(group) else [f.name]
    return keys


def test_every_field_has_bounds_here():
    assert sorted(BOUNDS) == sorted(all_keys())
    assert {"loss.mesh_weight", "loss.isometry_weight"} <= set(BOUNDS)


@pytest.mark.parametrize(("key", "value"), [(key, value) for key, (bad, _) in BOUNDS.items() for value in bad])
def test_refused_values(key, value):
    with pytest.raises(ConfigError, match=f"configuration: {key}: expected .*, got "):
        changed(Config(), key, value)


@pytest.mark.parametrize(("key", "value"), [(key, value) for key, (_, good) in BOUNDS.items() for value in good])
def test_taken_values(key, value):
    group, _, name = key.rpartition(".")
    made = changed(Config(), key, value)
    assert getattr(getattr(made, group) if group else made, name) == value


def test_nan_is_refused_where_bounds_are():
    for key, (bad, good) in BOUNDS.items():
        if bad and isinstance(good[-1], float):
            with pytest.raises(ConfigError, match=key):
                changed(Config(), key, float("nan"))


def test_exact_solver_needs_full_grids():
    with pytest.raises(ConfigError, match="sobolev.solver: expected cg, warp or auto where grid.prune is true"):
        changed(changed(Config(), "sobolev.solver", "cosine"), "grid.prune", True)


def test_single_resolution():
    made = changed(Config(), "grid.coarsest", Config().grid.levels)
    assert made.grid.coarsest == made.grid.levels


def test_a_config_is_frozen_and_compares():
    with pytest.raises(FrozenInstanceError):
        Config().seed = 1  # type: ignore[misc]
    assert Config() == Config()
    assert hash(Config()) == hash(Config())
    assert changed(Config(), "loss.tangential", 0.5) != Config()


def test_presets():
    assert preset("default") == Config()
    paper = preset("paper")
    # The paper: 5,000 iterations at 17 frames and 10,000 at 80, pruned grids, plain distances, constant rates.
    assert paper.optimiser.total(17) == 5000
    assert paper.optimiser.total(80) == pytest.approx(10000, rel=0.01)
    assert paper.grid.prune
    assert paper.loss.tangential == 1
    assert paper.optimiser.decay == "constant"
    assert {preset(name) for name in PRESETS} == {Config(), paper}
    with pytest.raises(ConfigError, match="preset: expected default or paper, got 'fast'"):
        preset("fast")


def test_iterations_grow_with_frames():
    made = OptimiserConfig(iterations=100, iterations_per_frame=2.5)
    assert [made.total(t) for t in (2, 17, 18, 19, 37)] == [100, 100, 102, 105, 150]


def test_rates_fall_with_frames():
    made = OptimiserConfig(chain=True, rate=0.08, rate_fall=0.5)
    assert [made.for_length(t).rate for t in (2, 17, 68, 272)] == pytest.approx([0.08, 0.08, 0.04, 0.02])
    assert made.for_length(17) == made
    assert made.for_length(68).template_rate == made.template_rate
    # The warm-up grows as the rates fall, to two thirds of the run.
    made = OptimiserConfig(chain=True, iterations=300, iterations_per_frame=0.0, warmup=50, rate_fall=0.5)
    assert [made.for_length(t).warmup for t in (2, 17, 68, 272, 10000)] == [50, 50, 100, 200, 200]
    assert OptimiserConfig(chain=True, iterations=30, warmup=50).for_length(100).warmup == 50
    assert preset("paper").optimiser.for_length(80).rate == preset("paper").optimiser.rate
    # Without a chain no move adds up along the sequence.
    assert OptimiserConfig(rate_fall=0.5).for_length(272) == OptimiserConfig(rate_fall=0.5)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", range(30)),
        ("10:27", range(10, 27)),
        (" 1 : 9 : 3 ", range(1, 9, 3)),
        ("-3:", range(27, 30)),
        ("::-1", range(29, -1, -1)),
    ],
)
def test_parse_slice(text, expected):
    assert list(range(30))[parse_slice(text)] == list(expected)


@pytest.mark.parametrize("text", ["7", "a:b", "1:2:0", "1:2:3:4", "1;2", "1:2.0"])
def test_parse_slice_refuses(text):
    with pytest.raises(ConfigError, match=r"frames: expected start:stop or start:stop:step, as 10:27, got"):
        parse_slice(text)


@pytest.mark.parametrize(
    "values",
    [
        {"template": {"faces_max": 2 * 10**9}},
        {"optimiser": {"iterations": 10**20}},
        {"optimiser": {"iterations_per_frame": 1e20}},
        {"optimiser": {"epsilon": 1e-300}},
        {"refine": {"reach": 1e300}},
        {"refine": {"iterations": 10**9}},
        {"sobolev": {"lambda_growth": 1e30}},
        {"loss": {"isometry_weight": float("inf")}},
        {"keyframe": {"choice": "9" * 5000}},
        {"points": 10**12},
        {"seed": 2**64},
    ],
    ids=lambda values: str(values)[:40],
)
def test_numbers_without_bound_are_refused(values: dict) -> None:
    with pytest.raises(ConfigError, match="configuration: .*: expected ") as error:
        config_from_mapping(values)
    assert len(str(error.value)) < 200


def test_large_numbers_that_make_sense_pass() -> None:
    config_from_mapping({"seed": 2**63 - 1, "points": 10**8, "optimiser": {"iterations": 10**6}, "fill": 1e-6})
