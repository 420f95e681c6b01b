"""Cells and data of a mesh as VTK has them, in arrays of NumPy, and the way to meshio and back."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.errors import InvalidMeshError, UnsupportedMeshError

SPLIT = {2: ("vertex", 1), 4: ("line", 2)}
"""Poly-vertices and poly-lines come as vertices and lines, one for each of their parts."""

TURNED = {8: ("quad", [0, 1, 3, 2]), 11: ("hexahedron", [0, 1, 3, 2, 4, 5, 7, 6])}
"""Pixels and voxels come as quadrilaterals and hexahedra."""


class Dataset(NamedTuple):
    """A grid or PolyData.

    Attributes
    ----------
    points : (n, 3) float
    types : (m,) uint8       VTK's types of the cells
    offset : (m + 1,) int    where the nodes of every cell begin, and the end
    nodes : (k,) int
    point_data, cell_data, field_data : dict    arrays by name
    """

    points: NDArray[Any]
    types: NDArray[Any]
    offset: NDArray[Any]
    nodes: NDArray[Any]
    point_data: dict[str, NDArray[Any]]
    cell_data: dict[str, NDArray[Any]]
    field_data: dict[str, NDArray[Any]]


def names() -> Any:
    """Tables of meshio: names and order of nodes of VTK's cell types."""
    import meshio._vtk_common

    return meshio._vtk_common


def blocks_of(data: Dataset) -> tuple[Any, list[str]]:
    """Make a meshio.Mesh of one block for each type of cells; also tell which come as others.

    Raises
    ------
    InvalidMeshError        cells have other numbers of nodes than their type
    UnsupportedMeshError    meshio has no name for cells
    """
    from meshio import Mesh
    from meshio._common import num_nodes_per_cell

    table = names()
    types, offset, flat = data.types, data.offset, data.nodes
    size = np.diff(offset)
    if len(types) != len(size) or (size < 0).any() or offset[0] != 0 or offset[-1] != len(flat):
        msg = "its cells do not fit together"
        raise InvalidMeshError(msg)
    blocks: list[Any] = []
    rows: list[NDArray[Any]] = []
    said: list[str] = []
    kinds = types.astype(np.int64) * (int(size.max()) + 1) + size
    _, first = np.unique(kinds, return_index=True)
    for i in np.sort(first):
        kind, width = int(types[i]), int(size[i])
        which = np.flatnonzero(kinds == kinds[i])
        nodes = flat[offset[which][:, None] + np.arange(width)]
        if kind in SPLIT:
            name, step = SPLIT[kind]
            said.append(f"poly-{name} cells come as {name} cells")
            nodes = np.stack([nodes[:, j : width - step + j + 1] for j in range(step)], axis=2)
            which = np.repeat(which, nodes.shape[1])
            nodes = nodes.reshape(-1, step)
        elif kind in TURNED:
            name, order = TURNED[kind]
            said.append(f"VTK's cells of type {kind} come as {name} cells")
            nodes = nodes[:, order]
        elif kind in table.vtk_to_meshio_type and kind not in (0, 42):
            name, order = table.vtk_to_meshio_type[kind], table.vtk_to_meshio_order(kind)
            nodes = nodes if order is None else nodes[:, order]
        else:
            msg = f"it has cells of VTK's type {kind} (first: cell {i})"
            raise UnsupportedMeshError(msg)
        if nodes.shape[1] != num_nodes_per_cell.get(name, nodes.shape[1]):
            msg = f"its cell {i} is of type {name} and has {width} nodes"
            raise InvalidMeshError(msg)
        same = [j for j, (other, old) in enumerate(blocks)
                if other == name and old.shape[1:] == nodes.shape[1:]]
        if same:
            blocks[same[0]] = (name, np.concatenate([blocks[same[0]][1], nodes]))
            rows[same[0]] = np.concatenate([rows[same[0]], which])
        else:
            blocks.append((name, nodes))
            rows.append(which)
    cell_data = {key: [values[row] for row in rows]
                 for key, values in data.cell_data.items()}
    point_data: Any = data.point_data
    mesh = Mesh(data.points, blocks, point_data, cell_data, data.field_data)
    return mesh, list(dict.fromkeys(said))


def dataset_of(mesh: Any) -> Dataset:
    """The arrays of a meshio.Mesh as VTK takes them; sets become arrays of 0 and 1.

    Raises
    ------
    UnsupportedMeshError    VTK has no such cells
    """
    table = names()
    kinds = table.meshio_to_vtk_type
    unknown = [block.type for block in mesh.cells if block.type not in kinds]
    if unknown:
        msg = f"VTK has no cells of type {unknown[0]}"
        raise UnsupportedMeshError(msg)
    orders = [table.meshio_to_vtk_order(block.type) for block in mesh.cells]
    rows = [block.data if order is None else block.data[:, order]
            for block, order in zip(mesh.cells, orders, strict=True)]
    types = np.concatenate([np.full(len(block.data), kinds[block.type], np.uint8)
                            for block in mesh.cells])
    size = np.concatenate([np.full(len(nodes), nodes.shape[1]) for nodes in rows])
    n, sizes = len(mesh.points), [len(block.data) for block in mesh.cells]
    kind = mesh.points.dtype if mesh.points.dtype in (np.float32, np.float64) else np.float64
    points = np.zeros((n, 3), dtype=kind)
    points[:, : mesh.points.shape[1]] = mesh.points
    point = {name: _members([members], [n]) for name, members in mesh.point_sets.items()}
    cell = {name: _members(members, sizes) for name, members in mesh.cell_sets.items()}
    cell |= {name: np.concatenate(values) for name, values in mesh.cell_data.items()}
    return Dataset(
        points, types, np.concatenate([[0], np.cumsum(size)]).astype(np.int64),
        np.concatenate([nodes.ravel() for nodes in rows]).astype(np.int64),
        _plain(point | mesh.point_data), _plain(cell), _plain(mesh.field_data),
    )


def _members(members: list[Any], sizes: list[int]) -> NDArray[np.uint8]:
    """Array of 0 and 1 of the members of a set, given by blocks as indices or masks."""
    parts = []
    for part, size in zip(members, sizes, strict=True):
        inside = np.zeros(size, dtype=np.uint8)
        if part is not None and len(part):
            inside[np.asarray(part)] = 1
        parts.append(inside)
    return np.concatenate(parts)



def _plain(arrays: dict[str, Any]) -> dict[str, NDArray[Any]]:
    """Arrays of one or two axes in the order of bytes of the machine; truth values become bytes."""
    found = {}
    for name, given in arrays.items():
        values = np.atleast_1d(np.asarray(given))
        if values.dtype.kind not in "US":
            kind = np.uint8 if values.dtype.kind == "b" else values.dtype.newbyteorder("=")
            values = values.astype(kind, copy=False)
            values = np.ascontiguousarray(
                values.reshape(len(values), -1) if values.ndim > 2 else values)
        found[name] = values
    return found
