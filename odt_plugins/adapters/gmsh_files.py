"""Gmsh's files of version 4.1 as they are written, and files that only Gmsh itself can read.

meshio writes entities without nodes of their own as if they were not there.
"""

from __future__ import annotations

import tempfile
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats import gmsh_read, gmsh_write
from odt_plugins.adapters.formats.gmsh_groups import tag_of
from odt_plugins.adapters.formats.gmsh_tables import BOUNDS, ENTITY, NODE_ENTITY, PHYSICAL
from odt_plugins.adapters.formats.titles import plain, written


def write(path: Path, mesh: Any, binary: bool) -> None:
    """Write version 4.1, with the groups and bounds of every entity.

    Parameters
    ----------
    path : path
    mesh : meshio.Mesh    cells of one block may be of several entities; without tags of entities
                          all cells of a dimension are of one
    binary : bool         or as text
    """
    parts = _parts(mesh)
    blocks, tags, sets = parts.cells, parts.cell_data[ENTITY], parts.cell_sets
    of_cells = [(block.dim, int(tag[0])) for block, tag in zip(blocks, tags, strict=True)]
    of_nodes = parts.point_data.get(NODE_ENTITY)
    if of_nodes is None:
        of_nodes = _lowest(len(parts.points), blocks, of_cells)
    parts.point_data[NODE_ENTITY] = of_nodes
    number = _number_by_entity(parts)
    of_nodes = parts.point_data[NODE_ENTITY]
    own = {key: k for k, key in enumerate(of_cells)}
    names = {name: value for name, value in mesh.field_data.items() if is_group(value)}
    groups = parts.cell_data.get(PHYSICAL)
    with path.open("wb") as file:
        mark = np.array([1], dtype=np.int32).tobytes() if binary else b""
        file.write(gmsh_write.section("MeshFormat", binary, b"4.1 %d 8\n" % binary, mark))
        if names:
            file.write(gmsh_write.names(names))
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
        file.write(gmsh_write.nodes(parts.points, of_nodes, binary))
        file.write(gmsh_write.elements(blocks, tags, binary))
        if mesh.gmsh_periodic is not None:
            file.write(gmsh_write.periodic(
                [(*link, number[np.asarray(pairs, dtype=np.int64)])
                 for *link, pairs in mesh.gmsh_periodic], binary))
        for name, values in parts.point_data.items():
            if name != NODE_ENTITY:
                file.write(gmsh_write.values("NodeData", name, values, binary))
        for name, arrays in parts.cell_data.items():
            if name not in (PHYSICAL, ENTITY):
                file.write(gmsh_write.values("ElementData", name, np.concatenate(arrays), binary))


def _number_by_entity(mesh: Any) -> NDArray[np.int64]:
    """Put nodes in the order of their entities, in which they are written, and number them so.

    meshio takes values at nodes in the order in which these stand in the file.

    Returns
    -------
    number : (n,) int    of every node, now
    """
    entity = mesh.point_data[NODE_ENTITY]
    order = np.lexsort((entity[:, 1], entity[:, 0]))
    number = np.empty(len(order), dtype=np.int64)
    number[order] = np.arange(len(order))
    mesh.points = mesh.points[order]
    mesh.point_data = {name: np.asarray(values)[order] for name, values in mesh.point_data.items()}
    for block in mesh.cells:
        block.data = number[block.data]
    return number


def _put(file: BinaryIO, binary: bool, values: Any, dtype: str) -> None:
    array = np.asarray(values, dtype=dtype).ravel()
    file.write(array.tobytes() if binary else b"".join(b"%s " % str(v).encode()
                                                       for v in array.tolist()))


def is_group(value: Any) -> bool:
    """Whether field data are tag and dimension of a physical group."""
    array = np.asarray(value)
    return array.shape == (2,) and array.dtype.kind in "iu" and 0 <= array[1] <= 3


def same_names(groups: dict[str, Any]) -> list[dict[str, int]]:
    """Titles and tags of the groups of one dimension and one name in their file."""
    found: dict[tuple[str, int], dict[str, int]] = {}
    for title, value in groups.items():
        if is_group(value):
            key = plain(title, groups), int(value[1])
            found.setdefault(key, {})[title] = int(value[0])
    return list(found.values())


def _groups(names: Any, groups: Any, sets: Any, dim: int, k: int) -> list[int]:
    """Tags of the physical groups of a block: its label, and the sets that hold all its cells."""
    out = [] if groups is None or not len(groups[k]) or not groups[k][0] else [int(groups[k][0])]
    for name in sets:
        tag, of = names.get(name, (tag_of(name), dim))
        if of == dim and name != BOUNDS and tag not in (None, *out) and sets[name][k]:
            out.append(int(tag))
    return out


def restore_names(path: Path, field_data: Any) -> None:
    """Give groups of a file the names that they have in files, where several may have the same."""
    names = {name: value for name, value in field_data.items() if is_group(value)}
    known = written(plain(title, names) for title in names)
    data = path.read_bytes()
    head, end, rest = data.partition(b"$EndPhysicalNames")
    for title in names:
        there = known[plain(title, names)]
        head = head.replace(f'"{title}"'.encode(), f'"{there}"'.encode())
    if data[: len(head)] != head:
        path.write_bytes(head + end + rest)


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
        return gmsh_read.read(Path(target))
