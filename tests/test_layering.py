"""Imports point one way: apps -> warpdef -> kernels, and inside warpdef/ from the upper floors to the lower ones.

Read from the source, so that no import has to run; those inside functions and for type checkers alone count as well.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from warpdef.apps.main import COMMANDS

ROOT = Path(__file__).resolve().parents[1]
FLOORS = {"warpdef": "warpdef", "kernels": "warpdef.kernels", "apps": "warpdef.apps"}
HEAVY = {"warp", "numpy", "scipy", "trimesh", "pymeshlab", "gpytoolbox", "pyvista", "matplotlib"}
KERNELS_MAY_IMPORT = set(sys.stdlib_module_names) | {"warp", "numpy"}
APPS_ON_KERNELS = "warpdef.apps.benchmark"
MAIN = "warpdef.__main__"
"""``python -m warpdef``: a door to the command that Python wants beside the library. It counts as one of the apps."""

FLOORS_INSIDE = (
    ("errors", "kernel_cache"),
    ("config_values", "device"),
    ("config_grids", "config_refine", "config_template"),
    ("cloud", "config", "geometry", "texture", "transitions"),
    ("appearance", "presets", "sequence"),
    ("cleaning", "mesh"),
    ("motion", "progress", "quality", "rig", "template", "vertex_measures"),
    ("result",),
    ("files",),
    ("datasets", "export", "fit", "truth"),
    ("memory",),
    ("shortage",),
    ("cube_clouds", "prepare"),
    ("reports", "starting_template"),
    ("pipeline", "run_clouds"),
)
"""Rooms of warpdef/, a file or a folder each, from the ground up. A room imports from floors below its own only."""


@dataclass(frozen=True)
class Import:
    """One import: ``source`` imports ``target``; ``deferred`` when inside a function or for type checkers only."""

    source: str
    target: str
    line: int
    deferred: bool

    def __str__(self) -> str:
        return f"{self.source}, line {self.line}: imports {self.target}"


def modules(root: Path) -> dict[str, Path]:
    """Import names of all Python files on the three floors."""
    found = {}
    for folder, package in FLOORS.items():
        for path in sorted((root / folder).rglob("*.py")):
            parts = [package, *path.relative_to(root / folder).with_suffix("").parts]
            found[".".join(part for part in parts if part != "__init__")] = path
    return found


def read_imports(root: Path) -> list[Import]:
    """Every import of the project, with relative ones resolved and ``from package import module`` as the module."""
    known = modules(root)
    return [found for name, path in known.items() for found in _imports_of(name, path, known)]


def _imports_of(name: str, path: Path, known: dict[str, Path]) -> Iterator[Import]:
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]

    def visit(node: ast.AST, deferred: bool) -> Iterator[Import]:
        if isinstance(node, ast.Import):
            yield from (Import(name, alias.name, node.lineno, deferred) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                base = ".".join(
                    [*package.split(".")[: len(package.split(".")) - node.level + 1], *filter(None, [base])]
                )
            for alias in node.names:
                inner = f"{base}.{alias.name}"
                yield Import(name, inner if inner in known else base, node.lineno, deferred)
        elif isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)):
            deferred = True
        elif isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            deferred = True
        for child in ast.iter_child_nodes(node):
            yield from visit(child, deferred)

    yield from visit(ast.parse(path.read_text(encoding="utf-8")), False)


def floor(module: str) -> str:
    """``apps``, ``kernels``, ``warpdef``, or the empty text for other people's modules."""
    if module.split(".")[0] != "warpdef":
        return ""
    if module == MAIN:
        return "apps"
    return next((f for f in ("kernels", "apps") if module.split(".")[1:2] == [f]), "warpdef")


def broken_arrows(imports: list[Import]) -> list[Import]:
    """Imports that point back, or leave the kernels for anything but Warp and NumPy."""
    broken = []
    for found in imports:
        source, target = floor(found.source), floor(found.target)
        if source == "kernels":
            ok = target == "kernels" or (not target and found.target.split(".")[0] in KERNELS_MAY_IMPORT)
        elif source == "warpdef":
            ok = target != "apps"
        else:
            ok = target != "kernels" or found.source.startswith(APPS_ON_KERNELS)
        if not ok:
            broken.append(found)
    return broken


def room(module: str) -> str:
    """The file or folder of warpdef/ that ``module`` is in; the empty text for the package itself and other floors."""
    return module.split(".")[1] if floor(module) == "warpdef" and "." in module else ""


def climbs(imports: list[Import]) -> list[Import]:
    """Imports inside warpdef/ that go to another room on the same floor or above."""
    height = {name: i for i, names in enumerate(FLOORS_INSIDE) for name in names}
    top = len(FLOORS_INSIDE)  # of a room that is not listed, which a test of its own says
    return [
        found
        for found in imports
        if (source := room(found.source)) and (target := room(found.target)) and source != target
        if height.get(source, top) <= height.get(target, top)
    ]


def heavy_at_start(imports: list[Import], roots: set[str]) -> list[Import]:
    """Heavy packages that loading ``roots`` imports, directly or through other modules of the project."""
    found, loaded, waiting = [], set(), set(roots)
    while waiting:
        module = waiting.pop()
        loaded.add(module)
        for item in imports:
            if item.source == module and not item.deferred:
                if item.target.split(".")[0] in HEAVY:
                    found.append(item)
                elif item.target not in loaded:
                    waiting.add(item.target)
    return found


def cycles(imports: list[Import]) -> list[list[str]]:
    """Circles among the imports, those that run late included; each as the list of its modules."""
    graph: dict[str, set[str]] = {}
    for found in imports:
        if floor(found.target) and found.source != found.target:
            graph.setdefault(found.source, set()).add(found.target)
    circles: list[list[str]] = []
    done: set[str] = set()

    def walk(module: str, trail: list[str]) -> None:
        if module in trail:
            circles.append(trail[trail.index(module) :])
        elif module not in done:
            for target in sorted(graph.get(module, ())):
                walk(target, [*trail, module])
            done.add(module)

    for module in sorted(graph):
        walk(module, [])
    return circles


def _show(found: list) -> str:
    return "\n".join(str(item) for item in found)


def test_imports_point_one_way() -> None:
    found = read_imports(ROOT)
    assert any(floor(i.source) == "apps" and floor(i.target) == "warpdef" for i in found)  # it does read something
    assert not broken_arrows(found), _show(broken_arrows(found))


def test_every_room_stands_on_one_floor() -> None:
    """A new file or folder of warpdef/ is added to FLOORS_INSIDE, on the lowest floor that its imports allow."""
    listed = [name for names in FLOORS_INSIDE for name in names]
    assert sorted(listed) == sorted({room(name) for name in modules(ROOT)} - {""})


def test_rooms_import_downwards() -> None:
    assert not climbs(read_imports(ROOT)), _show(climbs(read_imports(ROOT)))


def test_nothing_imports_the_door() -> None:
    assert not [str(found) for found in read_imports(ROOT) if found.target == MAIN]


def test_no_import_circle() -> None:
    assert not cycles(read_imports(ROOT)), _show(cycles(read_imports(ROOT)))


def test_nothing_heavy_before_a_command_runs() -> None:
    roots = {"warpdef", "warpdef.apps.main", *(f"warpdef.apps.{name}" for name in COMMANDS)}
    found = heavy_at_start(read_imports(ROOT), roots)
    assert not found, _show(found)


def project(root: Path, **files: str) -> list[Import]:
    """Imports of a small project written to ``root``; ``kernels__a`` stands for kernels/a.py."""
    for folder in FLOORS:
        (root / folder).mkdir()
        (root / folder / "__init__.py").touch()
    for name, text in files.items():
        (root / name.replace("__", "/")).with_suffix(".py").write_text(text)
    return read_imports(root)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("kernels__a", "import scipy"),
        ("kernels__a", "def f():\n    from warpdef.config import Config"),
        ("kernels__a", "from ..config import Config"),
        ("kernels__a", "from warpdef import config"),
        ("warpdef__a", "from warpdef.apps.main import run"),
        ("warpdef__a", "from .apps import main"),
        ("apps__a", "from warpdef.kernels import adam"),
        ("apps__a", "from warpdef import kernels"),
    ],
)
def test_a_broken_arrow_is_found(tmp_path: Path, name: str, text: str) -> None:
    assert len(broken_arrows(project(tmp_path, **{name: text}))) == 1


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("kernels__a", "import warp as wp\nimport numpy as np\nimport math\nfrom warpdef.kernels import b"),
        ("warpdef__a", "from warpdef.kernels import b\nimport scipy.spatial"),
        ("apps__benchmark", "from warpdef.kernels import b\nfrom warpdef.config import Config"),
        ("apps__a", "from warpdef.config import Config\nimport rich"),
    ],
)
def test_a_right_arrow_passes(tmp_path: Path, name: str, text: str) -> None:
    assert broken_arrows(project(tmp_path, **{name: text})) == []


def test_a_circle_is_found(tmp_path: Path) -> None:
    found = project(
        tmp_path, warpdef__a="from warpdef import b", warpdef__b="from .c import x", warpdef__c="import warpdef.a"
    )
    assert [sorted(circle) for circle in cycles(found)] == [["warpdef.a", "warpdef.b", "warpdef.c"]]


def test_a_deferred_import_closes_a_circle(tmp_path: Path) -> None:
    found = project(tmp_path, warpdef__a="from warpdef import b", warpdef__b="def f():\n    import warpdef.a")
    assert [sorted(circle) for circle in cycles(found)] == [["warpdef.a", "warpdef.b"]]


@pytest.mark.parametrize(
    "text",
    [
        "from warpdef.files import ply",
        "def f():\n    from .pipeline import reconstruct",
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from warpdef.files import Saver",
        "from warpdef import mesh",  # the same floor
    ],
)
def test_a_climb_is_found(tmp_path: Path, text: str) -> None:
    empty = dict.fromkeys(("warpdef__files", "warpdef__pipeline", "warpdef__mesh"), "")
    found = climbs(project(tmp_path, warpdef__cleaning=text, **empty))
    assert [i.source for i in found] == ["warpdef.cleaning"]


def test_the_way_down_passes(tmp_path: Path) -> None:
    text = "from warpdef.errors import WarpdefError\ndef f():\n    from warpdef.kernels import cg\n    import warpdef"
    assert climbs(project(tmp_path, warpdef__errors="import os", warpdef__mesh=text)) == []


def test_a_heavy_import_is_found(tmp_path: Path) -> None:
    found = project(
        tmp_path,
        apps__a="import rich\nfrom warpdef import mesh",
        apps__b="def f():\n    import scipy.spatial\n    from warpdef import mesh",
        warpdef__mesh="import numpy as np",
    )
    assert [i.source for i in heavy_at_start(found, {"warpdef.apps.a"})] == ["warpdef.mesh"]
    assert heavy_at_start(found, {"warpdef.apps.b"}) == []
