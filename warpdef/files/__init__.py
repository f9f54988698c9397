"""Everything that is read from or written to disk, in one place to import from.

Behind it: ``cloud_files`` and ``mesh_files`` (sequences), ``frame_files`` (numbered files), ``formats`` (the table of
suffixes), ``ply``, ``text_formats``, ``numpy_files``, ``pcd``, ``las`` and so on (its formats), ``cloud_archives`` with
``point_masks`` and ``depth_images`` (files of all frames), ``texture`` and ``texture_colors``, ``disk`` (bytes).
Results live in ``run_folder`` and come back by ``saved_run``, the configuration in ``config_file``.
"""

from warpdef.files.cloud_files import read_clouds, write_clouds_npz
from warpdef.files.mesh_files import read_geometry, read_mesh, read_mesh_frames, read_mesh_sequence, same_triangles
from warpdef.files.ply import write_ply

__all__ = [
    "read_clouds",
    "read_geometry",
    "read_mesh",
    "read_mesh_frames",
    "read_mesh_sequence",
    "same_triangles",
    "write_clouds_npz",
    "write_ply",
]
