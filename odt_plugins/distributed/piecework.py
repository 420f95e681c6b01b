"""What a worker does with the pieces of a mesh on disk: one at a time is in its memory."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.distributed.block import Block, improve
from odt_plugins.distributed.figures import Figures, figures_of
from odt_plugins.distributed.partition import RINGS, grown, seams
from odt_plugins.distributed.store import Piece, join, load, read_piece, save, write_piece
from odt_plugins.distributed.versions import versions_here
from odt_plugins.engine.density import size_field
from odt_plugins.engine.geometry import boundary_vertices, signed_volumes
from odt_plugins.engine.star import star_sum
from odt_plugins.mesh import BoolArray, FloatArray, SimplexMesh, compact_labels
from odt_plugins.options import Options

Ids = NDArray[np.int64]


class Taken(NamedTuple):
    """What the driver learns of a piece of the input.

    Attributes
    ----------
    path : str               where it is kept
    figures : Figures
    vertices : int
    rim : (k,) int           vertices on the boundary of the piece, in its numbering
    points : (k, 3)          where they are
    sizes : (k,) float64     the size field there
    mean : float             mean of that field
    orientation : int        -1 when all cells came with negative volume
    regions : str or None    name of the cell array of labels
    lost : list of str       names of the other cell arrays
    """

    path: str
    figures: Figures
    vertices: int
    rim: NDArray[np.intp]
    points: FloatArray
    sizes: FloatArray
    mean: float
    orientation: int
    regions: str | None
    lost: list[str]


class Numbers(NamedTuple):
    """What a piece is told: the first of its numbers, and those of its vertices in other pieces."""

    first: int
    rim: NDArray[np.intp]
    ids: Ids
    sizes: FloatArray
    scale: float


class Done(NamedTuple):
    """What the driver learns of a piece after a round.

    Attributes
    ----------
    path : str
    figures : Figures
    rim : ids of vertices that may belong to other pieces as well
    freed : ids of those waiting that were inside the block
    """

    path: str
    figures: Figures
    rim: Ids
    freed: Ids


class Cut(NamedTuple):
    """What is left of a piece, if anything, and what was cut off: label and path of each part."""

    rest: Done | None
    parts: list[tuple[int, str]]


def take_in(item: tuple[str, str], regions: str | None) -> Taken:
    """Read a piece of the input, measure it and keep it as arrays."""
    source, path = item
    piece, orientation, name, lost = read_piece(source, regions)
    n = len(piece.points)
    count = star_sum(np.ones(len(piece.cells)), piece.cells, n)
    mean = star_sum(signed_volumes(piece.points, piece.cells) ** (1 / 3), piece.cells, n)
    scale = float((mean[count > 0] / count[count > 0]).mean())
    sizes = scale * size_field(piece.points, piece.cells)
    rim = np.flatnonzero(boundary_vertices(piece.cells, n))
    save(path, Piece(piece.points, piece.cells, piece.regions, piece.ids, sizes, piece.whole,
                     piece.data))
    return Taken(path, figures_of(piece.points, piece.cells), n, rim, piece.points[rim],
                 sizes[rim], scale, orientation, name, lost)


def first_round(item: tuple[str, str, Numbers], options: Options) -> Done:
    """Number the vertices of a piece and improve what lies within it."""
    source, path, number = item
    piece = load(source)
    n = len(piece.points)
    ids = number.first + np.arange(n, dtype=np.int64)
    ids[number.rim] = number.ids
    sizes = piece.sizes.copy()
    sizes[number.rim] = number.sizes
    held = np.zeros(n, dtype=np.bool_)
    held[number.rim] = True
    piece = Piece(piece.points, piece.cells, piece.regions, ids, sizes / number.scale, piece.whole,
                  piece.data)
    return _improved(piece, held, options, path, ids[:0], held)


def split(item: tuple[str, str, Ids, Ids, Ids]) -> Cut:
    """Cut off what lies around some vertices, one part for each of their labels.

    Parameters
    ----------
    item : source, start of the paths of the parts, ids of its vertices in other pieces, ids of
           the vertices to be cut off, ascending, and their labels
    """
    source, path, rim, ids, labels = item
    piece = load(source)
    n = len(piece.points)
    patch = np.full(n, -1, dtype=np.int32)
    place = np.minimum(np.searchsorted(ids, piece.ids), len(ids) - 1)
    known = ids[place] == piece.ids
    patch[known] = labels[place[known]]
    label = grown(patch, piece.cells, RINGS)
    cells = np.bincount(piece.cells.ravel(), minlength=n)
    parts = []
    for k in np.unique(label[label >= 0]).tolist():
        members = np.flatnonzero(label == k)
        whole = np.bincount(piece.cells[members].ravel(), minlength=n) == cells
        parts.append((int(k), f"{path}-{k}.npz"))
        save(parts[-1][1], piece.part(members, whole))
    shared, _ = seams(piece.cells, label, n)
    rest = np.flatnonzero(label < 0)
    if not len(rest):
        return Cut(None, parts)
    left = piece.part(rest)
    save(f"{path}.npz", left)
    outer = np.union1d(piece.ids[shared], rim)
    return Cut(Done(f"{path}.npz", figures_of(left.points, left.cells),
                    np.intersect1d(left.ids, outer), rim[:0]), parts)


def merge(item: tuple[list[str], str, Ids, Ids, Ids], options: Options) -> Done:
    """Join what was cut off around the same vertices, and improve it.

    Parameters
    ----------
    item : paths of the parts, path of the result, ids of vertices in several pieces, ascending,
           in how many each, and ids of the vertices that are waiting
    options : Options
    """
    sources, path, shared, pieces, waiting = item
    piece, count = join([load(source) for source in sources])
    all_of = np.ones(len(piece.ids), dtype=np.int64)
    place = np.minimum(np.searchsorted(shared, piece.ids), len(shared) - 1)
    known = shared[place] == piece.ids
    all_of[known] = pieces[place[known]]
    held = count < all_of
    return _improved(piece, held, options, path, waiting, held & np.isin(piece.ids, waiting))


def publish(item: tuple[str, Path], regions: str, orientation: int) -> Piece:
    """Write a piece of the result; gives back one without cells and vertices."""
    source, path = item
    piece = load(source)
    write_piece(path, piece, regions, orientation)
    return piece.part(np.zeros(0, dtype=np.intp))


def _improved(
    piece: Piece, held: BoolArray, options: Options, path: str, waiting: Ids, later: BoolArray
) -> Done:
    labels, regions = np.unique(piece.regions), compact_labels(piece.regions, len(piece.cells))
    mesh = SimplexMesh(piece.points, piece.cells, regions, held)
    power = -float(mesh.dim + 2 if options.exponent is None else options.exponent)
    sizes = piece.sizes if options.density == "keep" else None
    result = improve(Block(mesh, sizes, options, power, later, versions_here()))
    save(path, Piece(result.points, result.cells, labels[result.regions], piece.ids,
                     piece.sizes if result.density is None else result.density,
                     np.ones(len(piece.ids), dtype=np.bool_), piece.data))
    return Done(path, figures_of(result.points, result.cells), piece.ids[held],
                np.intersect1d(piece.ids[~held], waiting))
