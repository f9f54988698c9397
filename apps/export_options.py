"""What ``warpdef export`` does beyond writing frames: a rig, a measure, and the lines that say what they cost."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from warpdef.apps.console import say
from warpdef.errors import InputError

if TYPE_CHECKING:
    from warpdef.export import ExportFormat
    from warpdef.export.animation import Animation
    from warpdef.export.points import MovingPoints
    from warpdef.rig.decompose import Rig
    from warpdef.vertex_measures import VertexMeasures

_UNITS = {0.001: "mm", 0.01: "cm", 0.1: "dm", 1000.0: "km", 0.0254: "inches", 0.3048: "feet"}


@dataclass(frozen=True)
class Packing:
    """Where and how a moving mesh is written, as the flags of ``warpdef export`` and ``warpdef deform`` say it."""

    file: Path
    format: str = ""
    bones: str = ""
    precise: bool = False
    meshopt: bool = False
    overwrite: bool = False

    @property
    def suffix(self) -> str:
        """The key of the format."""
        return (self.format or self.file.suffix).lower().removeprefix(".")

    def is_rigged(self, form: ExportFormat) -> bool:
        """Whether bones move what is written."""
        return bool(self.bones) or not form.writer

    def check(self, measured: bool = False, points: bool = False) -> ExportFormat:
        """The format, once it is sure that it holds what is wanted and that the place is free.

        Args:
            measured: with a number at every vertex. points: points without faces.

        Raises:
            InputError: it does not, or something stands there.
        """
        from warpdef.export import check_content, check_place, format_of

        form = format_of(self.file, self.format, points)
        parse_bones(self.bones)
        check_place(self.file, form, self.overwrite)
        check_content(self.file, form, self.is_rigged(form), measured, self.meshopt)
        return form

    def write(self, animation: Animation | MovingPoints, form: ExportFormat) -> list[Path]:
        """Write it, with a rig where one is asked for, and return the places written.

        Raises:
            InputError: as ``export`` and ``fit_bones`` do.
        """
        from warpdef.export import export
        from warpdef.export.animation import Animation

        how = {"format": self.format, "overwrite": self.overwrite, "precise": self.precise, "meshopt": self.meshopt}
        if isinstance(animation, Animation) and self.is_rigged(form):
            how["rig"] = fit_bones(animation, parse_bones(self.bones))
        return export(animation, self.file, **how)

    def say_cost(self, animation: Animation | MovingPoints, form: ExportFormat) -> None:
        """What was rounded or is not in the file, who does not read it, and where a rig would serve better."""
        from warpdef.export.animation import Animation

        if isinstance(animation, Animation):
            say_left_out(animation, form, self.suffix)
        if isinstance(animation, Animation) and form.quantised and not self.is_rigged(form):
            say_quantised(animation, self.precise)
        if self.meshopt:
            say("warpdef: what --meshopt packs is read by three.js, Babylon.js and game engines; Blender does not")


def parse_bones(text: str) -> int | None:
    """The number of bones that ``--bones`` asks for; None for ``auto`` and for nothing.

    Raises:
        InputError: neither a whole number above 0 nor ``auto``.
    """
    if text in ("", "auto"):
        return None
    if not text.isdecimal() or int(text) < 1:
        raise InputError(f"--bones: expected a whole number above 0, or auto, got '{text}'")
    return int(text)


def fit_bones(animation: Animation, bone_count: int | None) -> Rig:
    """A rig for an animation; its number of bones and its error go to standard error."""
    from warpdef.rig.decompose import fit_rig

    rig = fit_rig(animation.vertices, bone_count)
    mean, most = (100.0 * error / rig.extent for error in (rig.mean_error, rig.max_error))
    say(
        f"warpdef: rig of {rig.bone_count} bones: the mesh is {mean:.2f} % of its extent away on average, "
        f"{most:.1f} % at most"
    )
    return rig


def say_left_out(animation: Animation, form: ExportFormat, suffix: str) -> None:
    """What was said of axis and unit and the file has no place for."""
    left = {"up": f"{animation.up.upper()} up", "unit": f"a scale of {animation.metres_per_unit:g}"}
    asked = {"up": animation.up != "y", "unit": animation.metres_per_unit != 1.0}
    missing = [left[key] for key in left if asked[key] and key not in form.carries]
    if missing:
        say(f"warpdef: .{suffix} has the result's own coordinates: import it with {' and '.join(missing)}")


def say_quantised(animation: Animation, precise: bool) -> None:
    """What morph targets cost: the step of their numbers, and that many frames are better off with a rig."""
    from warpdef.export.gltf import TARGETS_MANY, quantisation

    if not precise:
        step = quantisation(animation.vertices)[1]
        print(f"positions are multiples of {step:.2g} (--precise keeps float32)")
    if len(animation) > TARGETS_MANY:
        say(f"warpdef: {len(animation)} frames are as many morph targets; --bones auto writes a rig, small and quick")


def load_measures(output: Path, clouds: Path | None, truth: Path | None, truth_frames: slice | None) -> VertexMeasures:
    """What can be measured at the vertices of a run, of all its frames.

    Args:
        clouds: its input; None: clouds.npz in the run folder, where there is one. truth: true meshes; the same.
        truth_frames: the truth's frames that the run was made from.

    Raises:
        InputError: something is missing or damaged, or numbers of frames do not fit.
    """
    from warpdef.apps.viewer.content import load_content

    measures = load_content(output, clouds=clouds, truth=truth, truth_frames=truth_frames).panes[0].colouring
    assert measures is not None
    return measures


def unit_name(metres_per_unit: float) -> str:
    """What a length of 1 is called, as far as that is known: 1 is also what stands where nothing was said."""
    return _UNITS.get(metres_per_unit, "input units")


def say_measure(animation: Animation, suffix: str, rigged: bool) -> None:
    """What the colours stand for, and where a format shows them once only."""
    measured = animation.measured
    if measured is not None:
        low, high = measured.limits
        print(f"{measured.what}: colours from {low:.3g} to {high:.3g}")
    elif animation.frame_colors is None:
        return
    if rigged:
        over = "median" if measured is None else "mean"
        say(f"warpdef: a rig moves no colours: those of the {over} over the frames are in the file")
    elif suffix == "glb":
        say("warpdef: the colours of a .glb change in web viewers; Blender shows the first frame's, but all of a .usdc")
