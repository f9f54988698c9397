"""Meshes as frames: their vertices are points where they cover the surface evenly, else points are drawn from it."""

from __future__ import annotations

import zlib

import numpy as np

from warpdef.cloud import FramePoints
from warpdef.files.surface import Surface
from warpdef.files.texture_colors import colors_at, uv_of_places, uv_of_vertices
from warpdef.geometry.sampling import sample_surface
from warpdef.geometry.triangles import face_areas, is_watertight, signed_volume
from warpdef.mesh import check_faces

POINTS_LEAST = 5000  # drawn
VERTICES_LEAST = 1000
EVEN = 0.25  # of the vertices: as many of equal share of the surface would do as well
IN_USE = 0.9  # of the vertices: with fewer it is a cloud with some faces


def is_even(surface: Surface) -> bool:
    """Whether the vertices of a surface with faces would do as a cloud of it: enough, of like shares of its area.

    Vertices with areas a are worth (sum a)^2 / sum a^2 of equal ones.
    """
    points, faces = surface.points, surface.faces
    if faces is None or not len(faces) or not np.isfinite(points).all():
        return True
    used = np.zeros(len(points), dtype=bool)
    used[faces] = True
    if used.mean() < IN_USE:
        return True
    if len(points) < VERTICES_LEAST:
        return False
    areas = np.bincount(faces.ravel(), np.repeat(face_areas(points, faces), 3), len(points))
    squares = float((areas**2).sum())
    return not squares > 0 or float(areas.sum()) ** 2 / squares >= EVEN * len(points)


def cloud_of(surface: Surface, name: str, pixels: np.ndarray | None = None) -> tuple[FramePoints, bool]:
    """Points, normals and colours of one frame, and whether they were drawn from its faces.

    Args:
        name: of the frame, which the draw depends on, so that frames share no places.
        pixels: its texture image (H, W, 3), whose colours its points take where they have none of their own.

    Raises:
        InputError: a face names a point that is not there.
    """
    faces = surface.faces
    if faces is not None and len(faces):
        faces = check_faces(faces, len(surface.points), name)
    if faces is None or is_even(surface):
        colors = surface.colors
        if colors is None and pixels is not None and faces is not None:
            uv = uv_of_vertices(surface.uv, surface.corner_uv, faces, len(surface.points))
            colors = None if uv is None else colors_at(pixels, uv)
        return FramePoints(surface.points, surface.normals, colors), False
    rng = np.random.default_rng(zlib.crc32(name.encode()))
    points, normals, face, weights = sample_surface(surface.points, faces, max(POINTS_LEAST, len(surface.points)), rng)
    colors = surface.colors
    if colors is not None:
        mixed = np.einsum("nk,nkc->nc", weights, colors[faces[face], :3].astype(np.float64))
        colors = np.rint(mixed).astype(np.uint8)
    elif pixels is not None:
        uv = uv_of_places(surface, face, weights)
        colors = None if uv is None else colors_at(pixels, uv)
    outward = normals * np.sign(signed_volume(surface.points, faces)) if is_watertight(faces) else None
    return FramePoints(points, outward, colors), True
