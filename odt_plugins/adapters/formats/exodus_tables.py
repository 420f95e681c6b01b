"""Element types, sides and names of Exodus files."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.errors import MeshFileError

TYPES = {
    ("SPHERE", 1): "vertex", ("BAR", 2): "line", ("BAR", 3): "line3", ("TRI", 3): "triangle",
    ("TRI", 6): "triangle6", ("TRI", 7): "triangle7", ("QUAD", 4): "quad", ("QUAD", 8): "quad8",
    ("QUAD", 9): "quad9", ("TET", 4): "tetra", ("TET", 10): "tetra10", ("TET", 14): "tetra14",
    ("PYRAMID", 5): "pyramid", ("PYRAMID", 13): "pyramid13", ("WEDGE", 6): "wedge",
    ("WEDGE", 15): "wedge15", ("HEX", 8): "hexahedron", ("HEX", 20): "hexahedron20",
    ("HEX", 27): "hexahedron27",
}
"""Types of cells by family and number of nodes."""

FAMILIES = {"CIRCLE": "SPHERE", "POINT": "SPHERE", "NODE": "SPHERE", "BEAM": "BAR", "TRUSS": "BAR",
            "ROD": "BAR", "EDGE": "BAR", "LINE": "BAR", "TRIANGLE": "TRI", "TRISHELL": "TRI",
            "SHELL": "QUAD", "TETRA": "TET", "TETRAHEDRON": "TET", "HEXAHEDRON": "HEX",
            "PRISM": "WEDGE"}
"""Other names of families."""

WORDS = {"vertex": "SPHERE", "line": "BAR2", "line3": "BAR3", "triangle": "TRI3",
         "triangle6": "TRI6", "quad": "QUAD4", "quad8": "QUAD8", "quad9": "QUAD9",
         "tetra": "TETRA", "tetra10": "TETRA10", "pyramid": "PYRAMID", "pyramid13": "PYRAMID13",
         "wedge": "WEDGE", "wedge15": "WEDGE15", "hexahedron": "HEX8", "hexahedron20": "HEX20"}
"""What the types of cells are called in files."""

ORDER = {"hexahedron20": [*range(12), *range(16, 20), *range(12, 16)],
         "wedge15": [*range(9), *range(12, 15), *range(9, 12)]}
"""Places in files of the nodes of types that have them in another order there, and as well the
other way round: nodes on upright edges come before those at the top."""

TRIANGLE, QUAD = ((0, 1), (1, 2), (2, 0)), ((0, 1), (1, 2), (2, 3), (3, 0))

SIDES: dict[str, tuple[tuple[int, ...], ...]] = {
    "triangle": TRIANGLE, "quad": QUAD,
    "tetra": ((0, 1, 3), (1, 2, 3), (0, 3, 2), (0, 2, 1)),
    "hexahedron": ((0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (0, 4, 7, 3), (0, 3, 2, 1),
                   (4, 5, 6, 7)),
    "wedge": ((0, 1, 4, 3), (1, 2, 5, 4), (0, 3, 5, 2), (0, 2, 1), (3, 4, 5)),
    "pyramid": ((0, 1, 4), (1, 2, 4), (2, 3, 4), (0, 4, 3), (0, 3, 2, 1)),
}
"""Corners of the sides of cells. Those of shells in space are its two faces and then its edges."""

LINEAR = {"triangle6": "triangle", "tetra10": "tetra"}
"""Types of second order whose sides are known."""

MIDDLES = {"triangle6": TRIANGLE, "tetra10": (*TRIANGLE, (0, 3), (1, 3), (2, 3))}
"""Edges on which nodes lie, in the order of these."""

FACES = {2: ("line", "line3"), 3: ("triangle", "triangle6"), 4: ("quad", "quad8")}
"""Types of sides by their number of corners, linear and of second order."""

CORNERS = {name: count for count, names in FACES.items() for name in names}
"""Number of corners of the types of sides."""


def type_of(word: Any, nodes: int) -> str:
    """Type of the cells that a file calls so.

    Raises
    ------
    MeshFileError    it is none of TYPES
    """
    text = word.decode() if isinstance(word, bytes) else str(word)
    family = re.sub(r"[\d\s\0]+", "", text).upper()
    kind = TYPES.get((FAMILIES.get(family, family), nodes))
    if kind is None:
        msg = f"it has cells of type {text.strip()!r} with {nodes} nodes"
        raise MeshFileError(msg)
    return kind


def side_of(kind: str, side: int, *, shell: bool) -> tuple[str, list[int]] | None:
    """Type and nodes, as places in a cell, of a side; None of the faces of shells and unknown ones.

    Parameters
    ----------
    kind : str      type of the cell
    side : int      from 0
    shell : bool    whether triangles and quadrilaterals are shells in space
    """
    linear = LINEAR.get(kind, kind)
    sides = SIDES.get(linear, ())
    if shell and linear in ("triangle", "quad"):
        side -= 2
    if not 0 <= side < len(sides):
        return None
    corners = list(sides[side])
    if kind not in LINEAR:
        return FACES[len(corners)][0], corners
    edges = [frozenset(edge) for edge in MIDDLES[kind]]
    around = [*zip(corners, corners[1:] + corners[:1], strict=True)]
    around = around[:1] if len(corners) == 2 else around
    first = len(set().union(*edges))
    nodes = corners + [first + edges.index(frozenset(edge)) for edge in around]
    return FACES[len(corners)][1], nodes


def texts(rows: Any, count: int) -> list[str]:
    """Strings of a table of letters; empty ones where there is no such table."""
    if rows is None:
        return [""] * count
    table = np.asarray(rows[:])
    return [b"".join(row.tolist()).split(b"\0")[0].decode("utf-8", "replace").strip()
            for row in table.reshape(count, -1)]


def components(names: list[str]) -> dict[str, list[int]]:
    """Join variables into arrays, by their indices: three that end with X, Y and Z are one array.

    Two that end with _R and _Z are one too. Of equal names the first counts.
    """
    place: dict[str, int] = {}
    for i, name in enumerate(names):
        place.setdefault(name, i)
    out: dict[str, list[int]] = {}
    used: set[str] = set()
    for name in names:
        for ends in (("X", "Y", "Z"), ("_R", "_Z")):
            stem = name.removesuffix(ends[0])
            whole = [stem + end for end in ends]
            if stem not in (name, "") and set(whole) <= set(place) and stem not in place:
                out[stem] = [place[one] for one in whole]
                used |= set(whole)
    return out | {name: [i] for name, i in place.items() if name not in used}


def step_names(name: str, steps: int) -> list[str]:
    """Names of an array at each of the time steps; a single one has the name alone."""
    return [name] if steps == 1 else [f"{name}[{k}]" for k in range(steps)]


def facets_in(
    wanted: NDArray[np.int64], rows: NDArray[np.int64], kind: str, *, shell: bool
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Find a cell with each facet, if possible one that has its corners in the same direction.

    Parameters
    ----------
    wanted : (q, k) int    corners
    rows : (m, r) int      cells
    kind : str             their type
    shell : bool           whether triangles and quadrilaterals are shells in space

    Returns
    -------
    cell, side : (q,) int  -1 where there is none
    """
    cell = np.full(len(wanted), -1, dtype=np.int64)
    side = np.full(len(wanted), -1, dtype=np.int64)
    marked = np.zeros(max(int(rows.max(initial=0)), int(wanted.max(initial=0))) + 1, dtype=bool)
    marked[wanted] = True
    found: dict[tuple[int, ...], tuple[int, int]] = {}
    for s in range(8):
        known = side_of(kind, s, shell=shell)
        if known is None:
            continue
        if CORNERS[known[0]] != wanted.shape[1]:
            continue
        table = rows[:, known[1][: wanted.shape[1]]]
        near = np.flatnonzero(marked[table].all(axis=1))
        for i, row in zip(near.tolist(), table[near].tolist(), strict=True):
            found[_turned(row)] = i, s
            found.setdefault((-1, *sorted(row)), (i, s))
    for q, row in enumerate(wanted.tolist()):
        cell[q], side[q] = found.get(_turned(row)) or found.get((-1, *sorted(row)), (-1, -1))
    return cell, side


def _turned(row: list[int]) -> tuple[int, ...]:
    """Corners from the least on, in the same direction; of lines as they are."""
    if len(row) == 2:
        return tuple(row)
    first = row.index(min(row))
    return tuple(row[first:] + row[:first])
