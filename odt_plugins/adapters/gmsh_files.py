"""Gmsh's files of version 4.1, and files that only Gmsh itself can read.

meshio reads neither partitioned files, nor some entities with a physical group and some without,
nor data of some elements only, and writes entities without nodes of their own as if they were not
there. Node and element tables are read here; https://gmsh.info/doc/texinfo/gmsh.html#MSH-file-format
"""

from __future__ import annotations

import tempfile
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.errors import DataNotKeptWarning, MeshFileError, warn

PHYSICAL, ENTITY, NODE_ENTITY = "gmsh:physical", "gmsh:geometrical", "gmsh:dim_tags"
PARTITION, BOUNDS = "gmsh:partition", "gmsh:bounding_entities"

BOOKKEEPING = (NODE_ENTITY, BOUNDS)
"""Arrays and sets that mean something to Gmsh alone."""


class Entity(NamedTuple):
    """What the file says of an entity: its groups and bounds, and where it comes from."""

    physical: list[int]
    bounds: list[int]
    parent: tuple[int, int] | None = None
    partition: int = 0


def read(file: BinaryIO) -> Any:
    """Read a file of any version of Gmsh's; version 4.1 here, others by meshio.

    Parameters
    ----------
    file : binary file

    Returns
    -------
    meshio.Mesh    a block for each entity and type of cells; cell data ``gmsh:partition`` where
                   the file is partitioned

    Raises
    ------
    MeshFileError  nodes or elements are referred to that are not there
    Exception      anything at all, on a file that is broken
    """
    common, header = _inner("common"), _inner("main")
    line = file.readline().decode().strip()
    while line == "$Comments":
        common._fast_forward_to_end_block(file, "Comments")
        line = file.readline().decode().strip()
    if line != "$MeshFormat":
        msg = "it does not begin with $MeshFormat"
        raise MeshFileError(msg)
    version, size, text = header._read_header(file)
    if version in ("4", "4.1"):
        mesh = _read_41(file, bool(text), int(size))
    else:
        file.seek(0)
        mesh = header.read_buffer(file)
    mesh.info = {"text": bool(text)}
    return mesh


def _inner(name: str) -> Any:
    """Module of meshio's reader and writer of Gmsh's files."""
    return import_module(f"meshio.gmsh.{name}")


def _read_41(file: BinaryIO, text: bool, size: int) -> Any:
    common, other = _inner("common"), _inner("_gmsh41")
    index = np.dtype(f"u{size}")
    take = partial(_take, file, text)
    entities: dict[tuple[int, int], Entity] = {}
    names: dict[str, Any] = {}
    data: dict[str, list[Any]] = {"NodeData": [], "ElementData": []}
    nodes, blocks, periodic = None, None, None
    while True:
        line, ended = common._fast_forward_over_blank_lines(file)
        if ended:
            break
        section = line.strip().removeprefix("$")
        if line[0] != "$":
            msg = f"it has the line {line.strip()[:60]!r} between sections"
            raise MeshFileError(msg)
        if section == "PhysicalNames":
            common._read_physical_names(file, names)
            continue
        if section == "Periodic":
            periodic = other._read_periodic(file, text, size)
            continue
        if section in ("Entities", "PartitionedEntities"):
            entities |= _entities(take, index, section != "Entities")
        elif section == "Nodes":
            nodes = _nodes(take, index)
        elif section == "Elements":
            blocks = _elements(take, index)
        elif section in data:
            data[section].append(_data(file, text))
        elif section not in ("GhostElements", "Parametrizations", "InterpolationScheme",
                             "Comments"):
            warn(f"the section {section} is not read", DataNotKeptWarning)
        common._fast_forward_to_end_block(file, section)
    if nodes is None or blocks is None:
        msg = "it has no nodes or no elements"
        raise MeshFileError(msg)
    mesh = _mesh(nodes, blocks, entities, names, data)
    mesh.gmsh_periodic = periodic
    return mesh


def _take(file: BinaryIO, text: bool, dtype: Any, count: int) -> NDArray[Any]:
    """Read numbers.

    Raises
    ------
    EOFError    the file ends before
    """
    values = np.fromfile(file, dtype, count, sep=" " if text else "")  # type: ignore[call-overload]
    if len(values) != count:
        msg = "it ends too early"
        raise EOFError(msg)
    return np.asarray(values)


def _entities(take: Any, index: Any, partitioned: bool) -> dict[tuple[int, int], Entity]:
    out = {}
    if partitioned:
        _, ghosts = take(index, 2).tolist()
        take("i4", 2 * ghosts)
    for dim, count in enumerate(take(index, 4).tolist()):
        for _ in range(count):
            (tag,) = take("i4", 1).tolist()
            parent, partition = None, 0
            if partitioned:
                parent = tuple(take("i4", 2).tolist())
                partition = int(take("i4", take(index, 1)[0]).tolist()[0])
            take("f8", 6 if dim else 3)
            physical = take("i4", take(index, 1)[0]).tolist()
            bounds = take("i4", take(index, 1)[0]).tolist() if dim else []
            out[dim, tag] = Entity(physical, bounds, parent, partition)
    return out


def _nodes(take: Any, index: Any) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Coordinates (n, 3), tags (n,) and entities (n, 2) of the nodes."""
    points, tags, entities = [], [], []
    for _ in range(take(index, 4)[0]):
        dim, tag, parametric = take("i4", 3).tolist()
        count = int(take(index, 1)[0])
        width = 3 + (dim if parametric else 0)
        tags.append(take(index, count))
        points.append(take("f8", width * count).reshape(count, width)[:, :3])
        entities.append(np.tile([dim, tag], (count, 1)))
    return np.concatenate(points), np.concatenate(tags), np.concatenate(entities)


def _elements(take: Any, index: Any) -> list[tuple[int, int, str, NDArray[Any]]]:
    """Dimension, tag, type and rows (element, nodes ...) of every block."""
    from meshio._common import num_nodes_per_cell
    from meshio.gmsh.common import _gmsh_to_meshio_type

    out = []
    for _ in range(take(index, 4)[0]):
        dim, tag, number = take("i4", 3).tolist()
        kind = _gmsh_to_meshio_type[number]
        width = 1 + num_nodes_per_cell[kind]
        count = int(take(index, 1)[0])
        out.append((dim, tag, kind, take(index, width * count).reshape(count, width)))
    return out


def _data(file: BinaryIO, text: bool) -> tuple[str, NDArray[Any], NDArray[Any]]:
    """Name, tags (k,) and values (k, ...) of data of nodes or elements."""
    def number() -> int:
        return int(file.readline())

    names = [file.readline().decode().strip().strip('"') for _ in range(number())]
    for _ in range(number()):
        file.readline()
    integers = [number() for _ in range(number())]
    width, count = integers[1], integers[2]
    if text:
        rows = _take(file, text, "f8", count * (1 + width)).reshape(count, 1 + width)
        tags, values = rows[:, 0].astype(np.int64), rows[:, 1:]
    else:
        records = _take(file, text, np.dtype([("tag", "i4"), ("value", "f8", (width,))]), count)
        tags, values = records["tag"].astype(np.int64), records["value"]
    return names[0], tags, values[:, 0] if width == 1 else values


def _places(tags: NDArray[Any], wanted: NDArray[Any], what: str) -> NDArray[np.int64]:
    """Where the wanted tags stand among all.

    Raises
    ------
    MeshFileError    one is not there
    """
    order = np.argsort(tags, kind="stable")
    place = np.minimum(np.searchsorted(tags[order], wanted), len(tags) - 1)
    found = order[place] if len(tags) else place
    bad = ~(tags[found] == wanted) if len(tags) else np.ones(wanted.shape, dtype=np.bool_)
    if bad.any():
        msg = f"it refers to {what} {wanted[bad].ravel()[0]}, which is not there"
        raise MeshFileError(msg)
    return found


def _mesh(nodes: Any, blocks: Any, entities: Any, names: Any, data: Any) -> Any:
    from meshio import CellBlock, Mesh
    from meshio.gmsh.common import _gmsh_to_meshio_order

    points, tags, of_nodes = nodes
    none = Entity([], [])
    part = [np.full(len(rows), entities.get((dim, tag), none).partition)
            for dim, tag, _, rows in blocks]
    if any(values.any() for values in part):
        blocks, part = _without_cuts(blocks, part, entities)
    found = [entities.get((dim, tag), none) for dim, tag, _, _ in blocks]
    cells: list[Any] = [
        CellBlock(kind, _gmsh_to_meshio_order(kind, _places(tags, rows[:, 1:], "node")))
        for _, _, kind, rows in blocks]
    size = [len(rows) for _, _, _, rows in blocks]

    def of_blocks(values: list[int]) -> list[NDArray[Any]]:
        return [np.full(count, value) for count, value in zip(size, values, strict=True)]

    parents = [_parent(entities, dim, tag)[1] for dim, tag, _, _ in blocks]
    cell_data: Any = {ENTITY: of_blocks(parents)}
    if any(entity.physical for entity in found):
        groups = [entity.physical[0] if entity.physical else 0 for entity in found]
        cell_data = {PHYSICAL: of_blocks(groups)} | cell_data
    if any(values.any() for values in part):
        cell_data[PARTITION] = part
    own = np.array([entities.get(key, none).parent or key for key in map(tuple, of_nodes.tolist())])
    sets: dict[str, list[Any]] = {
        name: [np.arange(count if group in entity.physical and of == dim else 0)
               for count, entity, (dim, _, _, _) in zip(size, found, blocks, strict=True)]
        for name, (group, of) in names.items()}
    if entities and PARTITION not in cell_data:
        sets[BOUNDS] = [np.array(entity.bounds) for entity in found]
    point_data: Any = {name: _spread(tags, given, values, "node")
                       for name, given, values in data["NodeData"]}
    ids = np.concatenate([rows[:, 0] for _, _, _, rows in blocks])
    ends = np.cumsum(size)[:-1]
    for name, given, values in data["ElementData"]:
        cell_data[name] = np.split(_spread(ids, given, values, "element"), ends)
    return Mesh(points, cells, point_data | {NODE_ENTITY: own}, cell_data, names, None, sets)


def _parent(entities: Any, dim: int, tag: int) -> tuple[int, int]:
    """Entity of the model of which a part is; between parts it is the part itself."""
    entity = entities.get((dim, tag))
    return entity.parent if entity and entity.parent and entity.parent[0] == dim else (dim, tag)


def _without_cuts(blocks: Any, part: Any, entities: Any) -> tuple[list[Any], list[Any]]:
    """Join the blocks that are parts of one entity."""
    joined: dict[Any, list[int]] = {}
    for k, (dim, tag, kind, _) in enumerate(blocks):
        joined.setdefault((*_parent(entities, dim, tag), kind), []).append(k)
    return ([(*blocks[ks[0]][:3], np.concatenate([blocks[k][3] for k in ks]))
             for ks in joined.values()],
            [np.concatenate([part[k] for k in ks]) for ks in joined.values()])


def _spread(
    tags: NDArray[Any], given: NDArray[Any], values: NDArray[Any], what: str
) -> NDArray[Any]:
    """Values of all nodes or elements; those of which the file tells none are not a number."""
    out = np.full((len(tags), *values.shape[1:]), np.nan)
    out[_places(tags, given, what)] = values
    return out


def write(path: Path, mesh: Any, binary: bool) -> None:
    """Write version 4.1, with the groups and bounds of every entity.

    Parameters
    ----------
    path : path
    mesh : meshio.Mesh    cells of one block may be of several entities; without tags of entities
                          all cells of a dimension are of one
    binary : bool         or as text
    """
    common, inner = _inner("common"), _inner("_gmsh41")
    parts = _parts(mesh)
    blocks, tags, sets = parts.cells, parts.cell_data[ENTITY], parts.cell_sets
    of_cells = [(block.dim, int(tag[0])) for block, tag in zip(blocks, tags, strict=True)]
    of_nodes = parts.point_data.get(NODE_ENTITY)
    if of_nodes is None:
        of_nodes = _lowest(len(parts.points), blocks, of_cells)
    own = {key: k for k, key in enumerate(of_cells)}
    names = {name: value for name, value in mesh.field_data.items() if is_group(value)}
    groups = parts.cell_data.get(PHYSICAL)
    with path.open("wb") as file:
        file.write(b"$MeshFormat\n4.1 %d 8\n" % binary)
        if binary:
            file.write(np.array([1], dtype=np.int32).tobytes() + b"\n")
        file.write(b"$EndMeshFormat\n")
        if names:
            common._write_physical_names(file, names)
        put = partial(_put, file, binary)
        file.write(b"$Entities\n")
        there = sorted(set(of_cells) | set(map(tuple, of_nodes.tolist())))
        known = set(there)
        put([[sum(dim == d for dim, _ in there) for d in range(4)]], "u8")
        for dim, tag in there:
            k = own.get((dim, tag))
            inside = np.flatnonzero((of_nodes == (dim, tag)).all(axis=1))
            if k is not None:
                inside = np.unique(blocks[k].data)
            low, high = parts.points[inside].min(axis=0), parts.points[inside].max(axis=0)
            own_groups = [] if k is None else _groups(names, groups, sets, dim, k)
            bounds = [] if k is None or BOUNDS not in sets else [
                tag for tag in sets[BOUNDS][k] if (dim - 1, abs(int(tag))) in known]
            put([tag], "i4")
            put([*low, *high] if dim else low, "f8")
            put([len(own_groups)], "u8")
            put(own_groups, "i4")
            if dim:
                put([len(bounds)], "u8")
                put(bounds, "i4")
            file.write(b"" if binary else b"\n")
        file.write(b"\n$EndEntities\n")
        inner._write_nodes(file, parts.points, blocks, {NODE_ENTITY: of_nodes}, ".16e", binary)
        inner._write_elements(file, blocks, {ENTITY: tags}, binary)
        if mesh.gmsh_periodic is not None:
            inner._write_periodic(file, mesh.gmsh_periodic, ".16e", binary)
        for name, values in parts.point_data.items():
            if name != NODE_ENTITY:
                common._write_data(file, "NodeData", name, values, binary)
        for name, arrays in parts.cell_data.items():
            if name not in (PHYSICAL, ENTITY):
                common._write_data(file, "ElementData", name, np.concatenate(arrays), binary)


def _put(file: BinaryIO, binary: bool, values: Any, dtype: str) -> None:
    array = np.asarray(values, dtype=dtype).ravel()
    file.write(array.tobytes() if binary else b"".join(b"%s " % str(v).encode()
                                                       for v in array.tolist()))


def is_group(value: Any) -> bool:
    """Whether field data are tag and dimension of a physical group."""
    array = np.asarray(value)
    return array.shape == (2,) and array.dtype.kind in "iu" and 0 <= array[1] <= 3


def _groups(names: Any, groups: Any, sets: Any, dim: int, k: int) -> list[int]:
    """Tags of the physical groups of a block: its own one, and those with all of its cells."""
    out = [] if groups is None or not len(groups[k]) or not groups[k][0] else [int(groups[k][0])]
    for name, (tag, of) in names.items():
        if of == dim and name in sets and tag not in out and sets[name][k]:
            out.append(int(tag))
    return out


def _lowest(n: int, blocks: Any, of_cells: Any) -> NDArray[np.int64]:
    """Entity of lowest dimension that has a cell at each node."""
    out = np.tile(max(of_cells), (n, 1))
    for dim, tag, k in sorted(((*key, k) for k, key in enumerate(of_cells)), reverse=True):
        out[blocks[k].data.ravel()] = dim, tag
    return out


def _parts(mesh: Any) -> Any:
    """Part the blocks so that each has cells of one entity and one group; sets become truths.

    Entities that have cells of several groups are parted too: those of other groups get new tags.
    """
    from meshio import Mesh

    tags = mesh.cell_data.get(ENTITY) or [np.ones(len(block.data), int) for block in mesh.cells]
    groups = mesh.cell_data.get(PHYSICAL)
    unused = max([0, *(int(np.max(tag)) for tag in tags if len(tag))]) + 1
    taken: dict[tuple[int, int], int] = {}
    cells: list[Any] = []
    rows: list[tuple[int, Any, int]] = []
    for i, block in enumerate(mesh.cells):
        group = np.zeros(len(block.data), int) if groups is None else np.asarray(groups[i])
        keys, inverse = np.unique(np.stack([tags[i], group], axis=1), axis=0, return_inverse=True)
        for j, (tag, own) in enumerate(keys.tolist()):
            if taken.setdefault((block.dim, tag), own) != own:
                tag, unused = unused, unused + 1
                taken[block.dim, tag] = own
            rows.append((i, np.flatnonzero(inverse.ravel() == j), tag))
            cells.append((block.type, block.data[rows[-1][1]]))
    cell_data = {name: [np.asarray(values[i])[row] for i, row, _ in rows]
                 for name, values in mesh.cell_data.items()}
    cell_data[ENTITY] = [np.full(len(row), tag) for _, row, tag in rows]
    out = Mesh(np.zeros((len(mesh.points), 3)), cells, dict(mesh.point_data), cell_data)
    out.points[:, : mesh.points.shape[1]] = mesh.points
    for name, members in mesh.cell_sets.items():
        if name == BOUNDS:
            out.cell_sets[name] = [() if members[i] is None else members[i] for i, _, _ in rows]
            continue
        inside = [np.zeros(len(block.data), bool) for block in mesh.cells]
        for mask, member in zip(inside, members, strict=True):
            if member is not None and len(member):
                mask[np.asarray(member)] = True
        out.cell_sets[name] = [bool(inside[i][row].all()) for i, row, _ in rows]
    return out


def installed() -> bool:
    """Say whether Gmsh is there."""
    return find_spec("gmsh") is not None


def translate(path: Path) -> Any:
    """Let Gmsh read a file, and read what it writes as version 4.1.

    Raises
    ------
    Exception    anything at all, on a file that is broken
    """
    import gmsh

    with tempfile.TemporaryDirectory() as folder:
        target = str(Path(folder) / "mesh.msh")
        gmsh.initialize(interruptible=False)
        try:
            for name, value in (("General.Terminal", 0), ("Mesh.SaveAll", 1), ("Mesh.Binary", 1),
                                ("Mesh.MshFileVersion", 4.1), ("PostProcessing.SaveMesh", 0)):
                gmsh.option.setNumber(name, value)
            gmsh.merge(str(path))
            gmsh.write(target)
            for view in gmsh.view.getTags():
                gmsh.view.write(view, target, append=True)
        finally:
            gmsh.finalize()
        with open(target, "rb") as file:
            return read(file)
