"""A number that means something stands once: the same name with the same value in two rooms is one number too many."""

from __future__ import annotations

import ast
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ALIKE_BY_CHANCE = {
    "HEADER_MAX": "what a format's header may hold is each format's own",
    "HOLD": "unseen vertices are held by their expected place, joints of a rig by the seam between their bones",
}


def constants(source: str) -> dict[str, float]:
    """Numbers given a name in capitals at the top of a file; one underscore in front does not make it another name."""
    found = {}
    for node in ast.parse(source).body:
        if not isinstance(node, ast.Assign):
            continue
        for target in node.targets:
            pairs = [(target, node.value)]
            if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                pairs = list(zip(target.elts, node.value.elts, strict=True))
            for name, value in pairs:
                if isinstance(value, ast.Call) and ast.unparse(value.func) == "wp.constant":
                    value = value.args[0]
                if isinstance(name, ast.Name) and name.id.isupper() and (number := _number(value)) is not None:
                    found[name.id.removeprefix("_")] = number
    return found


def _number(node: ast.expr) -> float | None:
    """The value of a literal, or of arithmetic on literals."""
    if any(isinstance(part, (ast.Name, ast.Call, ast.Attribute)) for part in ast.walk(node)):
        return None
    value = eval(compile(ast.Expression(node), "", "eval"))
    return value if isinstance(value, (int, float)) and not isinstance(value, bool) else None


def twice(files: dict[str, str]) -> dict[str, list[str]]:
    """Names that stand with one value in several files, and these files."""
    places: dict[tuple[str, float], list[str]] = defaultdict(list)
    for name, source in files.items():
        for key in constants(source).items():
            places[key].append(name)
    return {name: where for (name, _), where in places.items() if len(where) > 1}


def test_no_constant_stands_twice() -> None:
    paths = [path for folder in ("kernels", "warpdef", "apps") for path in sorted((ROOT / folder).rglob("*.py"))]
    own = {path.resolve() for path in paths}  # links to folders lead to the same files
    found = twice({str(path.relative_to(ROOT)): path.read_text(encoding="utf-8") for path in sorted(own)})
    assert {name: where for name, where in found.items() if name not in ALIKE_BY_CHANCE} == {}
    assert set(ALIKE_BY_CHANCE) <= set(found), "no longer alike"


def test_a_constant_that_stands_twice_is_found() -> None:
    files = {
        "a": "X, _Y = 1, 2\nZ = wp.constant(2**3)",
        "b": "X = 1\nY = 2",
        "c": "X = 2\nZ = 8\nw = 1",
        "d": "Z = f(8)",
    }
    assert twice(files) == {"X": ["a", "b"], "Y": ["a", "b"], "Z": ["a", "c"]}
