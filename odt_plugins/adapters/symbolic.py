"""Paths that are symbolic links: the file behind one is read and written, and the link stays."""

from __future__ import annotations

import glob
import os
from pathlib import Path


def behind(path: Path) -> Path:
    """The file that a path leads to, which need not be there; the path itself of no link."""
    return Path(os.path.realpath(path)) if path.is_symlink() else path


def name_behind(path: Path) -> str:
    """Name of a file behind a path that has the suffixes of the path, by which its format goes."""
    real = behind(path)
    return real.name if real.suffixes == path.suffixes else path.name


def with_companions(path: Path) -> Path:
    """Where to read: behind a link if files of its name are beside that file, and none beside it.

    Files such as XDMF's and TetGen's have others beside them.
    """
    real = behind(path)
    same = real.suffixes == path.suffixes
    return real if same and _beside(real) and not _beside(path) else path


def _beside(path: Path) -> list[Path]:
    """Other files beside a file whose names begin as that of the file."""
    return [other for other in path.parent.glob(f"{glob.escape(path.stem)}[._]*")
            if other.name != path.name]
