"""meshio.Mesh of tetrahedra or planar triangles.

Everything survives: the blocks and their tags, point, cell and field data, point and cell sets.
Cells of different blocks never mix. Blocks of other linear cells come back as they are. Triangles
and tetrahedra of higher order are optimised by their corners, see
:mod:`odt_plugins.adapters.higher_order`; other cells of higher order, such cells beside linear
ones, and polyhedra are refused by name.
"""

from __future__ import annotations

from collections.abc import Container, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.fields import dense, sampled
from odt_plugins.adapters.formats.change import Origin
from odt_plugins.adapters.formats.decks import HELD, UNREAD, indices
from odt_plugins.adapters.formats.medit import REQUIRED
from odt_plugins.adapters.higher_order import (
    HIGHER,
    LAGRANGE,
    HigherOrder,
    Lattice,
    carried_point_data,
    check_mid_nodes,
    lattice,
    order_of,
    placed_nodes,
    with_mid_nodes,
)
from odt_plugins.adapters.host import (
    CELL_VERTEX,
    NAMED_VERTEX,
    SET_VERTEX,
    HostMesh,
    KeptCells,
    NewVertices,
    Result,
    as_indices,
    classes_of,
    each_once,
    faces_now,
    is_instance,
    of_other_shape,
)
from odt_plugins.adapters.lengths import NOT_CELL_INDICES, check_lengths, of_one_shape
from odt_plugins.adapters.normals import NORMALS, are_normals, renewed
from odt_plugins.adapters.point_sets import (
    of_corners,
    walls_of,
    whole_cells,
    with_added,
    with_links,
    with_nodes,
)
from odt_plugins.adapters.regions import AUTO, Labels, region_labels
from odt_plugins.adapters.wedges import TEXTURE, carried, of_vertices, slid, texture_of
from odt_plugins.errors import InvalidMeshError, UnsupportedMeshError, counted
from odt_plugins.mesh.simplex import compact_labels

FACES = {"line": 2, "triangle": 3} | {
    name: dim + 1 for name, dim in
    (LAGRANGE | {name: dim for name, (dim, _) in HIGHER.items()}).items() if dim < 3}
"""Cells that must stay faces of the optimised ones, with their number of vertices."""

LINEAR = ("vertex", "line", "triangle", "quad", "polygon", "tetra", "hexahedron", "wedge",
          "pyramid")

KINDS = (
    "tetra", *(name for name, (dim, _) in HIGHER.items() if dim == 3), "VTK_LAGRANGE_TETRAHEDRON",
    "triangle", *(name for name, (dim, _) in HIGHER.items() if dim == 2), "VTK_LAGRANGE_TRIANGLE")
"""Cells that can be optimised, the first ones before the others."""

NODE_ENTITIES, CELL_ENTITIES = "gmsh:dim_tags", "gmsh:geometrical"
"""Data of Gmsh's files: dimension and tag of the entity of a node, tag of that of a cell."""

ORIGIN = "read_from"
"""Attribute of a meshio.Mesh that tells the file it was read from, and what stood where there."""


def matches(mesh: object) -> bool:
    """Say whether this is a meshio.Mesh."""
    return is_instance(mesh, "meshio", "Mesh")


def read(mesh: Any, regions: str | Sequence[str] | None = None) -> HostMesh:
    """Take the tetrahedra, or the triangles if there are none, out of all blocks.

    Parameters
    ----------
    mesh : meshio.Mesh
    regions : names, "auto" or None
                               of cell data of region labels, or of cell sets; "auto" finds cell
                               data, else takes the cell sets if every cell is in exactly one

    Raises
    ------
    UnsupportedMeshError       no tetrahedra and no triangles, or cells that cannot be kept
    InvalidMeshError           cell data whose length is not that of their block, or a cell set
                               with an index out of range
    InvalidOptionError         there is no cell data of that name
    """
    found = {block.type: np.shape(block.data) for block in mesh.cells if len(block.data)}
    kind = next((kind for kind in KINDS if kind in found), "triangle")
    shape = _shape(kind, found.get(kind, (0, 3))[1])
    for block in mesh.cells:
        known = block.type in LINEAR or _of_order(block, kind, shape)
        if len(block.data) and not known:
            beside = f" beside {kind}" if block.type in HIGHER and kind in found else ""
            wanted = "cells of one order" if beside else "linear cells such as tetra or triangle"
            msg = (f"got {counted(len(block.data), 'cell')} of type {block.type}{beside}; expected "
                   f"{wanted}, try converting the mesh to linear cells")
            raise UnsupportedMeshError(msg)
    if not found:
        info = mesh.info if isinstance(mesh.info, dict) else {}
        what, more, hint = "no cells", "", ""
        if info.get(UNREAD):
            what, more = "no cells that can be read", f", and {' and '.join(info[UNREAD])}"
            hint = ", try a mesh of first order, or a .msh or .vtu file"
        msg = (f"the mesh has {what} ({len(mesh.points)} vertices{more}); expected tetra or "
               f"triangle{hint}")
        raise InvalidMeshError(msg)
    if kind not in found:
        msg = f"got a mesh with cells of {', '.join(sorted(found))}; expected tetra or triangle"
        raise UnsupportedMeshError(msg)
    chosen = [i for i, block in enumerate(mesh.cells) if block.type == kind]
    sizes = [len(block.data) for block in mesh.cells]
    size = [sizes[i] for i in chosen]
    check_lengths(mesh, chosen)
    arrays = {name: np.concatenate(of_one_shape(name, [values[i] for i in chosen]))
              for name, values in mesh.cell_data.items()}
    sets = _memberships(mesh, chosen, size)
    order = 1 if shape is None else int(shape[0, 0])
    kept = tuple(part for i in _others(mesh, chosen) for part in _kept(mesh, i, order))
    if REQUIRED in mesh.point_sets:
        required = np.asarray(mesh.point_sets[REQUIRED])
        kept = (*kept, of_other_shape("required vertex", required, np.array([len(required)])))
    alone = [block.data for block in mesh.cells if block.type == "vertex" and len(block.data)]
    if alone:
        kept = (*kept, KeptCells(CELL_VERTEX, _rows(alone).reshape(-1, 1)))
    if len(getattr(mesh, HELD, ())):
        kept = (*kept, KeptCells(NAMED_VERTEX, np.asarray(getattr(mesh, HELD)).reshape(-1, 1)))
    rows = nodes = _rows([np.asarray(mesh.cells[i].data) for i in chosen])
    if shape is not None:
        check_mid_nodes(nodes, len(mesh.points), shape)
        nodes = nodes[:, : shape.shape[1]]
    labels = region_labels(arrays if regions == AUTO else sets | arrays, regions, nodes)
    if regions == AUTO and labels.values is None and sets:
        inside = np.stack(list(sets.values()))
        if (inside.sum(axis=0) == 1).all():
            labels = Labels(np.argmax(inside, axis=0), tuple(sets))
    sets_of = _sets_of(mesh, rows, labels.values, shape)
    return HostMesh(
        points=np.asarray(mesh.points),
        cells=nodes,
        regions=labels.values,
        regions_from=labels.names,
        blocks=np.repeat(np.arange(len(chosen)), size) if len(chosen) > 1 else None,
        kept=(*kept, *(KeptCells(f"{SET_VERTEX} {name!r}", given.reshape(-1, 1))
                       for name, given, whole in sets_of
                       if len(given) and name != REQUIRED and not len(whole))),
        source=mesh,
        layout=dict(zip(chosen, np.cumsum([0, *size[:-1]]).tolist(), strict=True)),
        anchors=_anchors(mesh, sets_of, nodes.shape[1]),
        coupled=_coupled(mesh),
        higher_order=shape is not None,
        nodes=None if shape is None else rows,
        shape=shape,
        whole=True,
        ids=np.flatnonzero(np.repeat([block.type == kind for block in mesh.cells], sizes)),
        texture=texture_of(arrays, kind, mesh.point_data),
        total=sum(sizes),
        fields=sampled({name: np.asarray(v) for name, v in mesh.point_data.items()}),
        densities=dense(arrays, (TEXTURE,)),
    )


def _rows(blocks: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Cells of several blocks, as whole numbers where each has a type of these."""
    rows = np.concatenate(blocks)
    whole = rows.dtype.kind == "f" and all(block.dtype.kind in "iu" for block in blocks)
    return rows.astype(np.int64) if whole else rows


def _shape(kind: str, width: int) -> Lattice | None:
    """Where the nodes of a type of cells lie; None of linear ones."""
    if kind in LAGRANGE:
        return lattice(LAGRANGE[kind], order_of(LAGRANGE[kind], width))
    if kind not in HIGHER:
        return None
    dim, order = HIGHER[kind]
    return lattice(dim, order, "vtk" if order == 2 else "gmsh")


def _of_order(block: Any, kind: str, shape: Lattice | None) -> bool:
    """Whether cells may lie beside those of a type: of the same order and the same family."""
    if shape is None or (block.type in LAGRANGE) != (kind in LAGRANGE):
        return False
    if block.type in LAGRANGE:
        dim = LAGRANGE[block.type]
        return bool(len(lattice(dim, int(shape[0, 0]))) == np.shape(block.data)[1])
    return HIGHER.get(block.type, (0, 0))[1] == int(shape[0, 0])


def write(result: Result, host: HostMesh) -> Any:
    """Copy the caller's mesh and exchange its points and the optimised blocks."""
    out = host.source.copy()
    origin = getattr(out, ORIGIN, None)
    origin = None if origin is None else origin._replace(cells=[*origin.cells])
    nodes = None if result.vertices is None else result.vertices.origin
    if host.higher_order and result.cells.shape[1] == host.cells.shape[1]:
        result, nodes = _with_mid_nodes(out, result, host)
    elif result.vertices is not None and (result.faces or result.vertices.renumbered):
        _renumber(out, result, result.vertices, host, origin)
    elif result.vertices is not None:
        for name in host.fields:
            out.point_data[name] = result.vertices.carried(np.asarray(out.point_data[name]), name)
    out.points = result.points
    _follow_links(out, host, nodes)
    if result.split is not None:
        _refine_others(out, result, host, origin)
    for i, start in host.layout.items():
        block = out.cells[i]
        end = start + len(block.data)
        here = np.flatnonzero((result.source >= start) & (result.source < end))
        local = result.source[here] - start
        block.data = as_indices(result.cells[here], block.data)
        _take(out, i, local, end - start)
        if origin is not None:
            origin.cells[i] = origin.cells[i][local]
        for name, values in result.of_cells.items():
            out.cell_data[name][i] = values[here].astype(np.asarray(out.cell_data[name][i]).dtype)
    if result.curved and not host.higher_order:
        _renew_normals(out, result, host)
    if result.feet is not None and not host.higher_order:
        for name, values in of_vertices(host.source.point_data).items():
            moved = slid(values, host.cells, result.feet)
            out.point_data[name] = moved.reshape(-1, *np.shape(out.point_data[name])[1:])
    if host.texture is not None and host.texture.ndim == 3:
        uv = carried(host.texture, host.cells, result).reshape(-1, 6)
        for i, start in host.layout.items():
            end = start + len(host.source.cells[i].data)
            out.cell_data[TEXTURE][i] = uv[(result.source >= start) & (result.source < end)]
    if origin is not None and nodes is not None:
        origin = origin._replace(points=np.where(nodes < 0, -1, origin.points[nodes]))
    setattr(out, ORIGIN, origin)
    return out


def _renew_normals(out: Any, result: Result, host: HostMesh) -> None:
    """Compute the normals of a curved surface anew that VTK's files have under this name."""
    if NORMALS in out.point_data and are_normals(np.asarray(out.point_data[NORMALS])):
        out.point_data[NORMALS] = renewed(
            np.asarray(out.point_data[NORMALS]), result.points, result.cells, of_vertices=True)
    for i in host.layout if NORMALS in out.cell_data else ():
        values = np.asarray(out.cell_data[NORMALS][i])
        if are_normals(values):
            out.cell_data[NORMALS][i] = renewed(
                values, result.points, out.cells[i].data, of_vertices=False)


def _follow_links(out: Any, host: HostMesh, nodes: NDArray[np.integer] | None) -> None:
    """Renumber the links between periodic points; `nodes` are the old numbers of the new points."""
    number = np.arange(len(host.points))
    if nodes is not None:
        number[:] = -1
        number[nodes[nodes >= 0]] = np.flatnonzero(nodes >= 0)
    if out.gmsh_periodic:
        out.gmsh_periodic = with_links(out.gmsh_periodic, number, host.points, out.points) or None
    if getattr(out, "identified", None) is not None:
        out.identified = np.unique(number[out.identified])
        out.identified = out.identified[out.identified >= 0]


def _coupled(mesh: Any) -> NDArray[np.int64] | None:
    """Vertices of the faces that a file of Gmsh or Netgen says to be periodic, if there are any."""
    known = getattr(mesh, "identified", None)
    pairs = [] if known is None else [known]
    pairs += [np.asarray(entry[-1]).ravel() for entry in mesh.gmsh_periodic or ()]
    return np.unique(np.concatenate(pairs)).astype(np.int64) if pairs else None


def _sets_of(
    mesh: Any, cells: NDArray[Any], labels: NDArray[Any] | None, shape: Lattice | None
) -> list[tuple[str, NDArray[Any], NDArray[Any]]]:
    """Name of every point set, its vertices of cells, and the cells that fill it if a volume."""
    out = []
    there = ((cells >= 0) & (cells < len(mesh.points))).all(axis=1)
    cells = walls = cells[there].astype(np.int64)
    if mesh.point_sets:
        known = None if labels is None else compact_labels(labels, there.size)[there]
        walls = walls_of(cells, known, len(mesh.points), shape)
    for name, members in mesh.point_sets.items():
        given = indices(members)
        given = given[np.isin(given, cells)]
        around = cells, walls, len(mesh.points), shape
        out.append((name, of_corners(given, *around), whole_cells(given, *around)))
    return out


def _anchors(
    mesh: Any, sets: list[tuple[str, NDArray[Any], NDArray[Any]]], corners: int
) -> NDArray[Any]:
    """Vertices of vertex cells, and of point sets of few cells.

    A volume is filled by cells, which are more than half as many as its corners; sets that are none
    are kept.
    """
    named = [np.asarray(block.data) for block in mesh.cells if block.type == "vertex"]
    named += [given for name, given, whole in sets if name == REQUIRED or (
        len(whole) and 2 * len(whole) <= len(np.unique(whole[:, :corners])))]
    return np.concatenate([np.zeros(0, dtype=np.int64),
                           *(v.ravel().astype(np.int64) for v in named)])


def _refine_others(out: Any, result: Result, host: HostMesh, origin: Origin | None) -> None:
    """Cut the blocks beside the refined cells too, with their data and sets.

    A mid-point is in a point set when both ends of its edge are.
    """
    for i, block in enumerate(out.cells):
        if i in host.layout or result.split is None or not len(block.data):
            continue
        size = len(block.data)
        block.data = as_indices(result.split(np.asarray(block.data)), block.data)
        local = np.repeat(np.arange(size), len(block.data) // size)
        _take(out, i, local, size)
        if origin is not None:
            origin.cells[i] = origin.cells[i][local]
    if result.vertices is None:
        return
    for name, members in out.point_sets.items():
        old = indices(members)
        inside = _inside(old, len(host.points))
        added = len(host.points) + np.flatnonzero(inside[result.vertices.corners].all(axis=1))
        out.point_sets[name] = as_indices(np.concatenate([old, added]), np.asarray(members))


def _take(out: Any, i: int, local: NDArray[Any], size: int) -> None:
    """Give the cells of a block the data and sets of its cells ``local``."""
    for values in out.cell_data.values():
        values[i] = np.asarray(values[i])[local]
    for name, members in out.cell_sets.items():
        if name not in NOT_CELL_INDICES and members[i] is not None and len(members[i]):
            members[i] = _members(np.asarray(members[i]), local, size)


def _renumber(
    out: Any, result: Result, vertices: NewVertices, host: HostMesh, origin: Origin | None
) -> None:
    """Let point data, sets and other blocks follow vertices that came and went, or other faces."""
    others = _others(out, host.layout)
    for i, block in enumerate(out.cells):
        if i in others:
            size = len(block.data)
            first = sum(len(other.data) for other in host.source.cells[:i])
            now = faces_now(result, host, first + np.arange(size), np.asarray(block.data))
            block.data = as_indices(now.rows, block.data)
            if not np.array_equal(now.source, np.arange(size)):
                _take(out, i, now.source, size)
                if origin is not None:
                    origin.cells[i] = origin.cells[i][now.source]
        elif i not in host.layout:
            block.data = as_indices(vertices.number[block.data], block.data)
    entities = out.cell_data.get(CELL_ENTITIES)
    for name, values in out.point_data.items():
        out.point_data[name] = vertices.carried(np.asarray(values), name, field=name in host.fields)
        if name == NODE_ENTITIES and entities is not None:
            of_cells = np.concatenate([entities[i] for i in host.layout])[result.source]
            fresh = vertices.origin < 0
            _set_entities(out.point_data[name], host.cells.shape[1] - 1, result.cells, fresh,
                          of_cells)
            for i in sorted(others, key=lambda i: -out.cells[i].dim):
                _set_entities(out.point_data[name], out.cells[i].dim, out.cells[i].data, fresh,
                              np.asarray(entities[i]))
    for name, members in out.point_sets.items():
        there = vertices.number[indices(members)] if result.split is not None else with_added(
            indices(members), host, result, vertices)
        out.point_sets[name] = as_indices(there, np.asarray(members))


def _with_mid_nodes(
    out: Any, result: Result, host: HostMesh
) -> tuple[Result, NDArray[np.int64] | None]:
    """Give every edge its mid-node; point data, sets and other blocks follow their nodes."""
    nodes = _rows([np.asarray(out.cells[i].data) for i in host.layout])
    others = [i for i in range(len(out.cells)) if i not in host.layout]
    kept = [np.asarray(out.cells[i].data).ravel().astype(np.int64) for i in others]
    shape = _shape(out.cells[next(iter(host.layout))].type, nodes.shape[1])
    if shape is None:
        return result, None
    q = with_mid_nodes(result, host.points, nodes,
                       np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *kept])), shape)
    for i in others:
        old = np.asarray(out.cells[i].data)
        out.cells[i].data = as_indices(q.number[old], old)
    placed = placed_nodes(q, result, host.points, nodes)
    entities = out.cell_data.get(CELL_ENTITIES)
    for name, values in out.point_data.items():
        if name == NODE_ENTITIES and entities is not None:
            of_cells = np.concatenate([entities[i] for i in host.layout])[result.source]
            out.point_data[name] = _node_entities(np.asarray(values), q, of_cells)
        else:
            out.point_data[name] = carried_point_data(
                name, np.asarray(values), q, placed if name in host.fields else None)
    out.point_sets = with_nodes(out.point_sets, host, result, q)
    return Result(q.points, q.cells, result.source), q.origin


def _node_entities(
    values: NDArray[Any], q: HigherOrder, of_cells: NDArray[np.integer]
) -> NDArray[Any]:
    """Dimension and tag (n', 2) of Gmsh's entity of every node; new ones lie in that of a cell."""
    out = values[np.maximum(q.origin, 0)]
    _set_entities(out, q.shape.shape[1] - 1, q.cells, q.origin < 0, of_cells)
    return out


def _set_entities(
    entities: NDArray[Any], dim: int, cells: NDArray[Any], fresh: NDArray[np.bool_],
    of_cells: NDArray[np.integer],
) -> None:
    """Write dimension and tag (n, 2) of the entity of a cell around it for every fresh node."""
    new = fresh[cells]
    entities[cells[new], 0] = dim
    entities[cells[new], 1] = np.broadcast_to(of_cells[:, None], cells.shape)[new]


def _memberships(mesh: Any, chosen: list[int], size: list[int]) -> dict[str, NDArray[np.bool_]]:
    """Which of the optimised cells are in each cell set that has some of them."""
    out = {}
    for name, members in mesh.cell_sets.items():
        if name in NOT_CELL_INDICES:
            continue
        inside = []
        for i, count in zip(chosen, size, strict=True):
            here = np.asarray([] if members[i] is None else members[i])
            inside.append(_inside(here, count))
        whole = np.concatenate(inside)
        if whole.any():
            out[name] = whole
    return out


def _others(mesh: Any, chosen: Container[int]) -> list[int]:
    """Blocks beside the optimised ones, but those of vertices."""
    return [i for i, block in enumerate(mesh.cells)
            if i not in chosen and block.type != "vertex" and len(block.data)]


def _kept(mesh: Any, i: int, order: int) -> list[KeptCells]:
    """A block that is not optimised, in parts where faces are there several times; faces of cells
    of some order may become others of the same data and sets.
    """
    kind, data = mesh.cells[i].type, np.asarray(mesh.cells[i].data)
    if kind not in FACES:
        return [of_other_shape(kind, data, np.full(len(data), data.shape[-1]))]
    columns = [np.asarray(values[i]) for values in mesh.cell_data.values()]
    for name, members in mesh.cell_sets.items():
        if name not in NOT_CELL_INDICES and members[i] is not None:
            columns.append(_inside(np.asarray(members[i]), len(data)))
    classes, labels = classes_of(columns, len(data))
    ids: Any = sum(len(block.data) for block in mesh.cells[:i]) + np.arange(len(data))
    if HIGHER.get(kind, (0, 1))[1] != order or kind in LAGRANGE:
        classes = ids = None
    rows = data[:, : FACES[kind]]
    return [part for part, _ in each_once(KeptCells(kind, rows, classes, labels, ids))]


def _members(members: NDArray[Any], local: NDArray[np.int32], size: int) -> NDArray[Any]:
    """Cells of a block that come from members of a cell set: a mask, or indices that increase."""
    inside = _inside(members, size)[local]
    return inside if members.dtype == np.bool_ else as_indices(np.flatnonzero(inside), members)


def _inside(members: NDArray[Any], size: int) -> NDArray[np.bool_]:
    """Mask (size,) of the members of a cell set, given as a mask or as indices."""
    inside = np.zeros(size, dtype=np.bool_)
    inside[members if members.dtype == np.bool_ else members.astype(np.int64)] = True
    return inside


def tetrahedra(points: NDArray[np.float64], cells: NDArray[np.int32]) -> Any:
    """Make a meshio.Mesh of tetrahedra."""
    from meshio import Mesh

    return Mesh(points, [("tetra", cells)])


def one_cell(corners: int) -> Any:
    """Make a meshio.Mesh of one triangle or tetrahedron, to see whether a format holds such."""
    from meshio import Mesh

    kind = "tetra" if corners == 4 else "triangle"
    return Mesh(np.zeros((corners, 3)), [(kind, np.arange(corners)[None])])
