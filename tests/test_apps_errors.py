"""Bad input at the command line: exit code 2, one clear sentence on standard error, nothing written."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import warp as wp

from warpdef.apps.help_pages import COMMON, EXAMPLES
from warpdef.apps.main import COMMANDS, build_app, run

GOOD = np.random.default_rng(0).normal(size=(4, 30, 3))


def save(folder: Path, points=GOOD, **others) -> Path:
    np.savez(folder / "clouds.npz", points=points, **others)
    return folder / "clouds.npz"


def changed(frame: int, value: float) -> np.ndarray:
    points = GOOD.copy()
    points[frame, 5] = value
    return points


def empty_folder(folder: Path) -> Path:
    (folder / "in").mkdir()
    return folder / "in"


def ply_folder(folder: Path, texts: list[str]) -> Path:
    source = empty_folder(folder)
    for number, text in enumerate(texts):
        (source / f"{number}.xyz").write_text(text)
    return source


def xyz(count: int) -> str:
    return "\n".join(" ".join(f"{x:.6f}" for x in row) for row in GOOD[0, :count]) + "\n"


def truncated(folder: Path) -> Path:
    path = save(folder)
    path.write_bytes(path.read_bytes()[:700])
    return path


def unequal_normals(folder: Path) -> Path:
    arrays: dict[str, Any] = {f"points_{t:04d}": GOOD[t] for t in range(4)} | {
        f"normals_{t:04d}": GOOD[t, :29] for t in range(4)
    }
    np.savez(folder / "clouds.npz", **arrays)
    return folder / "clouds.npz"


def unknown_suffix(folder: Path) -> Path:
    (folder / "clouds.docx").write_text("no clouds")
    return folder / "clouds.docx"


BAD_INPUT = {
    "nothing there": (lambda f: f / "absent", ["absent"]),
    "no files": (empty_folder, ["in"]),
    "one frame only": (lambda f: save(f, GOOD[:1]), ["clouds.npz", "at least 2"]),
    "nine points": (lambda f: ply_folder(f, [xyz(30), xyz(9)]), ["1.xyz", "at least 10", "got 9"]),
    "wrong shape": (lambda f: save(f, GOOD[:, :, :2]), ["clouds.npz", "(T, N, 3)", "(4, 30, 2)"]),
    "all points equal": (lambda f: save(f, np.ones((4, 30, 3))), ["points[0] of clouds.npz", "equal"]),
    "truncated": (truncated, ["clouds.npz"]),
    "not a number in text": (lambda f: ply_folder(f, [xyz(30), "1 2 three\n" * 30]), ["1.xyz"]),
    "unknown suffix": (unknown_suffix, ["clouds.docx", "suffix"]),
    "normals of another length": (unequal_normals, ["normals", "(30, 3)", "(29, 3)"]),
}


def check(arguments: list[str], folder: Path, expected: list[str], capfd: pytest.CaptureFixture[str]) -> str:
    """Run, expect code 2 and one sentence with all ``expected`` parts, and nothing new in ``folder``."""
    before = sorted(folder.rglob("*"))
    assert run(arguments) == 2
    shown, told = capfd.readouterr()
    assert shown == ""
    errors = [line for line in told.splitlines() if line.startswith("warpdef: error: ")]
    assert errors == told.splitlines()[-1:], told
    assert "Traceback" not in told
    for part in expected:
        assert part in errors[0]
    assert sorted(folder.rglob("*")) == before
    return errors[0]


@pytest.mark.parametrize("case", BAD_INPUT)
def test_bad_clouds(case: str, tmp_path: Path, capfd) -> None:
    make, expected = BAD_INPUT[case]
    check(["reconstruct", str(make(tmp_path)), "-o", str(tmp_path / "out")], tmp_path, expected, capfd)


def test_template_without_faces(tmp_path: Path, capfd) -> None:
    mesh = tmp_path / "mesh.off"
    mesh.write_text("OFF\n3 0 0\n0 0 0\n1 0 0\n0 1 0\n")
    arguments = ["reconstruct", str(save(tmp_path)), "-o", str(tmp_path / "out"), "--template", str(mesh)]
    check(arguments, tmp_path, ["mesh.off", "without faces"], capfd)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[grid]\nlevel = 3\n", ["run.toml", "unknown key 'grid.level'", "did you mean 'grid.levels'"]),
        ("[grid]\nlevels = 99\n", ["grid.levels", "1 to 16", "99"]),
        ("[grid\n", ["run.toml", "TOML"]),
        (None, ["run.toml"]),
    ],
)
def test_bad_configuration_files(text: str | None, expected: list[str], tmp_path: Path, capfd) -> None:
    file = tmp_path / "run.toml"
    if text is not None:
        file.write_text(text)
    arguments = ["reconstruct", str(save(tmp_path)), "-o", str(tmp_path / "out"), "--config", str(file)]
    check(arguments, tmp_path, expected, capfd)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--grid.level", "3"], ["--grid.level.", "Did you mean --grid.levels?"]),
        (["--grid.levels", "99"], ["grid.levels", "1 to 16", "99"]),
        (["--preset", "best"], ["best", "default", "paper"]),
        (["--frames", "0:1"], ["at least 2"]),
        (["--frames", "a:b"], ["frames", "a:b"]),
        (["--points", "9"], ["points", "9"]),
        (["--threads", "0"], ["--threads"]),
        (["--keyframe", "99"], ["keyframe", "99"]),
        (["--device", "cuda:99"], ["cuda:99"]),
        (["--device", "tpu"], ["tpu"]),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_bad_flags(arguments: list[str], expected: list[str], tmp_path: Path, capfd) -> None:
    check(["reconstruct", str(save(tmp_path)), "-o", str(tmp_path / "out"), *arguments], tmp_path, expected, capfd)


@pytest.mark.skipif(wp.is_cuda_available(), reason="there is a CUDA device here")
def test_no_cuda_device(tmp_path: Path, capfd) -> None:
    arguments = ["reconstruct", str(save(tmp_path)), "-o", str(tmp_path / "out"), "--device", "cuda:0"]
    check(arguments, tmp_path, ["expected a CUDA device for cuda:0", "take --device cpu"], capfd)


def test_a_keyframe_that_is_not_there_is_refused_before_any_work(tmp_path: Path, capfd, monkeypatch) -> None:
    monkeypatch.setattr("warpdef.prepare.clean", None)
    arguments = ["reconstruct", str(save(tmp_path)), "-o", str(tmp_path / "out"), "--keyframe", "40"]
    check(arguments, tmp_path, ["0..3", "got 40", "has 4 frames"], capfd)


def test_output_in_a_place_that_cannot_be(tmp_path: Path, capfd) -> None:
    clouds = save(tmp_path)
    check(["reconstruct", str(clouds), "-o", str(clouds / "out")], tmp_path, ["clouds.npz"], capfd)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["reconstrct"], ['"reconstruct"']),
        (["reconstruct"], ["INPUT"]),
        (["reconstruct", "somewhere"], ["--output"]),
        (
            ["reconstruct", "0.ply", "1.ply", "2.ply", "-o", "out"],
            ["nothing more, got '1.ply' and 1 more", "the folder"],
        ),
        (["reconstruct", "somewhere/*.ply", "-o", "out"], ["give the folder itself, not a pattern"]),
        (["reconstruct", "somewhere", "-o", "out.glb"], ["a folder for the result", "warpdef export out out.glb"]),
        (["evaluate", "absent", "absent.npz"], ["absent"]),
        (["sample", "absent.npz", "-o", "clouds.npz"], ["absent.npz"]),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_other_usage_errors(arguments: list[str], expected: list[str], tmp_path: Path, capfd, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    check(arguments, tmp_path, expected, capfd)


def process(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    code = "from warpdef.apps.main import main; main()"
    return subprocess.run(
        [sys.executable, "-c", code, *arguments],
        capture_output=True,
        text=True,
        timeout=120,
        env={**os.environ, **environment},
        check=False,
    )


def test_the_process_itself(tmp_path: Path) -> None:
    arguments = ["reconstruct", str(tmp_path / "absent"), "-o", str(tmp_path / "out")]
    done = process(*arguments)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("load\nwarpdef: error: ")
    assert len(done.stderr.splitlines()) == 2
    assert not (tmp_path / "out").exists()
    assert "Traceback" in process(*arguments, WARPDEF_TRACEBACK="1").stderr


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys; from warpdef.apps.main import run; run(sys.argv[1:]);"
        "heavy = {'numpy', 'warp', 'scipy', 'trimesh', 'pyvista', 'gpytoolbox', 'pymeshlab', 'matplotlib'};"
        "print(sorted(heavy & set(sys.modules)), file=sys.stderr)"
    )
    for arguments in (["--help"], ["--version"], ["-V"], ["reconstruct", "--help"]):
        done = subprocess.run(
            [sys.executable, "-c", code, *arguments], capture_output=True, text=True, timeout=60, check=True
        )
        assert done.stdout
        assert done.stderr.strip() == "[]"


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help(command: str, capfd) -> None:
    assert run([command, "--help"]) == 0
    shown = " ".join(capfd.readouterr().out.split())
    assert f"warpdef {command}" in shown
    # The function's own words, not the one line of the list of commands.
    function = build_app()[command].default_command
    assert function is not None
    assert (function.__doc__ or "").splitlines()[0] in shown


@pytest.mark.parametrize("name", EXAMPLES)
def test_help_begins_with_examples_that_parse(name: str, capfd) -> None:
    assert run([name, "--help"] if name else ["--help"]) == 0
    assert [line.strip() for line in capfd.readouterr().out.splitlines()[:2]] == list(EXAMPLES[name])
    for line in EXAMPLES[name]:
        build_app().parse_args(line.split()[1:], exit_on_error=False, print_error=False)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_shows_twenty_flags_at_most_and_help_all_every_one(command: str, capfd, monkeypatch) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    names = {a.names for a in build_app()[command].assemble_argument_collection() if a.names[0].startswith("-")}
    assert set(COMMON.get(command, ())) <= {name for flag in names for name in flag}, "a flag that there is not"
    shown = {}
    for flag in ("--help", "--help-all"):
        assert run([command, flag]) == 0
        rows = set(re.findall(r"^│ [ *]{0,4}(--?[\w.-]+)", capfd.readouterr().out, re.MULTILINE))
        shown[flag] = {flags for flags in names if rows & set(flags)}
    assert shown["--help-all"] == names
    assert len(shown["--help"]) == min(len(names), 20)
    if command in COMMON:
        assert shown["--help"] == {flags for flags in names if set(flags) & set(COMMON[command])}


def test_a_shell_completes_commands_and_flags(tmp_path: Path, capfd) -> None:
    script = tmp_path / "completion"
    assert run(["--install-completion", "--shell", "bash", "--output", str(script)]) == 0
    capfd.readouterr()
    typed = (("warpdef", "reco"), ("warpdef", "reconstruct", "in", "--refine.rec"), ("warpdef", "view", "out", "--ht"))
    lines = [f"source {script}"]
    for words in typed:
        lines.append(f"COMP_WORDS=({' '.join(words)}); COMP_CWORD={len(words) - 1}; COMPREPLY=()")
        lines.append(f'_warpdef warpdef {words[-1]} {words[-2]}; echo "${{COMPREPLY[@]}}"')
    done = subprocess.run(["bash", "-c", "\n".join(lines)], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.splitlines() == ["reconstruct", "--refine.recover", "--html"]
