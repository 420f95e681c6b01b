"""Which cell arrays of a caller's object are labels of regions, whose interfaces stay."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, TypeGuard

import numpy as np
from numpy.typing import NDArray

from odt_plugins.errors import InvalidOptionError
from odt_plugins.mesh.components import components
from odt_plugins.mesh.facets import row_keys
from odt_plugins.mesh.simplex import compact_labels

AUTO = "auto"
"""What to pass as `regions` to let the arrays be found."""

CHARTS = "charts"
"""What to pass as `regions` to keep the seams of the texture of a curved surface."""

REGION_ARRAYS = ("marker", "gmsh:physical", "gmsh:geometrical", "medit:ref", "cell_tags",
                 "nastran:part", "nastran:ref", "netgen:index", "tetgen:ref", "ugrid:ref",
                 "avsucd:material", "abaqus:elset", "mdpa:part")
"""Names that pytetwild.tetrahedralize_csg and the formats of meshio give to the material of a
cell. The first one that has several values, few if these are no whole numbers, is taken."""

KNOWN = re.compile(
    r"(cell|element|elem|triangle|face|tet|tetra)?"
    r"(entity|physical|material|mat|region|label|attribute|subdomain|domain|part|block|"
    r"elementblock|group|zone|phase|tissue|marker|tag|component)"
    r"(group|id|index|number|label|tag|marker|ref)?s?")
"""Other names of such arrays, in small letters and without anything but letters: CellEntityIds,
MaterialIds, PartId, ElementBlockIds, ..."""

NOT_REGIONS = re.compile(
    r".*(ghost|partition|process|original|pedigree|parent|global|local|select|halo|owner).*|"
    r"(cell|element|elem|face|triangle|tet|tetra|object)?(id|index|indices|number|num|type|"
    r"count|colou?r|flag|mark)s?|(vtk|mpi)?(proc|rank|procid|rankid)s?|(cell|refinement)?level")
"""Names, written in the same way, of integers that are no regions: partitions, ghost marks, ids."""

CELLS_A_PIECE = 10
"""How many cells the pieces of a region have on average, at least."""

SHARE = 0.5
"""Neighbours are of different labels at most this often, where 1 is as often as two cells picked
at random."""


class Labels(NamedTuple):
    """Labels (m,) of the cells, if there are any, and the names of the arrays they come from."""

    values: NDArray[Any] | None
    names: tuple[str, ...] = ()


class Spread(NamedTuple):
    """How the labels of one array lie in a mesh.

    Attributes
    ----------
    values, cells : (k,)    the different ones, and how many cells have each
    facets, between : int   facets that two cells share, and those where these differ
    pieces : int            how many sets of cells of one value hang together over facets; 0, as
                            `facets`, where the name of the array alone tells that it holds labels
    """

    values: NDArray[Any]
    cells: NDArray[Any]
    facets: int = 0
    between: int = 0
    pieces: int = 0


def are_names(regions: object) -> TypeGuard[str | Sequence[str] | None]:
    """Say whether an option `regions` names arrays, or none, and is not an array itself."""
    several = isinstance(regions, list | tuple) and len(regions) > 0
    return regions is None or isinstance(regions, str) or (
        several and all(isinstance(name, str) for name in regions))  # type: ignore[attr-defined]


def region_labels(
    arrays: Mapping[str, NDArray[Any]], regions: str | Sequence[str] | None, cells: NDArray[Any]
) -> Labels:
    """Take the labels of the cells from the arrays that are named, or find these arrays.

    Parameters
    ----------
    arrays : dict of (m, ...)     cell arrays by their names
    regions : names, or one name or several between commas; `AUTO` to find them; or None
    cells : (m, k) int            simplices, in the numbering of the caller

    Returns
    -------
    Labels                        equal where all these arrays are equal

    Raises
    ------
    InvalidOptionError            there is no array of that name
    """
    if regions is None:
        return Labels(None)
    if regions == AUTO:
        names = list(region_names([spreads(arrays, cells)]))
    elif isinstance(regions, str):
        names = [regions] if regions in arrays else [name.strip() for name in regions.split(",")]
    else:
        names = list(regions)
    for name in names:
        _expect(arrays, name)
    values = [np.unique(arrays[name], return_inverse=True)[1].ravel()
              if _are_attributes(name, arrays[name]) else arrays[name] for name in names]
    if len(values) > 1:
        rows = np.stack([compact_labels(v, len(cells)) for v in values], axis=1)
        values = [np.unique(rows, axis=0, return_inverse=True)[1].ravel()]
    return Labels(values[0], tuple(names)) if values else Labels(None)


def are_whole(values: NDArray[Any]) -> bool:
    """Say whether an array may hold labels: whole numbers of any type, truth values or texts."""
    if values.dtype.kind == "f":
        return bool(np.isfinite(values).all() and (values == np.rint(values)).all())
    if values.dtype.kind == "O":
        return all(isinstance(value, str) for value in values.ravel().tolist())
    return values.dtype.kind in "iubU"


def _are_attributes(name: str, values: NDArray[Any]) -> bool:
    """Say whether an array of a known name has numbers that are not whole, as TetGen's may."""
    return (name in REGION_ARRAYS and values.dtype.kind == "f" and not are_whole(values)
            and bool(np.isfinite(values).all()))


def is_known(name: str) -> bool:
    """Whether the name of an array tells that it has labels."""
    return name in REGION_ARRAYS or KNOWN.fullmatch(_plain(name)) is not None


def are_ids(name: str) -> bool:
    """Whether the name of an array tells that it has ids, colours, marks or the like."""
    return NOT_REGIONS.fullmatch(_plain(name)) is not None


def _plain(name: str) -> str:
    """A name in small letters, without anything but letters."""
    return re.sub(r"[^a-z]", "", name.lower())


def spreads(arrays: Mapping[str, NDArray[Any]], cells: NDArray[Any]) -> dict[str, Spread]:
    """How the whole numbers and texts of cell arrays lie in a mesh, or in a part of one.

    Parameters
    ----------
    arrays : dict of (m, ...)     cell arrays by their names
    cells : (m, k) int            simplices

    Returns
    -------
    dict of Spread                of all arrays that may be labels
    """
    out: dict[str, Spread] = {}
    pairs = None
    for name, values in arrays.items():
        known = is_known(name)
        whole = are_whole(values) or _are_attributes(name, values)
        whole = whole and values.shape in ((len(cells),), (len(cells), 1))
        if not whole or (are_ids(name) and not known):
            continue
        if values.dtype.kind == "O":
            values = values.astype(str)
        distinct, label, count = _told_apart(values)
        if known:
            # Few whole values of a float are labels; a field that is whole everywhere has more.
            if values.dtype.kind != "f" or len(distinct) <= _most(len(cells)):
                out[name] = Spread(distinct, count)
        elif len(distinct) <= _most(len(cells)):
            pairs = pairs or _neighbours(cells)
            first, second = pairs
            differ = label.ravel()[first] != label.ravel()[second]
            pieces = int(components(first[~differ], second[~differ], len(cells)).max()) + 1
            out[name] = Spread(distinct, count, len(differ), int(differ.sum()), pieces)
    return out


def _told_apart(values: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any], NDArray[np.int64]]:
    """Different values, which of them each is, and how often; those of sets without sorting."""
    if values.dtype != np.bool_:
        return np.unique(values, return_inverse=True, return_counts=True)
    count = np.bincount(values.ravel(), minlength=2)
    there = np.flatnonzero(count)
    return there.astype(np.bool_), values & (len(there) > 1), count[there]


def named_spreads(
    arrays: Mapping[str, NDArray[Any]], regions: str | Sequence[str] | None, cells: NDArray[Any]
) -> dict[str, Spread]:
    """:func:`spreads`, or the values of the arrays that are named; see :func:`region_labels`."""
    if regions == AUTO:
        return spreads(arrays, cells)
    names = region_labels(arrays, regions, cells).names
    for name in names:
        compact_labels(arrays[name], len(cells))
    return {name: Spread(*np.unique(arrays[name], return_counts=True)) for name in names}


def region_names(parts: Sequence[Mapping[str, Spread]]) -> tuple[str, ...]:
    """Names of the arrays that are labels: by their name, or since they part the mesh.

    Parameters
    ----------
    parts : list of dict     :func:`spreads` of all parts of the mesh
    """
    common = [name for name in parts[0] if all(name in part for part in parts)]
    whole = {name: _together([part[name] for part in parts]) for name in common}
    several = [name for name in common if len(whole[name].values) > 1]
    names = [name for name in REGION_ARRAYS if name in several][:1]
    return (*names, *(name for name in several
                      if name not in REGION_ARRAYS and _parts_the_mesh(whole[name])))


def _parts_the_mesh(found: Spread) -> bool:
    """Say whether labels part a mesh into few pieces that hang together.

    A piece, the cells of one label that hang together over facets, has at least CELLS_A_PIECE cells
    on average, unless there are only two pieces; and neighbours differ at most SHARE times as often
    as cells picked at random. The first is not so where all labels differ, the second where they
    are scattered. Of an array with a known name it is enough that not all labels differ.
    """
    m = int(found.cells.sum())
    if not found.pieces:
        return len(found.values) < m
    at_random = 1.0 - float((found.cells / m * ((found.cells - 1) / (m - 1))).sum())
    return found.pieces <= _most(m) and found.between <= SHARE * at_random * found.facets


def _together(parts: Sequence[Spread]) -> Spread:
    values, place = np.unique(np.concatenate([part.values for part in parts]), return_inverse=True)
    cells = np.bincount(place.ravel(), np.concatenate([part.cells for part in parts]))
    return Spread(values, cells, sum(part.facets for part in parts),
                  sum(part.between for part in parts), sum(part.pieces for part in parts))


def _most(m: int) -> int:
    """The largest number of pieces of m cells that are few."""
    return max(2, m // CELLS_A_PIECE)


def _neighbours(cells: NDArray[Any]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Cells (k,) on both sides of every facet that two of the simplices (m, d + 1) share."""
    rows = np.sort(cells.astype(np.int64), axis=1)
    d = rows.shape[1]
    facets = np.concatenate([np.delete(rows, i, axis=1) for i in range(d)])
    key = row_keys(facets, int(rows.max()) + 1)
    order = np.argsort(key, kind="stable")
    twin = np.flatnonzero(key[order][1:] == key[order][:-1])
    return order[twin] % len(cells), order[twin + 1] % len(cells)


def _expect(arrays: Mapping[str, NDArray[Any]], name: str) -> None:
    if name not in arrays:
        names = sorted(key for key, values in arrays.items()
                       if values[:1].size == 1 and values.dtype.kind != "c")
        known = f"one of {names} or " if names else ""
        none = " and finds no texture" if name == CHARTS else ""
        none += "" if names else ", the mesh has none"
        msg = (f"regions={name!r} names no cell array{none}; "
               f"expected {known}an array of integer labels, one per cell")
        raise InvalidOptionError(msg)
