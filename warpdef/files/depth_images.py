"""Depth images as clouds: an .npz of ``depth`` and what the camera was.

- ``depth`` (T, H, W), or (T, C, H, W) of C cameras: distance along the optical axis, 0 or NaN where nothing was seen;
- ``intrinsics`` (3, 3), or (4,) as fx, fy, cx, cy, in pixels; of each camera, (C, 3, 3), or image, where they differ;
- ``poses`` (4, 4), camera to world (x right, y down, z ahead), of each camera or image; without them one camera stands;
- ``depth_scale``, what a unit of depth is in the units of the result, 0.001 for millimetres as metres;
- ``colors`` (..., H, W, 3) and ``valid`` (..., H, W), as images of the same size.

An .npz of one frame, of a folder of them, holds the same without T.
"""

from __future__ import annotations

import numpy as np

from warpdef.cloud import FramePoints
from warpdef.errors import InputError
from warpdef.files.numpy_files import Npz, row
from warpdef.files.point_masks import VALID_NAMES, read_valid

DEPTH_NAMES = ("depth", "depths", "depth_images")
INTRINSICS_NAMES = ("intrinsics", "K", "camera_matrix")
POSE_NAMES = ("poses", "pose", "camera_to_world", "cam2world", "c2w")
_INVERSE_NAMES = ("extrinsics", "extrinsic", "world_to_camera", "world2cam", "w2c")
_WHAT = "intrinsics (3, 3) and, where the camera moves or there are several, poses (4, 4) from camera to world"


def points_of_depth(depth: np.ndarray, intrinsics: np.ndarray, pose: np.ndarray | None = None) -> np.ndarray:
    """The points that a pinhole camera saw, a row for each pixel with a finite depth above 0.

    Args:
        depth: distance along the optical axis, shape (H, W); its unit is that of the points.
        intrinsics: [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] in pixels, or (fx, fy, cx, cy).
        pose: camera to world, shape (4, 4), its translation in the unit of the depth; None: the camera's own frame,
            x right, y down, z ahead.

    Returns:
        Shape (N, 3) float64, row by row of the image.

    Raises:
        InputError: other shapes, or focal lengths that are not above 0.
    """
    depth = np.asarray(depth)
    if depth.ndim != 2 or depth.dtype.kind not in "fiu":
        raise InputError(f"depth: expected an image of numbers, shape (H, W), got {depth.shape} {depth.dtype}")
    return _points_at(depth, seen(depth), intrinsics, pose)


def seen(depth: np.ndarray) -> np.ndarray:
    """Pixels with a finite depth above 0, same shape."""
    return np.isfinite(depth) & (depth > 0)


def _points_at(depth: np.ndarray, pixels: np.ndarray, intrinsics: np.ndarray, pose: np.ndarray | None) -> np.ndarray:
    fx, fy, cx, cy = _four(np.asarray(intrinsics, dtype=np.float64))
    v, u = np.nonzero(pixels)
    z = depth[v, u].astype(np.float64)
    points = np.stack([(u - cx) / fx * z, (v - cy) / fy * z, z], axis=1)
    if pose is None:
        return points
    pose = np.asarray(pose, dtype=np.float64)
    if pose.shape != (4, 4) or not np.allclose(pose[3], (0, 0, 0, 1)):
        raise InputError(f"pose: expected a matrix (4, 4) with the last row 0 0 0 1, got {pose.shape}; transpose it?")
    return points @ pose[:3, :3].T + pose[:3, 3]


def _four(k: np.ndarray) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy."""
    if k.shape == (3, 3):
        k = np.array([k[0, 0], k[1, 1], k[0, 2], k[1, 2]])
    if k.shape != (4,) or not np.isfinite(k).all() or not (k[:2] > 0).all():
        raise InputError(
            f"intrinsics: expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] or fx, fy, cx, cy, with focal lengths in "
            f"pixels above 0, got {np.array2string(k.reshape(-1)[:9], precision=4)}"
        )
    return float(k[0]), float(k[1]), float(k[2]), float(k[3])


class DepthArchive:
    """The depth images of an .npz; ``cloud(t)`` gives the points of a frame, of all its cameras together.

    ``single``: they are those of one frame, (H, W), or (C, H, W) of C cameras.

    Raises:
        InputError: no intrinsics, or shapes that do not fit together.
    """

    def __init__(self, npz: Npz, colors: np.ndarray | None, single: bool = False) -> None:
        self.name = _held(npz, DEPTH_NAMES)
        depth, where = npz.array(self.name), f"{npz.path}: {self.name}"
        if single:
            depth, colors = depth[None], None if colors is None else colors[None]
        if depth.ndim not in (3, 4):
            shapes = ("(H, W)", "(C, H, W)") if single else ("(T, H, W)", "(T, C, H, W)")
            got = depth.shape[1:] if single else depth.shape
            raise InputError(f"{where}: expected shape {shapes[0]}, or {shapes[1]} of C cameras, got {got}")
        lead, image = depth.shape[:-2], depth.shape[-2:]
        name = _held(npz, INTRINSICS_NAMES)
        if not name:
            raise InputError(f"{where}: expected beside it {_WHAT}, got {', '.join(npz.names)[:120]}; add them")
        k = npz.array(name)
        tail = (3, 3) if k.shape[-2:] == (3, 3) else (4,)
        self.intrinsics = _spread(k, lead, tail, f"{npz.path}: {name}")
        name = _held(npz, POSE_NAMES)
        turned = next((n for n in npz.names if n.lower() in _INVERSE_NAMES), "")
        if not name and turned:
            raise InputError(
                f"{npz.path}: expected poses from camera to world, got '{turned}', which may be either way; save "
                f"them as poses, np.linalg.inv({turned}) if they are from world to camera"
            )
        if not name and len(lead) == 2 and lead[1] > 1:
            raise InputError(f"{where}: expected the poses of {lead[1]} cameras beside it; add poses (C, 4, 4)")
        self.poses = _spread(npz.array(name), lead, (4, 4), f"{npz.path}: {name}") if name else None
        scale = npz.array("depth_scale") if "depth_scale" in npz else np.ones(())
        if scale.size != 1 or not 0 < float(scale.reshape(())) < np.inf:
            raise InputError(f"{npz.path}: depth_scale: expected one number above 0, got {scale.reshape(-1)[:4]}")
        if colors is not None and (colors.shape[:-1] != depth.shape or colors.shape[-1] not in (3, 4)):
            raise InputError(f"{npz.path}: colours: expected shape {(*depth.shape, 3)}, got {colors.shape}")
        self.depth, self.scale, self.colors = depth, float(scale.reshape(())), colors
        self.valid = read_valid(npz, VALID_NAMES, [depth.shape, image, *([depth.shape[1:]] if single else [])])
        if self.valid is not None and single and self.valid.shape == depth.shape[1:]:
            self.valid = self.valid[None]

    def __len__(self) -> int:
        return len(self.depth)

    @property
    def used(self) -> tuple[str, ...]:
        """Names of arrays that belong to depth images."""
        return (*DEPTH_NAMES, *INTRINSICS_NAMES, *POSE_NAMES, "depth_scale")

    def cloud(self, t: int) -> FramePoints:
        """The points of frame t, and their colours."""
        depth = _cameras(row(self.depth, t))
        colors = None if self.colors is None else row(self.colors, t)
        points, shades = [], []
        for c, image in enumerate(depth):
            at = (t, c)[: self.depth.ndim - 2]
            pixels = seen(image)
            if self.valid is not None:
                pixels &= self.valid if self.valid.ndim == 2 else self.valid[at]
            pose = None if self.poses is None else self.poses[at]
            # The images are scaled, not the points: a pose is in the units of the result already.
            points.append(_points_at(image * self.scale, pixels, self.intrinsics[at], pose))
            if colors is not None:
                shades.append((colors if colors.ndim == 3 else colors[c])[pixels])
        return FramePoints(np.concatenate(points), None, np.concatenate(shades) if shades else None)


def _cameras(depth: np.ndarray) -> np.ndarray:
    return depth[None] if depth.ndim == 2 else depth


def _held(npz: Npz, names: tuple[str, ...]) -> str:
    return next((name for name in names if name in npz), "")


def _spread(array: np.ndarray, lead: tuple[int, ...], tail: tuple[int, ...], where: str) -> np.ndarray:
    """One value for all images, one a camera or one an image, as one an image."""
    try:
        if array.shape[array.ndim - len(tail) :] != tail:
            raise ValueError
        return np.broadcast_to(array, lead + tail)
    except ValueError:
        raise InputError(
            f"{where}: expected shape {tail}, or one for each of the images, {lead + tail}, got {array.shape}"
        ) from None
