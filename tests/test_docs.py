"""What README.md and the documents in .github/ say exists, and what they tell people to type is taken."""

from __future__ import annotations

import ast
import importlib
import re
from dataclasses import replace
from functools import partial
from pathlib import Path

import documented
import numpy as np
import pytest
import synthetic
from documented import ROOT, blocks, complaint, documents, flag_complaint, lines, loose_flags, spans

import warpdef
from warpdef.apps.config_table import with_tables
from warpdef.apps.main import COMMANDS
from warpdef.export import FORMATS
from warpdef.files.cloud_files import CONTAINERS
from warpdef.files.config_file import load_config
from warpdef.files.formats import CLOUD_SUFFIXES

TEXTS = documents()
README = TEXTS["README.md"]
TYPED = sorted({(name, line) for name, text in TEXTS.items() for line in lines(text)})
FLAGS = sorted({(name, span) for name, text in TEXTS.items() for span in loose_flags(text)})


@pytest.mark.parametrize(("name", "line"), TYPED)
def test_each_command_line_is_understood(name: str, line: str) -> None:
    assert complaint(line) == ""


@pytest.mark.parametrize(("name", "span"), FLAGS)
def test_each_flag_is_taken_by_a_command(name: str, span: str) -> None:
    assert flag_complaint(span) == ""


def test_every_document_is_read() -> None:
    """The README, the results and the configuration name commands or flags, or the search above sees none."""
    assert {"README.md", ".github/RESULTS.md", ".github/CONFIGURATION.md"} <= {name for name, _ in TYPED}
    assert len([line for name, line in TYPED if name == "README.md" and line.startswith("warpdef ")]) >= 10
    assert len([flag for name, flag in FLAGS if name == ".github/CONFIGURATION.md"]) >= 70


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("```bash\nwarpdef reconstruct scans/ -o mine --no-refine.recover\n```", "Unknown option: --no-refine.recover"),
        ("```bash\nwarpdef view result \\\n  --sidebyside\n```", "--sidebyside"),
        ("```bash\n. .venv/bin/activate && warpdef reconstrct scans/\n```", "reconstrct"),
        ("```bash\nwarpdef reconstruct scans/ -o mine --preset papers\n```", "papers"),
        ("  ```bash\n  warpdef reconstruct scans/ -o mine --iterations many\n  ```", "many"),
        ("as `warpdef experiment\nmain -o tables --threads two` does", "two"),
        ("`warpdef reconstruct in -o out --template.surface auto|shut`", "shut"),
        ("off with `--no-refine.recover`.", "--no-refine.recover: no command has it"),
        ("one of `--color error|colour`", "--color error|colour: no command takes it"),
        ("```bash\npip install -e '.[everything]'\n```", "no extra everything"),
        ("```bash\npython tests/faults.py --try 3\n```", "no flag --try"),
        ("```bash\npython tests/no_such.py\n```", "no such file"),
        ("```bash\npython -m warpdef.apps.no_table\n```", "no such module"),
        ("```bash\n.ci/ran\n```", "no such program"),
    ],
)
def test_what_cannot_be_typed_is_found(text: str, said: str) -> None:
    found = [*map(complaint, lines(text)), *map(flag_complaint, loose_flags(text))]
    assert said in " ".join(found)


@pytest.mark.parametrize(
    "text",
    [
        "`warpdef view result --frames -5: --size 300x200` and `--slow 4`, `--refine.no-recover`, `-o`",
        "```bash\npip install -e '.[dev]' && python -m pytest  # all of them\n```",
        "`--template.surface auto|closed|open`, `python tests/faults.py --trials 2`",
    ],
)
def test_what_can_be_typed_passes(text: str) -> None:
    assert lines(text) or loose_flags(text)
    assert [*filter(None, map(complaint, lines(text))), *filter(None, map(flag_complaint, loose_flags(text)))] == []


def test_the_shortest_lines_are_complete() -> None:
    assert set(documented.LEAST) == set(COMMANDS)
    assert [complaint(f"warpdef {line}") for line in documented.LEAST.values()] == [""] * len(COMMANDS)


def test_a_newcomer_types_two_commands_after_the_install() -> None:
    install, demo, test = lines("\n".join(f"```bash\n{block}```" for block in blocks(README, "bash")))[:3]
    assert install.startswith("pip install ")
    assert demo == "warpdef demo"
    assert test in (ROOT / ".ci" / "run").read_text().splitlines()


def test_the_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_bytes()) < 14 * 1024


def test_the_python_example_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As it stands there, on four small clouds, with few iterations."""
    (example,) = blocks(README, "python")
    small = warpdef.Config()
    small = {
        "grid": replace(small.grid, levels=3),
        "optimiser": replace(small.optimiser, iterations=10, warmup=5),
        "refine": replace(small.refine, iterations=1),
    }
    monkeypatch.setattr(warpdef, "Config", partial(warpdef.Config, **small), raising=False)
    monkeypatch.chdir(tmp_path)
    truth = synthetic.turning_ellipsoid(4, 300, np.random.default_rng(3))
    np.savez("clouds.npz", points=np.stack(truth.clouds))
    names: dict = {}
    exec(compile(example, "README.md", "exec"), names)
    result = names["result"]
    assert result.vertices.shape == (4, *result.vertices.shape[1:]) and len(result.steps) == 1
    assert names["landmarks"].shape == (4, 1, 3)
    assert names["half_way"].shape == (1, *result.vertices.shape[1:])


def test_the_python_example_uses_what_there_is() -> None:
    (example,) = blocks(README, "python")
    used = {
        node.attr
        for node in ast.walk(ast.parse(example))
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "warpdef"
    }
    assert {"reconstruct", "Config"} <= used
    # Modules of the same name (as warpdef/evaluate.py would be) must not hide the functions once they are imported.
    importlib.import_module("warpdef.pipeline")
    assert [name for name in sorted(used) if not callable(getattr(warpdef, name))] == []


@pytest.mark.parametrize("name", sorted(TEXTS))
def test_named_files_exist(name: str) -> None:
    named = [s for s in spans(TEXTS[name]) if re.fullmatch(r"(apps|warpdef|kernels|tests)/[\w/.]*|LICENSE|\.ci/run", s)]
    assert named or name != "README.md"
    assert [file for file in named if not (ROOT / file).exists()] == []


@pytest.mark.parametrize("name", sorted(TEXTS))
def test_links_lead_somewhere(name: str) -> None:
    """Pictures and other documents; a place within one is a heading there."""
    broken = []
    for target in re.findall(r"\]\(([^)\s]+)\)", TEXTS[name]):
        path, _, place = target.partition("#")
        file = (ROOT / name).parent / path if path else ROOT / name
        if not file.exists() or (place and place not in anchors(file.read_text(encoding="utf-8"))):
            broken.append(target)
    assert broken == []


def anchors(text: str) -> set[str]:
    """Places that a link can name, as GitHub makes them of headings."""
    titles = re.findall(r"^#+ (.+)$", re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def test_what_to_change_where_is_true() -> None:
    """In the table every name in code that follows a file is defined in that file."""
    rows = re.findall(r"^\| .+ \|$", README.split("## Where to change what")[1].split("\n## ")[0], re.MULTILINE)[2:]
    assert len(rows) == 6
    missing = []
    for row in rows:
        text, files = "", 0
        for span in spans(row):
            if (ROOT / span).is_file():
                text, files = (ROOT / span).read_text(encoding="utf-8"), files + 1
            elif re.fullmatch(r"\w+", span) and not re.search(rf"^ *(def|class) {span}\b|^{span}\b.*=", text, re.M):
                missing.append(span)
        assert files, row
    assert missing == []


def test_every_format_is_named() -> None:
    """What is read in the README, what is written in the guide."""
    use, written = README.split("## Use it")[1].split("\n## ")[0], TEXTS[".github/GUIDE.md"].split("## Hand it over")[1]
    assert [suffix for suffix in (*CLOUD_SUFFIXES, *CONTAINERS) if f"`{suffix}`" not in use] == []
    assert [suffix for suffix in FORMATS if f"`.{suffix}`" not in written.split("\n## ")[0]] == []


@pytest.mark.parametrize("name", sorted(TEXTS))
def test_configuration_files_shown_can_be_loaded(name: str, tmp_path: Path) -> None:
    for block in blocks(TEXTS[name], "toml"):
        (tmp_path / "shown.toml").write_text(block, encoding="utf-8")
        load_config(tmp_path / "shown.toml", warpdef.Config())


def test_the_configuration_table_is_up_to_date() -> None:
    text = TEXTS[".github/CONFIGURATION.md"]
    assert with_tables(text) == text, "run: python -m warpdef.apps.config_table .github/CONFIGURATION.md"


@pytest.mark.parametrize("name", sorted(TEXTS))
def test_rows_of_tables_have_the_columns_of_their_heads(name: str) -> None:
    """A row that a line break or a stray bar divides is drawn as text, and ends its table."""
    text = re.sub(r"^ *```.*?^ *```", "", TEXTS[name], flags=re.MULTILINE | re.DOTALL)
    tables = re.findall(r"(?:^\|.*\n)+", text, flags=re.MULTILINE)
    assert tables or "CONFIGURATION" not in name
    for table in tables:
        rows = table.splitlines()
        assert re.fullmatch(r"\|( ?-+:? ?\|)+", rows[1]), rows[0]
        columns = {row: len(re.findall(r"(?<!\\)\|", row)) for row in rows}
        assert [row for row in rows if columns[row] != columns[rows[0]] or not row.endswith("|")] == []


def test_a_document_without_the_marks_is_refused() -> None:
    with pytest.raises(ValueError, match="marks"):
        with_tables("# Configuration")
