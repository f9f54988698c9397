"""What ``--help`` shows: two lines to begin with, and of commands with many flags those that people use.

``--help-all`` shows them all.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

from cyclopts.help import DefaultFormatter

if TYPE_CHECKING:
    from cyclopts.help import HelpPanel
    from rich.console import Console, ConsoleOptions

ALL = "--help-all"
HELP = ("--help", "-h", ALL)

EXAMPLES = {
    "": ("warpdef demo", "warpdef reconstruct scans/ -o out"),
    "demo": ("warpdef demo", "warpdef demo --output out --frames 9"),
    "reconstruct": (
        "warpdef reconstruct scans/ -o out",
        "warpdef reconstruct scans/ -o out --frames 0:20 --keyframe middle",
    ),
    "evaluate": ("warpdef evaluate out", "warpdef evaluate out truth.npz --per-frame"),
    "sample": ("warpdef sample truth/ -o clouds.npz", "warpdef sample truth/ -o clouds.npz --points 2000 --noise 0.01"),
    "datasets": ("warpdef datasets check meshes/", "warpdef datasets check meshes/ --json"),
    "experiment": (
        "warpdef experiment main --data truths/ -o tables",
        "warpdef experiment main --data truths/ -o tables --quick",
    ),
    "bench": ("warpdef bench --quick", "warpdef bench --json here.json --compare there.json"),
    "export": ("warpdef export out motion.glb", "warpdef export out motion.usdc --up z --fps 30"),
    "deform": ("warpdef deform out dense.obj -o dense.glb", "warpdef deform out dense.obj -o dense.usdc --fps 30"),
    "view": ("warpdef view out", "warpdef view out --color error --screenshot error.png --azimuth 90"),
}
"""Two lines that a command's help begins with, by its name; the empty name is the program itself."""

COMMON = {
    "reconstruct": (
        "--output", "--resume", "--preset", "--config", "--device", "--threads", "--quiet", "--live", "--overwrite",
        "--max-seconds", "--frames", "--points", "--columns", "--crop", "--seed", "--keyframe", "--template",
        "--align-template", "--template.surface", "--iterations",
    ),
    "experiment": (
        "--data", "--output", "--only", "--quick", "--samples", "--preset", "--config", "--meshes", "--workers",
        "--cluster", "--worker-count", "--device", "--threads", "--keep", "--again", "--plot", "--json", "--frames",
        "--points", "--iterations",
    ),
    "view": (
        "--input", "--truth", "--compare", "--side-by-side", "--frames", "--color", "--cloud", "--wireframe", "--fps",
        "--up", "--unit", "--frame", "--azimuth", "--elevation", "--zoom", "--size", "--screenshot", "--movie",
        "--html", "--overwrite",
    ),
}  # fmt: skip
"""The flags of a command's ``--help``, where there are more than twenty; any name of a flag stands for it."""


class CommonFlags(DefaultFormatter):
    """Help panels that leave out flags whose names are not among ``common``; arguments stay."""

    def __init__(self, common: Collection[str]) -> None:
        super().__init__()
        self.common = frozenset(common)

    def __call__(self, console: Console, options: ConsoleOptions, panel: HelpPanel) -> None:
        flags = [name for entry in panel.entries for name in entry.names if name.startswith("-")]
        if panel.format == "parameter" and flags:
            entries = [entry for entry in panel.entries if self.common & set(entry.names)]
            panel = panel.copy(entries=entries)
        if panel.entries:
            super().__call__(console, options, panel)


def asks_for_help(arguments: Sequence[str]) -> bool:
    """Whether a command line shows help; an empty one does."""
    return not arguments or any(flag in arguments for flag in HELP)
