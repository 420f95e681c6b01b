"""Kratos' model parts, .mdpa: properties, conditions, parts and data stay as they are."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.change import Change, NotRewritable
from odt_plugins.adapters.formats.decks import (
    HELD,
    ORDERS,
    REMARKS,
    Edit,
    Names,
    Row,
    as_lines,
    edited,
    fits,
    indices,
    joint_labels,
    numbers,
    order_of,
    real,
    rows_of,
    unread,
)
from odt_plugins.adapters.formats.titles import decoded
from odt_plugins.errors import MeshFileError

LABEL = "mdpa:part"
"""Array of labels of cells, by their properties and the parts that they are in."""

ENTITIES = {"Elements": 2, "Conditions": 2, "Geometries": 1}
"""Sections of cells, and the words before their nodes."""

FLAT = {2: "line", 3: "triangle", 4: "quad", 6: "triangle6", 8: "quad8", 9: "quad9"}

SOLID = {2: "line", 3: "triangle", 4: "tetra", 5: "pyramid", 6: "wedge", 8: "hexahedron",
         10: "tetra10", 13: "pyramid13", 15: "wedge15", 20: "hexahedron20"}
"""Types of cells by their numbers of nodes, in the plane or of surfaces, and in space."""

KNOWN = re.compile("Nodes|(Nodal|Elemental|Conditional)Data|Properties|Table|ModelPartData|"
                   "Elements|Conditions|Geometries|(SubModelPart|Mesh)(Data|Tables|Properties|"
                   "Nodes|Elements|Conditions|Geometries)?")
"""Sections in which it is known where nodes are named."""


class Section(NamedTuple):
    """The rows between Begin and End, with the kind, the words after it, and the part around."""

    kind: str
    name: str
    part: str
    rows: list[Row]


class Block(NamedTuple):
    """Cells of one type and name: their section's kind, type, rows of points, and lines."""

    entity: str
    kind: str
    cells: NDArray[np.int64]
    rows: list[Row]


class Parts(NamedTuple):
    """A file, read: sections, points with their rows, blocks, and what cannot be optimised."""

    data: bytes
    sections: list[Section]
    nodes: list[Row]
    number: dict[tuple[str, int], int]
    blocks: list[Block]
    held: list[int]
    others: list[str]


def read(path: Path) -> Any:
    """Read nodes, elements, conditions and geometries; the parts are sets of cells and of points.

    Returns
    -------
    meshio.Mesh      nodal data of all nodes are arrays of points; `held` are nodes that have to
                     stay: those of other cells, and of data of some nodes

    Raises
    ------
    MeshFileError    a section does not end, or refers to what is not there
    """
    from meshio import Mesh

    parts = _parsed(path.read_bytes())
    points = np.array([numbers(row.words[1:4]) for row in parts.nodes]).reshape(-1, 3)
    sets: dict[str, list[Any]] = {}
    at = [{int(row.words[0]): r for r, row in enumerate(block.rows)} for block in parts.blocks]
    point_sets: dict[str, Any] = {}
    for section in parts.sections:
        entity = _listed(section)
        if not entity or not section.part:
            continue
        ids = [int(word) for row in section.rows for word in row.words]
        if entity == "Nodes":
            nodes = [parts.number["", i] for i in ids if ("", i) in parts.number]
            point_sets[section.part] = np.unique(np.array(nodes, dtype=np.int64))
        else:
            rows = sets.setdefault(section.part, [np.zeros(0, np.int64) for _ in parts.blocks])
            for b, block in enumerate(parts.blocks):
                if block.entity == entity:
                    found = [at[b][i] for i in ids if i in at[b]]
                    rows[b] = np.union1d(rows[b], found).astype(np.int64)
    held = set(parts.held)
    point_data: dict[str, Any] = {}
    for section in parts.sections:
        if section.kind != "NodalData":
            continue
        nodes = [parts.number["", int(row.words[0])] for row in section.rows]
        if sorted(nodes) != list(range(len(points))):
            held |= set(nodes)
        elif all(len(row.words) == 3 and _is_real(row.words[2]) for row in section.rows):
            point_data[section.name] = np.zeros(len(points))
            point_data[section.name][nodes] = numbers([row.words[2] for row in section.rows])
    cells: list[Any] = [(block.kind, block.cells) for block in parts.blocks]
    mesh = Mesh(points, cells, point_data, _labels(parts, sets), cell_sets=sets,
                point_sets=point_sets)
    mesh.info = unread("the sections", (
        s.kind for s in parts.sections if s.rows and not _listed(s) and s.kind != "Nodes"
        and s.kind not in ENTITIES and s.name not in point_data))
    setattr(mesh, HELD, np.array(sorted(held), dtype=np.int64))
    if parts.others:
        setattr(mesh, REMARKS, [
            f"cells of type {', '.join(parts.others)} stay as they are with their nodes"])
    return mesh


def rewrite(source: Path, target: Path, change: Change) -> list[str]:
    """Replace nodes that moved, cells that were exchanged, and the parts and data that follow.

    Raises
    ------
    NotRewritable    nodes went that are named
    """
    parts = _parsed(source.read_bytes())
    data = parts.data
    names = Names(change, parts.number, [
        (block.entity, [int(row.words[0]) for row in block.rows]) for block in parts.blocks],
        _kinds(parts, change), {entity: max((int(row.words[0]) for s in parts.sections
                                             if s.kind == entity for row in s.rows), default=0)
                                for entity in ENTITIES})
    held = set(np.asarray(getattr(change.before, HELD)).tolist())
    if {parts.number[name] for name in names.lost} & held:
        msg = "nodes went that it refers to"
        raise NotRewritable(msg)
    edits = _nodes(parts, names, change)
    origin: dict[tuple[str, int], int] = {}
    for b, block in enumerate(parts.blocks):
        first, after = ENTITIES[block.entity], np.asarray(change.after.cells[b].data)
        for r, (row, slot) in enumerate(zip(block.rows, names.slots[b], strict=True)):
            old = int(block.rows[r].words[0])
            origin |= {(block.entity, names.of[b][i]): old for i in slot}
            lines = [{0: names.of[b][i], **dict(enumerate(names.nodes[after[i]].tolist(), first))}
                     for i in slot]
            edits.append(as_lines(data, row, lines))
    for section in parts.sections:
        entity = _listed(section)
        if section.kind == "NodalData":
            drop = {n for _, n in names.lost}
            values = change.after.point_data.get(section.name)
            edits += _values(data, section, drop, names, change, values)
        elif section.kind == "ElementalData":
            edits += _carried(data, section, origin, {
                int(row.words[0]) for block in parts.blocks if block.entity == "Elements"
                for row in block.rows})
        elif entity and section.rows:
            joined = _nodes_of(change, section.part, names) if entity == "Nodes" else set()
            edits += _members(data, section, entity, names, joined)
    edits = [edit for edit in edits if data[edit[0]: edit[1]] != edit[2]]
    data = edited(data, edits)
    target.write_bytes(_counted(data) if change.renumbered and _countable(parts) else data)
    known = change.before.point_data
    stale = [s.name for s in parts.sections if s.kind == "NodalData" and s.name not in known
             and len(s.rows) == len(parts.nodes) and change.moved.any()]
    text = f"nodal data {', '.join(stale)} where nodes moved (those of before there)"
    return [text] if stale else []


def _countable(parts: Parts) -> bool:
    """Whether nodes are numbered from 1 on, in their order, and it is known where they are named.

    Some readers take the order of nodes for their numbers.
    """
    counted = [number for _, number in parts.number] == [*range(1, len(parts.nodes) + 1)]
    return counted and all(KNOWN.fullmatch(section.kind) for section in parts.sections)


def _counted(data: bytes) -> bytes:
    """A file with its nodes numbered from 1 on, in their order."""
    parts = _parsed(data)
    edits = []
    for section in parts.sections:
        first, stop = ENTITIES.get(section.kind, 0), None
        if section.kind in ("Nodes", "NodalData"):
            stop = 1
        elif section.kind not in ENTITIES and _listed(section) != "Nodes":
            continue
        for row in section.rows:
            named = enumerate(row.words[first:stop], first)
            edits.append(as_lines(data, row, [
                {i: parts.number["", int(word)] + 1 for i, word in named}]))
    return edited(data, edits)


def _listed(section: Section) -> str:
    """What a section of a part lists: Nodes, Elements, ...; "" where it lists nothing."""
    found = re.fullmatch("(?:SubModelPart|Mesh)(Nodes|Elements|Conditions|Geometries)",
                         section.kind)
    return found[1] if found else ""


def _is_real(word: bytes) -> bool:
    return re.fullmatch(rb"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?", word) is not None


def _parsed(data: bytes) -> Parts:
    sections: list[Section] = []
    stack: list[Section] = []
    for row in rows_of(data, b"//"):
        word = row.words[0].lower()
        if word == b"begin" and len(row.words) > 1:
            name = decoded(b" ".join(row.words[2:]))
            outer = [s.name for s in stack if s.kind == "SubModelPart"]
            stack.append(Section(decoded(row.words[1]), name, ".".join(outer), []))
            sections.append(stack[-1])
        elif word == b"end" and stack:
            stack.pop()
        elif stack:
            stack[-1].rows.append(row)
    if stack or not sections:
        msg = f"it ends within {stack[-1].kind}" if stack else "it has no section"
        raise MeshFileError(msg)
    nodes = [row for s in sections if s.kind == "Nodes" for row in s.rows]
    number = {("", int(row.words[0])): v for v, row in enumerate(nodes)}
    if any(len(row.words) < 4 for row in nodes):
        msg = "it ends within the coordinates of a node"
        raise MeshFileError(msg)
    own = [s for s in sections if s.kind in ENTITIES and s.rows]
    order = order_of(type_of(s.name, s.kind) for s in own)
    found: dict[tuple[str, str, str], list[Row]] = {}
    held: list[int] = []
    others: list[str] = []
    for section in own:
        kind = type_of(section.name, section.kind)
        if kind and fits(kind, order):
            found.setdefault((section.kind, section.name, kind), []).extend(section.rows)
            continue
        others.append(section.name)
        first = ENTITIES[section.kind]
        held += [number["", int(w)] for row in section.rows for w in row.words[first:]]
    at = {i: v for (_, i), v in number.items()}
    blocks = []
    for (entity, _, kind), rows in found.items():
        first = ENTITIES[entity]
        cells = [[at[int(w)] for w in row.words[first:]] for row in rows]
        if len(set(map(len, cells))) != 1 or len(cells[0]) != _width(kind):
            msg = f"a row of {entity} does not have {_width(kind)} nodes"
            raise MeshFileError(msg)
        blocks.append(Block(entity, kind, np.array(cells, dtype=np.int64), rows))
    return Parts(data, sections, nodes, number, blocks, held, list(dict.fromkeys(others)))


def _width(kind: str) -> int:
    known = {name: size for table in (FLAT, SOLID) for size, name in table.items()}
    return known[kind]


def type_of(name: str, entity: str) -> str:
    """Type of the cells of a name, such as SmallDisplacementElement3D4N; "" where it tells none."""
    found = re.search(r"([23])D(\d+)N?(?!.*\dD\d)", name)
    if found is None:
        return ""
    flat = found[1] == "2" or entity == "Conditions" or re.search(
        r"(?i)shell|membrane|surface|quadrilateral|triangle|face|plate", name)
    if found[2] == "3" and (re.search("(?i)line", name) or (
            entity == "Conditions" and found[1] == "2")):
        return ""
    return (FLAT if flat else SOLID).get(int(found[2]), "")


def _labels(parts: Parts, sets: dict[str, list[Any]]) -> dict[str, Any]:
    """Labels of cells by their properties, and by parts that part the mesh."""
    kinds = [block.kind for block in parts.blocks]
    main = next((kind for kind in ORDERS if kind in kinds), "")
    chosen = [b for b, kind in enumerate(kinds) if kind == main]
    if not chosen:
        return {}
    width = {"tetra": 4, "tetra10": 4}.get(main, 3)
    cells = np.concatenate([parts.blocks[b].cells[:, :width] for b in chosen])
    given = [int(row.words[1]) if ENTITIES[parts.blocks[b].entity] > 1 else 0
             for b in chosen for row in parts.blocks[b].rows]
    inside = {name: np.concatenate([np.isin(np.arange(len(parts.blocks[b].rows)), rows[b])
                                    for b in chosen]) for name, rows in sets.items()}
    label = joint_labels([np.array(given)], inside, cells)
    if label is None:
        return {}
    ends = np.cumsum([0, *(len(parts.blocks[b].rows) for b in chosen)]).tolist()
    return {LABEL: [label[ends[chosen.index(b)]: ends[chosen.index(b) + 1]] if b in chosen else
                    np.zeros(len(block.rows), dtype=np.int64)
                    for b, block in enumerate(parts.blocks)]}


def _kinds(parts: Parts, change: Change) -> list[list[Any]]:
    """By block and row the property and the parts of every cell."""
    kinds: list[list[Any]] = [[row.words[1] for row in block.rows] if ENTITIES[block.entity] > 1
                              else [b""] * len(block.rows) for block in parts.blocks]
    for k, rows in enumerate(change.before.cell_sets.values()):
        for b, own in enumerate(rows):
            for r in own.tolist():
                kinds[b][r] = (kinds[b][r], k)
    return kinds


def _nodes(parts: Parts, names: Names, change: Change) -> list[Edit]:
    """What replaces the rows of nodes."""
    places: Any = np.asarray(change.after.points).tolist()
    lines: dict[int, list[dict[int, Any]]] = {parts.number[name]: [] for name in names.lost}
    for v in np.flatnonzero(change.moved & (change.points >= 0)).tolist():
        lines[int(change.points[v])] = [dict(enumerate(map(real, places[v]), 1))]
    last = len(parts.nodes) - 1
    for v in np.flatnonzero(change.points < 0).tolist():
        words = {0: int(names.nodes[v]), **dict(enumerate(map(real, places[v]), 1))}
        lines.setdefault(last, [{}]).append(words)
    return [as_lines(parts.data, parts.nodes[v], rows) for v, rows in lines.items()]


def _values(
    data: bytes, section: Section, drop: set[int], names: Names, change: Change, values: Any
) -> list[Edit]:
    """What replaces the rows of nodal data: values that differ, and those of new nodes.

    Of data that are no array of points only the rows of nodes that went are left out.
    """
    if values is None:
        return [as_lines(data, row, []) for row in section.rows if int(row.words[0]) in drop]
    old = np.asarray(change.before.point_data[section.name])
    at = {int(names.nodes[v]): v for v in range(len(change.points))}
    lines: list[list[dict[int, Any]]] = []
    for row in section.rows:
        number = int(row.words[0])
        v = at.get(number, -1)
        same = v < 0 or old[change.points[v]] == values[v]
        lines.append([] if number in drop else [{} if same else {2: real(float(values[v]))}])
    lines[-1] += [{0: int(names.nodes[v]), 1: 0, 2: real(float(values[v]))}
                  for v in np.flatnonzero(change.points < 0).tolist()]
    return [as_lines(data, row, parts) for row, parts in zip(section.rows, lines, strict=True)]


def _carried(
    data: bytes, section: Section, origin: dict[tuple[str, int], int], known: set[int]
) -> list[Edit]:
    """What replaces the rows of data of elements: every element has those of that it comes from."""
    strange = next((row for row in section.rows if not row.words[0].isdigit()), None)
    if strange is not None:
        msg = f"{section.kind} {section.name} has {strange.words[0]!r} in place of a number"
        raise NotRewritable(msg)
    rows = {int(row.words[0]): row for row in section.rows}
    of: dict[int, list[int]] = {}
    for (entity, number), old in origin.items():
        if entity == "Elements" and old in rows:
            of.setdefault(old, []).append(number)
    return [as_lines(data, row, [{0: number} for number in of.get(old, [])])
            for old, row in rows.items() if old in known]


def _nodes_of(change: Change, part: str, names: Names) -> set[int]:
    """Numbers of the nodes of a part: of its elements and conditions if it has some."""
    rows = zip(change.after.cells, change.after.cell_sets.get(part, ()), strict=False)
    of_cells = [np.asarray(block.data)[indices(own)].ravel() for block, own in rows]
    if sum(map(len, of_cells)):
        return set(names.nodes[np.concatenate(of_cells)].tolist())
    return names.of_set(part, "")


def _members(
    data: bytes, section: Section, entity: str, names: Names, joined: set[int]
) -> list[Edit]:
    """What replaces the rows of a part: without those that went, and new ones behind the last."""
    own = {int(word) for row in section.rows for word in row.words}
    if entity == "Nodes":
        drop = {number for _, number in names.lost}
        add = sorted(joined - own)
    else:
        drop = {number for kind, number in names.gone if kind == entity}
        add = [new for number in sorted(own) for new in names.fresh.get((entity, number), ())]
    edits = []
    for k, row in enumerate(section.rows):
        kept = [word for word in row.words if int(word) not in drop]
        if len(kept) == len(row.words):
            lines: list[dict[int, Any]] = [{}]
        else:
            blank = {i: b"" for i in range(len(kept), len(row.words))}
            lines = [dict(enumerate(kept)) | blank] if kept else []
        more = add if k == len(section.rows) - 1 else []
        rest = {i: b"" for i in range(1, len(row.words))}
        edits.append(as_lines(data, row, [*lines, *({0: n} | rest for n in more)]))
    return edits
