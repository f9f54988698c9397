"""Whether this machine can draw, found out in a process of its own: VTK does not raise where it cannot, it crashes."""

from __future__ import annotations

import re
import signal
import subprocess
import sys

from warpdef.apps.viewer.screen import has_screen, lost_screen, screen_lost
from warpdef.errors import MissingPackageError

PACKAGES = "libegl1 libgl1-mesa-dri"
"""Debian's packages that make off-screen rendering work without a screen."""

_LIBRARIES = {
    "libGL.so": "libgl1",
    "libEGL.so": "libegl1",
    "libOpenGL.so": "libopengl0",
    "libX11.so": "libx11-6",
    "libXrender.so": "libxrender1",
    "libXcursor.so": "libxcursor1",
    "libXt.so": "libxt6",
}

_SECONDS = 120.0

_PROGRAM = """
import sys
import pyvista
window = sys.argv[1] == "window"
plotter = pyvista.Plotter(off_screen=not window, window_size=[64, 64])
plotter.background_color = "white"
plotter.add_mesh(pyvista.Sphere(), color="black")
if window:
    plotter.show(interactive_update=True)
    plotter.iren.process_events()
picture = plotter.screenshot(return_img=True)
plotter.close()
sys.exit(0 if picture.min() < 128 < picture.max() else "nothing was drawn")
"""


class RenderingProbe:
    """Starts the trial at once, so that it runs while data is read; ``require`` waits for its end."""

    def __init__(self, window: bool) -> None:
        """Raises ``MissingPackageError`` at once where a window is wanted and there is no screen."""
        if window and sys.platform.startswith("linux") and not has_screen():
            raise MissingPackageError(
                "no screen for a window (DISPLAY is not set); use --screenshot FILE.png, --movie FILE.mp4 or "
                "--html FILE.html, which need none"
            )
        self._window = window
        self._process = subprocess.Popen(
            [sys.executable, "-c", _PROGRAM, "window" if window else "picture"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
        )

    def require(self) -> None:
        """Return once the machine has shown that it can draw.

        Raises:
            MissingPackageError: it cannot; the message says why, what to install, and what works without.
        """
        try:
            _, text = self._process.communicate(timeout=_SECONDS)
            code = self._process.returncode
            why = "" if code == 0 else explained(code, text, self._window)
        except subprocess.TimeoutExpired:
            why = advice(f"no picture after {_SECONDS:.0f} s")
        finally:
            self.stop()
        if why:
            raise MissingPackageError(
                f"{why}; without it `warpdef view OUT --html FILE.html` and `warpdef export` work"
            )

    def stop(self) -> None:
        """End the trial if it still runs."""
        if self._process.poll() is None:
            self._process.kill()
            self._process.communicate()


def explained(code: int, text: str, window: bool) -> str:
    """Why a process that draws ended, and what to do: its screen was lost, or libraries are missing."""
    if window and screen_lost(text) and "Failed to load" not in text:
        return lost_screen()
    return advice(why_it_ended(code, text))


def advice(why: str) -> str:
    """That this machine cannot draw, why, and which packages would help."""
    packages = " ".join(dict.fromkeys([*PACKAGES.split(), *_named_packages(why)]))
    return f"this machine cannot draw ({why}); on Debian or Ubuntu: apt-get install {packages}"


def why_it_ended(code: int, text: str) -> str:
    """The exit code of a process that draws, and what it wrote on standard error, in a few words."""
    # VTK's lines: colour codes, time and place, then the words after the bar.
    lines = [line.rpartition("| ")[2].strip() for line in re.sub(r"\x1b\[[0-9;]*m", "", text).splitlines()]
    lines = [line for line in lines if line]
    telling = next((line for line in lines if "Failed to load" in line), lines[-1] if lines else "")
    words = f": {telling:.160}" if telling else ""
    if code >= 0:
        return f"it ended with {code}{words}"
    try:
        return f"it was ended by {signal.Signals(-code).name}{words}"
    except ValueError:
        return f"it was ended by signal {-code}{words}"


def _named_packages(text: str) -> list[str]:
    return [_LIBRARIES[name] for name in re.findall(r"lib\w+\.so", text) if name in _LIBRARIES]
