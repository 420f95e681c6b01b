"""Exodus files, by netCDF: blocks, side sets, node sets and element sets with their ids and names.

The sides of a side set are read as lines, triangles or quadrilaterals beside the elements, where
the file tells of which nodes they are.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.decks import UNREAD
from odt_plugins.adapters.formats.exodus_tables import (
    ORDER,
    components,
    side_of,
    step_names,
    texts,
    type_of,
)
from odt_plugins.errors import MeshFileError

BLOCK, SIDE = "exodus:block", "exodus:side_set"
"""Arrays of cells: ids of blocks, 0 of sides; ids of side sets, 0 of elements."""

AXES = "XYZ"


class Block(NamedTuple):
    """A block of elements: its number, place of its first element, type, and rows of nodes."""

    number: int
    start: int
    kind: str
    rows: NDArray[np.int64]


class Sides(NamedTuple):
    """Sides of one type in a side set: number of the set, type, places in the set, nodes."""

    number: int
    kind: str
    places: NDArray[np.int64]
    rows: NDArray[np.int64]


def read(path: Path) -> Any:
    """Read a file, all its time steps: several as arrays of their own with the step in brackets.

    Returns
    -------
    meshio.Mesh      a block for each block of elements, then one for each side set and type of
                     its sides; names of blocks and side sets are cell sets, node sets point sets

    Raises
    ------
    MeshFileError    its parts do not fit together, or it has elements of an unknown type
    """
    import netCDF4
    from meshio import Mesh

    with netCDF4.Dataset(str(path)) as file:
        raw(file)
        blocks = blocks_of(file)
        points = _coordinates(file)
        steps = size_of(file, "time_step")
        sides = side_sets_of(file, blocks, points.shape[1] == 3)
        cells: list[Any] = [(b.kind, b.rows) for b in blocks]
        cells += [(s.kind, s.rows) for s in sides]
        for kind, rows in cells:
            bad = rows[(rows < 0) | (rows >= len(points))]
            if bad.size:
                msg = f"a {kind} refers to node {bad[0] + 1} of {len(points)}"
                raise MeshFileError(msg)
        ids = _ids(file, "eb_prop1", "num_el_blk")
        side_ids = _ids(file, "ss_prop1", "num_side_sets")
        cell_data: dict[str, Any] = {BLOCK: [
            *(np.full(len(b.rows), ids[b.number]) for b in blocks),
            *(np.zeros(len(s.rows), dtype=np.int64) for s in sides)]}
        if sides:
            cell_data[SIDE] = [*(np.zeros(len(b.rows), dtype=np.int64) for b in blocks),
                               *(np.full(len(s.rows), side_ids[s.number]) for s in sides)]
        cell_data |= _cell_arrays(file, blocks, sides, steps)
        sets: dict[str, Any] = {}
        for home, key, parts in (("eb_names", "num_el_blk", [b.number for b in blocks]),
                                 ("ss_names", "num_side_sets", [s.number for s in sides])):
            names = texts(file.variables.get(home), size_of(file, key))
            first = len(blocks) if key == "num_side_sets" else 0
            for i, number in enumerate(parts, first):
                if names[number]:
                    empty = [np.zeros(0, dtype=np.int64) for _ in cells]
                    sets.setdefault(names[number], empty)[i] = np.arange(len(cells[i][1]))
        _element_sets(file, blocks, sets, len(cells))
        mesh = Mesh(points, cells, _node_arrays(file, len(points), steps), cell_data,
                    cell_sets=sets, point_sets=node_sets_of(file, len(points)),
                    info={UNREAD: _besides(file)})
    return mesh


def _besides(file: Any) -> list[str]:
    """Name what only a copy of the file keeps, since a meshio.Mesh has no place for it."""
    times = np.asarray(file.variables["time_whole"][:] if "time_whole" in file.variables else [])
    out = ["the times of its steps"] if times.any() else []
    for what, home in (("glo", "the whole mesh"), ("nset", "node sets"), ("elset", "element sets")):
        names = texts(file.variables.get(f"name_{what}_var"), size_of(file, f"num_{what}_var"))
        if names:
            out.append(f"variables of {home} {', '.join(map(repr, names))}")
    factors = [name for name in file.variables if name.startswith("dist_fact_")
               and (np.asarray(file.variables[name][:]) != 1).any()]
    for ends, home in (("ss", "side sets"), ("ns", "node sets"), ("els", "element sets")):
        if any(re.fullmatch(rf"dist_fact_{ends}\d+", name) for name in factors):
            out.append(f"factors of {home}")
    if any(re.fullmatch(r"attrib\d+", name) for name in file.variables):
        out.append("attributes of elements")
    if size_of(file, "num_info"):
        out.append("information records")
    return out


def raw(file: Any) -> None:
    """Let a file give and take its numbers and letters as they stand there."""
    file.set_auto_maskandscale(False)
    file.set_auto_chartostring(False)


def size_of(file: Any, name: str) -> int:
    """Length of a dimension, 0 where there is none."""
    return len(file.dimensions[name]) if name in file.dimensions else 0


def _ids(file: Any, name: str, dimension: str) -> NDArray[np.int64]:
    """Ids of blocks or sets; numbers from 1 on where the file has none."""
    count = size_of(file, dimension)
    given = file.variables.get(name)
    return np.arange(1, count + 1) if given is None else np.asarray(given[:]).astype(np.int64)


def _coordinates(file: Any) -> NDArray[Any]:
    """Places (n, dimension), of 32 bits where the file has such."""
    if "coord" in file.variables:
        table = [*np.asarray(file.variables["coord"][:])]
    else:
        names = [f"coord{axis}" for axis in AXES.lower()[: size_of(file, "num_dim")]]
        table = [np.asarray(file.variables[name][:]) for name in names]
    if not table:
        msg = "it has no coordinates"
        raise MeshFileError(msg)
    points = np.stack(table, axis=1)
    return points.astype(points.dtype.newbyteorder("="))


def blocks_of(file: Any) -> list[Block]:
    """Blocks that have elements."""
    out, start = [], 0
    for b in range(size_of(file, "num_el_blk")):
        found = file.variables.get(f"connect{b + 1}")
        if found is None:
            start += size_of(file, f"num_el_in_blk{b + 1}")
            continue
        rows = np.asarray(found[:]).astype(np.int64) - 1
        kind = type_of(getattr(found, "elem_type", ""), rows.shape[1])
        rows = rows[:, ORDER[kind]] if kind in ORDER else rows
        if len(rows):
            out.append(Block(b, start, kind, rows))
        start += len(rows)
    if size_of(file, "num_elem") not in (0, start):
        msg = f"it declares {size_of(file, 'num_elem')} elements and holds {start}"
        raise MeshFileError(msg)
    return out


def side_sets_of(file: Any, blocks: list[Block], space: bool) -> list[Sides]:
    """Sides of all side sets whose nodes are known, by type."""
    out = []
    for k in range(size_of(file, "num_side_sets")):
        if f"elem_ss{k + 1}" not in file.variables:
            continue
        elements = np.asarray(file.variables[f"elem_ss{k + 1}"][:]).astype(np.int64) - 1
        sides = np.asarray(file.variables[f"side_ss{k + 1}"][:]).astype(np.int64) - 1
        found: dict[str, list[Any]] = {}
        for block in blocks:
            inside = (elements >= block.start) & (elements < block.start + len(block.rows))
            for side in np.unique(sides[inside]).tolist():
                known = side_of(block.kind, side, shell=space)
                if known is not None:
                    at = np.flatnonzero(inside & (sides == side))
                    rows = block.rows[elements[at] - block.start][:, known[1]]
                    found.setdefault(known[0], []).append((at, rows))
        for kind, parts in found.items():
            at = np.concatenate([places for places, _ in parts])
            order = np.argsort(at, kind="stable")
            rows = np.concatenate([nodes for _, nodes in parts])
            out.append(Sides(k, kind, at[order], rows[order]))
    return out


def node_sets_of(file: Any, n: int) -> dict[str, Any]:
    """Nodes of the sets by name, of those without one by `node_set_` and the id."""
    count = size_of(file, "num_node_sets")
    ids, names = _ids(file, "ns_prop1", "num_node_sets"), texts(file.variables.get("ns_names"),
                                                                 count)
    out: dict[str, NDArray[np.int64]] = {}
    for k in range(count):
        if f"node_ns{k + 1}" not in file.variables:
            continue
        nodes = np.asarray(file.variables[f"node_ns{k + 1}"][:]).astype(np.int64) - 1
        if ((nodes < 0) | (nodes >= n)).any():
            msg = f"a node set refers to a node beyond the {n} that there are"
            raise MeshFileError(msg)
        name = names[k] or f"node_set_{ids[k]}"
        out[name if name not in out else f"{name}_{ids[k]}"] = nodes
    return out


def _element_sets(file: Any, blocks: list[Block], sets: dict[str, Any], count: int) -> None:
    """Add the sets of elements to those of cells; a name that is taken gets the id behind it.

    One that sides alone have is of the same set.
    """
    names = texts(file.variables.get("els_names"), size_of(file, "num_elem_sets"))
    ids = _ids(file, "els_prop1", "num_elem_sets")
    for k, name in enumerate(names):
        if f"elem_els{k + 1}" not in file.variables:
            continue
        elements = np.asarray(file.variables[f"elem_els{k + 1}"][:]).astype(np.int64) - 1
        title = name or f"element_set_{ids[k]}"
        members = [np.zeros(0, dtype=np.int64) for _ in range(count)]
        for i, block in enumerate(blocks):
            inside = elements[(elements >= block.start)
                              & (elements < block.start + len(block.rows))]
            members[i] = np.unique(inside - block.start)
        own = sets.get(title, members)
        if own is not members and not any(map(len, own[: len(blocks)])):
            members[len(blocks):], own = own[len(blocks):], members
        sets[title if own is members else f"{title}_{ids[k]}"] = members


def _values(file: Any, what: str, i: int, tail: str = "") -> Any:
    """Values (steps, n, ...) of a variable in either of the forms that files have; None of none."""
    if f"vals_{what}_var{i + 1}{tail}" in file.variables:
        return np.asarray(file.variables[f"vals_{what}_var{i + 1}{tail}"][:])
    if not tail and f"vals_{what}_var" in file.variables:
        return np.asarray(file.variables[f"vals_{what}_var"][:])[:, i]
    return None


def _node_arrays(file: Any, n: int, steps: int) -> dict[str, Any]:
    """Variables of nodes at all steps."""
    names = texts(file.variables.get("name_nod_var"), size_of(file, "num_nod_var"))
    out: dict[str, Any] = {}
    for name, places in components(names).items():
        parts = [_values(file, "nod", i) for i in places]
        if not steps or any(part is None or part.shape[:2] != (steps, n) for part in parts):
            continue
        whole = parts[0] if len(parts) == 1 else np.stack(parts, axis=2)
        out |= {title: whole[t] for t, title in enumerate(step_names(name, steps))}
    return out


def _cell_arrays(
    file: Any, blocks: list[Block], sides: list[Sides], steps: int
) -> dict[str, list[Any]]:
    """Variables of elements and sides at all steps; not a number where a block has none."""
    parts = [("elem", "eb", b.number, np.arange(len(b.rows))) for b in blocks]
    parts += [("sset", "ss", s.number, s.places) for s in sides]
    out: dict[str, list[Any]] = {}
    for what, dimension in (("elem", "num_elem_var"), ("sset", "num_sset_var")):
        names = texts(file.variables.get(f"name_{what}_var"), size_of(file, dimension))
        for name, places in components(names).items():
            width = (len(places),) if len(places) > 1 else ()
            for t, title in enumerate(step_names(name, steps)):
                arrays = out.setdefault(title, [
                    np.full((len(rows), *width), np.nan) for *_, rows in parts])
                for k, (of, tail, number, rows) in enumerate(parts):
                    found = [_values(file, what, i, f"{tail}{number + 1}") for i in places]
                    if of == what and all(part is not None for part in found):
                        table = [part[t][rows] for part in found]
                        arrays[k] = np.stack(table, axis=1) if width else table[0]
    return out
