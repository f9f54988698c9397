"""The material of a mesh in USD: a UsdPreviewSurface, coloured as the .glb is."""

from __future__ import annotations

from typing import Any

from warpdef.export.animation import ROUGHNESS, Animation


def bind_material(stage: Any, animation: Animation, image: str | None) -> None:
    """Give ``/warpdef/mesh`` a material: its image, else its ``displayColor``, else the grey of all exports.

    Without a bound material that reads them, programs show vertex colours in their viewport at best.

    Args:
        stage: holds the mesh already.
        image: file name of the texture's image beside the file, read by ``st``; None where there is none.
    """
    from pxr import UsdShade

    types, shaders = _types(), _Shaders(stage)
    surface = shaders.define("surface", "UsdPreviewSurface")
    surface.CreateInput("roughness", types.Float).Set(ROUGHNESS)
    surface.CreateInput("metallic", types.Float).Set(0.0)
    color = surface.CreateInput("diffuseColor", types.Color3f)
    if image is not None:
        color.ConnectToSource(_image_reader(shaders, image))
    elif animation.colors is not None or animation.measured is not None:
        reader = shaders.define("colors", "UsdPrimvarReader_float3")
        reader.CreateInput("varname", types.String).Set("displayColor")
        color.ConnectToSource(reader.CreateOutput("result", types.Float3))
    else:
        color.Set(animation.base_color)
    shaders.material.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", types.Token))
    UsdShade.MaterialBindingAPI.Apply(stage.GetPrimAtPath("/warpdef/mesh")).Bind(shaders.material)


class _Shaders:
    """A material, and shaders made in it."""

    def __init__(self, stage: Any) -> None:
        from pxr import UsdShade

        self._stage = stage
        self.material = UsdShade.Material.Define(stage, "/warpdef/material")

    def define(self, name: str, kind: str) -> Any:
        from pxr import UsdShade

        shader = UsdShade.Shader.Define(self._stage, f"/warpdef/material/{name}")
        shader.CreateIdAttr(kind)
        return shader


def _types() -> Any:
    from pxr import Sdf

    return Sdf.ValueTypeNames


def _image_reader(shaders: _Shaders, image: str) -> Any:
    """The output of a shader that reads an image by the mesh's texture coordinates."""
    from pxr import Sdf

    types = _types()
    reader = shaders.define("coordinates", "UsdPrimvarReader_float2")
    reader.CreateInput("varname", types.String).Set("st")
    texture = shaders.define("texture", "UsdUVTexture")
    texture.CreateInput("file", types.Asset).Set(Sdf.AssetPath(f"./{image}"))
    texture.CreateInput("sourceColorSpace", types.Token).Set("sRGB")
    for wrap in ("wrapS", "wrapT"):
        texture.CreateInput(wrap, types.Token).Set("repeat")
    texture.CreateInput("st", types.Float2).ConnectToSource(reader.CreateOutput("result", types.Float2))
    return texture.CreateOutput("rgb", types.Float3)
