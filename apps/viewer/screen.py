"""The screen that a window stands on: whether there is one, and whether it was lost. Not every crash is a library's."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from typing import Any

_LOST = re.compile(
    r"bad X server connection|X connection to \S+ broken|fatal IO error|"
    r"(can(no|')t|could not|unable to) (open|connect to) (the )?(X )?(display|screen|server)",
    re.IGNORECASE,
)

_kept: list[Any] = []  # Xlib calls it as long as the process lives


def has_screen() -> bool:
    """Whether an X server is named; VTK's Linux wheels draw windows by X only."""
    return bool(os.environ.get("DISPLAY"))


def screen_lost(text: str) -> bool:
    """Whether what a process that had a window wrote on standard error says that its screen is not there, or gone."""
    return _LOST.search(text) is not None


def lost_screen() -> str:
    """That it is, and what to do."""
    return (
        f"the screen DISPLAY={os.environ.get('DISPLAY', '')} does not answer or was lost; start it or connect to it "
        "again (as with ssh -X)"
    )


def explain_loss(say: Callable[[str], None], code: int) -> None:
    """From now on a screen that is lost ends the process with ``code`` and a line of ours, not with Xlib's alone."""
    import ctypes

    try:
        install = ctypes.CDLL("libX11.so.6").XSetIOErrorHandler
    except (OSError, AttributeError):
        return  # no Xlib

    def lost(_display: int | None) -> int:
        say(f"warpdef: error: {lost_screen()}")
        # Xlib would end it here, too: nothing may be drawn any more.
        os._exit(code)

    handler = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p)(lost)
    _kept.append(handler)
    install.restype = ctypes.c_void_p
    install(handler)
