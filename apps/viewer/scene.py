"""The scene: one actor a surface and one a cloud, whose points are replaced from frame to frame.

It draws into a window, into pictures and, from a running reconstruction, whatever vertices it is given meanwhile.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from warpdef.apps.viewer.actors import CloudActor, Look, SurfaceActor
from warpdef.apps.viewer.bars import BAR, SCALE_BAR, ColorBar, ScaleBar
from warpdef.apps.viewer.camera import (
    VIEW_ANGLE,
    Camera,
    Room,
    Stand,
    fit_camera,
    pixels_per_length,
    seen_aspect,
    turned,
)
from warpdef.apps.viewer.captions import Captions, room_for, tile_letter_size
from warpdef.apps.viewer.flat import TEXT_COLOR
from warpdef.apps.viewer.scales import Scales
from warpdef.apps.viewer.trails import add_trails

if TYPE_CHECKING:
    import numpy as np

    from warpdef.apps.viewer.content import Content
    from warpdef.mesh import MeshSequence


class Scene:
    """All panes of a content in one render window."""

    def __init__(
        self,
        content: Content,
        *,
        off_screen: bool,
        size: tuple[int, int],
        look: Look | None = None,
        stand: Stand | None = None,
        camera: Camera | None = None,
    ) -> None:
        """Args: camera: stand there, not where the whole motion is seen from ``stand``."""
        import pyvista
        from vtkmodules.vtkCommonCore import vtkLogger

        # Without a screen VTK warns that it found none before it takes another way.
        vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_ERROR)
        self.content = content
        self.look = look or Look()
        self.stand = stand or Stand()
        self._kept = camera
        self.frame = 0
        self.tile = False
        """Whether this is a tile of a contact sheet, with its frame's number and no bar."""
        self._window = not off_screen
        # Its methods that PyVista wraps are not described as methods.
        self.plotter: Any = pyvista.Plotter(
            off_screen=off_screen, shape=(1, len(content.panes)), border=False, window_size=list(size)
        )
        self.surfaces: list[SurfaceActor | None] = []
        self.clouds: list[CloudActor | None] = []
        self.trails: list[Any] = [None] * len(content.panes)
        self.scales = Scales(content, self.look.color, self.look.clim, self.look.cmap)
        self._help: Any = None
        self.plotter.set_background("white")
        for index, pane in enumerate(content.panes):
            self.plotter.subplot(0, index)
            self.surfaces.append(None if pane.meshes is None else SurfaceActor(self.plotter, pane, self.scales))
            self.clouds.append(None if pane.clouds is None else CloudActor(self.plotter, pane, self.scales))
        self.captions = Captions(self.plotter)
        if len(content.panes) > 1:
            self.plotter.link_views()
        self.place_camera()
        self.show(0)
        # The mouse turns the camera without asking anybody here.
        self.plotter.renderers[0].AddObserver("StartEvent", lambda *_: self._follow_camera())

    def place_camera(self, turn: float = 0.0, all_round: bool = False) -> None:
        """Stand where the whole motion is seen, ``turn`` degrees about the up axis from the usual place."""
        width, height = self.plotter.window_size
        if self._kept is not None:
            placed = turned(self._kept, self.content.up, turn)
        else:
            placed = fit_camera(
                self.content.outline,
                self.content.up,
                width / len(self.content.panes) / height,
                stand=self.stand,
                room=self.room((width, height)),
                turn=turn,
                all_round=all_round,
            )
        for renderer in self.plotter.renderers:
            camera = renderer.camera
            camera.view_angle = VIEW_ANGLE
            camera.SetWindowCenter(0.0, -placed.lift)
            camera.position, camera.focal_point, camera.up = placed.position, placed.focus, placed.up
            renderer.camera_set = True
            renderer.ResetCameraClippingRange()
        for cloud in self.clouds:
            if cloud is not None:
                cloud.size_points(pixels_per_length(placed.distance, height))

    @property
    def camera(self) -> Camera:
        """Where the camera stands now, wherever the mouse has brought it."""
        import numpy as np

        now = self.plotter.renderers[0].camera
        position, focus, up = (np.array(x, dtype=float) for x in (now.position, now.focal_point, now.up))
        return Camera(position, focus, up, float(np.linalg.norm(position - focus)), -now.GetWindowCenter()[1])

    def read(self, x: int, y: int) -> bool:
        """Say what is under that pixel of the window, counted from its lower left; returns whether the words are new.

        Nothing is said outside the surfaces, and with a negative place.
        """
        said = self.captions.reading
        self.captions.put_reading(self._reading(x, y), tuple(self.plotter.window_size))
        return self.captions.reading != said

    def _reading(self, x: int, y: int) -> str:
        import numpy as np
        from vtkmodules.vtkRenderingCore import vtkCellPicker

        from warpdef.apps.viewer.reading import reading

        for pane, surface, renderer in zip(self.content.panes, self.surfaces, self.plotter.renderers, strict=True):
            if surface is None or not renderer.IsInViewport(x, y):
                continue
            picker = vtkCellPicker()
            picker.SetTolerance(0.0)
            picker.PickFromListOn()
            picker.AddPickList(surface.actor)
            if picker.Pick(x, y, 0.0, renderer):
                r, s, _ = picker.GetPCoords()
                weights = np.array([1.0 - r - s, r, s])
                return reading(self.content, pane, self.frame, self.look.color, picker.GetCellId(), weights)
        return ""

    def room(self, size: tuple[int, int]) -> Room:
        """What is left for the motion in a picture of that width and height; a window always keeps the bar's place."""
        if self.tile:
            return room_for(size, tile=True)
        bar = self._window or self.look.color in self.content.measures
        return room_for(size, bar=bar, scale_bar=self.look.scale_bar, slider=self._window)

    def show(self, frame: int) -> None:
        """Move everything to a frame; nothing is rendered yet."""
        self.frame = frame
        for surface, cloud in zip(self.surfaces, self.clouds, strict=True):
            if surface is not None:
                surface.show(frame, self.look)
            if cloud is not None:
                cloud.show(frame, self.look, surface)
        self._show_trails()
        self._write()

    def _write(self) -> None:
        """Titles and bars, as large as the window is now."""
        size = tuple(self.plotter.window_size)
        if self.tile:
            self.captions.put_on_tile(self.content, self.frame, size)
        else:
            self.captions.put(self.content, self.scales, self.look.color, self.frame, size, slider=self._window)
        self._follow_camera()

    def _follow_camera(self) -> None:
        """The scale bar and the edges, for where the camera stands now."""
        width, height = self.plotter.window_size
        pixels = pixels_per_length(self.plotter.renderers[0].camera.distance, height)
        for surface in self.surfaces:
            if surface is not None and self.look.wireframe:
                surface.size_edges(pixels)
        if not self.look.scale_bar or self.tile:
            self.captions.scale_bar.hide()
            return
        self.captions.put_scale(self.content, self.look.color, pixels, (width, height), slider=self._window)

    def refresh(self) -> None:
        """Show the present frame again, after the look was changed."""
        self.show(self.frame)

    def set_vertices(self, pane: int, meshes: MeshSequence) -> None:
        """New vertices for a pane that has a mesh, as from a reconstruction that still runs; then ``refresh``.

        The same actors go on; the trajectories are drawn anew.
        """
        target = self.content.panes[pane]
        target.meshes = meshes
        if target.colouring is not None:
            target.colouring.forget(meshes)
        for actor in (self.surfaces[pane], self.clouds[pane]):
            if actor is not None:
                actor.forget()
        self.scales.forget()
        if self.trails[pane] is not None:
            self.plotter.renderers[pane].remove_actor(self.trails[pane], render=False)
            self.trails[pane] = None

    def show_help(self, text: str) -> None:
        """A text over the first pane; the empty text takes it away."""
        if self._help is not None:
            self.plotter.renderers[0].remove_actor(self._help, render=False)
            self._help = None
        if text:
            self.plotter.subplot(0, 0)
            self._help = self.plotter.add_text(
                text, position="left_edge", font_size=9, color=TEXT_COLOR, font="courier"
            )

    def picture(self) -> np.ndarray:
        """What is seen, shape (height, width, 3) uint8; with a fourth channel, the opacity, in a transparent look."""
        for renderer in self.plotter.renderers:
            renderer.ResetCameraClippingRange()
        assert self.plotter.render_window is not None  # it has one until it is closed
        self.plotter.render_window.Render()
        return self._taken(self.plotter)

    def seen_aspect(self, size: tuple[int, int]) -> float:
        """Width over height of the narrowest pane that shows the motion as large as a wide one of that height does.

        A kept camera sees what it saw: its panes are as wide as the picture of ``size`` has them.
        """
        if self._kept is not None:
            return size[0] / len(self.content.panes) / size[1]
        return seen_aspect(self.content.outline, self.content.up, self.stand, self.room(size))

    def foot(self, frames: list[int], width: int, tile_height: int) -> np.ndarray | None:
        """The bars below some frames as a picture of that width, as high as they need; None without any."""
        import pyvista

        colored = self.look.color in self.content.measures
        if not colored and not self.look.scale_bar:
            return None
        letters = tile_letter_size(tile_height)
        lines = 1.0 + (BAR if colored else 0.0) + (SCALE_BAR if self.look.scale_bar else 0.0)
        size = width, math.ceil(lines * letters)
        plotter: Any = pyvista.Plotter(off_screen=True, window_size=list(size))
        try:
            plotter.set_background("white")
            if colored:
                bar = ColorBar(plotter.renderer)
                bar.put(self.scales, self.look.color, self.content.unit, frames, size, letters, 0.5 * letters)
            if self.look.scale_bar:
                pixels = pixels_per_length(self.plotter.renderers[0].camera.distance, tile_height)
                scale_bar = ScaleBar(plotter.renderer)
                scale_bar.put(pixels, self.content.unit, size, letters, (lines - SCALE_BAR) * letters, 0.2 * width)
            return self._taken(plotter)
        finally:
            plotter.close()

    def _taken(self, plotter: Any) -> np.ndarray:
        picture = plotter.screenshot(return_img=True, transparent_background=self.look.transparent)
        assert picture is not None  # None is the answer where no picture was asked for
        return without_white(picture) if self.look.transparent else picture

    def close(self) -> None:
        """Give the render window back."""
        self.plotter.close()

    def _show_trails(self) -> None:
        for index, pane in enumerate(self.content.panes):
            if self.look.trajectories and self.trails[index] is None:
                self.plotter.subplot(0, index)
                self.trails[index] = add_trails(self.plotter, pane)
            if self.trails[index] is not None:
                self.trails[index].visibility = self.look.trajectories


def without_white(picture: np.ndarray) -> np.ndarray:
    """A picture drawn on white, (H, W, 4) uint8, with the white taken out of its edges, which would shine on black."""
    import numpy as np

    share = picture[..., 3:] / 255.0
    own = (picture[..., :3] - 255.0 * (1.0 - share)) / np.maximum(share, 1e-6)
    return np.concatenate([np.rint(own.clip(0.0, 255.0)).astype(np.uint8), picture[..., 3:]], axis=2)
