"""Names and sizes that keep the house readable: a class name is one thing, a file no longer than a mind can hold."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("apps", "kernels", "tests", "warpdef")
LINES_MAX = 400


def sources(root: Path) -> list[Path]:
    """Python files of the project; those behind the links in warpdef/ stand once."""
    found = [path for folder in FOLDERS for path in sorted((root / folder).rglob("*.py"))]
    linked = (root / "warpdef" / "apps", root / "warpdef" / "kernels")
    return [path for path in found if not any(path.is_relative_to(link) for link in linked)]


def classes_of_one_name(paths: list[Path]) -> dict[str, list[str]]:
    """Where classes of the same name stand, those inside functions and classes, too."""
    places: dict[str, list[str]] = defaultdict(list)
    for path in paths:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ClassDef):
                places[node.name].append(f"{path.name}:{node.lineno}")
    return {name: where for name, where in places.items() if len(where) > 1}


def test_no_two_classes_have_one_name() -> None:
    twice = classes_of_one_name(sources(ROOT))
    assert not twice, f"rename all but one: {twice}"


def test_no_file_is_too_long() -> None:
    lengths = {str(path.relative_to(ROOT)): len(path.read_text().splitlines()) for path in sources(ROOT)}
    assert {"warpdef/config.py", "apps/main.py", "kernels/cg.py", "tests/test_house.py"} <= set(lengths)
    long = {name: lines for name, lines in lengths.items() if lines > LINES_MAX}
    assert not long, f"over {LINES_MAX} lines, to be split by idea: {long}"


@pytest.mark.parametrize(
    ("texts", "found"),
    [
        (["class A: ...", "class B: ..."], []),
        (["class A: ...", "class A: ..."], ["A"]),
        (["class A: ...", "def f():\n    class A: ..."], ["A"]),
        (["class A:\n    class B: ...", "def A(): ...\nclass C:\n    class B: ..."], ["B"]),
    ],
)
def test_names_that_stand_twice_are_found(texts: list[str], found: list[str], tmp_path: Path) -> None:
    paths = [tmp_path / f"{i}.py" for i in range(len(texts))]
    for path, text in zip(paths, texts, strict=True):
        path.write_text(text)
    assert list(classes_of_one_name(paths)) == found


def test_the_head_of_the_fit_names_all_rooms() -> None:
    folder = ROOT / "warpdef" / "fit"
    head = (folder / "__init__.py").read_text()
    assert [path.stem for path in folder.glob("[a-z]*.py") if not re.search(rf"\b{path.stem}\b", head)] == []
