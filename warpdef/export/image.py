"""The image of a texture beside an export: under a name of its own, so that an export replaces nobody else's image."""

from __future__ import annotations

import re
from pathlib import Path

from warpdef.texture import Texture

LIBRARY = "warpdef_texture.mtl"
"""Name of the material file in a folder of OBJ files."""

MATERIAL = "warpdef_texture"
"""Name of the material in it."""

_OURS = re.compile(r"(.+_)?warpdef_texture\.(mtl|png|jpg)")


def image_name(texture: Texture, beside: Path | None = None) -> str:
    """What the image is called: in a folder ``warpdef_texture.png``; beside a file that begins with ``walk_usdc_``."""
    start = "" if beside is None else f"{beside.stem}_{beside.suffix[1:]}_"
    return f"{start}warpdef_texture.{texture.kind}"


def is_image_of_export(name: str) -> bool:
    """Whether a file called so belongs to an export."""
    return _OURS.fullmatch(name) is not None


def write_library(texture: Texture, folder: Path) -> None:
    """Put the image and a material file of it into ``folder``."""
    name = image_name(texture)
    (folder / name).write_bytes(texture.data)
    lines = ["# warpdef", f"newmtl {MATERIAL}", "Kd 1 1 1", "Ks 0 0 0", "illum 1", f"map_Kd {name}", ""]
    (folder / LIBRARY).write_text("\n".join(lines), encoding="ascii", newline="\n")
