"""The window: keys, slider, and the loop that plays, by its own clock: VTK's timers never fire without a screen."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from warpdef.apps.viewer.actors import MATERIAL, PLAIN
from warpdef.apps.viewer.flat import TEXT_COLOR, letter_size
from warpdef.apps.viewer.movie import save_picture
from warpdef.apps.viewer.player import Player
from warpdef.apps.viewer.scene import Scene
from warpdef.apps.viewer.timeline import LEFT, RIGHT, SLIDER_AT

_IDLE_SECONDS = 0.01
_SLOW_VERTICES = 50000

KEYS = (
    ("space", "space", "play or pause", "play"),
    ("Right", "right", "one frame on", "forward"),
    ("Left", "left", "one frame back", "back"),
    ("Home", "home", "first frame", "first"),
    ("End", "end", "last frame", "last"),
    ("Up", "up", "faster", "faster"),
    ("Down", "down", "slower", "slower"),
    ("l", "l", "loop", "loop"),
    ("c", "c", "next colouring", "colour"),
    ("p", "p", "input cloud", "cloud"),
    ("t", "t", "trajectories", "trajectories"),
    ("w", "w", "wireframe", "wireframe"),
    ("s", "s", "smooth or flat", "smooth"),
    ("r", "r", "camera to its place", "camera"),
    ("b", "b", "scale bar", "scale"),
    ("k", "k", "keep the camera in a file", "keep"),
    ("x", "x", "save a picture", "picture"),
    ("h", "h", "this help", "help"),
    ("q", "q", "quit", "quit"),
)
"""VTK's name of a key, its name for people, what it does, and the method of ``Window`` that does it."""

HELP = "\n".join(f"{shown:>6}  {what}" for _, shown, what, _ in KEYS) + "\n\ndrag to turn, wheel to zoom"


class Window:
    """A scene with a player, driven by keys; ``run`` returns when it is closed."""

    def __init__(
        self, scene: Scene, player: Player, folder: Path, say: Callable[[str], None], camera: Path | None = None
    ) -> None:
        """Args: folder: where pictures go. say: told what happened, in a line. camera: where that is kept."""
        self.scene, self.player = scene, player
        self._folder, self._say, self._camera = folder, say, camera
        self._pointer, self._read, self._size = (-1, -1), (-1, -1, -1), (0, 0)
        self._open, self._dirty, self._helping = True, True, False
        self._actions = {key: getattr(self, name) for key, _, _, name in KEYS}
        self._slider: Any = None
        self._colours = [MATERIAL, PLAIN, *scene.content.measures]

    def open(self, title: str) -> None:
        """Show the window and take over keys and slider."""
        plotter, interactor = self.scene.plotter, self.scene.plotter.iren.interactor
        if self.player.count > 1:
            plotter.subplot(0, 0)
            self._slider = plotter.add_slider_widget(
                self._slid,
                rng=(0, self.player.count - 1),
                value=self.player.frame,
                pointa=(LEFT, 0.05),
                pointb=(RIGHT, 0.05),
                title_height=0.02,
                slider_width=0.02,
                tube_width=0.006,
                color=TEXT_COLOR,
                interaction_event="always",
            )
            # The number stands beside it, clear of the bar above.
            drawn = self._slider.GetRepresentation()
            drawn.ShowSliderLabelOff()
            drawn.SetSliderLength(0.014)
            drawn.SetEndCapLength(0.004)
            drawn.SetEndCapWidth(0.014)
            # Over all panes, not in the first.
            self._slider.EnabledOff()
            self._slider.SetDefaultRenderer(self.scene.captions.over)
            self._slider.SetCurrentRenderer(self.scene.captions.over)
            self._slider.EnabledOn()
        plotter.title = title
        plotter.show(interactive_update=True, auto_close=False)
        plotter.iren.clear_key_event_callbacks()
        # With an observer of its own the style no longer acts on keys: its w, s, p, e would collide with ours.
        interactor.GetInteractorStyle().AddObserver("CharEvent", lambda *_: None)
        interactor.AddObserver("KeyPressEvent", self._pressed)
        interactor.AddObserver("MouseMoveEvent", self._moved)
        interactor.AddObserver("ExitEvent", lambda *_: self.quit())
        self.scene.place_camera()

    def run(self, until: Callable[[], bool] = lambda: False) -> None:
        """Play and answer keys until the window is closed or ``until`` says so."""
        while self._open and not until():
            if not self.spin(time.monotonic()):
                time.sleep(_IDLE_SECONDS)

    def spin(self, now: float) -> bool:
        """Answer what was pressed, go on to ``now``, draw if anything changed; returns whether it did."""
        self.scene.plotter.iren.process_events()
        if not self._open:
            return False
        changed = self.player.tick(now)
        size = tuple(self.scene.plotter.window_size)
        if size != self._size:
            self._size, self._dirty = size, True
            self._place_slider()
        read = self._read_pointer()
        if not (changed or read or self._dirty or self.player.frame != self.scene.frame):
            return False
        self._dirty = False
        self.scene.show(self.player.frame)
        if self._slider is not None:
            self._slider.GetRepresentation().SetValue(self.player.frame)
        self.scene.plotter.render()
        return True

    def _place_slider(self) -> None:
        """Above the strip, however high the window is."""
        if self._slider is None:
            return
        drawn, height = self._slider.GetRepresentation(), SLIDER_AT * letter_size(self._size) / self._size[1]
        drawn.GetPoint1Coordinate().SetValue(LEFT, height)
        drawn.GetPoint2Coordinate().SetValue(RIGHT, height)
        drawn.Modified()  # its ends are not counted as its own

    def _read_pointer(self) -> bool:
        """Say what is under the mouse, where it or the frame is another one; while it plays there is no time for it."""
        wanted = (-1, -1, -1) if self.player.playing else (*self._pointer, self.scene.frame)
        if wanted == self._read:
            return False
        self._read = wanted
        return self.scene.read(*wanted[:2])

    def redraw(self) -> None:
        """Draw at the next ``spin``, whatever it finds."""
        self._dirty = True

    @property
    def is_open(self) -> bool:
        """Whether it has not been closed yet."""
        return self._open

    def press(self, key: str) -> None:
        """Do what a key does; unknown keys do nothing."""
        action = self._actions.get(key) or self._actions.get(key.lower())
        if action is not None:
            action()
            self._dirty = True

    def _pressed(self, interactor: Any, _event: str) -> None:
        self.press(interactor.GetKeySym() or "")

    def _moved(self, interactor: Any, _event: str) -> None:
        self._pointer = tuple(interactor.GetEventPosition())

    def _slid(self, value: float) -> None:
        if round(value) != self.player.frame:
            self.player.playing = False
            self.player.go(round(value), time.monotonic())

    def play(self) -> None:
        self.player.toggle(time.monotonic())

    def forward(self) -> None:
        self.player.step(1, time.monotonic())

    def back(self) -> None:
        self.player.step(-1, time.monotonic())

    def first(self) -> None:
        self.player.go(0, time.monotonic())

    def last(self) -> None:
        self.player.go(self.player.count - 1, time.monotonic())

    def faster(self) -> None:
        self.player.faster(1, time.monotonic())

    def slower(self) -> None:
        self.player.faster(-1, time.monotonic())

    def loop(self) -> None:
        self.player.loop = not self.player.loop

    def colour(self) -> None:
        look = self.scene.look
        at = self._colours.index(look.color) if look.color in self._colours else -1
        look.color = self._colours[(at + 1) % len(self._colours)]
        if look.color == "error" and self._slow_to_measure():
            self._say("distances to the surface are measured when a frame is first shown: scrubbing is slow until then")

    def _slow_to_measure(self) -> bool:
        """Whether the meshes are so large that a frame's distances take far longer than its picture."""
        return max(len(s.data.points) for s in self.scene.surfaces if s is not None) > _SLOW_VERTICES

    def cloud(self) -> None:
        self.scene.look.cloud = not self.scene.look.cloud

    def trajectories(self) -> None:
        self.scene.look.trajectories = not self.scene.look.trajectories

    def wireframe(self) -> None:
        self.scene.look.wireframe = not self.scene.look.wireframe

    def smooth(self) -> None:
        self.scene.look.smooth = not self.scene.look.smooth

    def camera(self) -> None:
        self.scene.place_camera()

    def scale(self) -> None:
        self.scene.look.scale_bar = not self.scene.look.scale_bar

    def keep(self) -> None:
        """Write where the camera stands to the file that was named, or to the next free name beside the pictures."""
        from warpdef.apps.viewer.camera_file import save_camera

        path = self._camera or self._free("warpdef-camera-{:03d}.json")
        save_camera(path, self.scene.camera, self.scene.content.origin)
        self._say(f"camera: {path} (--camera {path} looks from there again)")

    def picture(self) -> None:
        """Save what is seen beside where the program was started, under the next free name."""
        path = self._free("warpdef-{:03d}.png")
        save_picture(self.scene.picture(), path)
        self._say(f"picture: {path}")

    def _free(self, name: str) -> Path:
        number = 1
        while (path := self._folder / name.format(number)).exists():
            number += 1
        return path

    def help(self) -> None:
        self._helping = not self._helping
        self.scene.show_help(HELP if self._helping else "")

    def quit(self) -> None:
        self._open = False
