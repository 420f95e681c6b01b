"""What a worker does with the pieces of a mesh on disk: one at a time is in its memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.fields import field_names
from odt_plugins.adapters.host import interpolated
from odt_plugins.adapters.regions import Spread
from odt_plugins.carrying.sources import cell_source, surrounding_cells
from odt_plugins.distributed.block import Block, improve
from odt_plugins.distributed.figures import Figures, measure_part
from odt_plugins.distributed.partition import RINGS, grown, seams
from odt_plugins.distributed.store import (
    GHOSTS,
    IDS,
    TABLES,
    Piece,
    join,
    load,
    read_piece,
    save,
    write_piece,
)
from odt_plugins.distributed.versions import versions_here
from odt_plugins.engine.cells.elementary import power
from odt_plugins.engine.cells.geometry import boundary_vertices, signed_volumes
from odt_plugins.engine.odt.density import size_field
from odt_plugins.engine.run.within import Within
from odt_plugins.engine.topology.star import star_sum
from odt_plugins.errors import InvalidMeshError, TangledMeshError, UnsupportedMeshError, counted
from odt_plugins.mesh.arrays import BoolArray, FloatArray
from odt_plugins.mesh.simplex import SimplexMesh, cell_signs, compact_labels
from odt_plugins.options import Options

Ids = NDArray[np.int64]

NEAR_RINGS = 2
"""Rings of cells around inverted ones that count as near to them."""


class Taken(NamedTuple):
    """What the driver learns of a piece of the input.

    Attributes
    ----------
    path : str               where it is kept
    figures : Figures
    vertices : int
    rim : (k,) int           vertices on the boundary of the piece, in its numbering
    ids : (k,) int or None   their numbers in the whole mesh, when the piece came with some
    points : (k, 3)          where they are
    sizes : (k,) float64     the size field there
    mean : float             mean of that field
    orientation : int        -1 when all cells came with negative volume
    turned : int             cells of mixed orientation that were turned
    spreads : dict           how its arrays of integers lie in it
    kinds : dict             what a value of every array is, its shape and type, in each of TABLES
    ghosts : bool            whether it told which of its cells belong to others
    inverted : int           cells that are inverted or flat; the figures are those of the others
                             then, and the sizes mean nothing
    around : (q, 3)          vertices of the rim near to those cells
    more : tuple of str      names of its field data
    """

    path: str
    figures: Figures | None
    vertices: int
    rim: NDArray[np.intp]
    ids: Ids | None
    points: FloatArray
    sizes: FloatArray
    mean: float
    orientation: int
    turned: int
    spreads: dict[str, Spread]
    kinds: dict[str, dict[str, tuple[tuple[int, ...], str]]]
    ghosts: bool
    inverted: int
    around: FloatArray
    more: tuple[str, ...]


class Numbers(NamedTuple):
    """What a piece is told of the whole.

    Attributes
    ----------
    first : int or None      its first number; None when it came with numbers
    rim : (k,) int           its vertices in other pieces, in its numbering
    ids : (k,) int           their numbers
    sizes : (k,) float64     the size field there
    scale : float            mean of that field over all pieces
    kept : dict              names of the arrays that all pieces have, in each of TABLES
    regions : tuple of str   cell arrays of labels
    known : list of (k,)     all values that each of them has in the whole mesh, ascending
    """

    first: int | None
    rim: NDArray[np.intp]
    ids: Ids
    sizes: FloatArray
    scale: float
    kept: dict[str, tuple[str, ...]]
    regions: tuple[str, ...]
    known: list[NDArray[Any]]


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


def take_in(
    item: tuple[str, str], regions: str | Sequence[str] | None, *, untangle: bool = False
) -> Taken | None:
    """Read a piece of the input, measure it and keep it as arrays; None when it is empty.

    Raises
    ------
    InvalidMeshError         it is broken, or two of its vertices have the same number
    UnsupportedMeshError     it holds other cells than linear tetrahedra
    TangledMeshError         cells are inverted or flat, and not to be untangled
    """
    source, path = item
    try:
        found = read_piece(source, regions, untangle=untangle)
    except (InvalidMeshError, UnsupportedMeshError) as exc:
        if source in str(exc) or isinstance(exc, TangledMeshError):
            raise
        msg = f"{source}: {exc}"
        raise type(exc)(msg) from exc
    if found is None:
        return None
    piece = found.piece
    used = np.bincount(piece.cells.ravel(), minlength=len(piece.points)) > 0
    _expect_numbered_once(piece.ids[used], source)
    return Taken(**measured(piece, path, numbered=found.numbered), orientation=found.orientation,
                 turned=found.turned, spreads=found.spreads, ghosts=found.ghosts,
                 kinds={table: {name: (values.shape[1:], values.dtype.str.rstrip("0123456789")
                                       if values.dtype.kind in "US" else values.dtype.str)
                                for name, values in getattr(piece, table).items()}
                        for table in TABLES}, more=found.more)


def measured(piece: Piece, path: str, *, numbered: bool) -> dict[str, Any]:
    """Keep a piece at a path; what :class:`Taken` tells of its vertices and cells."""
    n, cells = len(piece.points), piece.cells
    bad = cell_signs(piece.points, cells)[0] <= 0
    near = np.zeros(n, dtype=np.bool_)
    sizes, scale = np.ones(n), 1.0
    if bad.any():
        near[cells[bad]] = True
        for _ in range(NEAR_RINGS):
            near[cells[near[cells].any(axis=1)]] = True
    else:
        count = star_sum(np.ones(len(cells)), cells, n)
        mean = star_sum(power(signed_volumes(piece.points, cells), 1 / 3), cells, n)
        scale = float((mean[count > 0] / count[count > 0]).mean())
        sizes = scale * size_field(piece.points, cells)
    rim = np.flatnonzero(boundary_vertices(cells, n))
    save(path, replace(piece, sizes=sizes))
    figures = None if bad.all() else measure_part(piece.points, cells[~bad], path)
    return {"path": path, "figures": figures, "vertices": n, "rim": rim,
            "ids": piece.ids[rim] if numbered else None, "points": piece.points[rim],
            "sizes": sizes[rim], "mean": scale, "inverted": int(bad.sum()),
            "around": piece.points[rim[near[rim]]]}


def _expect_numbered_once(ids: Ids, source: str) -> None:
    values, count = np.unique(ids, return_counts=True)
    twice = values[count > 1]
    if len(twice):
        msg = (f"{source} has {counted(len(twice), 'number')} for several vertices each in {IDS}, "
               f"as {twice[0]}; expected one vertex for each, try without that array")
        raise InvalidMeshError(msg)


def numbered(source: str, number: Numbers) -> Piece:
    """Load a piece of the input as a part of the whole."""
    piece = load(source)
    ids = piece.ids if number.first is None else (
        number.first + np.arange(len(piece.points), dtype=np.int64))
    ids[number.rim] = number.ids
    sizes = piece.sizes
    sizes[number.rim] = number.sizes
    data, cell_data = ({name: getattr(piece, table)[name] for name in number.kept[table]}
                       for table in TABLES)
    labels = np.zeros(len(piece.cells), dtype=np.int64)
    for name, known in zip(number.regions, number.known, strict=True):
        labels = labels * len(known) + np.searchsorted(known, cell_data[name].reshape(-1))
    return replace(piece, ids=ids, sizes=sizes / number.scale, data=data, cell_data=cell_data,
                   regions=labels)


def first_round(item: tuple[str, str, Numbers], options: Options) -> Done:
    """Number the vertices of a piece and improve what lies within it."""
    source, path, number = item
    piece = numbered(source, number)
    held = np.zeros(len(piece.points), dtype=np.bool_)
    held[number.rim] = True
    return _improved(piece, held, options, path, piece.ids[:0], held)


def split(item: tuple[str, str, Ids, Ids, Ids]) -> Cut:
    """Cut off what lies within RINGS rings of some vertices, one part for each of their labels.

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
    return Cut(Done(f"{path}.npz", measure_part(left.points, left.cells, f"{path}.npz"),
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


def publish(item: tuple[str, Path, Numbers | None], orientation: int) -> Piece:
    """Write a piece of the result, one of the input with its numbers.

    Gives back one without cells and vertices.
    """
    source, path, number = item
    piece = load(source) if number is None else numbered(source, number)
    write_piece(path, piece, orientation)
    return piece.part(np.zeros(0, dtype=np.intp))


def expect_apart(mesh: SimplexMesh) -> None:
    """Refuse cells that are in several pieces."""
    if len(mesh.uneven.crowded):
        msg = (f"pieces overlap at {counted(len(mesh.uneven.crowded), 'facet')}; expected every "
               f"cell in one piece only, or the cell array {GHOSTS}")
        raise InvalidMeshError(msg)


def _improved(
    piece: Piece, held: BoolArray, options: Options, path: str, waiting: Ids, later: BoolArray
) -> Done:
    labels, regions = np.unique(piece.regions), compact_labels(piece.regions, len(piece.cells))
    mesh = SimplexMesh(piece.points, piece.cells, regions, held)
    expect_apart(mesh)
    exponent = options.smoothing.exponent
    power = -float(mesh.dim + 2 if exponent is None else exponent)
    sizes = piece.sizes if options.density == "keep" else None
    result = improve(Block(mesh, sizes, options, power, versions_here(), Within(cut=later)))
    source = cell_source(mesh.points, mesh.cells, regions, result.points, result.cells,
                         result.regions, options.threads)
    cell_data = {name: values[source] for name, values in piece.cell_data.items()}
    data = dict(piece.data)
    names = field_names(data) if options.fields != "keep" else ()
    moved = np.flatnonzero((result.points != mesh.points).any(axis=1))
    if names and moved.size:
        near = np.zeros(len(mesh.points), dtype=np.int32)
        near[result.cells] = source[:, None]
        cell, weights = surrounding_cells(mesh, result.points[moved], near[moved], options.threads)
        for name in names:
            data[name] = piece.data[name].copy()
            data[name][moved] = interpolated(piece.data[name][mesh.cells[cell]], weights)
    save(path, Piece(result.points, result.cells, labels[result.regions], piece.ids,
                     piece.sizes if result.density is None else result.density,
                     np.ones(len(piece.ids), dtype=np.bool_), data, cell_data))
    return Done(path, measure_part(result.points, result.cells, path), piece.ids[held],
                np.intersect1d(piece.ids[~held], waiting))
