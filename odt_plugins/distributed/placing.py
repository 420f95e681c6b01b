"""Where the pieces of a result go: beside the old ones, which go when the index names the new."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
from itertools import count
from pathlib import Path

from odt_plugins.distributed.store import Piece, piece_files, write_index
from odt_plugins.errors import MeshFileError


def place_pieces(index: Path, files: list[Path], example: Piece) -> None:
    """Move files into a folder of their own beside the index, and let it name them.

    Nothing else is touched, but the pieces of an earlier result which the index named before.

    Parameters
    ----------
    index : path             a .pvtu file, which may exist
    files : list of path     on the same file system
    example : Piece          see :func:`write_index`

    Raises
    ------
    MeshFileError, OSError   the index names what it named before, and that is still there
    """
    folder = _new_folder(index)
    try:
        for file in files:
            os.replace(file, folder / file.name)
        old = _earlier(index)
        write_index(index, [f"{folder.name}/{file.name}" for file in files], example)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    for path in old:
        with contextlib.suppress(OSError):
            path.unlink()
    for parent in {path.parent for path in old}:
        with contextlib.suppress(OSError):
            parent.rmdir()


def piece_name(index: Path, k: int) -> str:
    """Name of the file of a piece."""
    return f"{index.stem}-{k}.vtu"


def _new_folder(index: Path) -> Path:
    """Make a folder of the name of the index, with a number when others have that name."""
    for k in count(1):
        folder = index.with_name(index.stem + (f"-{k}" if k > 1 else ""))
        try:
            folder.mkdir()
        except FileExistsError:
            continue
        break
    return folder


def _earlier(index: Path) -> list[Path]:
    """The pieces that an index names, as far as they have the places of a result."""
    try:
        paths = [Path(path) for path in piece_files(index)[0]]
    except MeshFileError:
        return []
    stem = re.escape(index.stem)
    return [path for path in paths
            if path.parent.parent == index.parent
            and re.fullmatch(rf"{stem}(-\d+)?", path.parent.name)
            and re.fullmatch(rf"{stem}-\d+\.vtu", path.name)]
