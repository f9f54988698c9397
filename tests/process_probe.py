"""What the system tells of a process: memory, processor time, and whether it still speaks. Linux; elsewhere nothing."""

from __future__ import annotations

import contextlib
import os
import select
import subprocess
import time
from pathlib import Path


def _status(key: str) -> int:
    try:
        return int(Path("/proc/self/status").read_text().split(f"{key}:")[1].split()[0]) << 10
    except (OSError, IndexError):
        return 0  # not Linux: memory is not judged


def reset_peak() -> int:
    """Resident bytes now; the peak is counted from here."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
    return _status("VmRSS")


def peak_memory() -> int:
    """Most resident bytes since ``reset_peak``."""
    return _status("VmHWM")


def speaks(worker: subprocess.Popen, patience: float) -> bool:
    """Wait for a line of the worker, or until it has used so many seconds of processor time; idle, ten times that."""
    assert worker.stdout is not None
    begin, used = time.monotonic(), _processor_seconds(worker.pid)
    while not select.select([worker.stdout], [], [], 1.0)[0]:
        if _processor_seconds(worker.pid) - used > patience or time.monotonic() - begin > 10 * patience:
            return False
    return True


def _processor_seconds(process: int) -> float:
    """Processor time that a process has used; 0 where the system does not tell."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError, ValueError):
        return 0.0
