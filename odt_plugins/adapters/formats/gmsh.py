"""Gmsh's files written into themselves: all sections stay but for places, elements and values."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats import gmsh_nodes, gmsh_read, gmsh_tables
from odt_plugins.adapters.formats.change import Change, NotRewritable
from odt_plugins.adapters.formats.decks import edited
from odt_plugins.adapters.formats.gmsh_nodes import Edit, coded
from odt_plugins.adapters.formats.gmsh_tables import BOUNDS, ENTITY, File, Nodes, Run, Values

PLAIN = {"MeshFormat", "PhysicalNames", "Nodes", "Elements", "NodeData", "ElementData"}
"""Sections that a file has when it is written anew, too."""


class _Rows(NamedTuple):
    """Elements that take the place of those of a run.

    Attributes
    ----------
    source : (m,) int64     row of the run from which each comes
    block, cell : (m,)      block and cell of the result
    numbers : (m,) int64
    fresh : (m,) bool       whether the element has other nodes, or is not the first that comes from
                            its source
    """

    source: NDArray[np.int64]
    block: NDArray[np.int64]
    cell: NDArray[np.int64]
    numbers: NDArray[np.int64]
    fresh: NDArray[np.bool_]


def rewrite(source: Path, target: Path, change: Change) -> list[str]:
    """Replace places of nodes that moved, elements that were exchanged, and values of both.

    An element takes the place, the number and the tags of the one from which its data come; the
    others that come from the same one follow it, with new numbers. Where elements and all values of
    elements are numbered from 1 on in their order, those of the result are, too: some readers know
    no other values. So are nodes of a binary file of version 4.1 that nothing else refers to.

    Raises
    ------
    NotRewritable    the arrays are other ones, there are ghost elements, or nodes came to parts,
                     or went that correspond to others
    """
    file = gmsh_read.parsed(source.read_bytes())
    nodes, runs, entities = gmsh_read.tables(file)
    _expect_known(nodes, change)
    if _plain(file, nodes) and (change.number < 0).any():
        raise NotRewritable
    parts = gmsh_read.values_of(file)
    rows = _emitted(runs, _homes(runs, nodes, entities, change), change)
    if _ordered("ElementData", np.concatenate([run.numbers for run in runs]), parts):
        rows = _in_order(rows)
    nodes = nodes._replace(counted=change.renumbered and _countable(file) and _ordered(
        "NodeData", nodes.tags, parts))
    exchanged = any(row.fresh.any() or len(row.fresh) != len(run.numbers)
                    for run, row in zip(runs, rows, strict=True))
    if exchanged and file.all("GhostElements"):
        msg = "it has ghost elements, and elements were exchanged"
        raise NotRewritable(msg)
    edits, lost = gmsh_nodes.places(file, nodes, change, parted=bool(
        file.all("PartitionedEntities")))
    if exchanged or nodes.counted:
        edits += _elements(file, runs, rows, nodes, change)
    for name, part in zip(gmsh_read.array_names(parts), parts, strict=True):
        if part.kind == "NodeData":
            edits += gmsh_nodes.values(file, nodes, part, change,
                                       np.asarray(change.after.point_data[name]))
            continue
        more, gone = _element_values(file, part, runs, rows, change.after.cell_data.get(name, []))
        edits += more
        if gone:
            lost.append(f"values of {name!r} at the corners of {gone} elements that were exchanged")
    target.write_bytes(edited(file.data, edits))
    return lost


def _plain(file: File, nodes: Nodes) -> bool:
    """Whether a binary file of version 2 has no more than nodes from 1 on, cells, values and links.

    meshio reads no others of that kind: gaps between numbers are closed by writing it anew.
    """
    known = PLAIN | {"Periodic"}
    return (file.version == "2" and not file.text and {s.name for s in file.sections} <= known
            and np.array_equal(nodes.tags, np.arange(1, len(nodes.tags) + 1)))


def _countable(file: File) -> bool:
    """Whether readers may expect nodes from 1 on, and no section but known ones has their tags."""
    known = PLAIN | {"Entities", "ElementNodeData", "InterpolationScheme"}
    return file.version == "4.1" and not file.text and {s.name for s in file.sections} <= known


def _expect_known(nodes: Nodes, change: Change) -> None:
    """See whether the mesh has the nodes, arrays, names and sets of the file.

    Raises
    ------
    NotRewritable    it has others
    """
    before, after = change.before, change.after
    paired = [np.ravel(entry[3]) for entry in before.gmsh_periodic or ()]
    if paired and (change.number[np.concatenate(paired)] < 0).any():
        msg = "nodes went that correspond to others"
        raise NotRewritable(msg)
    if len(before.gmsh_periodic or ()) > len(after.gmsh_periodic or ()):
        msg = "periodic links were left out"
        raise NotRewritable(msg)
    if not np.array_equal(nodes.points, before.points):
        msg = "its nodes are in another order than were read"
        raise NotRewritable(msg)
    for what in ("point_data", "cell_data", "field_data", "cell_sets"):
        if set(getattr(before, what)) != set(getattr(after, what)):
            msg = f"the {what.replace('_', ' ')} are other ones than those of the file"
            raise NotRewritable(msg)
    same = all(np.array_equal(value, after.field_data[name])
               for name, value in before.field_data.items())
    for i, rows in enumerate(change.cells):
        size = len(before.cells[i].data)
        for name, members in before.cell_sets.items():
            if name != BOUNDS:
                same &= np.array_equal(_mask(members[i], size)[rows],
                                       _mask(after.cell_sets[name][i], len(rows)))
        for name in gmsh_tables.TAGS:
            if name in before.cell_data:
                same &= np.array_equal(np.asarray(before.cell_data[name][i])[rows],
                                       after.cell_data[name][i])
    if not same:
        msg = "its groups or entities are other ones than those of the file"
        raise NotRewritable(msg)


def _mask(members: Any, size: int) -> NDArray[np.bool_]:
    """Truth of the cells of a block that are in a set."""
    inside = np.zeros(size, dtype=np.bool_)
    given = np.asarray([] if members is None else members)
    inside[given if given.dtype == np.bool_ else given.astype(np.int64)] = True
    return inside


def _homes(
    runs: list[Run], nodes: Nodes, entities: Any, change: Change
) -> list[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Block and row in the mesh of every element of every run.

    Raises
    ------
    NotRewritable    elements do not belong to the cells that were read
    """
    before = change.before
    tags = before.cell_data.get(ENTITY)
    own = [_entity(run, entities) for run in runs]
    out: list[Any] = [None] * len(runs)
    for kind in sorted({run.kind for run in runs}):
        name = gmsh_read.type_names()[kind]
        blocks = [i for i, block in enumerate(before.cells) if block.type == name]
        size = [len(before.cells[i].data) for i in blocks]
        cells = np.concatenate([np.column_stack([
            np.zeros(len(before.cells[i].data)) if tags is None else tags[i],
            np.sort(before.cells[i].data, axis=1)]) for i in blocks]).astype(np.int64)
        which = [k for k, run in enumerate(runs) if run.kind == kind]
        records = np.concatenate([np.column_stack([
            own[k] if tags is not None else np.zeros(len(own[k]), dtype=np.int64),
            np.sort(gmsh_read.places(nodes.tags, runs[k].nodes, "node"), axis=1)]) for k in which])
        if np.array_equal(cells, records):
            found = np.arange(len(cells))
        else:
            both, inverse = np.unique(np.concatenate([cells, records]), axis=0, return_inverse=True)
            inverse = inverse.ravel()
            home = np.full(len(both), -1, dtype=np.int64)
            home[inverse[: len(cells)]] = np.arange(len(cells))
            found = home[inverse[len(cells):]]
            if (found < 0).any() or len(np.unique(inverse[: len(cells)])) != len(cells):
                msg = f"its elements of type {name} are other ones than were read"
                raise NotRewritable(msg)
        block = np.repeat(blocks, size)[found]
        row = np.concatenate([np.arange(count) for count in size])[found]
        ends = np.cumsum([len(runs[k].numbers) for k in which])[:-1]
        for k, one, two in zip(which, np.split(block, ends), np.split(row, ends), strict=True):
            out[k] = one.astype(np.int64), two
    return out


def _entity(run: Run, entities: Any) -> NDArray[np.int64]:
    """Entity of each element as the mesh has it."""
    if run.entity[0] or run.entity[1]:
        return np.full(len(run.numbers), gmsh_read.parent(entities, *run.entity)[1])
    return run.tags[:, 1] if run.tags.shape[1] > 1 else np.zeros(len(run.numbers), dtype=np.int64)


def _emitted(runs: list[Run], homes: Any, change: Change) -> list[_Rows]:
    """Say which elements take the place of those of every run, with their numbers."""
    order = [np.argsort(rows, kind="stable") for rows in change.cells]
    ranked = [rows[one] for rows, one in zip(change.cells, order, strict=True)]
    differs = [change.exchanged(i) for i in range(len(order))]
    last = max((int(run.numbers.max(initial=0)) for run in runs), default=0)
    out = []
    for run, (block, row) in zip(runs, homes, strict=True):
        start, count = np.zeros(len(row), np.int64), np.zeros(len(row), np.int64)
        for i in np.unique(block).tolist():
            here = block == i
            start[here] = np.searchsorted(ranked[i], row[here], "left")
            count[here] = np.searchsorted(ranked[i], row[here], "right") - start[here]
        source = np.repeat(np.arange(len(row)), count)
        place = np.arange(len(source)) - np.repeat(np.cumsum(count) - count, count)
        of, at = block[source], start[source] + place
        cell, fresh = np.zeros(len(source), np.int64), np.zeros(len(source), np.bool_)
        for i in np.unique(of).tolist():
            here = of == i
            cell[here] = order[i][at[here]]
            fresh[here] = differs[i][cell[here]]
        # The number goes to the one that is as it was, or else to the first.
        ranks = np.lexsort([place, fresh, source])
        heir = np.zeros(len(source), dtype=np.bool_)
        heir[ranks[np.unique(source[ranks], return_index=True)[1]]] = True
        numbers = np.where(heir, run.numbers[source], 0)
        numbers[~heir] = last + 1 + np.arange((~heir).sum())
        last += int((~heir).sum())
        out.append(_Rows(source, of, cell, numbers, fresh | ~heir))
    return out


def _ordered(kind: str, every: NDArray[np.int64], parts: list[Values]) -> bool:
    """Whether there are values of elements or nodes, and all are numbered from 1 on in order."""
    tags = [part.tags for part in parts if part.kind == kind]
    first = np.arange(1, len(every) + 1)
    return bool(tags) and all(np.array_equal(found, first) for found in (every, *tags))


def _in_order(rows: list[_Rows]) -> list[_Rows]:
    """The same rows, with numbers from 1 on."""
    first = 1 + np.cumsum([0, *(len(row.numbers) for row in rows)])
    return [row._replace(numbers=start + np.arange(len(row.numbers)))
            for start, row in zip(first.tolist(), rows, strict=False)]


def _elements(
    file: File, runs: list[Run], rows: list[_Rows], nodes: Nodes, change: Change
) -> list[Edit]:
    """What replaces the elements, and their numbers and counts."""
    section = file.all("Elements")[0]
    numbers = np.concatenate([row.numbers for row in rows])
    told = [len(numbers)]
    if file.version[0] == "4":
        told = [len(runs), len(numbers), int(numbers.min()), int(numbers.max())]
    edits: list[Edit] = [
        (start, stop, text)
        for value, (start, stop) in zip(told, gmsh_tables.heads(file, section), strict=False)
        if (text := _number(file, value)) != file.data[start:stop]]
    every = gmsh_nodes.tags(nodes, change)
    for run, row in zip(runs, rows, strict=True):
        same = not row.fresh.any() and np.array_equal(row.numbers, run.numbers)
        if same and not nodes.counted:
            continue
        made = np.concatenate([
            np.asarray(change.after.cells[i].data)[row.cell[row.block == i]]
            for i in np.unique(row.block).tolist()] or [np.zeros((0, run.nodes.shape[1]), int)])
        back = np.concatenate([np.flatnonzero(row.block == i)
                               for i in np.unique(row.block).tolist()] or [np.zeros(0, int)])
        cells = np.zeros_like(made)
        cells[back] = made
        cells = every[cells[:, _order(run, row, cells, nodes, change)]]
        if run.at[1]:
            edits.append((*run.at, coded(
                file, len(row.numbers), file.long if file.version[0] == "4" else "i4")))
        edits.append(_run(file, run, row, cells))
    return edits


def _number(file: File, value: int) -> bytes:
    """A count in the head of a section; that of versions before 4 is always text."""
    return str(value).encode() if file.version[0] != "4" else coded(file, value, file.long)


def _order(run: Run, row: _Rows, cells: NDArray[Any], nodes: Nodes, change: Change) -> list[int]:
    """Places in the mesh, whose cells take that of the run, of the nodes of an element of the file.

    Raises
    ------
    NotRewritable    elements have their nodes in different orders
    """
    kept = ~row.fresh
    if not kept.any():
        name = change.after.cells[int(row.block[0])].type if len(row.block) else ""
        return gmsh_read.order_of(name, run.nodes.shape[1])
    given = change.number[gmsh_read.places(nodes.tags, run.nodes[row.source[kept]], "node")]
    mesh = cells[kept]
    order = [mesh[0].tolist().index(v) for v in given[0].tolist()]
    if not np.array_equal(mesh[:, order], given):
        msg = "elements of an entity have their nodes in other orders than were read"
        raise NotRewritable(msg)
    return order


def _run(file: File, run: Run, row: _Rows, cells: NDArray[Any]) -> Edit:
    """What replaces the rows of a run."""
    start, stop = int(run.rows[0, 0]), int(run.rows[-1, 1])
    if not file.text:
        kind = np.dtype(file.long if file.version == "4.1" else "i4").newbyteorder(file.order)
        head = np.tile([run.kind, 1, run.tags.shape[1]], (len(cells), 0 if run.at[1] else 1))
        table = np.column_stack([head, row.numbers, run.tags[row.source], cells])
        return start, stop, table.astype(kind).tobytes()
    end = b"\r\n" if b"\r\n" in file.data[stop: stop + 2] else b"\n"
    before = {"1": [run.kind], "2": [run.kind, run.tags.shape[1]]}.get(file.version, [])
    behind = [cells.shape[1]] if file.version == "1" else []
    tags = run.tags.tolist()
    lines = [
        " ".join(map(str, [number, *before, *tags[k], *behind, *nodes])).encode() if new
        else file.data[run.rows[k, 0]: run.rows[k, 1]]
        for k, number, new, nodes in zip(
            row.source.tolist(), row.numbers.tolist(),
            (row.fresh | (row.numbers != run.numbers[row.source])).tolist(), cells.tolist(),
            strict=True)]
    if not lines:
        while file.data[stop: stop + 1] in (b"\r", b"\n"):
            stop += 1
    return start, stop, end.join(lines)


def _element_values(
    file: File, part: Values, runs: list[Run], rows: list[_Rows], values: Any
) -> tuple[list[Edit], int]:
    """What replaces values of elements; of corners also the number of elements without them."""
    old = np.concatenate([run.numbers[row.source] for run, row in zip(runs, rows, strict=True)])
    new = np.concatenate([row.numbers for row in rows])
    fresh = np.concatenate([row.fresh for row in rows])
    block = np.concatenate([row.block for row in rows])
    cell = np.concatenate([row.cell for row in rows])
    order = np.argsort(old, kind="stable")
    start = np.searchsorted(old[order], part.tags, "left")
    count = np.searchsorted(old[order], part.tags, "right") - start
    source = np.repeat(np.arange(len(count)), count)
    at = order[np.repeat(start, count) + np.arange(len(source))
               - np.repeat(np.cumsum(count) - count, count)]
    corners = part.kind == "ElementNodeData"
    gone = int(fresh[at].sum()) if corners else 0
    if corners:
        source, at = source[~fresh[at]], at[~fresh[at]]
        differs = np.zeros(len(at), dtype=np.bool_)
        own = part.values[source]
    else:
        width = part.values.shape[1]
        own = np.full((len(at), width), np.nan)
        for i in np.unique(block[at]).tolist():
            here = block[at] == i
            own[here] = np.asarray(values[i])[cell[at[here]]].reshape(-1, width)
        own = np.where(np.isnan(own), part.values[source], own)
        differs = ((own != part.values[source]) & ~np.isnan(own)).any(axis=1)
    strange = np.flatnonzero(~np.isin(part.tags, np.concatenate([run.numbers for run in runs])))
    if len(source) + len(strange) == len(count) and not differs.any() and np.array_equal(
            new[at], part.tags[source]):
        return [], gone
    lines = []
    for k, number, other, found in zip(source.tolist(), new[at].tolist(), differs.tolist(),
                                       own.tolist(), strict=True):
        line = file.data[part.rows[k, 0]: part.rows[k, 1]]
        head = coded(file, number, "i4")
        if file.text:
            rest = b" ".join(repr(x).encode() for x in found) if other else line.split(None, 1)[1]
            line = line if number == part.tags[k] and not other else head + b" " + rest
        else:
            line = head + (b"".join(coded(file, x, "f8") for x in found) if other else line[4:])
        lines.append(line)
    lines += [file.data[start:stop] for start, stop in part.rows[strange].tolist()]
    start_, stop = (int(part.rows[0, 0]), int(part.rows[-1, 1])) if len(part.rows) else (0, 0)
    end = b"" if not file.text else b"\r\n" if file.data[stop: stop + 2] == b"\r\n" else b"\n"
    return [(*part.at, str(len(lines)).encode()), (start_, stop, end.join(lines))], gone
