"""What stands in a scene: a surface, a cloud. Made once; from frame to frame only points move."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

    from warpdef.apps.viewer.content import Pane
    from warpdef.apps.viewer.scales import Scales

from warpdef.apps.viewer.checker import REST

PLAIN, MATERIAL = "plain", "template"
_GREY, _CLOUD = "#c3c8d2", "#46566b"
_EDGE = "#3a4250"
_EDGE_OPACITY, _EDGE_PIXELS = 0.6, 12.0  # of edges that are at least so long on the picture


@dataclass
class Look:
    """What is switched on.

    color: ``plain``, ``template`` or a measure
    clim:  ends of that measure's bar; None: from the values
    cmap:  matplotlib's name of the measures' colour map; empty: the usual ones
    transparent: pictures have no background
    """

    color: str = MATERIAL
    cloud: bool = False
    trajectories: bool = False
    wireframe: bool = False
    smooth: bool = True
    clim: tuple[float, float] | None = None
    cmap: str = ""
    scale_bar: bool = False
    transparent: bool = False


class SurfaceActor:
    """One pane's mesh and its colours."""

    def __init__(self, plotter: Any, pane: Pane, scales: Scales) -> None:
        import pyvista
        from vtkmodules.vtkRenderingCore import vtkPolyDataMapper

        from warpdef.apps.viewer.checker import Checker

        self._pane, self._scales = pane, scales
        vertices, faces = self._surface(0)
        self.data = pyvista.PolyData()
        self._faces: np.ndarray | None = None
        self._painted = False
        self._fill(vertices, faces)
        self.actor = plotter.add_mesh(
            self.data, color=_GREY, scalars=None, specular=0.1, ambient=0.2, diffuse=0.9, show_scalar_bar=False
        )
        # PyVista's mapper makes one like this for itself when it first draws; the checker needs it before.
        self._mapper = vtkPolyDataMapper()
        self._mapper.SetInputData(self.data)
        self._mapper.SetScalarModeToUsePointFieldData()
        self._mapper.InterpolateScalarsBeforeMappingOn()
        self.actor.SetMapper(self._mapper)
        self._checker = Checker(self.actor, self._mapper)
        self.actor.prop.edge_color, self.actor.prop.line_width = _EDGE, 1.0
        self._edge = edge_length(vertices, faces)

    def size_edges(self, pixels_per_length: float) -> None:
        """Edges as faint as they are dense: where triangles are small, their edges would hide the surface."""
        pixels = self._edge * pixels_per_length
        self.actor.prop.edge_opacity = min(max(pixels * _EDGE_OPACITY / _EDGE_PIXELS, 0.1), _EDGE_OPACITY)

    def _surface(self, frame: int) -> tuple[np.ndarray, np.ndarray]:
        found = self._pane.surface(frame)
        assert found is not None  # a pane without meshes gets no surface
        return found

    def _fill(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        """New places for the points; new triangles only where they did change."""
        import pyvista

        if faces is not self._faces and (
            self._faces is None or faces.shape != self._faces.shape or not (faces == self._faces).all()
        ):
            self.data.copy_from(pyvista.PolyData.from_regular_faces(vertices.astype("f4"), faces))
            points = self.data.point_data
            points["Normals"], points[REST] = vertices.astype("f4"), vertices.astype("f4")
            points["rgb"], points["value"] = (vertices * 0).astype("u1"), vertices[:, 0].astype("f4")
            points.active_normals_name = "Normals"
            self._painted = False
        else:
            places: Any = self.data.points  # sliced below, which its annotation leaves out
            places[:] = vertices
        self._faces = faces

    def show(self, frame: int, look: Look) -> None:
        """The mesh of a frame in the look's colours."""
        from warpdef.export.vertex_normals import vertex_normals

        vertices, faces = self._surface(frame)
        self._fill(vertices, faces)
        if look.smooth:
            self.data.point_data["Normals"] = vertex_normals(vertices, faces)
            self.data.point_data.active_normals_name = "Normals"
        prop = self.actor.prop
        prop.show_edges = look.wireframe
        prop.interpolation = "phong" if look.smooth else "flat"
        self._paint(frame, look.color)

    def _paint(self, frame: int, color: str) -> None:
        mapper, colouring = self._mapper, self._pane.colouring
        measured = False
        if colouring is not None and color in colouring.measures:
            measured = True
            self.data.point_data["value"] = colouring.values(color, frame).astype("f4")
            table = self._scales.table(color)
            mapper.SetLookupTable(table)
            mapper.SetScalarRange(*table.scalar_range)
            mapper.SetColorModeToMapScalars()
            mapper.SelectColorArray("value")
        elif color == MATERIAL:
            if not self._painted or (self._pane.colors is not None and self._pane.colors.ndim == 3):
                self._painted = True
                self._paint_material(frame)
            mapper.SetColorModeToDirectScalars()
            mapper.SelectColorArray("rgb")
        mapper.SetScalarVisibility(measured or color == MATERIAL)
        self._checker.show(color == MATERIAL and self._pane.colors is None)
        # A number's colour must be the bar's, not a shade of it.
        self.actor.prop.lighting = not measured

    def _paint_material(self, frame: int) -> None:
        from warpdef.apps.viewer.checker import checker_places
        from warpdef.apps.viewer.colouring import material_hues

        pane = self._pane
        if pane.colors is not None:
            self.data.point_data["rgb"] = pane.colors if pane.colors.ndim == 2 else pane.colors[frame]
            return
        rest = pane.rest
        if rest is None:
            rest = self._surface(frame)[0] if pane.moving is None else pane.moving.vertices[pane.keyframe]
        self.data.point_data["rgb"], self.data.point_data[REST] = material_hues(rest), checker_places(rest)

    def forget(self) -> None:
        """The vertices are others now: colours are taken anew."""
        self._painted = False


class CloudActor:
    """One pane's input cloud; coloured by its distance to the mesh where that is what the mesh shows."""

    def __init__(self, plotter: Any, pane: Pane, scales: Scales) -> None:
        import pyvista

        assert pane.clouds is not None  # a pane without clouds gets none here
        self._clouds, self._colouring, self._scales = pane.clouds, pane.colouring, scales
        self._colors = pane.cloud_colors
        self._frames: dict[int, Any] = {}
        self._spacing = point_spacing(pane.clouds[0])
        self.actor = plotter.add_mesh(
            pyvista.PolyData(self._clouds[0].astype("f4")),
            color=_CLOUD,
            point_size=3.0,
            render_points_as_spheres=True,
            show_scalar_bar=False,
        )

    def size_points(self, pixels_per_length: float) -> None:
        """Points as large as they are apart, so that a dense cloud is no blot and a thin one is seen."""
        self.actor.prop.point_size = min(max(0.7 * self._spacing * pixels_per_length, 1.5), 6.0)

    def show(self, frame: int, look: Look, surface: SurfaceActor | None) -> None:
        """The cloud of a frame, where it is switched on or stands alone in its pane."""
        import pyvista

        self.actor.visibility = look.cloud or surface is None
        if not self.actor.visibility:
            return
        if frame not in self._frames:
            self._frames[frame] = pyvista.PolyData(self._clouds[frame].astype("f4"))
        data, mapper, colouring = self._frames[frame], self.actor.mapper, self._colouring
        measured = False
        if look.color == "error" and surface is not None and colouring is not None:
            measured = True
            data.point_data["error"] = colouring.point_errors(frame).astype("f4")
            mapper.lookup_table = self._scales.table("error")
            mapper.scalar_range = self._scales.table("error").scalar_range
            mapper.SetScalarModeToUsePointFieldData()
            mapper.SelectColorArray("error")
        own = None if self._colors is None or surface is not None else self._colors[frame]
        if own is not None:
            data.point_data["rgb"] = own
            mapper.SetScalarModeToUsePointFieldData()
            mapper.SetColorModeToDirectScalars()
            mapper.SelectColorArray("rgb")
        mapper.scalar_visibility = measured or own is not None
        mapper.SetInputDataObject(data)

    def forget(self) -> None:
        """The mesh is another now, so are the distances to it."""
        self._frames.clear()


def edge_length(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Median length of the faces' first edges, in the units of vertices (V, 3); 0 without faces."""
    import numpy as np

    ends = vertices[faces[:, :2]]
    return float(np.median(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1))) if len(faces) else 0.0


def point_spacing(points: np.ndarray, samples: int = 100) -> float:
    """Median distance of some points, shape (N, 3), to their nearest neighbour, in their units; 0 for a single one."""
    import numpy as np

    if len(points) < 2:
        return 0.0
    nearest = []
    for k in np.unique(np.linspace(0, len(points) - 1, samples).astype(int)):
        away_sq = ((points - points[k]) ** 2).sum(axis=1)
        away_sq[k] = np.inf
        nearest.append(float(away_sq.min()) ** 0.5)
    return float(np.median(nearest))
