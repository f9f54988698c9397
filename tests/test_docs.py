"""What the README tells people to type exists."""

from __future__ import annotations

import ast
import importlib
import re
import shlex
from pathlib import Path

import pytest

import warpdef
from warpdef.apps.config_table import with_table
from warpdef.apps.main import build_app

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", README, flags=re.MULTILINE | re.DOTALL)


def commands() -> list[str]:
    return [line for block in blocks("bash") for line in block.splitlines() if line]


@pytest.mark.parametrize("line", [line for line in commands() if line.startswith("warpdef ")])
def test_each_command_is_understood(line: str) -> None:
    command, bound, _ = build_app().parse_args(shlex.split(line)[1:], exit_on_error=False, print_error=False)
    assert command.__name__ == shlex.split(line)[1]
    assert bound is not None


def test_first_commands_are_install_and_demo() -> None:
    install, demo, test = commands()[:3]
    assert install.startswith("pip install ")
    assert demo == "warpdef demo"
    assert test in (ROOT / ".ci" / "run").read_text().splitlines()


def test_the_python_example_uses_what_there_is() -> None:
    (example,) = blocks("python")
    used = {
        node.attr
        for node in ast.walk(ast.parse(example))
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "warpdef"
    }
    assert {"reconstruct", "Config"} <= used
    # Modules of the same name (as warpdef/evaluate.py would be) must not hide the functions once they are imported.
    importlib.import_module("warpdef.pipeline")
    assert [name for name in sorted(used) if not callable(getattr(warpdef, name))] == []


def test_named_files_exist() -> None:
    named = re.findall(r"`((?:apps|warpdef|kernels|tests)/[\w/]+\.py|LICENSE|\.ci/run)`", README)
    assert named
    assert [name for name in named if not (ROOT / name).exists()] == []


def test_images_exist() -> None:
    images = re.findall(r"!\[[^\]]*\]\(([^)]+)\)", README)
    assert [image for image in images if not (ROOT / image).exists()] == []


def test_the_configuration_table_is_up_to_date() -> None:
    assert with_table(README) == README, "run: python -m warpdef.apps.config_table README.md"
