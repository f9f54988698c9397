"""What the documents tell people to type, and whether the program takes it. Nothing is run: lines are parsed.

Documents are README.md and the Markdown files of .github/. Read are blocks of code and spans of code in the text. Words
that stand for many (``a|b``) are tried one by one.
"""

from __future__ import annotations

import ast
import importlib.util
import itertools
import re
import shlex
import sys
import textwrap
from functools import cache
from pathlib import Path

import cyclopts

from warpdef.apps.main import COMMANDS, build_app

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # pyright: ignore[reportMissingImports] - installed with Python 3.10 alone

ROOT = Path(__file__).resolve().parents[1]

LEAST = {
    "demo": "demo",
    "reconstruct": "reconstruct in -o out",
    "evaluate": "evaluate out truth.npz",
    "sample": "sample truth.npz -o clouds.npz",
    "datasets": "datasets check folder",
    "experiment": "experiment main -o tables",
    "bench": "bench",
    "export": "export out file.glb",
    "deform": "deform out mesh.obj -o file.glb",
    "view": "view out",
}
"""The shortest complete line of every command."""


def documents() -> dict[str, str]:
    """Every document by its path."""
    paths = [ROOT / "README.md", *sorted((ROOT / ".github").glob("*.md"))]
    return {str(path.relative_to(ROOT)): path.read_text(encoding="utf-8") for path in paths}


def blocks(text: str, language: str) -> list[str]:
    """Blocks of code of one language, without their indentation."""
    found = re.findall(rf"^( *)```{language}\n(.*?)^\1```", text, flags=re.MULTILINE | re.DOTALL)
    return [textwrap.dedent(block) for _, block in found]


def spans(text: str) -> list[str]:
    """Spans of code in the text; one that goes over the end of a line is one line."""
    prose = re.sub(r"^ *```.*?^ *```", "", text, flags=re.MULTILINE | re.DOTALL)
    return [" ".join(span.split()) for span in re.findall(r"(?<!`)`([^`]+)`(?!`)", prose)]


def lines(text: str) -> list[str]:
    """Every command line: those of blocks for the shell, and spans that begin as one."""
    shell = "\n".join(blocks(text, "bash")).replace("\\\n", " ")
    typed = [line.split(" # ")[0].strip() for line in shell.splitlines()]
    typed += [span for span in spans(text) if re.match(r"(warpdef|python3?|pip) ", span)]
    return [part.strip() for line in typed if line and not line.startswith("#") for part in line.split("&&")]


def loose_flags(text: str) -> list[str]:
    """Spans that begin with a flag: no command line, but a part of one."""
    return [span for span in spans(text) if re.match(r"--?[a-z]", span)]


def complaint(line: str) -> str:
    """Why a command line cannot be typed; empty if it can."""
    program, *rest = shlex.split(line)
    if program == "warpdef":
        if len(rest) == 1 and rest[0] in COMMANDS:
            return ""
        return next(filter(None, (_of_warpdef(words) for words in _one_by_one(rest))), "")
    if program in ("python", "python3"):
        return _of_python(rest)
    if program == "pip":
        return _of_pip(rest)
    if program in ("ruff", "pyright", "."):
        return "" if program == "." or program in project()["optional"] else f"{program}: no extra brings it"
    return "" if (ROOT / program).is_file() else f"{program}: no such program"


def flag_complaint(span: str) -> str:
    """Why no command takes a flag, with its value if it has one; empty if one does."""
    flag, *values = span.split()
    if not values:
        return "" if flag in all_flags() else f"{flag}: no command has it"
    for command in LEAST.values():
        tries = [_of_warpdef(shlex.split(command) + words) for words in _one_by_one([flag, *values])]
        if not any(tries):
            return ""
    return f"{span}: no command takes it"


@cache
def all_flags() -> frozenset[str]:
    """The flags of all commands, as the parser lists them, with those that switch something off."""
    app = build_app()
    found = {"--help", "--help-all", "--version", "--install-completion"}
    for command in COMMANDS:
        for argument in app[command].assemble_argument_collection():
            found.update(argument.names)
    return frozenset(found)


def _one_by_one(words: list[str]) -> list[list[str]]:
    return [list(choice) for choice in itertools.product(*(word.split("|") for word in words))]


def _of_warpdef(words: list[str]) -> str:
    try:
        build_app().parse_args(words, exit_on_error=False, print_error=False)
    except cyclopts.CycloptsError as error:
        return " ".join(f"warpdef {shlex.join(words)}: {error}".split())
    return ""


def _of_python(words: list[str]) -> str:
    if words[0] == "-m":
        return "" if importlib.util.find_spec(words[1]) else f"{words[1]}: no such module"
    script = ROOT / words[0]
    if not script.is_file():
        return f"{words[0]}: no such file"
    calls = [node for node in ast.walk(ast.parse(script.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]
    adds = [call for call in calls if isinstance(call.func, ast.Attribute) and call.func.attr == "add_argument"]
    known = {a.value for call in adds for a in call.args if isinstance(a, ast.Constant)}
    unknown = [word for word in words[1:] if word.startswith("-") and word not in known]
    return f"{words[0]}: no flag {', '.join(unknown)}" if unknown else ""


def _of_pip(words: list[str]) -> str:
    asked = [extra for word in words for group in re.findall(r"\[(.+)\]", word) for extra in group.split(",")]
    unknown = sorted(set(asked) - set(project()["extras"]))
    return f"pip: no extra {', '.join(unknown)}" if unknown or words[0] != "install" else ""


@cache
def project() -> dict[str, list[str]]:
    """Names of the extras, and of the packages that they bring."""
    optional = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    packages = [re.split(r"[\[<>=]", package)[0] for group in optional.values() for package in group]
    return {"extras": list(optional), "optional": packages}
