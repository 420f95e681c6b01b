"""pyvista.UnstructuredGrid of tetrahedra or triangles, pyvista.PolyData of triangles.

Everything survives: class, dtype of the points, point, cell and field data, active arrays, ids,
names of components, tables of colours and user dictionary. Normals of a curved surface, active or
called so, are computed anew, the active texture coordinates of triangles interpolated where
vertices moved. Other linear cells (lines, boundary triangles, quadrilaterals, hexahedra, ...) come
back as they are. Quadratic and Lagrange triangles and tetrahedra are optimised by their corners,
see :mod:`odt_plugins.adapters.higher_order`; other cells of higher order, such cells beside linear
ones, polyhedra and triangle strips are refused by name.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.fields import dense, sampled
from odt_plugins.adapters.higher_order import (
    carried_point_data,
    check_mid_nodes,
    lattice,
    order_of,
    placed_nodes,
    with_mid_nodes,
)
from odt_plugins.adapters.host import (
    CELL_VERTEX,
    HostMesh,
    KeptCells,
    Result,
    any_became_others,
    classes_of,
    each_once,
    faces_now,
    is_instance,
    of_other_shape,
)
from odt_plugins.adapters.lengths import check_arrays_of_vtk
from odt_plugins.adapters.normals import NORMALS, are_normals, renewed
from odt_plugins.adapters.polydata_cells import (
    are_vertices,
    segments_of,
    sizes_and_starts,
    with_middles,
    with_numbers,
)
from odt_plugins.adapters.regions import region_labels
from odt_plugins.adapters.vtk_files import as_before, put_array
from odt_plugins.adapters.wedges import slid
from odt_plugins.errors import UnsupportedMeshError, counted

IndexArray = NDArray[np.int64]

VERTEX, POLY_VERTEX, LINE, POLY_LINE, TRIANGLE, TETRA = 1, 2, 3, 4, 5, 10

LINEAR = {
    VERTEX: "vertex",
    POLY_VERTEX: "poly-vertex",
    LINE: "line",
    POLY_LINE: "poly-line",
    TRIANGLE: "triangle",
    6: "triangle strip",
    7: "polygon",
    8: "pixel",
    9: "quadrilateral",
    TETRA: "tetrahedron",
    11: "voxel",
    12: "hexahedron",
    13: "wedge",
    14: "pyramid",
    15: "pentagonal prism",
    16: "hexagonal prism",
}
"""Cell types of VTK, by their number, that may lie in a mesh."""

QUADRATIC = {21: "quadratic line", 22: "quadratic triangle", 24: "quadratic tetrahedron"}
"""Cell types that may lie in a mesh of quadratic triangles or tetrahedra beside linear ones."""

LAGRANGE = {68: "Lagrange curve", 69: "Lagrange triangle", 71: "Lagrange tetrahedron"}
"""Cell types of any order, that may lie beside one another where their order is the same."""

DIMENSION = {TETRA: 3, 24: 3, 71: 3, TRIANGLE: 2, 22: 2, 69: 2}
"""Dimension of the cells that can be optimised, the first ones before the others."""

REFINED = {VERTEX: 1, LINE: 2, TRIANGLE: 3}
"""Vertices of the cells that can be refined beside others."""

FACES = {21: 2, TRIANGLE: 3, 22: 3, 68: 2, 69: 3}
"""Corners of the cells that must stay edges or faces of the optimised ones; lines apart."""


def matches(mesh: object) -> bool:
    """Say whether this is a pyvista UnstructuredGrid or PolyData."""
    return is_instance(mesh, "pyvista", "UnstructuredGrid") or is_instance(
        mesh, "pyvista", "PolyData"
    )


def read(mesh: Any, regions: str | Sequence[str] | None = None) -> HostMesh:
    """Take the arrays out of a grid or of PolyData.

    Parameters
    ----------
    mesh : pyvista.UnstructuredGrid or pyvista.PolyData
    regions : names, "auto" or None
                               of cell arrays of region labels, see
                               :func:`odt_plugins.adapters.regions.region_labels`

    Raises
    ------
    UnsupportedMeshError       no tetrahedra and no triangles, or cells that cannot be kept
    InvalidMeshError           an array has too few values
    InvalidOptionError         there is no cell array of that name
    """
    check_arrays_of_vtk(mesh)
    grid = mesh.IsA("vtkUnstructuredGrid")
    nodes, ids, kept = _read_grid(mesh) if grid else _read_polydata(mesh)
    dim = DIMENSION[int(np.asarray(mesh.celltypes)[ids[0]])] if grid and len(ids) else 2
    shape = lattice(dim, order_of(dim, nodes.shape[1]))
    wide = len(shape) > shape.shape[1]
    if wide:
        check_mid_nodes(nodes, mesh.n_points, shape)
    corners = nodes[:, : shape.shape[1]]
    arrays = {name: np.atleast_1d(mesh.cell_data[name])[ids] for name in mesh.cell_data.keys()}
    labels = region_labels(arrays, regions, corners)
    name = mesh.point_data.active_texture_coordinates_name
    texture = None if name is None else np.asarray(mesh.point_data[name])
    anchors = _anchors(mesh, grid)
    return HostMesh(
        points=np.asarray(mesh.points),
        cells=corners,
        regions=labels.values,
        regions_from=labels.names,
        kept=(*kept, KeptCells(CELL_VERTEX, anchors[:, None])) if len(anchors) else kept,
        source=mesh,
        layout=(ids, nodes if wide else None, shape),
        ids=ids,
        total=mesh.n_cells,
        fields=sampled(
            {name: np.asarray(mesh.point_data[name]) for name in mesh.point_data.keys()},
            (mesh.point_data.active_normals_name, name)),
        densities=dense(arrays, (mesh.cell_data.active_normals_name,)),
        anchors=anchors,
        higher_order=wide,
        nodes=nodes if wide else None,
        shape=shape if wide else None,
        whole=True,
        texture=None if texture is None else texture.reshape(len(texture), -1),
        words=lambda text: text.replace("merging vertices at the same place", "mesh.clean()"),
    )


def write(result: Result, host: HostMesh) -> Any:
    """Copy the caller's object and exchange its points, cells and cell data."""
    out = host.source.copy(deep=True)
    ids, nodes, _ = host.layout
    nodes = nodes if result.cells.shape[1] == host.cells.shape[1] else None
    out.cell_data.clear()
    vertices = result.vertices
    number = vertices.number if vertices is not None and vertices.renumbered else None
    if nodes is not None:
        rows = _write_higher_order(out, result, host)
    else:
        if not host.source.IsA("vtkUnstructuredGrid"):
            rows = _write_polydata(out, result, host)
        elif result.split is not None:
            rows = _write_refined(out, result, host.source, ids)
        else:
            rows = _write_grid(out, result, host, number)
        if number is not None:
            out.point_data.clear()
        out.points = result.points
    if vertices is not None and nodes is None:
        _carry_point_data(out, host.source, lambda name, values: vertices.carried(
            values, name, field=name in host.fields), list(host.fields) if number is None else None)
    _carry_cell_data(out, host.source, rows, result, ids)
    if nodes is None:
        _follow_surface(out, result, host, rows)
    as_before(out, host.source, narrow=False)
    return out


def _follow_surface(out: Any, result: Result, host: HostMesh, rows: IndexArray) -> None:
    """Interpolate the active texture coordinates and compute normals anew.

    `rows` tells for every new cell in which row of the caller's cell data it had its data.
    """
    source = host.source
    name = source.point_data.active_texture_coordinates_name
    if name is not None and result.feet is not None:
        out.point_data[name] = slid(
            np.asarray(source.point_data[name]), host.cells, result.feet)
    if not result.curved:
        return
    mine = np.isin(rows, optimised_cells(host))
    for data, old, own, of_vertices in ((out.point_data, source.point_data, slice(None), True),
                                        (out.cell_data, source.cell_data, mine, False)):
        for name in {old.active_normals_name, NORMALS}.intersection(data.keys()):
            values = np.array(data[name])
            if are_normals(values):
                values[own] = renewed(
                    values[own], result.points, result.cells, of_vertices=of_vertices)
                data[name] = values


def optimised_cells(host: HostMesh) -> IndexArray:
    """Indices in the caller's object of the cells that are optimised."""
    ids: IndexArray = host.layout[0]
    return ids


def _anchors(mesh: Any, grid: bool) -> IndexArray:
    """Vertices of vertex cells."""
    if not grid:
        cells = np.asarray(mesh.verts)
        return cells[are_vertices(cells)]
    types = np.asarray(mesh.celltypes)
    offset, flat = _connectivity(mesh)
    which = np.flatnonzero(np.isin(types, (VERTEX, POLY_VERTEX)))
    return flat[_positions(offset[which], np.diff(offset)[which])]


def _read_grid(mesh: Any) -> tuple[IndexArray, IndexArray, tuple[KeptCells, ...]]:
    types = np.asarray(mesh.celltypes)
    there = set(types.tolist())
    kind = next((k for k in DIMENSION if k in there), TRIANGLE)
    names = LINEAR | (LAGRANGE if kind in LAGRANGE else {} if kind in LINEAR else QUADRATIC)
    _refuse_unknown(types, list(names))
    offset, flat = _connectivity(mesh)
    if kind in LAGRANGE:
        _expect_one_order(types, np.diff(offset), kind)
    ids = np.flatnonzero(types == kind)
    if not ids.size and types.size:
        found = ", ".join(names[int(t)] for t in np.unique(types))
        count = counted(types.size, "cell")
        msg = (f"got a grid of {count} of type {found}; expected tetrahedra or triangles, try "
               f"mesh.triangulate()")
        raise UnsupportedMeshError(msg)
    width = int(np.diff(offset)[ids[0]]) if ids.size else 3
    cells = flat[offset[ids][:, None] + np.arange(width)]

    kept = []
    for other, which in _beside(types, kind):
        start, size = offset[which], np.diff(offset)[which]
        if other in (LINE, POLY_LINE):
            first = _positions(start, size - 1)
            rows = np.stack([flat[first], flat[first + 1]], axis=1)
        elif other in FACES:
            rows = flat[start[:, None] + np.arange(FACES[other])]
        else:
            kept.append(of_other_shape(names[other], flat[_positions(start, size)], size))
            continue
        known = _known(mesh, which, size - 1 if other == POLY_LINE else None)
        if other not in ((LINE, TRIANGLE) if kind in LINEAR else (21, 22, 68, 69)):
            known = (None, known[1], None)
        kept += [part for part, _ in each_once(KeptCells(names[other], rows, *known))]
    return cells, ids, tuple(kept)


def _beside(types: NDArray[Any], kind: int) -> list[tuple[int, IndexArray]]:
    """Types of cells that are neither optimised nor vertices, each with indices of its cells."""
    return [(other, np.flatnonzero(types == other)) for other in np.unique(types).tolist()
            if other not in (kind, VERTEX, POLY_VERTEX)]


def _known(
    mesh: Any, which: IndexArray, parts: IndexArray | None = None
) -> tuple[NDArray[np.int64] | None, IndexArray, IndexArray | None]:
    """Classes, labels and ids of cells: of some that have the same numbers in all arrays.

    Cells of so many parts each, poly-lines, become no others: their parts have labels only.
    """
    arrays = [np.atleast_1d(mesh.cell_data[name])[which] for name in mesh.cell_data.keys()]
    classes, labels = classes_of(arrays, len(which))
    if parts is not None:
        return None, np.repeat(labels, parts), None
    return classes, labels, which


def _expect_one_order(types: NDArray[Any], size: IndexArray, kind: int) -> None:
    """Refuse Lagrange cells of several orders in one grid."""
    order = order_of(DIMENSION[kind], int(size[types == kind][0]))
    for other in LAGRANGE:
        nodes = len(lattice({68: 1, 69: 2, 71: 3}[other], order))
        bad = np.flatnonzero((types == other) & (size != nodes))
        if bad.size:
            name = counted(bad.size, LAGRANGE[other])
            msg = (f"got {name} of another order than {order} (first: cell {bad[0]}); expected "
                   f"cells of one order, try extracting them")
            raise UnsupportedMeshError(msg)


def _connectivity(mesh: Any) -> tuple[IndexArray, IndexArray]:
    """Offsets and vertex indices of the ragged cells; pyvista 0.49 renamed the first."""
    offset = mesh.cell_offsets if hasattr(mesh, "cell_offsets") else mesh.offset
    return np.asarray(offset), np.asarray(mesh.cell_connectivity)


def _refuse_unknown(types: NDArray[Any], known: list[int]) -> None:
    bad = np.flatnonzero(~np.isin(types, known))
    if bad.size:
        from vtkmodules import vtkCommonDataModel

        kind = int(types[bad[0]])
        name = next(name.removeprefix("VTK_") for name, value in vars(vtkCommonDataModel).items()
                    if name.startswith("VTK_") and value == kind)
        msg = (f"got {counted(bad.size, 'cell')} of type {name} (first: cell {bad[0]}); expected "
               "linear tetrahedra or triangles, try grid.linear_copy() or extracting the linear "
               "cells")
        raise UnsupportedMeshError(msg)


def _write_higher_order(out: Any, result: Result, host: HostMesh) -> IndexArray:
    """Set cells, points and point data of a grid whose cells have mid-nodes."""
    source = host.source
    ids, nodes, shape = host.layout
    offset, flat = _connectivity(source)
    others = np.ones(len(flat), dtype=np.bool_)
    others[(offset[ids][:, None] + np.arange(nodes.shape[1])).ravel()] = False
    q = with_mid_nodes(result, host.points, nodes, np.unique(flat[others]), shape)
    whole = Result(q.points, q.cells, result.source)
    rows = _write_grid(out, whole, host, q.number)
    out.point_data.clear()
    out.points = q.points
    placed = placed_nodes(q, result, host.points, nodes)
    _carry_point_data(out, source, lambda name, values: carried_point_data(
        name, values, q, placed if name in host.fields else None))
    return rows


def _carry_point_data(
    out: Any, source: Any, carry: Callable[[str, NDArray[Any]], NDArray[Any]],
    names: Sequence[str] | None = None,
) -> None:
    """Give the points the data of those they came from, or some of these arrays if named."""
    old, new = source.point_data, out.point_data
    for name in old.keys() if names is None else names:
        put_array(new, carry(name, np.asarray(old[name])), name)


def _write_grid(
    out: Any, result: Result, host: HostMesh, number: IndexArray | None = None
) -> IndexArray:
    """Set the cells of a grid, each near the cell it came from; return where their data lie.

    The other cells take new indices of points, if `number` has them, or become other faces.
    """
    ids, types = optimised_cells(host), np.asarray(host.source.celltypes)
    offset, old = _connectivity(host.source)
    flat = old if number is None else number[old]
    others = np.setdiff1d(np.arange(len(types)), ids)
    parts = [(result.cells, ids[result.source])]
    for _, which in _beside(types, int(types[ids[0]])):
        if any_became_others(result, host, which):
            width = np.arange(offset[which[0] + 1] - offset[which[0]])
            faces = faces_now(result, host, which, old[offset[which][:, None] + width])
            parts.append((faces.rows, which[faces.source]))
            others = np.setdiff1d(others, which)
    rows = np.concatenate([*(origin for _, origin in parts), others])
    order = np.argsort(rows, kind="stable")

    pool = np.concatenate([*(cells.ravel() for cells, _ in parts), flat])
    size = np.concatenate([*(np.full(len(cells), cells.shape[1]) for cells, _ in parts),
                           np.diff(offset)[others]])
    new = np.cumsum(size)[: len(size) - len(others)]
    start = np.concatenate([np.append(0, new)[:-1], new[-1] + offset[others]])
    rows, start, size = rows[order], start[order], size[order]
    connectivity = pool[_positions(start, size)].astype(old.dtype)
    _set_cells(out, types[rows], size, connectivity)
    return np.asarray(rows)


def _write_refined(out: Any, result: Result, source: Any, ids: IndexArray) -> IndexArray:
    """Set the cells of a refined grid, parts in the place of the whole; as :func:`_write_grid`."""
    types = np.asarray(source.celltypes)
    offset, flat = _connectivity(source)
    parts = [(int(types[ids[0]]), result.cells, ids[result.source])]
    for kind in np.setdiff1d(types, types[ids]).tolist():
        which = np.flatnonzero(types == kind)
        if kind not in REFINED:
            msg = (f"got {counted(len(which), LINEAR[kind])} (first: cell {which[0]}) beside the "
                   f"refined cells; expected only vertices, lines and triangles")
            raise UnsupportedMeshError(msg)
        nodes = flat[offset[which][:, None] + np.arange(REFINED[kind])]
        split = result.split(nodes) if result.split is not None else nodes
        parts.append((kind, split, np.repeat(which, len(split) // len(which))))
    rows = np.concatenate([origin for _, _, origin in parts])
    size = np.concatenate([np.full(len(cells), cells.shape[1]) for _, cells, _ in parts])
    kinds = np.concatenate([np.full(len(cells), kind) for kind, cells, _ in parts])
    pool = np.concatenate([cells.ravel() for _, cells, _ in parts])
    start = np.cumsum(size) - size
    order = np.argsort(rows, kind="stable")
    connectivity = pool[_positions(start[order], size[order])].astype(flat.dtype)
    _set_cells(out, kinds[order], size[order], connectivity)
    return np.asarray(rows[order])


def _set_cells(out: Any, types: NDArray[Any], size: IndexArray, flat: NDArray[Any]) -> None:
    from vtkmodules.util.numpy_support import numpy_to_vtk

    kinds = numpy_to_vtk(np.ascontiguousarray(types, dtype=np.uint8), deep=True)
    out.SetCells(kinds, cell_array(size, flat))


def cell_array(size: IndexArray, flat: NDArray[Any]) -> Any:
    """Make a vtkCellArray of cells of so many nodes (m,), and these one after another."""
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonDataModel import vtkCellArray

    cells = vtkCellArray()
    offset = np.concatenate([[0], np.cumsum(size)]).astype(flat.dtype)
    cells.SetData(numpy_to_vtk(offset, deep=True), numpy_to_vtk(flat, deep=True))
    return cells


def _read_polydata(mesh: Any) -> tuple[IndexArray, IndexArray, tuple[KeptCells, ...]]:
    if mesh.n_strips:
        found = counted(mesh.n_strips, "triangle strip")
        msg = f"got PolyData with {found}; expected triangles only, try mesh.triangulate()"
        raise UnsupportedMeshError(msg)
    faces = np.asarray(mesh.faces)
    size, start = sizes_and_starts(faces)
    which = np.flatnonzero(size == 3)
    if not len(which) and mesh.n_cells:
        vertices, lines = counted(mesh.n_verts, "vertex cell"), counted(mesh.n_lines, "line cell")
        others = counted(len(size), "other polygon")
        found = f"{vertices}, {lines} and {others}" if len(size) else f"{vertices} and {lines}"
        better = "mesh.triangulate()" if len(size) else "mesh.delaunay_2d() or mesh.delaunay_3d()"
        msg = f"got PolyData of {found}; expected triangles, try {better}"
        raise UnsupportedMeshError(msg)
    kept: tuple[KeptCells, ...] = ()
    if mesh.n_lines:
        rows, parts = segments_of(np.asarray(mesh.lines))
        lines = mesh.n_verts + np.arange(mesh.n_lines)
        known = _known(mesh, lines, None if len(rows) == len(lines) else parts)
        kept = tuple(part for part, _ in each_once(KeptCells("line", rows, *known)))
    if len(which) < len(size):
        first, more = start[size != 3], size[size != 3]
        kept += (of_other_shape("polygon", faces[_positions(first, more)], more),)
    return (faces[start[which][:, None] + np.arange(3)], mesh.n_cells - len(size) + which, kept)


def has_triangles(mesh: Any) -> bool:
    """Say whether some of the faces of PolyData are triangles."""
    return 3 in sizes_and_starts(np.asarray(mesh.faces))[0]


def _write_polydata(out: Any, result: Result, host: HostMesh) -> IndexArray:
    """Set the cells of a surface, faces behind vertices and lines; as :func:`_write_grid`."""
    ids, source = host.layout[0], host.source
    faces, first = np.asarray(source.faces), source.n_verts + source.n_lines
    beside = np.arange(first)
    if result.vertices is not None and result.vertices.renumbered:
        number = result.vertices.number
        faces = with_numbers(faces, number)
        if source.n_verts:
            out.verts = with_numbers(np.asarray(source.verts), number)
        which = np.arange(source.n_verts, first)
        if result.split is not None and source.n_lines:
            out.lines = with_middles(np.asarray(source.lines), result.split)
        elif any_became_others(result, host, which):
            lines = faces_now(result, host, which, np.asarray(source.lines).reshape(-1, 3)[:, 1:])
            out.lines = np.insert(lines.rows, 0, 2, axis=1).ravel()
            beside = np.append(np.arange(source.n_verts), which[lines.source])
        elif source.n_lines:
            out.lines = with_numbers(np.asarray(source.lines), number)
    size, start = sizes_and_starts(faces)
    rest = np.flatnonzero(size != 3)
    count = np.full((len(result.cells), 1), 3, dtype=result.cells.dtype)
    pool = np.append(np.concatenate([count, result.cells], axis=1), faces)
    rows = np.append(ids[result.source], first + rest)
    size = np.append(count, size[rest]) + 1
    begin = np.append(4 * np.arange(len(count)), 4 * len(count) + start[rest] - 1)
    order = np.argsort(rows, kind="stable")
    out.faces = pool[_positions(begin[order], size[order])]
    return np.concatenate([beside, rows[order]])


def _carry_cell_data(
    out: Any, source: Any, rows: IndexArray, result: Result, ids: IndexArray
) -> None:
    """Give every cell the data of the cell it came from.

    Densities whose integrals stay are those of the result, in the place of cells with these `ids`.

    A single complex number comes from pyvista without its axis.
    """
    old, new = source.cell_data, out.cell_data
    for name in old.keys():
        values = np.atleast_1d(old[name])[rows]
        if name in result.of_cells:
            own = result.of_cells[name]
            values[np.isin(rows, ids)] = own.reshape(len(own), *values.shape[1:])
        put_array(new, values, name)


def _positions(start: IndexArray, size: IndexArray) -> IndexArray:
    """Positions start[0], ..., start[0] + size[0] - 1, start[1], ... of ragged rows."""
    ends = np.cumsum(size)
    total = int(ends[-1]) if len(ends) else 0
    return np.asarray(np.arange(total) + np.repeat(start - (ends - size), size))


def tetrahedra(points: NDArray[np.float64], cells: NDArray[np.int32]) -> Any:
    """Make a pyvista.UnstructuredGrid of tetrahedra."""
    from pyvista import UnstructuredGrid

    return UnstructuredGrid({TETRA: cells}, points)
