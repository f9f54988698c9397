"""The image that a mesh file names, found and read.

A mesh may come from anywhere, and what it names is later copied into results that are handed on. So a name leads
nowhere but into the folder of the mesh file and the folders in it. Of a name that leads elsewhere, absolute, by ``..``
or on another computer, only the last part counts: the image is looked for beside the mesh. Nothing is fetched. Links
are followed, as for every file that is read. A mesh without its image is still a mesh: what cannot be used becomes a
note, not an error.
"""

from __future__ import annotations

import os
import posixpath
import re
from pathlib import Path

from warpdef.errors import InputError
from warpdef.files.disk import reason
from warpdef.files.surface import NamedImages
from warpdef.texture import Texture

TEXTURE_MAX = 128 << 20
"""Bytes of the largest image that is read."""

_LIBRARY_MAX = 16 << 20
# What may stand between ``map_Kd`` and the name; -o and -s move and scale the image.
_OPTION = re.compile(r"-(?!o\s|s\s)(mm\s+\S+\s+\S+|t(\s+[-+.\deE]+(?=\s)){1,3}|[A-Za-z]+\s+\S+)\s+")
_PLACED = re.compile(r"-[os]\s")


class _Unusable(Exception):
    """Why an image is left out, as the end of a sentence."""


def read_texture(path: Path, named: NamedImages) -> tuple[Texture | None, tuple[str, ...]]:
    """The image of a mesh, if its file names one, and only one.

    Args:
        path: the mesh file.
        named: what it names.

    Returns:
        The image or None, and, where one is named but cannot be used, a line that says why.
    """
    try:
        images = [(name, "") for name in named.images] or _images_of_materials(path.parent, named)
        images = list(dict.fromkeys(images))
        if not images:
            return None, ()
        if len(images) > 1:
            shown = ", ".join(_shown(name) for name, _ in images[:3])
            raise _Unusable(f"names {len(images)} images ({shown}), of which a result holds one; bake them into one")
        return _read_image(path.parent, *images[0]), ()
    except _Unusable as why:
        return None, (f"{path}: goes on without its texture image: it {why}",)


def read_texture_file(path: Path) -> Texture:
    """An image file by its own name.

    Raises:
        InputError: not there, not readable, too large, neither PNG nor JPEG, or damaged.
    """
    try:
        data = _read(path, TEXTURE_MAX)
        return Texture.from_bytes(data)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({reason(error)})") from None
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _read_image(folder: Path, name: str, base: str) -> Texture:
    place = _find(folder, name, base)
    if place is None:
        raise _Unusable(f"names {_shown(name)}, which is not in its folder; put the image beside it")
    try:
        return read_texture_file(place)
    except InputError as error:
        raise _Unusable(f"names {_shown(name)}: {error}") from None


def _images_of_materials(folder: Path, named: NamedImages) -> list[tuple[str, str]]:
    """Images of the materials used, each with the folder of its library, counted from the mesh's."""
    found: dict[str, tuple[str, str]] = {}
    read: set[str] = set()
    for line in named.libraries:
        # A name may hold blanks, and a line several names.
        for library in [line] if _find(folder, line) else line.split():
            place = _find(folder, library)
            if place is None:
                raise _Unusable(f"names the material file {_shown(library)}, which is not in its folder")
            within = os.path.relpath(place, folder)
            if within in read:
                continue
            read.add(within)
            try:
                text = _read(place, _LIBRARY_MAX)
            except (OSError, InputError) as error:
                raise _Unusable(f"names the material file {_shown(library)}: {reason(error)}") from None
            base = posixpath.dirname(within.replace(os.sep, "/"))
            for material, image in _parse_library(text).items():
                found.setdefault(material, (image, base))
    # Writers of one material leave out to name it.
    used = [found.get(name) for name in named.materials] if named.materials else list(found.values())
    images = [image for image in used if image is not None]
    for image, _ in images:
        if _PLACED.match(image):
            raise _Unusable("places the image by -o or -s, which is not supported; put that into the coordinates")
    return images


def _parse_library(text: bytes) -> dict[str, str]:
    """Images by material of an .mtl file, of ``map_Kd``; materials without one are left out."""
    images: dict[str, str] = {}
    material = ""
    for line in os.fsdecode(text).replace("\\\n", " ").replace("\\\r\n", " ").splitlines():
        word, _, rest = line.replace("\t", " ").strip().partition(" ")
        rest = rest.strip()
        if word == "newmtl":
            material = rest
        elif word.lower() == "map_kd" and rest:
            at = 0
            while option := _OPTION.match(rest, at):
                at = option.end()
            images.setdefault(material, rest[at:].strip('"'))
    return images


def _find(folder: Path, name: str, base: str = "") -> Path | None:
    """A file named in another one, in ``folder`` or below; ``base``: folder below it that the name may count from."""
    name = name.replace("\\", "/")
    places = []
    if not name.startswith("/") and not re.match("[A-Za-z]:", name):
        within = [posixpath.normpath(posixpath.join(start, name)) for start in (base, "")]
        places += [place for place in within if place != ".." and not place.startswith("../")]
    last = re.split("[/:]", name)[-1]
    places += [posixpath.join(base, last), last] if last not in ("", ".", "..") else []
    return next((folder / place for place in places if os.path.isfile(folder / place)), None)


def _read(path: Path, limit: int) -> bytes:
    with open(path, "rb") as stream:
        data = stream.read(limit + 1)
    if len(data) > limit:
        raise InputError(f"expected at most {limit >> 20} MiB, got more; make it smaller")
    return data


def _shown(name: str) -> str:
    name = "".join(letter if letter.isprintable() else "?" for letter in name[:61])
    return f"'{name if len(name) <= 60 else name[:57] + '...'}'"
