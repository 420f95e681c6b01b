"""Folders for work in progress; a run removes those of runs that were killed on this machine."""

from __future__ import annotations

import contextlib
import os
import shutil
import socket
import tempfile
from pathlib import Path

from odt_plugins.processes import is_gone

GONE = "-gone"
"""End of the names of folders that are being removed."""


def make_scratch(parent: Path, start: str) -> Path:
    """Make a folder for this process, and clear away those of processes that ended before theirs.

    Parameters
    ----------
    parent : path     where
    start : str       of its name

    Raises
    ------
    OSError
    """
    mine = f"{start}-{socket.gethostname()}-"
    for old in list(parent.iterdir()):
        if old.name.startswith(f"{start}-") and old.name.endswith(GONE):
            shutil.rmtree(old, ignore_errors=True)
        elif old.name.startswith(mine):
            with contextlib.suppress(ValueError, OSError):
                if is_gone(int(old.name.removeprefix(mine).partition("-")[0])):
                    clear(old)
    return Path(tempfile.mkdtemp(prefix=f"{mine}{os.getpid()}-", dir=parent))


def clear(folder: Path) -> None:
    """Remove a work folder at one stroke; processes that still work in it then end or fail."""
    gone = folder.with_name(folder.name + GONE)
    with contextlib.suppress(OSError):
        os.replace(folder, gone)
    shutil.rmtree(gone, ignore_errors=True)
