"""Two libraries that turn oriented points into a closed surface with even triangles: gpytoolbox and pymeshlab.

gpytoolbox is the default: it needs no system library, is single-threaded and so repeats itself to the last bit, and its
triangles are better. pymeshlab runs on one thread here for the same reason.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from warpdef.errors import ConfigError, MissingPackageError

GPYTOOLBOX_REMESH_ITERATIONS = 5  # triangle quality 0.982, after 10 iterations 0.985
PYMESHLAB_REMESH_ITERATIONS = 10
_PYMESHLAB_FILTERS = (
    "generate_surface_reconstruction_screened_poisson",
    "meshing_isotropic_explicit_remeshing",
)

Mesh = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Backend:
    """What the template needs from a library.

    name:    ``gpytoolbox`` or ``pymeshlab``
    poisson: screened Poisson reconstruction (Kazhdan and Hoppe 2013):
             points (N, 3), outward normals (N, 3), depth, screening -> vertices (V, 3), faces (F, 3)
    remesh:  even triangles (Botsch and Kobbelt 2004): vertices, faces, edge length -> vertices, faces
    """

    name: str
    poisson: Callable[[np.ndarray, np.ndarray, int, float], Mesh]
    remesh: Callable[[np.ndarray, np.ndarray, float], Mesh]


def load_backend(name: str) -> Backend:
    """The backend of that name; ``auto`` takes gpytoolbox where it is installed, else pymeshlab.

    Raises:
        MissingPackageError: the library, or a system library that it needs, is not there.
        ConfigError: an unknown name.
    """
    if name == "gpytoolbox":
        return _load_gpytoolbox()
    if name == "pymeshlab":
        return _load_pymeshlab()
    if name != "auto":
        raise ConfigError(f"configuration: template.backend: expected auto, gpytoolbox or pymeshlab, got {name!r}")
    try:
        return _load_gpytoolbox()
    except MissingPackageError as missing:
        try:
            return _load_pymeshlab()
        except MissingPackageError as also_missing:
            raise MissingPackageError(f"{missing} Nor can pymeshlab be used: {also_missing}") from also_missing


def _load_gpytoolbox() -> Backend:
    try:
        import gpytoolbox_bindings  # noqa: F401 - its functions import it late and then hide why that failed
        from gpytoolbox import point_cloud_to_mesh, remesh_botsch
    except ImportError as error:
        raise MissingPackageError(
            f"the template needs gpytoolbox, which does not import ({error}); "
            "pip install gpytoolbox, or give a mesh of your own with --template."
        ) from error

    def poisson(points: np.ndarray, normals: np.ndarray, depth: int, screening: float) -> Mesh:
        vertices, faces = point_cloud_to_mesh(points, normals, psr_screening_weight=screening, psr_depth=depth)
        return np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int32)

    def remesh(vertices: np.ndarray, faces: np.ndarray, edge_length: float) -> Mesh:
        vertices, faces = remesh_botsch(vertices, faces, GPYTOOLBOX_REMESH_ITERATIONS, edge_length, True)
        return np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int32)

    return Backend("gpytoolbox", poisson, remesh)


def _load_pymeshlab() -> Backend:
    advice = (
        "on Debian or Ubuntu: apt install libgl1 libopengl0; or set template.backend to gpytoolbox, "
        "which needs no OpenGL."
    )
    try:
        import pymeshlab
    except ImportError as error:
        raise MissingPackageError(f"pymeshlab does not import ({error}); pip install pymeshlab and {advice}") from error
    # Without libOpenGL whole plugins are skipped with no more than a warning.
    missing = [f for f in _PYMESHLAB_FILTERS if f not in pymeshlab.filter_list()]
    if missing:
        raise MissingPackageError(f"pymeshlab came up without {', '.join(missing)}; {advice}")

    def poisson(points: np.ndarray, normals: np.ndarray, depth: int, screening: float) -> Mesh:
        meshes = pymeshlab.MeshSet(verbose=False)
        meshes.add_mesh(pymeshlab.Mesh(vertex_matrix=points, v_normals_matrix=normals))
        meshes.generate_surface_reconstruction_screened_poisson(depth=depth, pointweight=screening, threads=1)
        return _taken(meshes)

    def remesh(vertices: np.ndarray, faces: np.ndarray, edge_length: float) -> Mesh:
        meshes = pymeshlab.MeshSet(verbose=False)
        meshes.add_mesh(pymeshlab.Mesh(vertex_matrix=vertices, face_matrix=faces))
        meshes.meshing_isotropic_explicit_remeshing(
            iterations=PYMESHLAB_REMESH_ITERATIONS, targetlen=pymeshlab.PureValue(edge_length)
        )
        return _taken(meshes)

    def _taken(meshes) -> Mesh:
        mesh = meshes.current_mesh()
        return np.array(mesh.vertex_matrix(), dtype=np.float64), np.array(mesh.face_matrix(), dtype=np.int32)

    return Backend("pymeshlab", poisson, remesh)
