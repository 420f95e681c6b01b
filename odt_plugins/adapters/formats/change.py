"""What a run changed of a mesh that was read from a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class NotRewritable(Exception):
    """A rewriter cannot keep the rest of its source; the message says why."""


class Origin(NamedTuple):
    """The file that a meshio.Mesh was read from, and where its points and cells stood there.

    Attributes
    ----------
    path : path
    format : str                name in meshio of the format that it was read as
    stamp : (int, int)          its size in bytes and its time in nanoseconds when it was read
    points : (n',) int64        point of the file of every point; -1 for new ones
    cells : list of (m',) int64 for every block the row of that block in the file from which the
                                data of every cell come
    """

    path: Path
    format: str
    stamp: tuple[int, int]
    points: NDArray[np.int64]
    cells: list[NDArray[np.int64]]

    def __deepcopy__(self, memo: dict[int, Any]) -> Origin:
        return self

    @property
    def unchanged(self) -> bool:
        """Whether the file is still the one that was read."""
        return self.path.is_file() and stamp(self.path) == self.stamp


class Change(NamedTuple):
    """A mesh as its file has it, and as it is to be.

    Attributes
    ----------
    before : meshio.Mesh        as the file is read
    after : meshio.Mesh         the same blocks, in the same order
    points : (n',) int64        point of `before` of every point of `after`; -1 for new ones
    cells : list of (m',) int64 for every block the row of `before` from which the data of every
                                cell of `after` come
    """

    before: Any
    after: Any
    points: NDArray[np.int64]
    cells: list[NDArray[np.int64]]

    @property
    def renumbered(self) -> bool:
        """Whether points came or went."""
        return not np.array_equal(self.points, np.arange(len(self.before.points)))

    @property
    def number(self) -> NDArray[np.int64]:
        """Point of `after` of every point of `before`, (n,); -1 for those that went."""
        out = np.full(len(self.before.points), -1, dtype=np.int64)
        kept = np.flatnonzero(self.points >= 0)
        out[self.points[kept]] = kept
        return out

    @property
    def moved(self) -> NDArray[np.bool_]:
        """Points of `after` that are new or elsewhere, (n',)."""
        old = np.asarray(self.before.points)[self.points]
        new = np.asarray(self.after.points)
        return np.asarray((self.points < 0) | (old != new).any(axis=1))

    def exchanged(self, block: int) -> NDArray[np.bool_]:
        """Cells of a block of `after` that have other corners than those they come from, (m',)."""
        old = np.asarray(self.before.cells[block].data)[self.cells[block]]
        here = np.asarray(self.after.cells[block].data)
        return np.asarray((self.points[here] != old).any(axis=1))


def stamp(path: Path) -> tuple[int, int]:
    """Size in bytes and time in nanoseconds of a file."""
    told = path.stat()
    return told.st_size, told.st_mtime_ns


def origin_of(path: Path, name: str, mesh: Any) -> Origin:
    """Say of a mesh that was just read that it is as the file has it."""
    return Origin(path.absolute(), name, stamp(path), np.arange(len(mesh.points)),
                  [np.arange(len(block.data)) for block in mesh.cells])
