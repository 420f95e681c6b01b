"""Pieces of a mesh on disk: partitioned VTK at both ends, and arrays between."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters import files, meshio_mesh
from odt_plugins.adapters.regions import Spread, named_spreads
from odt_plugins.errors import (
    InvalidMeshError,
    MeshFileError,
    TangledMeshError,
    UnsupportedMeshError,
    counted,
    writing,
)
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.simplex import reverse, simplex_mesh
from odt_plugins.mesh.tangled import tangled_mesh

IDS = "GlobalPointIds"
"""Point array: vertices of several pieces with the same number are one."""

GHOSTS, DUPLICATE = "vtkGhostType", 1
"""Cell array of VTK, and the bit in it of cells that belong to another piece."""


@dataclass(frozen=True)
class Piece:
    """Some cells of a mesh, with the vertices they use.

    Attributes
    ----------
    points : (n, 3) float64
    cells : (m, 4) int32         positive, in the numbering of the piece
    regions : (m,) int64         labels
    ids : (n,) int64             number of every vertex in the whole mesh
    sizes : (n,) float64         cell size h of the input, carried with the vertices
    whole : (n,) bool            whether all cells around a vertex, of those of the piece that it
                                 was split from, are here
    data : dict                  point arrays of the input
    cell_data : dict             cell arrays of the input, those that the labels are from as well
    """

    points: FloatArray
    cells: IntArray
    regions: NDArray[np.int64]
    ids: NDArray[np.int64]
    sizes: FloatArray
    whole: BoolArray
    data: dict[str, NDArray[Any]] = field(default_factory=dict)
    cell_data: dict[str, NDArray[Any]] = field(default_factory=dict)

    def part(self, members: NDArray[Any], whole: BoolArray | None = None) -> Piece:
        """Take some of the cells, with the vertices they use."""
        used, number = np.unique(self.cells[members], return_inverse=True)
        cells = np.ascontiguousarray(number.reshape(-1, self.cells.shape[1]), dtype=np.int32)
        whole = self.whole if whole is None else whole
        return Piece(self.points[used], cells, self.regions[members], self.ids[used],
                     self.sizes[used], whole[used],
                     {name: values[used] for name, values in self.data.items()},
                     {name: values[members] for name, values in self.cell_data.items()})


TABLES = ("data", "cell_data")
"""Fields of a piece that hold arrays by their names."""


def save(path: str, piece: Piece) -> None:
    """Write a piece beside its place and rename it."""
    arrays = {f.name: getattr(piece, f.name) for f in fields(piece) if f.name not in TABLES}
    for table in TABLES:
        arrays |= {f"{table} {name}": values for name, values in getattr(piece, table).items()}
    beside = f"{path}.part"
    with open(beside, "wb") as file:
        np.savez(file, **arrays)
    os.replace(beside, path)


def load(path: str) -> Piece:
    """Read what :func:`save` wrote."""
    with np.load(path, allow_pickle=False) as stored:
        arrays = {name: stored[name] for name in stored.files}
    data, cell_data = ({name.removeprefix(f"{table} "): arrays.pop(name) for name in list(arrays)
                        if name.startswith(f"{table} ")} for table in TABLES)
    return Piece(**arrays, data=data, cell_data=cell_data)


def join(pieces: list[Piece]) -> tuple[Piece, NDArray[np.int64]]:
    """Join pieces along their common vertices.

    Returns
    -------
    Piece
    count : (n,) int64     in how many of the pieces all cells around a vertex are here

    Raises
    ------
    InvalidMeshError       vertices of the same number are not at one place
    """
    ids, first, number = np.unique(np.concatenate([p.ids for p in pieces]), return_index=True,
                                   return_inverse=True)
    starts = np.cumsum([0, *(len(p.ids) for p in pieces)])
    cells = [number[p.cells.astype(np.int64) + start]
             for p, start in zip(pieces, starts[:-1], strict=True)]

    def rows(name: str) -> NDArray[Any]:
        return np.asarray(np.concatenate([getattr(p, name) for p in pieces])[first])

    points = rows("points")
    split = np.unique(number[(points[number] != np.concatenate([p.points for p in pieces])).any(1)])
    if len(split):
        msg = (f"{counted(len(split), 'vertex is', 'vertices are')} at several places, as number "
               f"{ids[split[0]]}; expected {IDS} to name every vertex once, try without them")
        raise InvalidMeshError(msg)
    whole = np.concatenate([p.whole for p in pieces])
    count = np.bincount(number, weights=whole, minlength=len(ids)).astype(np.int64)
    data = {name: np.concatenate([p.data[name] for p in pieces])[first] for name in pieces[0].data}
    cell_data = {name: np.concatenate([p.cell_data[name] for p in pieces])
                 for name in pieces[0].cell_data}
    return Piece(np.ascontiguousarray(points),
                 np.concatenate(cells).astype(np.int32),
                 np.concatenate([p.regions for p in pieces]), ids, rows("sizes"),
                 np.ones(len(ids), dtype=np.bool_), data, cell_data), count


def piece_files(source: str | os.PathLike[str]) -> tuple[list[str], bool]:
    """List the files of the pieces of a .pvtu file, or of a directory of .vtu files.

    Returns
    -------
    paths : list of str
    ghosts : bool          whether the pieces have cells of others as well

    Raises
    ------
    MeshFileError          there are none, or some are missing
    """
    path = Path(source)
    ghosts = False
    if path.is_dir():
        found = sorted(str(p) for p in path.glob("*.vtu"))
    else:
        try:
            grid = ElementTree.parse(path).getroot().find("PUnstructuredGrid")
        except (OSError, ElementTree.ParseError) as exc:
            why = getattr(exc, "strerror", None) or exc
            msg = f"cannot read {path}: {why}; expected a .pvtu file or a directory of .vtu files"
            raise MeshFileError(msg) from exc
        ghosts = grid is not None and grid.get("GhostLevel", "0") != "0"
        pieces = [] if grid is None else grid.findall("Piece")
        found = [str(path.parent / piece.get("Source", "")) for piece in pieces]
    missing = [name for name in found if not os.path.isfile(name)]
    if missing or not found:
        what = f"{missing[0]} is missing" if missing else "it names no pieces"
        msg = f"cannot read {path}: {what}; expected a .pvtu file or a directory of .vtu files"
        raise MeshFileError(msg)
    return found, ghosts


class Found(NamedTuple):
    """A piece as it was read: its sizes are not known yet, its numbers only when it came with some.

    Attributes
    ----------
    piece : Piece
    numbered : bool            whether it came with numbers
    ghosts : bool              whether it told which cells belong to others; they are left out
    orientation : int          -1 when its cells came with negative volume
    turned : int               cells of mixed orientation that were turned
    spreads : dict             see :func:`odt_plugins.adapters.regions.named_spreads`
    more : tuple of str        names of its field data
    """

    piece: Piece
    numbered: bool
    ghosts: bool
    orientation: int
    turned: int
    spreads: dict[str, Spread]
    more: tuple[str, ...]


def read_piece(
    path: str, regions: str | Sequence[str] | None, *, untangle: bool = False
) -> Found | None:
    """Read a piece, all its labels 0.

    Parameters
    ----------
    path : str
    regions : names of the cell arrays of labels, "auto" or None
    untangle : bool              whether some cells may be inverted or flat

    Returns
    -------
    Found, or None for a piece without cells of its own

    Raises
    ------
    MeshFileError, InvalidMeshError, UnsupportedMeshError
    """
    try:
        source = files.read_file(path)
    except InvalidMeshError:
        return None
    if not any(len(block.data) for block in source.cells):
        return None
    host = meshio_mesh.read(source)
    if host.cells.shape[1:] != (4,) or host.higher_order or host.kept:
        msg = f"{path} holds other cells than linear tetrahedra; expected these alone in pieces"
        raise UnsupportedMeshError(msg)
    try:
        mesh, orientation = simplex_mesh(host.points, host.cells)
    except TangledMeshError:
        if not untangle:
            raise
        mesh, orientation = tangled_mesh(host.points, host.cells)
    n = len(mesh.points)
    ids = np.asarray(source.point_data.get(IDS, 0.0))
    numbered = ids.shape == (n,) and ids.dtype.kind in "iu"
    data = {name: np.asarray(values) for name, values in source.point_data.items()
            if name not in (IDS, GHOSTS)}
    cell_data = {name: np.concatenate([np.asarray(values[block]) for block in host.layout])
                 for name, values in source.cell_data.items()}
    ghosts = cell_data.pop(GHOSTS, None)
    piece = Piece(mesh.points, mesh.cells, np.zeros(len(mesh.cells), dtype=np.int64),
                  ids.astype(np.int64) if numbered else np.arange(n, dtype=np.int64),
                  np.ones(n), np.ones(n, dtype=np.bool_), data, cell_data)
    if ghosts is not None:
        piece = piece.part(np.flatnonzero(ghosts.astype(np.int64) & DUPLICATE == 0))
    if not len(piece.cells):
        return None
    return Found(piece, numbered, ghosts is not None, orientation, mesh.turned,
                 named_spreads(piece.cell_data, regions, piece.cells), tuple(source.field_data))


def write_piece(path: Path, piece: Piece, orientation: int) -> None:
    """Write a piece as .vtu, with its numbers and its arrays."""
    from meshio import Mesh

    turned = np.full(len(piece.cells), orientation < 0)
    mesh = Mesh(piece.points, [("tetra", reverse(piece.cells, turned))],
                point_data={**piece.data, IDS: piece.ids},
                cell_data={name: [values] for name, values in piece.cell_data.items()})
    files.write_file(path, mesh)


def write_index(path: Path, names: list[str], example: Piece) -> None:
    """Write the .pvtu file that names the pieces; it comes last."""
    root = ElementTree.Element("VTKFile", type="PUnstructuredGrid", version="1.0",
                               byte_order="LittleEndian")
    grid = ElementTree.SubElement(root, "PUnstructuredGrid", GhostLevel="0")
    _declare(grid, "PPointData", {**example.data, IDS: example.ids})
    _declare(grid, "PCellData", example.cell_data)
    _declare(grid, "PPoints", {"Points": example.points})
    for name in names:
        ElementTree.SubElement(grid, "Piece", Source=name)
    beside = path.with_name(f".{path.name}.part")
    with writing(path, "another path"):
        ElementTree.ElementTree(root).write(beside, xml_declaration=True)
        os.replace(beside, path)


def _declare(grid: Any, tag: str, arrays: dict[str, NDArray[Any]]) -> None:
    element = ElementTree.SubElement(grid, tag)
    for name, values in arrays.items():
        kind = values.dtype
        if kind.kind in "US":
            ElementTree.SubElement(element, "PArray", type="String", Name=name)
            continue
        word = {"f": "Float", "i": "Int", "u": "UInt"}[kind.kind] + str(8 * kind.itemsize)
        width = values.shape[1] if values.ndim > 1 else 1
        ElementTree.SubElement(element, "PDataArray", type=word, Name=name,
                               NumberOfComponents=str(width))
