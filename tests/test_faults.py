"""Faults done to runs on purpose; ``tests/faults.py`` does any number of them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.skipif(not hasattr(os, "fork"), reason="trials are forked")
def test_every_fault_is_survived() -> None:
    """Twenty kills at random moments, and each other fault once. A process of its own: it forks before any threads."""
    script = Path(__file__).with_name("faults.py")
    alone = {**os.environ, "CUDA_VISIBLE_DEVICES": "", "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, str(script), "--trials", "1", "--kills", "20"]
    done = subprocess.run(command, capture_output=True, text=True, env=alone, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    rows = [line.strip("| ").split(" | ") for line in done.stdout.splitlines() if line.startswith("| ")][2:]
    assert rows[0] == ["killed (SIGKILL) at a random moment", "20", "20"]
    assert rows[-1] == ["all", "34", "34"] and all(tried == survived for _, tried, survived in rows)
