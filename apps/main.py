"""The ``warpdef`` command: one line a subcommand, and the one place where errors become messages and exit codes.

Subcommands are named by import path and loaded when called, so that ``warpdef --help`` imports nothing heavy. A new
one is a file in this folder and a line in ``COMMANDS``.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

import cyclopts
from cyclopts import App

from warpdef import __version__
from warpdef.apps.exit_codes import EXIT_ERROR, EXIT_OK
from warpdef.apps.help_pages import ALL, COMMON, EXAMPLES, HELP, CommonFlags, asks_for_help
from warpdef.apps.imports import one_thread_each
from warpdef.apps.signals import Ended, ending_signals, exit_code
from warpdef.apps.streams import guarded_streams, open_missing_descriptors
from warpdef.errors import WarpdefError

COMMANDS = {
    "demo": "Make a walking figure, reconstruct it from sampled points, and compare with the truth.",
    "reconstruct": "Reconstruct one moving mesh from a sequence of point clouds.",
    "evaluate": "Compare a result with the true mesh sequence.",
    "sample": "Sample point clouds from a true mesh sequence.",
    "datasets": "Say which true mesh sequences a folder holds, and what is wrong with them.",
    "experiment": "Run a whole table of the paper, or of our own, with published numbers beside ours.",
    "bench": "Measure the kernels and the whole iteration on this machine.",
    "export": "Write a result for another program: glb, usd, pc2, mdd, pvd, obj, ply, stl, 3mf, bvh, npz, anime.",
    "deform": "Move other geometry, a denser or textured mesh or points, as a result moves.",
    "view": "Show a result in a window, or as pictures, a movie or a web page.",
}
"""Name and summary; ``name`` is the function ``name`` of ``warpdef.apps.name``."""

ANSWERING = ("evaluate", "datasets")
"""Commands whose answer is what they print."""

TRACEBACK_VARIABLE = "WARPDEF_TRACEBACK"


def build_app(called: str = "", short: bool = False) -> App:
    """The program with all its subcommands; ``called`` shows its own, longer help instead of its summary.

    ``short`` help shows of a command's flags those that people use, where it has many.
    """
    common = COMMON.get(called) if short else None
    more = f"All flags: warpdef {called if called in COMMANDS else 'COMMAND'} {ALL}. "
    app = App(
        name="warpdef",
        version=__version__,
        version_flags=["--version", "-V"],
        help="From a sequence of raw point clouds to one mesh that moves.",
        help_flags=HELP,
        help_formatter=None if common is None else CommonFlags(common),
        help_epilogue=("" if called in COMMANDS and common is None else more)
        + "Exit codes: 0 done, 2 bad input or usage, 128 and the signal's number interrupted "
        "(130 Ctrl-C, 143 SIGTERM, 129 SIGHUP). "
        f"{TRACEBACK_VARIABLE}=1 shows tracebacks.",
        suppress_keyboard_interrupt=False,
    )
    app.register_install_completion_command(
        help="Let the shell (bash, zsh, fish) complete commands and flags, from its next start on."
    )
    for position, (name, summary) in enumerate(COMMANDS.items()):
        app.command(
            f"warpdef.apps.{name}:{name}", name=name, help=None if name == called else summary, sort_key=position
        )
    return app


def run(arguments: Sequence[str] | None = None) -> int:
    """Run the program on ``arguments`` (the process's own if None) and return its exit code.

    Every ``WarpdefError``, usage error and failing file access becomes one sentence on standard error and code 2;
    anything else is a defect of ours and keeps its traceback.
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    open_missing_descriptors()
    with guarded_streams() as shown, ending_signals():
        code = _run(arguments)
        shown.flush()
        if shown.lost is not None:
            _say(f"standard output cannot be written ({shown.lost.strerror}): what was to be shown there is lost")
            # Of these commands that was all; the others have their result in files.
            if code == EXIT_OK and (not arguments or arguments[0] not in COMMANDS or arguments[0] in ANSWERING):
                code = EXIT_ERROR
    return code


def _run(arguments: Sequence[str]) -> int:
    tracebacks = os.environ.get(TRACEBACK_VARIABLE, "") not in ("", "0")
    try:
        app = build_app(arguments[0] if arguments else "", short=ALL not in arguments)
        if asks_for_help(arguments):
            name = arguments[0] if arguments and arguments[0] not in HELP else ""
            if name in EXAMPLES:
                print("\n".join(f"  {line}" for line in EXAMPLES[name]) + "\n")
        code = app(arguments, exit_on_error=False, print_error=False, result_action="return_value")
    except (WarpdefError, cyclopts.CycloptsError, OSError) as error:
        if tracebacks:
            raise
        _say(f"error: {_one_line(error)}")
        return EXIT_ERROR
    except KeyboardInterrupt as ended:
        if tracebacks:
            raise
        _say(f"interrupted{f' by {ended}' if isinstance(ended, Ended) else ''}: nothing was written")
        return exit_code(ended)
    return code if isinstance(code, int) else EXIT_OK


def _one_line(error: BaseException) -> str:
    if isinstance(error, cyclopts.UnusedCliTokensError) and error.unused_tokens:
        first, *more = error.unused_tokens
        count = f" and {len(more)} more" if more else ""
        return f"expected nothing more, got '{first}'{count}; give the folder where frames are several files"
    return " ".join(str(error).split())


def _say(text: str) -> None:
    print(f"warpdef: {text}", file=sys.stderr)


def main() -> None:
    """Entry point of the ``warpdef`` console script."""
    one_thread_each()
    sys.exit(run())


if __name__ == "__main__":
    main()
