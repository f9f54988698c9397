"""Numbers of others, and our own targets: the one place where they are written down.

Values of *Preconditioned Deformation Grids* (Pacific Graphics 2025) are its rows "Ours"; Chamfer distances in 1e-5.
"""

from __future__ import annotations

from dataclasses import dataclass

PAPER = "paper"
TARGET = "target"


@dataclass(frozen=True)
class Published:
    """One row of somebody's table, under the experiment and setting that repeat it.

    who:      the paper, another program, or our target
    where:    table of the source, or how it was measured
    data:     what it is the mean of
    cd:       Chamfer distance, 1e-5; None where only other measures are given
    """

    experiment: str
    setting: str
    who: str
    where: str
    data: str
    cd: float | None
    nc: float | None = None
    f05: float | None = None
    f1: float | None = None
    tracking: float | None = None

    def measures(self) -> dict[str, float]:
        """The values given, by our measures' names and in plain units."""
        names = ("normal_consistency", "f_score_0.5", "f_score_1", "tracking")
        values = dict(zip(names, (self.nc, self.f05, self.f1, self.tracking), strict=True))
        cd = None if self.cd is None else self.cd * 1e-5
        return {key: value for key, value in {"chamfer_l2": cd, **values}.items() if value is not None}


_AMA, _DFAUST, _DT4D = "AMA (33 sequences)", "DFAUST (109 sequences)", "DT4D animals (89 sequences)"


def _paper(experiment: str, where: str, *rows: tuple) -> list[Published]:
    return [Published(experiment, setting, PAPER, where, *values) for setting, *values in rows]


def _measured(setting: str, cd: float, nc: float, f05: float | None = None, tracking: float | None = None) -> Published:
    where = "run by us, one CPU thread, true normals unless said"
    return Published("accuracy", setting, "SPARE", where, "this sequence", cd, nc, f05, None, tracking)


def _target(
    setting: str,
    cd: float | None,
    nc: float | None = None,
    f05: float | None = None,
    tracking: float | None = None,
) -> Published:
    return Published("accuracy", setting, TARGET, "default preset", "this sequence", cd, nc, f05, None, tracking)


PUBLISHED: tuple[Published, ...] = (
    *_paper(
        "main",
        "table 1 (tab:metrics)",
        ("all", _AMA, 0.47, 0.939, 0.985, 0.999),
        ("all", _DFAUST, 0.52, 0.957, 0.988, 0.997),
        ("all", _DT4D, 1.53, 0.960, 0.961, 0.994),
    ),
    *_paper(
        "length",
        "tab:length",
        ("10 frames", _AMA, 0.55, 0.928, 0.980, 0.999),
        ("20 frames", _AMA, 0.54, 0.928, 0.979, 0.999),
        ("40 frames", _AMA, 0.66, 0.923, 0.971, 0.999),
        ("60 frames", _AMA, 0.72, 0.919, 0.960, 0.997),
        ("80 frames", _AMA, 1.35, 0.906, 0.931, 0.990),
    ),
    *_paper(
        "resolution",
        "tab:metrics_res",
        ("2,500 points", _AMA, 0.79, 0.922, 0.948, 0.997),
        ("5,000 points", _AMA, 0.47, 0.939, 0.985, 0.999),
        ("10,000 points", _AMA, 0.40, 0.950, 0.993, 0.999),
        ("20,000 points", _AMA, 0.37, 0.959, 0.996, 0.999),
    ),
    *_paper(
        "noise",
        "tab:noise",
        ("0 %", _AMA, 0.47, 0.939, 0.985, 0.999),
        ("0.25 %", _AMA, 0.76, 0.912, 0.958, 0.998),
        ("0.5 %", _AMA, 1.25, 0.865, 0.870, 0.995),
        ("1 %", _AMA, 3.83, 0.703, 0.581, 0.902),
        ("2 %", _AMA, 20.90, 0.529, 0.254, 0.508),
    ),
    # Settings: preconditioning, multi-resolution, isometry.
    *_paper(
        "components",
        "tab:structure",
        ("- - -", _AMA, 9e5, 0.796, 0.720, 0.791),
        ("- - I", _AMA, 3e2, 0.901, 0.929, 0.967),
        ("- M -", _AMA, 0.69, 0.910, 0.960, 0.997),
        ("- M I", _AMA, 4.39, 0.913, 0.958, 0.991),
        ("P - -", _AMA, 2.54, 0.901, 0.950, 0.991),
        ("P - I", _AMA, 4.37, 0.913, 0.958, 0.991),
        ("P M -", _AMA, 0.67, 0.933, 0.978, 0.998),
        ("P M I", _AMA, 0.47, 0.939, 0.985, 0.999),
    ),
    # The figure of the levels prints no other number than that of the default, 10.
    *_paper("levels", "table 1; fig:grid_level shows the others", ("10 levels", _AMA, 0.47, 0.939, 0.985, 0.999)),
    *_paper(
        "initialization",
        "tab:init",
        ("first, poisson", _AMA, 0.59, 0.931, 0.975, 0.999),
        ("first, tetrahedra", _AMA, 0.60, 0.930, 0.973, 0.998),
        ("middle, poisson", _AMA, 0.52, 0.935, 0.981, 0.999),
        ("middle, tetrahedra", _AMA, 0.60, 0.933, 0.977, 0.998),
        ("auto, poisson", _AMA, 0.53, 0.935, 0.981, 0.999),
        ("auto, tetrahedra", _AMA, 0.54, 0.934, 0.978, 0.999),
        ("first, poisson", _DT4D, 2.50, 0.959, 0.951, 0.992),
        ("first, tetrahedra", _DT4D, 5.07, 0.912, 0.879, 0.940),
        ("first, given", _DT4D + ", diffusion model's mesh", 8.42, 0.956, 0.942, 0.984),
        ("middle, poisson", _DT4D, 2.32, 0.962, 0.961, 0.994),
        ("middle, tetrahedra", _DT4D, 6.70, 0.925, 0.902, 0.948),
        ("middle, given", _DT4D + ", diffusion model's mesh", 1.87, 0.962, 0.956, 0.992),
        ("auto, poisson", _DT4D, 2.35, 0.962, 0.961, 0.994),
        ("auto, tetrahedra", _DT4D, 4.45, 0.925, 0.905, 0.954),
        ("auto, given", _DT4D + ", diffusion model's mesh", 3.53, 0.960, 0.954, 0.989),
    ),
    *_paper(
        "accuracy",
        "tables 1, tab:noise, tab:metrics_res, tab:length",
        ("ama_crane 10:27", _AMA, 0.47, 0.939, 0.985, 0.999),
        ("horse_gallop 0:17", _DT4D, 1.53, 0.960, 0.961, 0.994),
        ("ama_crane 10:27, noise 0.5 %", _AMA, 1.25, 0.865, 0.870, 0.995),
        ("ama_crane 10:27, noise 1 %", _AMA, 3.83, 0.703, 0.581, 0.902),
        ("ama_crane 10:27, 2,500 points", _AMA, 0.79, 0.922, 0.948, 0.997),
        ("ama_crane 10:27, 20,000 points", _AMA, 0.37, 0.959, 0.996, 0.999),
        ("ama_crane 0:80", _AMA, 1.35, 0.906, 0.931, 0.990),
    ),
    _measured("ama_crane 10:27", 0.309, 0.963, 0.996, 0.0043),
    _measured("horse_gallop 0:17", 0.557, 0.968, None, 0.0085),
    _measured("ama_crane 10:27, noise 1 %", 4.53, 0.778),
    _measured("ama_crane 0:80", 0.532, 0.960, None, 0.0106),
    _measured("cesiumman_walk 0:17", 0.431, 0.975, None, 0.0047),
    Published("accuracy", "ama_crane 10:27, 2,500 points", "SPARE", "run by us", "this sequence", 0.395),
    Published("accuracy", "ama_crane 10:27, 20,000 points", "SPARE", "run by us", "this sequence", 0.260),
    Published("accuracy", "crane_clouds", "SPARE", "run by us; the median, one frame at 3.2", "this sequence", 0.39),
    _target("ama_crane 10:27", 0.28, 0.967, 0.997, 0.0038),
    _target("horse_gallop 0:17", 0.32, None, None, 0.005),
    _target("crane_clouds", 0.36),
    _target("ama_crane 10:27, noise 0.5 %", 0.60, 0.93),
    _target("ama_crane 10:27, noise 1 %", 1.3, 0.88),
    _target("ama_crane 10:27, 2,500 points", 0.36),
    _target("ama_crane 10:27, 20,000 points", 0.25),
    _target("ama_crane 0:80", 0.36, 0.963, None, 0.008),
    _target("cesiumman_walk 0:17", 0.36, None, None, 0.0042),
)

WORST_FRAME = {"horse_gallop 0:17": 0.6e-5, "crane_clouds": 0.5e-5}
"""Targets on the worst frame's Chamfer distance, by setting of ``accuracy``."""

ABOVE_FLOOR = {"face_mmface4d 0:17": 0.10e-5}
"""Targets on how far the mean Chamfer distance may lie above the floor, by setting of ``accuracy``."""


def published(experiment: str, setting: str) -> list[Published]:
    """What others report for a setting, in the order of the tables."""
    return [row for row in PUBLISHED if (row.experiment, row.setting) == (experiment, setting)]
