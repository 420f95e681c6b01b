"""New faces for the current mesh of a MeshSet in its place, so that Mesh objects of it stay valid.

MeshLab sets no faces. But every face can be halved twice, which leaves one in its middle whose
three vertices belong to no other face; all others are deleted. What these are to be is told by
places alone: a vertex is moved to where a vertex of the old mesh was put, and the two are merged.
Places also tell data of faces to MeshLab's function filters.
"""

from __future__ import annotations

import signal
import weakref
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.host import Result
from odt_plugins.adapters.pymeshlab_copy import (
    custom_attributes,
    has_polygons,
    muted,
    textures,
    without_pictures,
)
from odt_plugins.adapters.pymeshlab_ply import FACE_SCALAR
from odt_plugins.adapters.wedges import carried, slid
from odt_plugins.errors import DataNotKeptWarning, warn
from odt_plugins.processes import held_back


def result_in_place(meshes: Any, result: Result) -> Result | None:
    """Put the faces of a result into the order in which the current mesh can take them.

    Returns
    -------
    Result or None    faces have the textures of those whose places they take; None when the mesh
                      has custom attributes or curvature directions of faces, which MeshLab sets for
                      new meshes only, edges of three faces, or faces whose number changes; and
                      when it is no Mesh object in use, but has texture coordinates of wedges alone:
                      the filter that sets them adds some of vertices
    """
    from pymeshlab import MissingComponentException

    in_use = weakref.ref(meshes.current_mesh())() is not None
    mesh = meshes.current_mesh()
    if mesh.has_wedge_tex_coord() and not (mesh.has_vertex_tex_coord() or in_use):
        return None
    if any("face" in attribute.reader for attribute in custom_attributes(meshes)):
        return None
    with suppress(MissingComponentException), muted():
        mesh.face_curvature_principal_dir1_matrix()
        return None
    ends = np.sort(mesh.face_matrix()[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    if np.unique(ends, axis=0, return_counts=True)[1].max() > 2:
        return None
    numbers = textures(without_pictures(mesh))[1]
    if numbers is None:
        return result if len(result.cells) == len(ends) // 3 else None
    feet = result.feet
    wanted = numbers[result.source if feet is None else feet.under]
    here, there = (np.argsort(x, kind="stable") for x in (numbers, wanted))
    if not np.array_equal(numbers[here], wanted[there]):
        return None
    order = np.empty_like(there)
    order[here] = there
    if feet is not None:
        feet = feet._replace(under=feet.under[order], corners=feet.corners[order])
    of_cells = {name: values[order] for name, values in result.of_cells.items()}
    return result._replace(cells=result.cells[order], source=result.source[order], feet=feet,
                           of_cells=of_cells)


def can_be_set(meshes: Any, result: Result) -> bool:
    """Say whether :func:`set_faces` succeeds, by trying it with a copy of the current mesh.

    A filter that fails amidst the others would leave a mesh that none of them brings back.
    """
    from pymeshlab import PyMeshLabException

    trial = without_pictures(meshes.current_mesh())
    if custom_attributes(trial):
        trial.apply_filter("generate_copy_of_current_mesh")
    try:
        with muted():
            set_faces(trial, result)
    except PyMeshLabException:
        return False
    mesh = trial.current_mesh()
    there = (np.array(mesh.vertex_matrix()), np.array(mesh.face_matrix()))
    return np.array_equal(there[0], result.points) and np.array_equal(there[1], result.cells)


@held_back(signal.SIGINT)
def set_faces(meshes: Any, result: Result) -> None:
    """Give the current mesh the faces of a result of :func:`result_in_place`, and its points.

    Warns
    -----
    DataNotKeptWarning    the mesh had polygons
    """
    mesh = meshes.current_mesh()
    n, old, cells = mesh.vertex_number(), mesh.face_matrix(), result.cells
    selected = mesh.face_selection_array()[result.source]
    scalars = mesh.face_scalar_array() if mesh.has_face_scalar() else None
    scalars = None if scalars is None else result.carried(scalars, FACE_SCALAR)
    colours = mesh.face_color_matrix()[result.source] if mesh.has_face_color() else None
    wedges = uv = None
    if mesh.has_wedge_tex_coord():
        wedges = carried(mesh.wedge_tex_coord_matrix().reshape(-1, 3, 2), old, result)
    if mesh.has_vertex_tex_coord() and result.feet is not None:
        uv = slid(mesh.vertex_tex_coord_matrix(), old, result.feet)
    if has_polygons(mesh):
        warn("MeshLab does not keep the polygons, which are now triangles", DataNotKeptWarning)
        meshes.apply_filter("meshing_poly_to_tri")
    own = _own_places(mesh.vertex_matrix())
    move_vertices(meshes, own)
    for _ in range(2):
        _keep_middles(meshes)
    corners = np.array(mesh.face_matrix())

    def tell(values: NDArray[Any]) -> None:
        """Put three numbers of every corner, (m, 3, 3), where function filters read them."""
        places = np.zeros((mesh.vertex_number(), 3))
        places[:n], places[corners] = own, values
        move_vertices(meshes, places)

    told = np.zeros((len(cells), 3, 3))
    told[:, 0, 2] = 0.0 if scalars is None else scalars
    told[:, 1, 2] = selected
    if wedges is not None:
        told[:, :, :2] = wedges
    tell(told)
    meshes.apply_filter("compute_selection_by_condition_per_face", condselect="z1 > 0.5")
    if scalars is not None:
        meshes.apply_filter("compute_scalar_by_function_per_face", q="z0")
    if wedges is not None:
        meshes.apply_filter("compute_texcoord_by_function_per_wedge", **{
            f"{name}{i}": f"{axis}{i}" for name, axis in ("ux", "vy") for i in range(3)})
    if colours is not None:
        told[:, 0], told[:, 1, 0] = np.rint(255.0 * colours[:, :3]), np.rint(255.0 * colours[:, 3])
        tell(told)
        meshes.apply_filter("compute_color_by_function_per_face", r="x0", g="y0", b="z0", a="x1")
    places = np.tile(own[0], (mesh.vertex_number(), 1))
    places[:n], places[corners] = own, own[cells]
    move_vertices(meshes, places)
    meshes.apply_filter("meshing_remove_duplicate_vertices")
    mesh.compact()
    if uv is not None:
        move_vertices(meshes, np.column_stack([uv, np.zeros(n)]))
        meshes.apply_filter("compute_texcoord_by_function_per_vertex", u="x", v="y")
    move_vertices(meshes, result.points)


def _own_places(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """A place of its own for every vertex, (n, 3), that has the negative zeros of its old one."""
    out = np.where((points == 0.0) & np.signbit(points), points, 0.0)
    negative = np.signbit(out)
    axis = np.argmin(negative, axis=1)
    out[np.arange(len(out)), axis] = 1.0 + np.arange(len(out))
    origin = np.flatnonzero(negative.all(axis=1))[:1]
    out[origin] = points[origin]
    return out


def _keep_middles(meshes: Any) -> None:
    """Halve the edges of the current mesh and delete the faces that have an old vertex."""
    from pymeshlab import PureValue

    mesh = meshes.current_mesh()
    old = np.array(mesh.vertex_matrix())
    meshes.apply_filter(
        "meshing_surface_subdivision_midpoint", iterations=1, threshold=PureValue(0.0),
        selected=False)
    count = mesh.vertex_number()
    far = 4.0 * (count + old.max())
    places = np.full((count, 3), far)
    places[:, 0] += np.arange(count)
    places[: len(old)] = old
    move_vertices(meshes, places)
    meshes.apply_filter("compute_selection_by_edge_length", threshold=0.5 * far)
    meshes.apply_filter("meshing_remove_selected_faces")
    mesh.compact()


@held_back(signal.SIGINT)
def move_vertices(meshes: Any, points: NDArray[np.float64]) -> None:
    """Set the vertex coordinates of the current mesh, exactly, and nothing else.

    Linear morphing x + p (y - x) towards a mesh of the same size is the only filter of MeshLab
    that sets coordinates from data; unlike the function filters it copes with custom attributes.
    By way of the origin, with y = -x and then y = 2 x', p = 1/2, nothing is rounded. A -0.0 lives
    through x + p (y - x) only if p (y - x) underflows to -0.0.
    """
    old = np.array(meshes.current_mesh().vertex_matrix())
    if np.array_equal(old, points):
        return
    negative = (old == 0.0) & np.signbit(old)
    stays = negative & (points == 0.0) & np.signbit(points)
    tiny = -np.nextafter(0.0, 1.0)
    _halfway(meshes, np.where(negative, tiny, 0.0 - old))
    _halfway(meshes, np.where(stays, tiny, 2.0 * points))
    meshes.current_mesh().update_bounding_box()


def _halfway(meshes: Any, points: NDArray[np.float64]) -> None:
    """Move the vertices of the current mesh half of the way to other places."""
    from pymeshlab import Mesh

    own = meshes.current_mesh_id()
    meshes.add_mesh(Mesh(points, meshes.current_mesh().face_matrix()), "target", True)
    target = meshes.current_mesh_id()
    meshes.set_current_mesh(own)
    try:
        meshes.apply_filter("compute_coord_linear_morphing", targetmesh=target, percentmorph=50.0)
    finally:
        meshes.set_current_mesh(target)
        meshes.apply_filter("delete_current_mesh")
        meshes.set_current_mesh(own)
