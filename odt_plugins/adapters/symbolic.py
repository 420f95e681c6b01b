"""Paths that are symbolic links: the file behind one is read and written, and the link stays."""

from __future__ import annotations

import glob
import os
from pathlib import Path

from odt_plugins.errors import MeshFileError

TWO = (".gz", ".ugrid")
"""Suffixes with another one before them that belongs to the format."""


def behind(path: Path) -> Path:
    """The file that a path leads to, which need not be there; the path itself of no link."""
    return Path(os.path.realpath(path)) if path.is_symlink() else path


def name_behind(path: Path) -> str:
    """Name of a file behind a path, with the suffix of the path, by which its format goes.

    What is written beside that file has its name too, and not that of another file there.
    """
    real = behind(path)
    return real.name if _alike(real, path) else real.name + _suffix(path)


def with_companions(path: Path) -> Path:
    """Where to read: behind a link if files of its name are beside that file, and none beside it.

    Files such as XDMF's and TetGen's have others beside them.
    """
    real = behind(path)
    return real if _alike(real, path) and _beside(real) and not _beside(path) else path


def expect_file(path: Path) -> None:
    """Refuse a path of which the system gives no file.

    Raises
    ------
    MeshFileError
    """
    try:
        if path.is_file():
            path.open("rb").close()
            return
        why = f"it is {'a directory' if path.is_dir() else 'missing'}"
    except OSError as exc:
        why = exc.strerror or str(exc)
    msg = f"cannot read {path}: {why}; expected a mesh file"
    raise MeshFileError(msg)


def _alike(path: Path, other: Path) -> bool:
    """Whether the suffixes of two paths tell the same format, and the same kind of it."""
    return _suffix(path).lower() == _suffix(other).lower()


def _suffix(path: Path) -> str:
    """The last suffix of a path, with what it has of the one before: .vtu, .vol.gz, .b8.ugrid."""
    return "".join(path.suffixes[-2 if path.suffix.lower() in TWO else -1:])


def _beside(path: Path) -> list[Path]:
    """Other files beside a file whose names begin as that of the file."""
    return [other for other in path.parent.glob(f"{glob.escape(path.stem)}[._]*")
            if other.name != path.name]
