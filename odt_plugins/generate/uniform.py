"""Uniform refinement of a caller's mesh: every edge halved, the same type back."""

from __future__ import annotations

from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters import arrays, files, meshio_mesh, pyvista_mesh
from odt_plugins.adapters.host import (
    CELL_VERTEX,
    NAMED_VERTEX,
    SET_VERTEX,
    Adapter,
    HostMesh,
    NewVertices,
    Result,
    as_indices,
)
from odt_plugins.adapters.point_sets import depths
from odt_plugins.adapters.registry import find_adapter
from odt_plugins.errors import UnsupportedMeshError
from odt_plugins.generate.refine3d import check_size, red_refinement, refined_rows
from odt_plugins.mesh.simplex import mesh_arrays, simplex_mesh
from odt_plugins.mesh.surface import surface_mesh

MeshT = TypeVar("MeshT")

ADAPTERS: tuple[Adapter, ...] = (arrays, files, meshio_mesh, pyvista_mesh)

SPLIT = ("line", "triangle", NAMED_VERTEX, CELL_VERTEX)
"""Cells that are refined beside others, and vertices."""


def uniform_refine(mesh: MeshT) -> MeshT:
    """Cut every triangle into four and every tetrahedron into eight at the mid-points of the edges.

    Parameters
    ----------
    mesh : (points, cells) or (points, cells, regions) arrays, pyvista.UnstructuredGrid or PolyData,
        meshio.Mesh, or the path of a mesh file, of linear triangles or tetrahedra

    Returns
    -------
    same type as `mesh`
        A meshio.Mesh for a path. Vertices keep their index; the mid-points follow, in the order of
        the ends of their edges, lower first. The parts of a cell stand in its place, oriented like
        it, with its data and labels, and so do those of vertices, lines and boundary triangles
        beside the cells. Point data that are floating-point numbers are interpolated, others are
        those of the lower end, but markers of the boundary, or of a side of it, mark no mid-points
        beside or inside; a mid-point is in a point set when both ends are. Lines of PolyData stay
        single ones, with the mid-points on them.

    Raises
    ------
    InvalidMeshError        the mesh is broken, too large, or has lines or triangles beside its
                            tetrahedra that are none of their edges and faces
    UnsupportedMeshError    there are other cells than triangles, tetrahedra, lines and vertices

    Notes
    -----
    The octahedron inside a tetrahedron is cut around the diagonal that leaves the best worst
    radius ratio, so that shapes stay as good after many levels as after the first.

    References
    ----------
    L. Chen, M. Holst, CMAME 200 (2011) 967-984, doi:10.1016/j.cma.2010.11.007, Section 5.3.

    Examples
    --------
    >>> import numpy as np
    >>> from odt_plugins import generate
    >>> points = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    >>> points, cells = generate.uniform_refine((points, np.array([[0, 1, 2]])))
    >>> cells.tolist()
    [[0, 3, 4], [3, 1, 5], [4, 5, 2], [5, 4, 3]]
    """
    adapter, host = read_linear(mesh)
    p, t = mesh_arrays(host.points, host.cells)
    n = len(p)
    check_size(len(t), t.shape[1] - 1, 1)
    if p.shape[1] == t.shape[1]:
        surface_mesh(p, t, orient=True)
    else:
        simplex_mesh(p, t)
    refined = red_refinement(p, t)
    points = refined.points.astype(host.points.dtype)
    added = len(refined.edges)
    source = np.repeat(np.arange(len(t), dtype=np.int32), len(refined.cells) // len(t))

    def both() -> tuple[NDArray[np.int8], NDArray[np.int8]]:
        labels = host.regions
        now = depths(points, refined.cells, None if labels is None else labels[source])
        return depths(p, t, labels), now[n:]

    vertices = NewVertices(
        np.concatenate([np.arange(n), np.full(added, -1)]),
        np.arange(n),
        n + np.arange(added),
        refined.edges.astype(np.int32),
        np.full((added, 2), 0.5),
        depths=both,
    )
    result = Result(
        points, as_indices(refined.cells, host.cells), source, p.shape[1] == t.shape[1],
        vertices=vertices, split=partial(refined_rows, edges=refined.edges, n=n),
    )
    return adapter.write(result, host)


def unrefined(mesh: MeshT) -> MeshT:
    """Copy what :func:`uniform_refine` takes; a meshio.Mesh for a path."""
    adapter, host = read_linear(mesh)
    p, t = mesh_arrays(host.points, host.cells)
    source = np.arange(len(t), dtype=np.int32)
    return adapter.write(
        Result(host.points.copy(), host.cells.copy(), source, p.shape[1] == t.shape[1]), host)


def read_linear(mesh: Any) -> tuple[Adapter, HostMesh]:
    """Read a mesh of linear triangles or tetrahedra; others are refused."""
    adapter = find_adapter(mesh)
    if adapter not in ADAPTERS:
        kind = type(mesh)
        msg = (f"got an object of type {kind.__module__}.{kind.__qualname__}; expected arrays, a "
               "pyvista grid or PolyData, a meshio.Mesh or a path, try (points, cells) as arrays")
        raise UnsupportedMeshError(msg)
    host = adapter.read(mesh)
    if host.higher_order:
        msg = "got a mesh of cells of higher order; expected linear ones, try the corners alone"
        raise UnsupportedMeshError(msg)
    other = next((kept.kind for kept in host.kept
                  if kept.kind not in SPLIT and not kept.kind.startswith(SET_VERTEX)), None)
    if other is not None:
        msg = (f"got {other} cells beside those to refine; expected only vertices, lines and "
               f"triangles, try a mesh without them")
        raise UnsupportedMeshError(msg)
    return adapter, host
