"""The mesh that the fit begins with: the user's own, one of all frames, or one of the best keyframe."""

from __future__ import annotations

from dataclasses import replace

from warpdef.config import Config
from warpdef.cube_clouds import CubeClouds
from warpdef.fit.growing import template_of_all
from warpdef.fit.saving import Saved
from warpdef.mesh import TriMesh
from warpdef.template.build import sheet_note
from warpdef.template.choose import ChosenTemplate, accept_user_template, choose_template

_TORN = 0.25  # share beyond the points: noise of 2 % leaves 0.1 over a body; of an open sheet half and more


def find_template(
    clouds: CubeClouds, given: TriMesh | None, config: Config, saved: Saved | None = None
) -> ChosenTemplate:
    """The template in the cube, and its keyframe as a frame of the input.

    Args:
        given: a mesh of the user's own, input units. saved: the run to go on from, which has chosen already.

    Raises:
        InputError: no keyframe gives a mesh, or the one given does not fit; or it is not that of the saved run.
    """
    mine = None if given is None else TriMesh(clouds.into.to_cube(given.vertices), given.faces)
    if saved is not None:
        # A mesh that is to be put in place was put there by that run.
        return saved.template(None if config.template.align else mine, clouds.measured.numbers)
    config = config if clouds.scattered is None else _torn_by_noise(config)
    if given is None or mine is None:
        return _own_template(clouds, config)
    chosen = accept_user_template(mine, clouds.points_of_all(), config)
    notes = given.appearance.notes if given.appearance else ()
    return replace(chosen, warnings=[*notes, *chosen.warnings])


def _torn_by_noise(config: Config) -> Config:
    """For templates of noisy clouds: these leave holes over a closed body, which are no borders."""
    far = max(config.template.far_share_max, _TORN)
    return replace(config, template=replace(config.template, far_share_max=far))


def _own_template(clouds: CubeClouds, config: Config) -> ChosenTemplate:
    """Of all frames, where one camera saw a body that turns; else of the best keyframe."""
    sequence, view, note = clouds.calm, clouds.view, ""
    points, normals = clouds.points_of_all(), sequence.all_normals()
    if view is not None and config.template.grow and not sequence.order:
        chosen, note = template_of_all(points, normals, config, view)
        if chosen is not None:
            return chosen
    # Keyframe Selection: the frame with most surface near the middle, and screened Poisson on it.
    noise = "" if clouds.noise is None else str(clouds.noise["normals"])
    chosen = choose_template(points, normals, config, view, sequence.places, noise)
    if noise == "estimated":
        chosen = replace(chosen, report=replace(chosen.report, normals="estimated"))
    if not note:
        return replace(chosen, why=f"{chosen.why}{sheet_note(chosen.report)}")
    ends = "the mesh is a sheet of what is seen" if chosen.report.surface == "open" else "its far side is a guess"
    return replace(chosen, warnings=[f"{note}; {ends}", *chosen.warnings])
