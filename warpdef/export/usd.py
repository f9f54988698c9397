"""A moving mesh as USD: points and extent as time samples of one mesh."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from warpdef.errors import InputError, MissingPackageError
from warpdef.export.animation import Animation, linear_colors
from warpdef.export.image import image_name
from warpdef.export.usd_material import bind_material


def write_usd(animation: Animation, path: Path) -> None:
    """Write .usd, .usda, .usdc or .usdz by the suffix of ``path``.

    Time codes are frame numbers from 0. Triangles are shaded smoothly by the normals of every frame. Colours go to
    ``displayColor`` (linear), which the material reads, and ``displayOpacity``; a measure's and those of every
    frame are time samples. Texture coordinates go to ``primvars:st``, by the faces' corners where it has seams.
    Data far from its origin stands there by a translation of the parent. A texture's image is a file beside it,
    ``walk_usdc_warpdef_texture.png``; a .usdz holds it itself.

    Raises:
        MissingPackageError: usd-core is not installed.
        InputError: the file could not be written.
    """
    try:
        from pxr import Tf, Usd, UsdUtils
    except ImportError as error:
        raise MissingPackageError(
            f"{path.suffix} needs usd-core ({error}); install it: pip install 'warpdef[usd]'"
        ) from error
    packed = path.suffix == ".usdz"
    layer = path.with_name("scene.usdc") if packed else path
    image = None
    if animation.texture is not None:
        image = path.with_name(image_name(animation.texture, path))
        image.write_bytes(animation.texture.data)
    try:
        stage = Usd.Stage.CreateNew(str(layer))
        _fill(stage, animation)
        bind_material(stage, animation, None if image is None else image.name)
        stage.GetRootLayer().Save()
        if packed:
            done = UsdUtils.CreateNewUsdzPackage(str(layer), str(path))
            layer.unlink()
            if image is not None:
                image.unlink()
            if not done:
                raise InputError(f"{path.name}: the package could not be written; try .usdc")
    except Tf.ErrorException as error:
        raise InputError(
            f"{path.name}: cannot be written ({error!s:.200}); choose another place or free space"
        ) from None


def _fill(stage: Any, dressed: Animation) -> None:
    from pxr import Gf, Sdf, UsdGeom, Vt

    animation = dressed.joined
    UsdGeom.SetStageUpAxis(stage, {"y": UsdGeom.Tokens.y, "z": UsdGeom.Tokens.z}[animation.up])
    UsdGeom.SetStageMetersPerUnit(stage, animation.metres_per_unit)
    stage.SetTimeCodesPerSecond(animation.fps)
    stage.SetFramesPerSecond(animation.fps)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(len(animation) - 1)
    root = UsdGeom.Xform.Define(stage, "/warpdef")
    stage.SetDefaultPrim(root.GetPrim())
    if animation.is_far:
        root.AddTranslateOp().Set(Gf.Vec3d(*animation.origin.tolist()))
    mesh = UsdGeom.Mesh.Define(stage, "/warpdef/mesh")
    # Triangles as they are, not a cage for subdivision.
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateDoubleSidedAttr(True)
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(animation.faces), 3, dtype=np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(animation.faces.reshape(-1)))
    points, extent = mesh.CreatePointsAttr(), mesh.CreateExtentAttr()
    normals = mesh.CreateNormalsAttr()
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    moving = None
    if animation.moving_colors is not None:
        moving = mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex)
    for frame, positions in enumerate(animation.vertices):
        points.Set(Vt.Vec3fArray.FromNumpy(positions), frame)
        if moving is not None and animation.moving_colors is not None:
            shade = linear_colors(animation.moving_colors[frame]).astype(np.float32)
            moving.Set(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(shade)), frame)
        normals.Set(Vt.Vec3fArray.FromNumpy(animation.normals_of(frame)), frame)
        corners = [Gf.Vec3f(*map(float, corner)) for corner in (positions.min(axis=0), positions.max(axis=0))]
        extent.Set(Vt.Vec3fArray(corners), frame)
    if animation.colors is not None and moving is None:
        light = linear_colors(animation.colors).astype(np.float32)
        color = mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex)
        color.Set(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(light[:, :3])))
        if light.shape[1] == 4:
            opacity = mesh.CreateDisplayOpacityPrimvar(UsdGeom.Tokens.vertex)
            opacity.Set(Vt.FloatArray.FromNumpy(np.ascontiguousarray(light[:, 3])))
    if dressed.uv is not None:
        kind = Sdf.ValueTypeNames.TexCoord2fArray
        by, uv = UsdGeom.Tokens.vertex, dressed.uv
        if dressed.copies is not None:
            by, uv = UsdGeom.Tokens.faceVarying, np.ascontiguousarray(uv[dressed.faces].reshape(-1, 2))
        st = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", kind, by)
        st.Set(Vt.Vec2fArray.FromNumpy(uv))
