"""Kernels are compiled in a temporary place where Warp's own cannot be written."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from pathlib import Path

import pytest
import warp as wp

from warpdef import kernel_cache
from warpdef.kernel_cache import cache_warnings, ensure_cache


@pytest.fixture(autouse=True)
def not_begun(monkeypatch: pytest.MonkeyPatch) -> None:
    """As before Warp is initialised."""
    monkeypatch.setattr(wp.config, "kernel_cache_dir", None)
    monkeypatch.setattr(kernel_cache, "_told", [])


def test_a_place_that_can_be_written_is_left_to_warp(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv("WARP_CACHE_PATH", str(tmp_path / "mine"))
    ensure_cache()
    assert wp.config.kernel_cache_dir is None and cache_warnings() == []
    assert list((tmp_path / "mine" / wp.config.version).iterdir()) == []  # the probe is gone


@pytest.mark.parametrize("variables", [{"WARP_CACHE_PATH": "{}/file"}, {"HOME": "{}/file", "XDG_CACHE_HOME": ""}])
def test_elsewhere_with_a_warning(variables: dict[str, str], tmp_path: Path, monkeypatch, caplog) -> None:
    (tmp_path / "file").write_text("x")
    monkeypatch.delenv("WARP_CACHE_PATH", raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value.format(tmp_path))
    with caplog.at_level(logging.WARNING, "warpdef"):
        ensure_cache()
    (warning,) = cache_warnings()
    assert str(tmp_path / "file") in warning and "set WARP_CACHE_PATH" in warning and warning in caplog.text
    assert os.access(str(wp.config.kernel_cache_dir), os.W_OK)


def test_a_full_disk_and_what_it_holds_already(tmp_path: Path, monkeypatch) -> None:
    (tmp_path / wp.config.version / "a module").mkdir(parents=True)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setenv("WARP_CACHE_PATH", str(tmp_path))
    monkeypatch.setattr(Path, "write_bytes", full)
    ensure_cache()
    assert "No space left on device" in cache_warnings()[0]
    found = Path(str(wp.config.kernel_cache_dir)) / wp.config.version / "a module"
    assert found.is_symlink() and found.resolve() == tmp_path / wp.config.version / "a module"


def test_no_home_at_all(monkeypatch) -> None:
    for name in ("WARP_CACHE_PATH", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)  # what it gives for a user without one
    ensure_cache()
    assert "there is no home folder" in cache_warnings()[0]


def test_it_is_gone_with_the_process(tmp_path: Path) -> None:
    code = "import warp as wp; from warpdef.device import start_warp; start_warp(); print(wp.config.kernel_cache_dir)"
    environment = {**os.environ, "WARP_CACHE_PATH": "/dev/null", "TMPDIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, timeout=60)
    assert done.stdout.startswith(str(tmp_path)) and done.stderr.startswith("warpdef: warning: kernels cannot be kept")
    assert list(tmp_path.iterdir()) == []
