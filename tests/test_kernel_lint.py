"""Rules of the kernels, read from their text: what is written is declared, and no launch goes around the check."""

from __future__ import annotations

import ast
import importlib
import re
from pathlib import Path
from typing import Any

import pytest

import warpdef.kernels

GROUPS = ("In", "In and out", "Out")
# In a native snippet: an assignment through the array itself, or a pointer or reference to what is not const.
NATIVE_WRITES = (
    r"(?<!\w){0}\.data\[(?:[^\[\]]|\[[^\]]*\])*\](\[\w\])? *[-+*]?=[^=]",
    r"(?:^|;|\{{)\s*(?!const\b)[\w:]+\s*[*&]\s*(?:const\s+)?\w+ = (?:\([^()]*\))?{0}\.data",
)


def decorators(function: ast.FunctionDef) -> str:
    return " ".join(ast.unparse(d) for d in function.decorator_list)


def groups_of(function: ast.FunctionDef, lines: list[str]) -> dict[str, str]:
    """The comment that each parameter stands under: In, In and out, Out, or nothing."""
    found = {}
    for parameter in function.args.args:
        above = [
            re.match(r"\s*# (In and out|In|Out)\b[:,]", line) for line in lines[function.lineno : parameter.lineno]
        ]
        found[parameter.arg] = next((m[1] for m in reversed(above) if m), "")
    return found


def writes_of(function: ast.FunctionDef, native: str, writers: dict[str, list[int]]) -> set[str]:
    """Names that a function assigns to by index, adds to, or hands to a function that does."""
    found = {
        a.arg
        for a in function.args.args
        for rule in NATIVE_WRITES
        if re.search(rule.format(a.arg), native, re.MULTILINE)
    }
    for node in ast.walk(function):
        targets = (
            node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AugAssign) else []
        )
        found |= {ast.unparse(t.value).split("[")[0] for t in targets if isinstance(t, ast.Subscript)}
        if isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            at = [0] if called.startswith("wp.atomic_") else writers.get(called, [])
            found |= {ast.unparse(node.args[k]) for k in at}
    return found & {a.arg for a in function.args.args if "array" in ast.unparse(a.annotation or a)}


def lint(text: str, names: dict[str, Any] | None = None, writers: dict[str, list[int]] | None = None) -> list[str]:
    """What one file breaks. ``writers``: positions that its own and imported device functions write to; added to."""
    names, writers, lines, broken = names or {}, {} if writers is None else writers, text.split("\n"), []
    tree = ast.parse(text)
    for f in [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]:
        kind, groups = decorators(f), groups_of(f, lines)
        arguments = [a for a in f.args.args if a.arg not in ("self", "cls")]
        if any(isinstance(a.annotation, ast.Call) for a in arguments):
            broken.append(f"{f.name}: array types are written wp.array[dtype]")
        if "wp.func" in kind or "wp.kernel" in kind:
            native = next(
                (d.args[0] for d in f.decorator_list if isinstance(d, ast.Call) and "native" in ast.unparse(d)), None
            )
            snippet = eval(ast.unparse(native), dict(names)) if native else ""
            written = writes_of(f, snippet, writers)
            writers[f.name] = [k for k, a in enumerate(arguments) if a.arg in written]
        if "wp.kernel" in kind:
            order = [GROUPS.index(g) for g in groups.values() if g]
            if "" in groups.values():
                broken.append(f"{f.name}: parameters stand under # In:, # In and out: or # Out:")
            elif order != sorted(order):
                broken.append(f"{f.name}: inputs stand before outputs")
            for p, group in groups.items():
                if group == "In" and p in written:
                    broken.append(f"{f.name}: {p} is written, and an input")
                if group == "Out" and p not in written:
                    broken.append(f"{f.name}: {p} is an output that nothing writes")
                if (group == "Out") != p.endswith("_out"):
                    broken.append(f"{f.name}: outputs, and they alone, end in _out: {p}")
            if not kind.startswith("sizes("):
                broken.append(f"{f.name}: a kernel has a table of sizes")
        elif not kind and "launch(" in ast.unparse(f) and not f.name.startswith("_"):
            if f.returns is None or any(a.annotation is None for a in arguments):
                broken.append(f"{f.name}: launchers are annotated")
        if "wp.launch(" in ast.unparse(f) and f.name != "launch":
            broken.append(f"{f.name}: launches go through launching.launch")
    return broken


def files() -> list[tuple[Path, str]]:
    """All files with kernels, and the names of their modules: the folder's, and the bench's own."""
    found = [(path, f"warpdef.kernels.{path.stem}") for path in sorted(Path(warpdef.kernels.__path__[0]).glob("*.py"))]
    bench = importlib.import_module("warpdef.apps.benchmark.kernels")
    return [*found, (Path(str(bench.__file__)), bench.__name__)]


def test_the_kernels_keep_the_rules() -> None:
    broken, writers = [], {}
    for again in (False, True):  # what device functions write is known once all have been read
        for path, name in files():
            found = lint(path.read_text(encoding="utf-8"), vars(importlib.import_module(name)), writers)
            broken += [f"{path.name}: {line}" for line in found if again]
    assert broken == []
    assert len(writers) > 100 and writers["sort_group"] and writers["adj_sample"] == [0]


def test_the_head_of_the_folder_names_all_rooms() -> None:
    rooms = {path.stem for path, name in files() if name.startswith("warpdef.kernels.")} - {"__init__"}
    assert rooms - set(re.findall(r"\w+", warpdef.kernels.__doc__ or "")) == set()


GOOD = """
@wp.func_native("count_out.data[i] = 1;")
def one(i: int, count_out: wp.array[wp.int32]): ...

@sizes("threads x_out: N; count: N")
@wp.kernel
def _thing(
    # In:
    begin: int,
    y: wp.array[wp.vec3],
    # In and out: how often
    count: wp.array[wp.int32],
    # Out, added to:
    x_out: wp.array[wp.vec3],
):
    i = begin + wp.tid()
    one(i, count)
    wp.atomic_add(x_out, i, y[i])

def thing(begin: int, x_out: wp.array) -> None:
    launch(_thing, 1, [begin, x_out], x_out.device)
"""


def test_what_keeps_the_rules_passes() -> None:
    assert lint(GOOD) == []


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("y: wp.array[wp.vec3]", "y: wp.array(dtype=wp.vec3)", "_thing: array types are written wp.array[dtype]"),
        ("i: int, count_out: wp.array[", "i: int, count_out: wp.array(dtype=", "one: array types"),
        ("    # In:\n", "", "_thing: parameters stand under"),
        ("# In and out: how often", "# how often", "_thing: count is written, and an input"),
        ("atomic_add(x_out, i, y[i])", "atomic_add(y, i, x_out[i])", "_thing: y is written, and an input"),
        ("wp.atomic_add(x_out, i, y[i])", "x_out[i] += y[i]\n    y[i] = x_out[i]", "_thing: y is written"),
        ("wp.atomic_add(x_out, i, y[i])", "y[i][0] = 1.0", "_thing: y is written"),
        ("one(i, count)", "one(i, y)", "_thing: y is written"),
        ("wp.atomic_add(x_out, i, y[i])", "a = x_out[i]", "_thing: x_out is an output that nothing writes"),
        ("# Out, added to:", "# In:", "_thing: inputs stand before outputs"),
        ("    y: wp", "    y_out: wp", "_thing: outputs, and they alone"),
        ('@sizes("threads x_out: N; count: N")\n', "", "_thing: a kernel has a table of sizes"),
        ("x_out: wp.array) -> None", "x_out: wp.array)", "thing: launchers are annotated"),
        ("(begin: int, x_out: wp.array)", "(begin, x_out: wp.array)", "thing: launchers are annotated"),
        ("    launch(_thing, 1", "    wp.launch(_thing, 1", "thing: launches go through"),
        ("count_out.data[i] = 1;", "int* const c = count_out.data; c[i] = 1;", ""),
        ("count_out.data[i] = 1;", "const int* const c = count_out.data;", ""),
    ],
)
def test_what_breaks_a_rule_is_found(old: str, new: str, expected: str) -> None:
    assert old in GOOD
    text = GOOD.replace(old, new)
    text = text.replace("dtype=wp.int32]", "dtype=wp.int32)")
    found = lint(text)
    assert any(line.startswith(expected) for line in found) if expected else found == []
