"""pymeshlab.Mesh and the current mesh of a pymeshlab.MeshSet: planar triangles.

Everything survives: colours, scalars, texture coordinates per vertex and per wedge, textures,
custom attributes, selection, edges, label, visibility, transform matrix, the other meshes of the
set with their ids, and the filter script. Normals are recomputed. Faces of different textures or
charts of one never mix.

When edges were flipped a copy is built anew, since MeshLab cannot set faces: then curvature
directions and polygons (faux edges) are lost. So they are in copies of a mesh with several
textures, or with one and no wedges. Warnings name them, and textures whose names no PLY file can
hold. Copies belong to no file, as far as `save_project()` is concerned. A filter gives the mesh
itself its new faces (`pymeshlab_faces`), so that Mesh objects of it stay valid.

Custom attributes that came into a MeshSet with `add_mesh()` are unsound in pymeshlab: its function
filters crash on them or replace their values by others. Copies that are made here are sound.

A vertex that does not move keeps its coordinates bit for bit, the sign of a zero included; in one
that moves a new -0.0 comes out as 0.0.

A Mesh that comes back belongs to a MeshSet of its own, which lives as long as it does.
"""

from __future__ import annotations

import re
import weakref
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.fields import dense, sampled
from odt_plugins.adapters.host import HostMesh, KeptCells, Result, is_instance
from odt_plugins.adapters.pymeshlab_copy import (
    Attribute,
    custom_attributes,
    private_copy,
    rebuilt,
    textures,
    without_pictures,
)
from odt_plugins.adapters.pymeshlab_faces import (
    can_be_set,
    move_vertices,
    result_in_place,
    set_faces,
)
from odt_plugins.adapters.pymeshlab_ply import FACE_SCALAR, VERTEX_COLOUR, VERTEX_SCALAR, in_bytes
from odt_plugins.adapters.pymeshlab_set import copy_of_set, exchange
from odt_plugins.adapters.regions import region_labels
from odt_plugins.adapters.wedges import charts
from odt_plugins.errors import UnsupportedMeshError, counted


class InPlace(NamedTuple):
    """A MeshSet whose current mesh is to be changed itself instead of being copied."""

    meshes: Any


def matches(mesh: object) -> bool:
    """Say whether this is a pymeshlab Mesh or MeshSet."""
    if isinstance(mesh, InPlace):
        return True
    return is_instance(mesh, "pymeshlab", "Mesh") or is_instance(mesh, "pymeshlab", "MeshSet")


def read(mesh: Any, regions: str | Sequence[str] | None = None) -> HostMesh:
    """Take the arrays of a Mesh or of the current mesh of a MeshSet.

    Parameters
    ----------
    mesh : pymeshlab.Mesh, pymeshlab.MeshSet or InPlace
    regions : names, "auto" or None
                               of custom scalar attributes per face of whole numbers, see
                               :func:`odt_plugins.adapters.regions.region_labels`

    Raises
    ------
    UnsupportedMeshError       the MeshSet is empty, or the mesh has no faces
    InvalidOptionError         there is no attribute of that name
    """
    meshes = mesh.meshes if isinstance(mesh, InPlace) else mesh
    whole = is_instance(meshes, "pymeshlab", "MeshSet")
    if whole and not meshes.mesh_number():
        msg = "got a MeshSet without meshes; expected a current mesh, try load_new_mesh()"
        raise UnsupportedMeshError(msg)
    current = meshes.current_mesh() if whole else meshes
    if not current.face_number():
        found = counted(current.vertex_number(), "vertex", "vertices")
        msg = (f"got a mesh without faces ({found}); expected triangles, try "
               f"generate_surface_reconstruction_ball_pivoting() on a point cloud")
        raise UnsupportedMeshError(msg)
    copy = without_pictures(current)
    inner = copy.current_mesh()
    cells = np.array(inner.face_matrix())
    arrays = _labels(inner, custom_attributes(copy))
    labels = region_labels(arrays, regions, cells)
    edges = np.array(inner.edge_matrix())
    kept = [KeptCells("edge", edges)]
    blocks = None
    texture = np.array(inner.vertex_tex_coord_matrix()) if inner.has_vertex_tex_coord() else None
    if inner.has_wedge_tex_coord():
        texture = np.array(inner.wedge_tex_coord_matrix()).reshape(-1, 3, 2)
        chart, seams = charts(texture, cells)
        kept.append(seams)
        numbers = textures(copy)[1]
        blocks = chart if numbers is None else chart * (int(numbers.max()) + 2) + numbers + 1
    return HostMesh(
        points=np.array(inner.vertex_matrix()),
        cells=cells,
        regions=labels.values,
        regions_from=labels.names,
        blocks=blocks,
        kept=tuple(part for part in kept if len(part.rows)),
        source=mesh,
        texture=texture,
        words=in_words,
        fields=sampled(_vertex_data(inner, copy)),
        densities=dense(arrays | _face_data(inner, copy)),
        follows=False,
    )


def write(result: Result, host: HostMesh) -> Any:
    """Move the vertices or exchange the faces of the current mesh, in a copy unless InPlace."""
    source = host.source
    moves = result.feet is None and result.vertices is None
    moves = moves and not result.of_cells and np.array_equal(result.cells, host.cells)
    if isinstance(source, InPlace):
        if moves:
            move_vertices(source.meshes, result.points)
        elif result.vertices is None and (
            fitting := result_in_place(source.meshes, result)
        ) is not None and can_be_set(source.meshes, fitting):
            set_faces(source.meshes, fitting)
        else:
            exchange(source.meshes, rebuilt(source.meshes.current_mesh(), result))
        return source
    whole = is_instance(source, "pymeshlab", "MeshSet")
    mesh = source.current_mesh() if whole else source
    if moves:
        copy = private_copy(mesh)
        move_vertices(copy, result.points)
    else:
        copy = rebuilt(mesh, result)
    return copy_of_set(source, copy) if whole else standing_alone(copy)


def in_words(text: str) -> str:
    """Put an error message into MeshLab's words."""
    text = text.replace("merging vertices at the same place", "meshing_remove_duplicate_vertices()")
    return re.sub(r"\bcell(s?)\b(?!=)", r"face\1", text)


def standing_alone(owner: Any) -> Any:
    """Current mesh of a private MeshSet, which then lives as long as that mesh is in use."""
    mesh = owner.current_mesh()
    weakref.finalize(mesh, lambda kept: None, owner).atexit = False
    return mesh


def _vertex_data(mesh: Any, meshes: Any) -> dict[str, NDArray[Any]]:
    """Custom attributes of the vertices, their colours if several, their scalars if not all 0."""
    out: dict[str, NDArray[Any]] = {
        attribute.name: attribute.values(mesh) for attribute in custom_attributes(meshes)
        if attribute.reader.startswith("vertex")}
    scalars = np.array(mesh.vertex_scalar_array())
    colours = in_bytes(mesh.vertex_color_matrix() if mesh.has_vertex_color() else np.zeros((0, 4)))
    if (colours != colours[:1]).any():
        out[VERTEX_COLOUR] = colours
    return out | ({VERTEX_SCALAR: scalars} if scalars.any() else {})


def _face_data(mesh: Any, meshes: Any) -> dict[str, NDArray[Any]]:
    """Custom points of the faces, and their scalars where there are others than 0."""
    out: dict[str, NDArray[Any]] = {
        attribute.name: attribute.values(mesh) for attribute in custom_attributes(meshes)
        if attribute.reader == "face_custom_point_attribute_matrix"}
    scalars = np.array(mesh.face_scalar_array()) if mesh.has_face_scalar() else np.zeros(0)
    return out | ({FACE_SCALAR: scalars} if scalars.any() else {})


def _labels(mesh: Any, names: list[Attribute]) -> dict[str, NDArray[Any]]:
    """Scalar attributes per face, as integers where all values are whole numbers."""
    out: dict[str, NDArray[Any]] = {}
    for attribute in names:
        if attribute.reader == "face_custom_scalar_attribute_array":
            values = attribute.values(mesh)
            whole = np.isfinite(values).all() and (np.abs(values) < 2.0**53).all()
            whole = whole and (values == np.floor(values)).all()
            out[attribute.name] = values.astype(np.int64) if whole else values
    return out
