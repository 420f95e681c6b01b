"""Gmsh's files of all versions as meshes: by tags of nodes and elements, whatever their order."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats import gmsh_tables
from odt_plugins.adapters.formats.decks import UNREAD
from odt_plugins.adapters.formats.gmsh_groups import UNNAMED, without_copies
from odt_plugins.adapters.formats.gmsh_tables import (
    BOUNDS,
    DATA,
    ENTITY,
    NODE_ENTITY,
    PARTITION,
    PHYSICAL,
    File,
    Numbers,
    Run,
    Section,
    Values,
)
from odt_plugins.adapters.kinds import from_gmsh, nodes_of
from odt_plugins.errors import MeshFileError

KNOWN = ("MeshFormat", "Comments", "PhysicalNames", "Entities", "PartitionedEntities", "Nodes",
         "Elements", "Periodic", "NodeData", "ElementData", "InterpolationScheme")
"""Sections of which a mesh tells what they hold."""


class Entity(NamedTuple):
    """What the file says of an entity: its groups and bounds, and where it comes from."""

    physical: list[int]
    bounds: list[int]
    parent: tuple[int, int] | None = None
    partition: int = 0


def read(path: Path) -> Any:
    """Read a file of any version of Gmsh's.

    Returns
    -------
    meshio.Mesh    in version 4 a block for each entity and type of cells; cell data
                   ``gmsh:partition`` where the file is partitioned; views of several steps are
                   arrays with the number of the step behind their name; ``info`` has whether it is
                   text, and the sections that are not read

    Raises
    ------
    MeshFileError  nodes or elements are referred to that are not there
    Exception      anything at all, on a file that is broken
    """
    file = parsed(path.read_bytes())
    # A number that is none would become an index.
    with np.errstate(invalid="raise"):
        found, runs, entities = tables(file)
        own = values_of(file)
    data: dict[str, list[Any]] = {kind: [] for kind in DATA}
    for name, part in zip(array_names(own), own, strict=True):
        values = part.values
        data[part.kind].append((name, part.tags, values[:, 0] if values.shape[1] == 1 else values))
    names = gmsh_tables.names(file)
    if file.version in ("1", "2"):
        mesh = _old_mesh(found, runs, names, data)
    else:
        mesh = _mesh((found.points, found.tags, found.entities), _blocks(runs), entities, names,
                     data)
    mesh.gmsh_periodic = _periodic(file, found.tags)
    unread = [f"the section {s.name}" for s in file.sections
              if s.name not in KNOWN and s.name != "ElementNodeData"]
    if file.all("PartitionedEntities"):
        unread.append(f"the section PartitionedEntities, of which cells have {PARTITION!r}")
    unread += [f"data of the corners of elements {name!r}" for name, part in
               zip(array_names(own), own, strict=True) if part.kind == "ElementNodeData"]
    mesh.info = {"text": file.text, UNREAD: list(dict.fromkeys(unread))}
    return without_copies(mesh)


def parsed(data: bytes) -> File:
    """Find the sections of a file; a mesh that is there again with every view is one.

    Gmsh appends it so, with all elements or with those in groups.
    """
    file = gmsh_tables.parsed(data)
    meshes: list[list[Section]] = []
    for section in file.sections:
        if section.name == "MeshFormat":
            meshes.append([])
        if meshes and section.name in gmsh_tables.MESH:
            meshes[-1].append(section)
    meshes = [own for own in meshes if {"Nodes", "Elements"} <= {s.name for s in own}]
    if len(meshes) < 2:
        return file
    read = [_numbered(file, own) for own in meshes]
    most = max(range(len(read)), key=lambda k: sum(map(len, read[k])))
    if not all(one[key] == two.get(key) for part in read for one, two in
               zip(part, read[most], strict=True) for key in one):
        return file
    values = [section for section in file.sections if section.name not in gmsh_tables.MESH]
    return gmsh_tables.parsed(gmsh_tables.put_first(file, meshes[most], values))


def _numbered(file: File, sections: list[Section]) -> tuple[dict[Any, Any], dict[Any, Any]]:
    """Places of nodes by their tags, and nodes of elements, by their numbers if values have these.

    Gmsh numbers the elements of version 2 anew where it leaves some out.
    """
    own = {section.name: section for section in sections}
    found = gmsh_tables.nodes(file, own["Nodes"])
    by_number = bool(file.all("ElementData") or file.all("ElementNodeData"))
    runs = gmsh_tables.elements(file, own["Elements"], _sizes())
    cells = {number if by_number else tuple(nodes): nodes for run in runs
             for number, nodes in zip(run.numbers.tolist(), run.nodes.tolist(), strict=True)}
    return dict(zip(found.tags.tolist(), found.points.tolist(), strict=True)), cells


def tables(file: File) -> tuple[gmsh_tables.Nodes, list[Run], dict[tuple[int, int], Entity]]:
    """Nodes, elements and entities of a file.

    Raises
    ------
    MeshFileError    it has no nodes or no elements, or those of several meshes
    """
    count = [len(file.all(name)) for name in ("Nodes", "Elements")]
    if count != [1, 1]:
        msg = ("it has no nodes or no elements" if 0 in count else
               "it is of several different meshes, try a file for each")
        raise MeshFileError(msg)
    entities: dict[tuple[int, int], Entity] = {}
    for section in file.sections:
        if section.name in ("Entities", "PartitionedEntities"):
            numbers = Numbers(file, section.start, section.stop)
            entities |= _entities(file, numbers, section.name != "Entities")
    return (gmsh_tables.nodes(file, file.all("Nodes")[0]),
            gmsh_tables.elements(file, file.all("Elements")[0], _sizes()), entities)


def values_of(file: File) -> list[Values]:
    """Values of all views at all steps, in the order of the file."""
    return [gmsh_tables.values(file, section) for section in file.sections if section.name in DATA]


def array_names(own: list[Values]) -> list[str]:
    """Name of the array of each section of values: that of the view, several with a number.

    Sections of a view and a step that have other nodes or elements are of one array.
    """
    slots: dict[tuple[str, str], list[tuple[int, set[int]]]] = {}
    places = []
    for part in own:
        there = slots.setdefault((part.kind, part.name), [])
        tags = set(part.tags.tolist())
        k = next((k for k, (step, known) in enumerate(there)
                  if step == part.step and not known & tags), len(there))
        if k == len(there):
            there.append((part.step, set()))
        there[k][1].update(tags)
        places.append(k)
    return [part.name if len(slots[part.kind, part.name]) == 1 else f"{part.name}[{k}]"
            for part, k in zip(own, places, strict=True)]


def type_names() -> dict[int, str]:
    """Types of cells by their numbers."""
    from meshio.gmsh import gmsh_to_meshio_type

    return dict(gmsh_to_meshio_type)


def order_of(name: str, size: int) -> list[int]:
    """Places in a mesh of the nodes of an element of a file."""
    told = from_gmsh(name, np.arange(size)[None])[0].tolist()
    return [told.index(k) for k in range(size)]


def _sizes() -> dict[int, int]:
    """Number of nodes by the number of the type."""
    return {number: nodes_of(kind) or 0 for number, kind in type_names().items()}


def _entities(file: File, numbers: Numbers, parted: bool) -> dict[tuple[int, int], Entity]:
    out = {}
    index, corner = file.long, 3 if file.version == "4.1" else 6
    if parted:
        _, ghosts = numbers.integers(index, 2)
        numbers.take("i4", 2 * ghosts)
    for dim, count in enumerate(numbers.integers(index, 4)):
        for _ in range(count):
            (tag,) = numbers.integers("i4", 1)
            parent, partition = None, 0
            if parted:
                of, own = numbers.integers("i4", 2)
                parent = (of, own)
                partition = numbers.integers("i4", numbers.integers(index, 1)[0])[0]
            numbers.take("f8", 6 if dim else corner)
            physical = numbers.integers("i4", numbers.integers(index, 1)[0])
            bounds = numbers.integers("i4", numbers.integers(index, 1)[0]) if dim else []
            out[dim, tag] = Entity(physical, bounds, parent, partition)
    return out


def _periodic(file: File, tags: NDArray[np.int64]) -> list[Any] | None:
    """Dimension, entities, transformation and pairs of nodes of every link, as meshio has them."""
    sections = file.all("Periodic")
    if not sections:
        return None
    out: list[Any] = []
    for section in sections:
        if file.version == "4.1":
            numbers = Numbers(file, section.start, section.stop)
            for _ in range(numbers.integers(file.long, 1)[0]):
                dim, one, two = numbers.integers("i4", 3)
                affine = numbers.take("f8", numbers.integers(file.long, 1)[0])
                pairs = numbers.take(file.long, 2 * numbers.integers(file.long, 1)[0])
                out.append([dim, (one, two), affine if len(affine) else None, pairs])
            continue
        lines = iter(file.data[section.start: section.stop].split())
        for _ in range(int(next(lines))):
            dim, one, two = (int(next(lines)) for _ in range(3))
            word, affine = next(lines), np.zeros(0)
            if word == b"Affine":
                affine = np.array([float(next(lines)) for _ in range(16)])
                word = next(lines)
            pairs = np.array([int(next(lines)) for _ in range(2 * int(word))], dtype=np.int64)
            out.append([dim, (one, two), affine if len(affine) else None, pairs])
    for entry in out:
        entry[3] = places(tags, entry[3].astype(np.int64).reshape(-1, 2), "node")
    return out


def _blocks(runs: list[Run]) -> list[tuple[int, int, str, NDArray[Any]]]:
    """Dimension, tag, type and rows (element, nodes ...) of every run of version 4."""
    kinds = type_names()
    return [(*run.entity, kinds[run.kind], np.column_stack([run.numbers, run.nodes]))
            for run in runs]


def _old_mesh(found: gmsh_tables.Nodes, runs: list[Run], names: Any, data: Any) -> Any:
    """Make a mesh of a file of version 1 or 2, whose elements have tags."""
    from meshio import CellBlock, Mesh

    kinds = type_names()
    blocks: list[list[Run]] = []
    for run in runs:
        if not blocks or blocks[-1][0].kind != run.kind:
            blocks.append([])
        blocks[-1].append(run)
    cells: list[Any] = [CellBlock(
        kinds[block[0].kind], from_gmsh(
            kinds[block[0].kind],
            places(found.tags, np.concatenate([run.nodes for run in block]), "node")))
        for block in blocks]
    cell_data: dict[str, Any] = {}
    for name, column in ((PHYSICAL, 0), (ENTITY, 1), (PARTITION, 3)):
        if any(run.tags.shape[1] > column for run in runs):
            cell_data[name] = [np.concatenate([
                run.tags[:, column] if run.tags.shape[1] > column else np.zeros(len(run.nodes))
                for run in block]).astype(np.int32) for block in blocks]
    ids = [np.concatenate([run.numbers for run in block]) for block in blocks]
    point_data: Any = _joined(data["NodeData"], found.tags)
    every = np.concatenate(ids) if ids else np.zeros(0, dtype=np.int64)
    ends = np.cumsum([len(numbers) for numbers in ids])[:-1]
    for name, spread in _joined(data["ElementData"], every).items():
        cell_data[name] = np.split(spread, ends)
    return Mesh(found.points, cells, point_data, cell_data, names)


def _joined(data: list[Any], tags: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
    """Arrays of all nodes or elements, some of them told by several sections."""
    out: dict[str, NDArray[Any]] = {}
    for name, given, values in data:
        spread = _spread(tags, given, values)
        if name in out and out[name].shape == spread.shape:
            spread = np.where(np.isnan(spread), out[name], spread)
        out[name] = spread
    return out


def places(tags: NDArray[Any], wanted: NDArray[Any], what: str) -> NDArray[np.int64]:
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

    points, tags, of_nodes = nodes
    none = Entity([], [])
    part = [np.full(len(rows), entities.get((dim, tag), none).partition)
            for dim, tag, _, rows in blocks]
    if any(values.any() for values in part):
        blocks, part = _without_cuts(blocks, part, entities)
    found = [entities.get((dim, tag), none) for dim, tag, _, _ in blocks]
    cells: list[Any] = [
        CellBlock(kind, from_gmsh(kind, places(tags, rows[:, 1:], "node")))
        for _, _, kind, rows in blocks]
    size = [len(rows) for _, _, _, rows in blocks]

    def of_blocks(values: list[int]) -> list[NDArray[Any]]:
        return [np.full(count, value) for count, value in zip(size, values, strict=True)]

    parents = [parent(entities, dim, tag)[1] for dim, tag, _, _ in blocks]
    cell_data: Any = {ENTITY: of_blocks(parents)}
    if any(entity.physical for entity in found):
        groups = [entity.physical[0] if entity.physical else 0 for entity in found]
        cell_data = {PHYSICAL: of_blocks(groups)} | cell_data
    if any(values.any() for values in part):
        cell_data[PARTITION] = part
    own = np.array([entities.get(key, none).parent or key for key in map(tuple, of_nodes.tolist())])
    named = {(int(of), int(group)) for group, of in names.values()}
    beside = {(dim, abs(group)) for entity, (dim, _, _, _) in zip(found, blocks, strict=True)
              for group in entity.physical[1:]} - named
    every = [(name, {(int(of), int(group))}) for name, (group, of) in names.items()]
    every += [(UNNAMED.format(tag), {key for key in beside if key[1] == tag})
              for tag in sorted({tag for _, tag in beside})]
    sets: dict[str, list[Any]] = {
        name: [np.arange(count if groups & {(dim, abs(tag)) for tag in entity.physical} else 0)
               for count, entity, (dim, _, _, _) in zip(size, found, blocks, strict=True)]
        for name, groups in every}
    if entities and PARTITION not in cell_data:
        sets[BOUNDS] = [np.array(entity.bounds) for entity in found]
    point_data: Any = _joined(data["NodeData"], tags)
    ids = np.concatenate([rows[:, 0] for _, _, _, rows in blocks])
    ends = np.cumsum(size)[:-1]
    for name, spread in _joined(data["ElementData"], ids).items():
        cell_data[name] = np.split(spread, ends)
    return Mesh(points, cells, point_data | {NODE_ENTITY: own}, cell_data, names, None, sets)


def parent(entities: Any, dim: int, tag: int) -> tuple[int, int]:
    """Entity of the model of which a part is; between parts it is the part itself."""
    entity = entities.get((dim, tag))
    return entity.parent if entity and entity.parent and entity.parent[0] == dim else (dim, tag)


def _without_cuts(blocks: Any, part: Any, entities: Any) -> tuple[list[Any], list[Any]]:
    """Join the blocks that are parts of one entity."""
    joined: dict[Any, list[int]] = {}
    for k, (dim, tag, kind, _) in enumerate(blocks):
        joined.setdefault((*parent(entities, dim, tag), kind), []).append(k)
    return ([(*blocks[ks[0]][:3], np.concatenate([blocks[k][3] for k in ks]))
             for ks in joined.values()],
            [np.concatenate([part[k] for k in ks]) for ks in joined.values()])


def _spread(tags: NDArray[Any], given: NDArray[Any], values: NDArray[Any]) -> NDArray[Any]:
    """Values of all nodes or elements; those of which the file tells none are not a number.

    Gmsh stores values of elements and nodes that are in no group, too, and not these themselves.
    """
    out = np.full((len(tags), *values.shape[1:]), np.nan)
    known = np.isin(given, tags)
    out[places(tags, given[known], "node or element")] = values[known]
    return out
