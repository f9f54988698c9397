"""The scene: one actor a surface and one a cloud, whose points are replaced from frame to frame.

It draws into a window, into pictures and, from a running reconstruction, whatever vertices it is given meanwhile.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from warpdef.apps.view_camera import LIFT, VIEW_ANGLE, fit_camera

if TYPE_CHECKING:
    import numpy as np

    from warpdef.apps.view_content import Content, Pane
    from warpdef.colouring import Colouring
    from warpdef.mesh import MeshSequence

PLAIN, MATERIAL = "plain", "template"
TRAJECTORIES = 150
"""Vertices whose way is drawn."""
_GREY, _CLOUD, _TEXT, _UNKNOWN = "#c3c8d2", "#d1495b", "#20242c", "#9a9a9a"


@dataclass
class Look:
    """What is switched on. color: ``plain``, ``template`` or a measure."""

    color: str = MATERIAL
    cloud: bool = False
    trajectories: bool = False
    wireframe: bool = False
    smooth: bool = True


class SurfaceActor:
    """One pane's mesh, its colours, and its colour bar."""

    def __init__(self, plotter: Any, index: int, pane: Pane, unit: str) -> None:
        import pyvista

        self._index, self._pane, self._unit = index, pane, unit
        vertices, faces = pane.surface(0)
        self._data = pyvista.PolyData()
        self._faces: np.ndarray | None = None
        self._colors: np.ndarray | None = None
        self._fill(vertices, faces)
        self._data.point_data["Normals"] = vertices.astype("f4")
        self._data.point_data["rgb"] = (vertices * 0).astype("u1")
        self._data.point_data["value"] = vertices[:, 0].astype("f4")
        self._data.point_data.active_normals_name = "Normals"
        self.actor = plotter.add_mesh(
            self._data, color=_GREY, scalars=None, specular=0.1, ambient=0.2, diffuse=0.9, show_scalar_bar=False
        )
        self.actor.mapper.SetScalarModeToUsePointFieldData()
        self._bar = None
        self._plotter = plotter
        self._tables: dict[str, Any] = {}
        self._shown = ""

    def _fill(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        """New places for the points; new triangles only where they did change."""
        import pyvista

        if faces is not self._faces and (
            self._faces is None or faces.shape != self._faces.shape or not (faces == self._faces).all()
        ):
            self._data.copy_from(pyvista.PolyData.from_regular_faces(vertices.astype("f4"), faces))
            self._colors = None
        else:
            self._data.points[:] = vertices
        self._faces = faces

    def show(self, frame: int, look: Look) -> None:
        """The mesh of a frame in the look's colours."""
        from warpdef.vertex_normals import vertex_normals

        vertices, faces = self._pane.surface(frame)
        self._fill(vertices, faces)
        if look.smooth and not look.wireframe:
            self._data.point_data["Normals"] = vertex_normals(vertices, faces)
            self._data.point_data.active_normals_name = "Normals"
        prop = self.actor.prop
        prop.style = "wireframe" if look.wireframe else "surface"
        prop.interpolation = "phong" if look.smooth else "flat"
        prop.lighting = not look.wireframe
        self._paint(frame, look.color)

    def _paint(self, frame: int, color: str) -> None:
        mapper, colouring = self.actor.mapper, self._pane.colouring
        measured = colouring is not None and color in colouring.measures
        if measured:
            self._data.point_data["value"] = colouring.values(color, frame).astype("f4")
            mapper.lookup_table = self.table(color)
            mapper.scalar_range = self.table(color).scalar_range
            mapper.SetColorModeToMapScalars()
            mapper.SelectColorArray("value")
        elif color == MATERIAL:
            if self._colors is None:
                self._colors = self._material(frame)
                self._data.point_data["rgb"] = self._colors
            mapper.SetColorModeToDirectScalars()
            mapper.SelectColorArray("rgb")
        mapper.scalar_visibility = measured or color == MATERIAL
        self._show_bar(color if measured else "")

    def _material(self, frame: int) -> np.ndarray:
        from warpdef.colouring import material_colors

        if self._pane.colors is not None:
            return self._pane.colors
        moving = self._pane.moving
        return material_colors(
            self._pane.surface(frame)[0] if moving is None else moving.vertices[self._pane.keyframe]
        )

    def _show_bar(self, color: str) -> None:
        from warpdef.colouring import MEASURES

        if color == self._shown:
            return
        self._shown = color
        if self._bar is None and color:
            self._plotter.subplot(0, self._index)
            self._bar = self._plotter.add_scalar_bar(
                title=f"bar {id(self)}", mapper=self.actor.mapper, vertical=False, color=_TEXT, fmt="%.3g", n_labels=2
            )
            # Above the slider's place.
            self._bar.SetPosition(0.2, 0.075)
            self._bar.SetWidth(0.6)
            self._bar.SetHeight(0.07)
            self._bar.SetUnconstrainedFontSize(True)
            for text in (self._bar.GetTitleTextProperty(), self._bar.GetLabelTextProperty()):
                text.SetFontSize(13)
        if self._bar is not None:
            self._bar.SetVisibility(bool(color))
        if color:
            self._bar.SetLookupTable(self._tables[color])
            self._bar.SetTitle(MEASURES[color].label.format(self._unit))

    def table(self, color: str) -> Any:
        """Numbers to colours, the same in all frames."""
        if color not in self._tables:
            self._tables[color] = _lookup_table(color, self._pane.colouring)
        return self._tables[color]

    def forget(self) -> None:
        """The vertices are others now: ranges and colours are taken anew."""
        self._tables.clear()
        self._colors = None


class CloudActor:
    """One pane's input cloud; coloured by its distance to the mesh where that is what the mesh shows."""

    def __init__(self, plotter: Any, pane: Pane) -> None:
        import pyvista

        self._pane = pane
        self._frames: dict[int, Any] = {}
        self.actor = plotter.add_mesh(
            pyvista.PolyData(pane.clouds[0].astype("f4")),
            color=_CLOUD,
            point_size=4.0,
            render_points_as_spheres=True,
            show_scalar_bar=False,
        )

    def show(self, frame: int, look: Look, surface: SurfaceActor | None) -> None:
        """The cloud of a frame, where it is switched on or stands alone in its pane."""
        import pyvista

        self.actor.visibility = look.cloud or surface is None
        if not self.actor.visibility:
            return
        if frame not in self._frames:
            self._frames[frame] = pyvista.PolyData(self._pane.clouds[frame].astype("f4"))
        data, mapper, colouring = self._frames[frame], self.actor.mapper, self._pane.colouring
        measured = look.color == "error" and surface is not None and colouring is not None
        if measured:
            data.point_data["error"] = colouring.point_errors(frame).astype("f4")
            mapper.lookup_table = surface.table("error")
            mapper.scalar_range = surface.table("error").scalar_range
            mapper.SetScalarModeToUsePointFieldData()
            mapper.SelectColorArray("error")
        mapper.scalar_visibility = measured
        mapper.SetInputDataObject(data)

    def forget(self) -> None:
        """The mesh is another now, so are the distances to it."""
        self._frames.clear()


class Scene:
    """All panes of a content in one render window."""

    def __init__(self, content: Content, *, off_screen: bool, size: tuple[int, int], look: Look | None = None) -> None:
        import pyvista
        from vtkmodules.vtkCommonCore import vtkLogger

        # Without a screen VTK warns that it found none before it takes another way.
        vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_ERROR)
        self.content = content
        self.look = look or Look()
        self.frame = 0
        self.plotter = pyvista.Plotter(
            off_screen=off_screen, shape=(1, len(content.panes)), border=False, window_size=list(size)
        )
        self.surfaces: list[SurfaceActor | None] = []
        self.clouds: list[CloudActor | None] = []
        self.trails: list[Any] = [None] * len(content.panes)
        self._titles: list[Any] = []
        self._help: Any = None
        self.plotter.set_background("white")
        for index, pane in enumerate(content.panes):
            self.plotter.subplot(0, index)
            self.surfaces.append(None if pane.meshes is None else SurfaceActor(self.plotter, index, pane, content.unit))
            self.clouds.append(None if pane.clouds is None else CloudActor(self.plotter, pane))
            self._titles.append(self.plotter.add_text(" ", position="upper_left", font_size=9, color=_TEXT))
        if len(content.panes) > 1:
            self.plotter.link_views()
        self.place_camera()
        self.show(0)

    def place_camera(self, turn: float = 0.0, all_round: bool = False) -> None:
        """Stand where the whole motion is seen, ``turn`` degrees about the up axis from the usual place."""
        width, height = self.plotter.window_size
        placed = fit_camera(
            self.content.bounds,
            self.content.up,
            width / len(self.content.panes) / height,
            turn=turn,
            all_round=all_round,
        )
        for renderer in self.plotter.renderers:
            camera = renderer.camera
            camera.view_angle = VIEW_ANGLE
            camera.SetWindowCenter(0.0, -LIFT)
            camera.position, camera.focal_point, camera.up = placed.position, placed.focus, placed.up
            renderer.camera_set = True
            renderer.ResetCameraClippingRange()

    def show(self, frame: int) -> None:
        """Move everything to a frame; nothing is rendered yet."""
        self.frame = frame
        for pane, surface, cloud, title in zip(
            self.content.panes, self.surfaces, self.clouds, self._titles, strict=True
        ):
            if surface is not None:
                surface.show(frame, self.look)
            if cloud is not None:
                cloud.show(frame, self.look, surface)
            title.SetText(2, f"{pane.title}\nframe {frame} of {len(self.content)}: {self.content.names[frame]}")
        self._show_trails()

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
            self._help = self.plotter.add_text(text, position="left_edge", font_size=9, color=_TEXT, font="courier")

    def picture(self) -> np.ndarray:
        """What is seen, shape (height, width, 3) uint8."""
        for renderer in self.plotter.renderers:
            renderer.ResetCameraClippingRange()
        self.plotter.render_window.Render()
        return self.plotter.screenshot(return_img=True)

    def close(self) -> None:
        """Give the render window back."""
        self.plotter.close()

    def _show_trails(self) -> None:
        import numpy as np
        import pyvista

        from warpdef.colouring import material_colors, spread_out_vertices

        for index, pane in enumerate(self.content.panes):
            if self.look.trajectories and self.trails[index] is None and pane.moving is not None and len(self.content) > 1:
                vertices = pane.moving.vertices
                at_keyframe = vertices[pane.keyframe]
                chosen = spread_out_vertices(at_keyframe, TRAJECTORIES)
                count, length = len(chosen), len(vertices)
                points = vertices[:, chosen].transpose(1, 0, 2).reshape(-1, 3).astype("f4")
                ways = np.column_stack([np.full(count, length), np.arange(count * length).reshape(count, length)])
                lines = pyvista.PolyData(points, lines=ways.ravel())
                colors = material_colors(at_keyframe) if pane.colors is None else pane.colors
                lines.point_data["rgb"] = np.repeat(colors[chosen], length, axis=0)
                self.plotter.subplot(0, index)
                self.trails[index] = self.plotter.add_mesh(
                    lines, scalars="rgb", rgb=True, line_width=2.0, lighting=False, reset_camera=False
                )
            if self.trails[index] is not None:
                self.trails[index].visibility = self.look.trajectories


def _lookup_table(color: str, colouring: Colouring) -> Any:
    import pyvista

    from warpdef.colouring import MEASURES

    table = pyvista.LookupTable("coolwarm" if MEASURES[color].diverging else "viridis", n_values=256)
    table.scalar_range = colouring.limits(color)
    table.nan_color = _UNKNOWN
    return table
