"""XDMF files: the grids of one mesh, such as steps of time and tags of its cells and facets."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.decks import UNREAD
from odt_plugins.adapters.formats.exodus_tables import step_names
from odt_plugins.adapters.formats.xdmf_items import (
    Document,
    form_of,
    found,
    items_of,
    local,
    parse,
    resolved,
    stored,
    unnamed,
    values_of,
)
from odt_plugins.errors import DataNotKeptWarning, MeshFileError, warn

TYPES = {
    "vertex": (0, 1, 0x1, "polyvertex"), "line": (1, 2, 0x2, "polyline"),
    "polygon": (2, 0, 0x3, "polygon"), "triangle": (2, 3, 0x4, "triangle"),
    "quad": (2, 4, 0x5, "quadrilateral"), "tetra": (3, 4, 0x6, "tetrahedron"),
    "pyramid": (3, 5, 0x7, "pyramid"), "wedge": (3, 6, 0x8, "wedge"),
    "hexahedron": (3, 8, 0x9, "hexahedron"), "line3": (1, 3, 0x22, "edge_3"),
    "quad9": (2, 9, 0x23, "quadrilateral_9 quad_9"),
    "triangle6": (2, 6, 0x24, "triangle_6 tri_6"),
    "quad8": (2, 8, 0x25, "quadrilateral_8 quad_8"),
    "tetra10": (3, 10, 0x26, "tetrahedron_10 tet_10"), "pyramid13": (3, 13, 0x27, "pyramid_13"),
    "wedge15": (3, 15, 0x28, "wedge_15"), "wedge18": (3, 18, 0x29, "wedge_18"),
    "hexahedron20": (3, 20, 0x30, "hexahedron_20 hex_20"),
    "hexahedron24": (3, 24, 0x31, "hexahedron_24 hex_24"),
    "hexahedron27": (3, 27, 0x32, "hexahedron_27 hex_27"),
}
"""Types of cells: dimension, nodes, number in a list of mixed cells, and names in files."""

NAMED = {name: kind for kind, (*_, names) in TYPES.items() for name in names.split()}

NUMBERED = {number: kind for kind, (_, _, number, _) in TYPES.items()}

COUNTED = {1: "vertex", 2: "line", 3: "polygon"}
"""Types of mixed cells that have their number of nodes behind them."""

NAMED_DATA = 5
"""Most data without a place in the XML that are named."""

AXES = {"xyz": 1, "xy": 1, "x_y_z": 3, "x_y": 2}
"""Forms of coordinates, and their number of items."""


class Grid(NamedTuple):
    """A grid: its name, that of its series, where it has cells and points, its arrays and sets."""

    name: str
    series: str
    topology: Any
    geometry: Any
    attributes: list[Any]
    sets: list[Any]


class Cells(NamedTuple):
    """Cells of a grid, in the order of the file.

    Attributes
    ----------
    grid : Grid
    parts : list of (str, array)     type and rows of nodes of cells of one type that follow
    where : (m, 2) int               block of the mesh, and row there, of every cell
    """

    grid: Grid
    parts: list[tuple[str, NDArray[np.int64]]]
    where: NDArray[np.int64]


class Array(NamedTuple):
    """An array: its title, the element that holds it, and its cells, or None of points."""

    title: str
    element: Any
    cells: Cells | None


class Members(NamedTuple):
    """A set: its title, the element that holds it, and its cells, or None of points."""

    title: str
    element: Any
    cells: Cells | None


class Layout(NamedTuple):
    """What a file holds.

    Attributes
    ----------
    points : (n, d) array
    geometries : list                elements that hold them
    blocks : list of (str, array)    type and rows of nodes of all cells
    cells : list of Cells            cells of the grids, each element that holds some once
    sets : list of Members           of points and of cells
    arrays : list of Array           of points and of cells
    whole : dict                     elements of the arrays of whole grids, by their names
    unknown : list of str            what is none of these
    """

    points: NDArray[Any]
    geometries: list[Any]
    blocks: list[tuple[str, NDArray[np.int64]]]
    cells: list[Cells]
    sets: list[Members]
    arrays: list[Array]
    whole: dict[str, Any]
    unknown: list[str]


def read(path: Path) -> Any:
    """Read all grids of a file as one mesh, arrays of several steps with the step in brackets.

    Cells and facets of grids beside that of most dimensions are tags: those that the mesh has take
    their arrays, facets that it lacks become blocks. Cells without a value have 0, or one less than
    the least value where that is taken, and no number in arrays of floats.

    Raises
    ------
    MeshFileError    it has grids of several meshes, or parts that do not fit together

    Warns
    -----
    DataNotKeptWarning    arrays and sets of edges or faces, and finite-element functions, are not
                          read
    """
    from meshio import Mesh

    doc = parse(path)
    layout = layout_of(doc)
    for name in layout.unknown:
        warn(f"{name} is not read", DataNotKeptWarning)
    point_data: dict[str, Any] = {}
    cell_data: dict[str, Any] = {}
    for array in layout.arrays:
        values = values_of(doc, items_of(doc, array.element)[0])
        count = len(layout.points) if array.cells is None else len(array.cells.where)
        if len(values) != count:
            msg = f"its array {array.title!r} declares {count} values and holds {len(values)}"
            raise MeshFileError(msg)
        if array.cells is None:
            point_data[array.title] = values
        else:
            cell_data[array.title] = _on_blocks(values, array.cells.where, layout.blocks)
    whole = {name: values_of(doc, items_of(doc, element)[0])
             for name, element in layout.whole.items()}
    blocks: list[Any] = [*layout.blocks]
    point_sets: dict[str, Any] = {}
    cell_sets: dict[str, Any] = {}
    for own in layout.sets:
        members = members_of(doc, own)
        if own.cells is None:
            point_sets[own.title] = members
            continue
        where = own.cells.where[members]
        cell_sets[own.title] = [np.sort(where[where[:, 0] == b, 1]) for b in range(len(blocks))]
    mesh = Mesh(layout.points, blocks, point_data, cell_data, _groups(doc) | whole, point_sets,
                cell_sets)
    mesh.info = {UNREAD: _besides(doc)}
    return mesh


def layout_of(doc: Document) -> Layout:
    """Find points, cells and arrays of all grids of a file.

    Raises
    ------
    MeshFileError    its grids have different points, or cells that are none of one mesh
    """
    grids: list[Grid] = []
    for domain in doc.root:
        if local(domain) == "Domain":
            for element in domain:
                _collect(doc, resolved(doc, element), "", grids)
    grids = [grid for grid in grids if grid.geometry is not None and grid.topology is not None]
    if not grids:
        msg = "it holds no grid with points and cells"
        raise MeshFileError(msg)
    geometries, points = _points(doc, grids)
    cells = _distinct(doc, grids, len(points))
    first = max(cells, key=lambda own: max(map(_dim, own.parts), default=0))
    dim = max(map(_dim, first.parts), default=0)
    blocks = list(first.parts)
    cells = [_located(own, blocks, dim, first) for own in cells]
    arrays, whole, unknown = _arrays(doc, grids, cells)
    sets, more = _sets(doc, grids, cells, len(points))
    return Layout(points, geometries, blocks, cells, sets, arrays, whole, unknown + more)


def _collect(doc: Document, element: Any, series: str, grids: list[Grid]) -> None:
    """Add the uniform grids of an element, in the order of the file."""
    if local(element) != "Grid":
        return
    kind = element.get("GridType", element.get("Type", "Uniform")).lower()
    name = element.get("Name") or series or "the grid"
    children: list[Any] = []
    for child in element:
        if local(child) != "include":
            children.append(resolved(doc, child))
        elif child.get("href"):
            msg = f"it includes the file {child.get('href')}; expected one file, try joining them"
            raise MeshFileError(msg)
        else:
            kinds: dict[str, Any] = {}
            for other in found(doc, child.get("xpointer", "")):
                kinds.setdefault(local(other), other)
            children += kinds.values()
    if kind in ("collection", "tree"):
        temporal = element.get("CollectionType", "").lower() == "temporal"
        for child in children:
            _collect(doc, child, name if temporal else series, grids)
        return
    if kind != "uniform":
        msg = f"its grid {name!r} is of the type {element.get('GridType')}, which is not read"
        raise MeshFileError(msg)

    def first(what: str) -> Any:
        return next((child for child in children if local(child) == what), None)

    grids.append(Grid(name, series or name, first("Topology"), first("Geometry"),
                      [child for child in children if local(child) == "Attribute"],
                      [child for child in children if local(child) == "Set"]))


def _same_place(doc: Document, one: Any, two: Any) -> bool:
    """Whether two elements have the same numbers, without reading them where that is seen."""
    if one is two:
        return True
    ours, others = items_of(doc, one), items_of(doc, two)
    return len(ours) == len(others) and all(
        a is b or (form_of(a) == form_of(b) == "hdf" and not len(a) and not len(b)
                   and stored(doc, a) == stored(doc, b))
        for a, b in zip(ours, others, strict=True))


def _points(doc: Document, grids: list[Grid]) -> tuple[list[Any], NDArray[Any]]:
    """Elements of coordinates, and the points that they all have."""
    elements: list[Any] = []
    points = None
    for grid in grids:
        if any(_same_place(doc, grid.geometry, other) for other in elements):
            continue
        here = coordinates(doc, grid.geometry)
        if points is None:
            points = here
        elif not np.array_equal(points, here):
            msg = (f"its grids {grids[0].name!r} and {grid.name!r} have different points; expected "
                   f"grids of one mesh that does not move, try a file for each of them")
            raise MeshFileError(msg)
        elements.append(grid.geometry)
    return elements, np.zeros((0, 3)) if points is None else points


def coordinates(doc: Document, geometry: Any) -> NDArray[Any]:
    """Places (n, dimension) of an element.

    Raises
    ------
    MeshFileError    they are of a structured grid, or no table
    """
    kind = geometry.get("GeometryType", geometry.get("Type", "XYZ"))
    items = items_of(doc, geometry)
    if AXES.get(kind.lower()) != len(items):
        msg = f"it has points of the type {kind} in {len(items)} items; expected XYZ or XY in one"
        raise MeshFileError(msg)
    table = [values_of(doc, item) for item in items]
    if len(table) > 1:
        return np.stack([axis.ravel() for axis in table], axis=1)
    width = len(kind)
    if table[0].size % width:
        msg = f"it holds {table[0].size} coordinates, which are no points of {width}"
        raise MeshFileError(msg)
    return table[0].reshape(-1, width)


def _distinct(doc: Document, grids: list[Grid], count: int) -> list[Cells]:
    """Cells of the grids, each element of them once."""
    out: list[Cells] = []
    for grid in grids:
        if any(_same_place(doc, grid.topology, own.grid.topology) for own in out):
            continue
        parts, _ = cells_of(doc, grid.topology)
        for kind, rows in parts:
            bad = rows[(rows < 0) | (rows >= count)]
            if bad.size:
                msg = f"a {kind} of {grid.name!r} refers to point {bad[0]} of {count}"
                raise MeshFileError(msg)
        out.append(Cells(grid, parts, np.zeros((0, 2), dtype=np.int64)))
    return out


def offset_of(topology: Any) -> int:
    """Number of the first point."""
    return int(topology.get("BaseOffset", topology.get("Offset", 0)))


def cells_of(
    doc: Document, topology: Any
) -> tuple[list[tuple[str, NDArray[np.int64]]], list[int | None]]:
    """Type and rows of cells of one type that follow each other, and their numbers where mixed.

    Raises
    ------
    MeshFileError    they are of a structured grid or of an unknown type
    """
    name = topology.get("TopologyType", topology.get("Type", ""))
    items = items_of(doc, topology)
    if len(items) != 1:
        msg = (f"it has cells of the type {name} in {len(items)} items; expected cells with their "
               f"nodes, try another form than a structured grid")
        raise MeshFileError(msg)
    data = values_of(doc, items[0]).astype(np.int64)
    if name.lower() == "mixed":
        parts, codes = _mixed(data.ravel())
        return [(kind, rows - offset_of(topology)) for kind, rows in parts], codes
    kind = NAMED.get(name.lower())
    if kind is None:
        msg = f"it has cells of the type {name}, which is not read"
        raise MeshFileError(msg)
    width = TYPES[kind][1] or int(
        topology.get("NodesPerElement", data.shape[-1] if data.ndim > 1 else 0))
    if not width or data.size % width or (data.ndim > 1 and data.shape[-1] != width):
        msg = f"its cells of the type {name} have {data.shape} nodes, which are not {width} each"
        raise MeshFileError(msg)
    return [(kind, data.reshape(-1, width) - offset_of(topology))], [None]


def _mixed(data: NDArray[np.int64]) -> tuple[list[tuple[str, NDArray[np.int64]]], list[int | None]]:
    """Take a list of types and nodes apart; vertices may be without their number of nodes."""
    for counted in (COUNTED, {key: kind for key, kind in COUNTED.items() if key != 1}):
        parts: list[tuple[str, NDArray[np.int64]]] = []
        codes: list[int | None] = []
        at = 0
        while at < len(data):
            code = int(data[at])
            kind = NUMBERED.get(code, "")
            head = data[at: at + 1 + (code in counted)]
            width = int(head[-1]) if code in counted else TYPES.get(kind, (0, 0))[1]
            size = len(head) + width
            rows = data[at: at + (len(data) - at) // size * size].reshape(-1, size)
            ends = np.flatnonzero((rows[:, : len(head)] != head).any(axis=1))
            rows = rows[: ends[0]] if ends.size else rows
            if not kind or width < 1 or not len(rows) or (code == 2 and width != 2):
                break
            parts.append((kind, rows[:, len(head):]))
            codes.append(code if len(head) == 1 else -code)
            at += rows.size
        if at == len(data):
            return parts, codes
    msg = f"its mixed cells end within one, or have one of unknown type {data[at]}"
    raise MeshFileError(msg)


def _dim(part: tuple[str, Any]) -> int:
    return TYPES[part[0]][0]


def _located(
    own: Cells, blocks: list[tuple[str, NDArray[np.int64]]], dim: int, first: Cells
) -> Cells:
    """Find the cells of a grid among the blocks, to which facets that are not there are added."""
    if own is first:
        where = [np.stack([np.full(len(rows), b), np.arange(len(rows))], axis=1)
                 for b, (_, rows) in enumerate(own.parts)]
        return own._replace(where=np.concatenate([np.zeros((0, 2), dtype=np.int64), *where]))
    where = []
    for kind, rows in own.parts:
        place = np.full((len(rows), 2), -1, dtype=np.int64)
        for b, (other, table) in enumerate(blocks):
            if other == kind and table.shape[1] == rows.shape[1] and len(table):
                at = _rows_in(rows, table)
                new = (place[:, 0] < 0) & (at >= 0)
                place[new] = np.stack([np.full(int(new.sum()), b), at[new]], axis=1)
        missing = place[:, 0] < 0
        if missing.any() and _dim((kind, rows)) >= dim:
            msg = (f"its grids {first.grid.name!r} and {own.grid.name!r} have different cells; "
                   f"expected grids of one mesh, try a file for each of them")
            raise MeshFileError(msg)
        if missing.any():
            place[missing] = np.stack([np.full(int(missing.sum()), len(blocks)),
                                       np.arange(int(missing.sum()))], axis=1)
            blocks.append((kind, rows[missing]))
        where.append(place)
    return own._replace(where=np.concatenate([np.zeros((0, 2), dtype=np.int64), *where]))


def _rows_in(rows: NDArray[np.int64], table: NDArray[np.int64]) -> NDArray[np.int64]:
    """Row of a table with the same nodes in any order, -1 where there is none."""
    both = np.sort(np.concatenate([table, rows]), axis=1)
    _, key = np.unique(both, axis=0, return_inverse=True)
    key = key.ravel()
    place = np.full(int(key.max(initial=-1)) + 1, -1, dtype=np.int64)
    place[key[: len(table)][::-1]] = np.arange(len(table))[::-1]
    return np.asarray(place[key[len(table):]])


def _arrays(
    doc: Document, grids: list[Grid], cells: list[Cells]
) -> tuple[list[Array], dict[str, Any], list[str]]:
    """Arrays of all grids by their titles, those of whole grids, and what is none."""
    series: dict[tuple[bool, str, str], list[tuple[Any, Cells | None]]] = {}
    whole: dict[str, Any] = {}
    unknown: dict[str, None] = {}
    seen: set[Any] = set()
    for grid in grids:
        own = next(c for c in cells if _same_place(doc, grid.topology, c.grid.topology))
        for element in grid.attributes:
            name, center = element.get("Name", "data"), element.get("Center", "Node").lower()
            if element in seen:
                continue
            seen.add(element)
            if element.get("ItemType") or center not in ("node", "cell", "grid"):
                what = element.get("ItemType") or f"array of each {center}"
                unknown[f"{name!r}, {what},"] = None
                continue
            if len(items_of(doc, element)) != 1:
                msg = f"its array {name!r} holds {len(items_of(doc, element))} items, not one"
                raise MeshFileError(msg)
            if center == "grid":
                whole.setdefault(name, element)
                continue
            series.setdefault((center == "cell", grid.series, name), []).append(
                (element, own if center == "cell" else None))
    taken = [(of_cells, name) for of_cells, _, name in series]
    out: list[Array] = []
    for (of_cells, home, name), steps in series.items():
        title = name if taken.count((of_cells, name)) == 1 else f"{name} ({home})"
        out += [Array(step, element, own) for step, (element, own) in
                zip(step_names(title, len(steps)), steps, strict=True)]
    return out, whole, list(unknown)


def members_of(doc: Document, own: Members) -> NDArray[np.int64]:
    """Points, or places of cells in their grid, of a set.

    Raises
    ------
    MeshFileError    it has several items
    """
    items = items_of(doc, own.element)
    if len(items) != 1:
        msg = f"its set {own.title!r} holds {len(items)} items, not one"
        raise MeshFileError(msg)
    return np.asarray(values_of(doc, items[0]).ravel().astype(np.int64))


def _sets(
    doc: Document, grids: list[Grid], cells: list[Cells], points: int
) -> tuple[list[Members], list[str]]:
    """Sets of points and cells of all grids, those of steps that differ with numbers; and others.

    Raises
    ------
    MeshFileError    one has members that are not there
    """
    found: dict[tuple[bool, str], list[tuple[Members, NDArray[np.int64]]]] = {}
    unknown: dict[str, None] = {}
    seen: set[Any] = set()
    for grid in grids:
        own = next(c for c in cells if _same_place(doc, grid.topology, c.grid.topology))
        for element in grid.sets:
            name = element.get("Name", "set")
            kind = element.get("SetType", element.get("Type", "Node")).lower()
            if element in seen:
                continue
            seen.add(element)
            unknown |= {f"{child.get('Name', 'data')!r}, array of the set {name!r},": None
                        for child in element if local(child) == "Attribute"}
            if kind not in ("node", "cell"):
                unknown[f"{name!r}, set of each {kind},"] = None
                continue
            one = Members(name, element, own if kind == "cell" else None)
            members = members_of(doc, one)
            count = len(own.where) if kind == "cell" else points
            bad = members[(members < 0) | (members >= count)]
            if bad.size:
                msg = f"its set {name!r} refers to {kind} {bad[0]} of {count}"
                raise MeshFileError(msg)
            found.setdefault((kind == "cell", name), []).append((one, members))
    out = []
    for (_, name), entries in found.items():
        same = all(np.array_equal(entries[0][1], members) for _, members in entries)
        titles = [name] * len(entries) if same else step_names(name, len(entries))
        out += [own._replace(title=title) for title, (own, _) in zip(titles, entries, strict=True)]
    return out, list(unknown)


def _besides(doc: Document) -> list[str]:
    """What a file says that its mesh does not hold."""
    told = {element.get("Name", "") for element in doc.root.iter() if local(
        element) == "Information" and not (element.text or "").strip().startswith("<")}
    out = [f"the information {', '.join(sorted(told))}"] if told else []
    if any(local(element) == "Time" for element in doc.root.iter()):
        out.append("the times of its steps")
    for file, names in unnamed(doc).items():
        more = f" and {len(names) - NAMED_DATA} more" if len(names) > NAMED_DATA else ""
        out.append(f"the data {', '.join(names[:NAMED_DATA])}{more} of {file}, which its XML does "
                   f"not name")
    return out


def _on_blocks(
    values: NDArray[Any], where: NDArray[np.int64], blocks: list[tuple[str, NDArray[np.int64]]]
) -> list[NDArray[Any]]:
    """Values of some of the cells as an array of all."""
    missing: Any = np.nan
    if values.dtype.kind != "f":
        missing = 0 if not (values == 0).any() else values.min() - 1
        if values.dtype.kind == "u" and missing < 0:
            missing = values.max() + 1
    out = []
    for b, (_, rows) in enumerate(blocks):
        array = np.full((len(rows), *values.shape[1:]), missing, dtype=values.dtype)
        here = where[:, 0] == b
        array[where[here, 1]] = values[here]
        out.append(array)
    return out


def _groups(doc: Document) -> dict[str, Any]:
    """Names, numbers and dimensions of groups as meshio writes them beside the arrays."""
    out: dict[str, Any] = {}
    for element in doc.root.iter():
        text = (element.text or "").strip()
        if local(element) != "Information" or not text.startswith("<"):
            continue
        try:
            entries = list(ElementTree.fromstring(text))
        except ElementTree.ParseError:
            continue
        for entry in entries:
            if {"key", "dim"} <= set(entry.attrib) and (entry.text or "").strip().isdigit():
                out[entry.attrib["key"]] = np.array(
                    [int((entry.text or "").strip()), int(entry.attrib["dim"])])
    return out
