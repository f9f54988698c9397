"""What an installation is made of: its packages, its metadata, how to cite it, and its second way in."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import warpdef

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # pyright: ignore[reportMissingImports] - installed with Python 3.10 alone

ROOT = Path(__file__).resolve().parents[1]
SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
HOMES = {"warpdef": "warpdef", "warpdef.kernels": "kernels", "warpdef.apps": "apps"}


def test_every_package_on_disk_is_packed_once() -> None:
    found = [
        ".".join([package, *folder.relative_to(ROOT / home).parts])
        for package, home in HOMES.items()
        for folder in sorted({path.parent for path in (ROOT / home).rglob("*.py")})
        if not any(parent.is_symlink() for parent in [folder, *folder.parents])
    ]
    assert sorted(found) == sorted(SETTINGS["tool"]["setuptools"]["packages"])
    assert SETTINGS["tool"]["setuptools"]["package-dir"] == HOMES


@pytest.mark.parametrize("name", ["kernels", "apps"])
def test_the_checkout_shows_all_floors_in_one_place(name: str) -> None:
    """Type checkers and editors read the tree, not the installation: there the floors are links."""
    if not (ROOT / ".git").exists():
        pytest.skip("not a checkout: archives leave the links out")
    link = ROOT / "warpdef" / name
    assert link.is_symlink()
    assert link.resolve() == ROOT / name


def test_the_metadata_says_whose_it_is_and_what_for() -> None:
    project = SETTINGS["project"]
    assert project["authors"] == [{"name": "The warpdef authors"}]
    assert {"point clouds", "NVIDIA Warp"} <= set(project["keywords"])
    assert all(" :: " in classifier for classifier in project["classifiers"])
    assert not [c for c in project["classifiers"] if c.startswith("License")]  # the licence is an SPDX expression
    assert all(link.startswith("https://") for link in project["urls"].values())


def test_the_citation_names_this_version_and_the_paper() -> None:
    yaml = pytest.importorskip("yaml")
    citation = yaml.safe_load((ROOT / ".github" / "CITATION.cff").read_text(encoding="utf-8"))
    assert {"cff-version", "message", "title", "authors"} <= set(citation)  # what the format demands
    assert str(citation["version"]) == warpdef.__version__
    assert citation["license"] == SETTINGS["project"]["license"]
    paper = citation["preferred-citation"]
    assert {"type", "title", "authors"} <= set(paper)
    names = [author["family-names"] for author in paper["authors"]]
    assert names == ["Kaltheuner", "Oebel", "Droege", "Stotko", "Klein"]
    assert paper["url"] == SETTINGS["project"]["urls"]["Paper"]


def test_python_m_warpdef_is_the_command() -> None:
    done = subprocess.run([sys.executable, "-m", "warpdef", "--version"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.strip()) == (0, warpdef.__version__), done.stderr
