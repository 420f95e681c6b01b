"""Processes as the tests of batches and clusters watch them."""

from __future__ import annotations

import contextlib
import os
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from odt_plugins.adapters import apart


def full_disk(**names: str) -> dict[str, str]:
    """The environment, and these names, of a process whose files are cut off.

    Python would keep the half of what it compiled of a module, and trust it from then on.
    """
    return {**os.environ, **names, "PYTHONDONTWRITEBYTECODE": "1"}


def end_hdf5() -> None:
    """Let the process that reads and writes by HDF5 end; the next one sees what changed since."""
    with contextlib.suppress(ZeroDivisionError):
        apart.call(divmod, 1, 0, modules=())


def wait_until(condition: Callable[[], Any], seconds: float = 60.0) -> None:
    """Wait for something to happen."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.02)


def alive(pid: int) -> bool:
    """Whether a process is there and no zombie."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] != "Z"


def children(pid: int) -> list[int]:
    """All processes that a process started, and those that they did."""
    found = subprocess.run(["ps", "-o", "pid=", "--ppid", str(pid)], capture_output=True,
                           text=True, check=False).stdout.split()
    return [int(p) for p in found] + [g for p in found for g in children(int(p))]
