"""pymeshlab.Mesh and the current mesh of a pymeshlab.MeshSet: planar triangles.

Everything survives: colours, scalars, texture coordinates per vertex and per wedge, textures,
custom attributes, selection, edges, label, visibility, transform matrix, the other meshes of the
set with their ids, and the filter script. Normals are recomputed. When edges were flipped the mesh
is built anew, since MeshLab cannot set faces: then curvature directions, polygons (faux edges) and
all textures but the first are lost, with a warning that names them.

A Mesh that comes back belongs to a MeshSet of its own, which lives as long as it does.
"""

from __future__ import annotations

import os
import tempfile
import warnings
import weakref
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.host import HostMesh, KeptCells, Result, is_instance, region_array
from odt_plugins.errors import DataNotKeptWarning, UnsupportedMeshError

CUSTOM = {
    "__ca_vs__": "vertex_custom_scalar_attribute_array",
    "__ca_vp__": "vertex_custom_point_attribute_matrix",
    "__ca_fs__": "face_custom_scalar_attribute_array",
    "__ca_fp__": "face_custom_point_attribute_matrix",
}
"""How the PLY exporter marks the names of custom attributes, and how each kind is read."""

SELECTED = 0x20
"""Bit of a selected vertex or face in the property `flags` of MeshLab's PLY files."""


class Attribute(NamedTuple):
    """A custom attribute of a mesh: the method that reads it, and its name."""

    reader: str
    name: str

    def values(self, mesh: Any) -> NDArray[np.float64]:
        """Copy of its values, one row per vertex or face."""
        return np.array(getattr(mesh, self.reader)(self.name))

    def add(self, mesh: Any, values: NDArray[np.float64]) -> None:
        """Add it to another mesh."""
        kind = self.reader.removesuffix("_array").removesuffix("_matrix")
        getattr(mesh, f"add_{kind}")(values, self.name)


def matches(mesh: object) -> bool:
    """Say whether this is a pymeshlab Mesh or MeshSet."""
    return is_instance(mesh, "pymeshlab", "Mesh") or is_instance(mesh, "pymeshlab", "MeshSet")


def read(mesh: Any, regions: str | None = None) -> HostMesh:
    """Take the arrays of a Mesh or of the current mesh of a MeshSet.

    Parameters
    ----------
    mesh : pymeshlab.Mesh or pymeshlab.MeshSet
    regions : str or None      name of the custom scalar attribute per face that holds region
                               labels; None takes "marker" or another known name if it is there

    Raises
    ------
    UnsupportedMeshError       the MeshSet is empty, or the mesh has no faces
    InvalidOptionError         there is no attribute of that name
    """
    from pymeshlab import MeshSet

    whole = is_instance(mesh, "pymeshlab", "MeshSet")
    if whole and not mesh.mesh_number():
        msg = "got a MeshSet without meshes; expected a current mesh, try load_new_mesh()"
        raise UnsupportedMeshError(msg)
    current = mesh.current_mesh() if whole else mesh
    if not current.face_number():
        msg = (
            f"got a mesh without faces ({current.vertex_number()} vertices); expected triangles, "
            f"try generate_surface_reconstruction_ball_pivoting() on a point cloud"
        )
        raise UnsupportedMeshError(msg)
    copy = MeshSet()
    copy.add_mesh(current)
    inner = copy.current_mesh()
    names = custom_attributes(copy)
    labels = region_array(_labels(inner, names), regions)
    edges = np.array(inner.edge_matrix())
    return HostMesh(
        points=np.array(inner.vertex_matrix()),
        cells=np.array(inner.face_matrix()),
        regions=labels,
        kept=(KeptCells("edge", edges),) if len(edges) else (),
        source=mesh,
    )


def write(result: Result, host: HostMesh) -> Any:
    """Copy the caller's object and move the vertices or exchange the faces of the current mesh."""
    whole = is_instance(host.source, "pymeshlab", "MeshSet")
    copy = private_copy(host.source.current_mesh() if whole else host.source)
    if np.array_equal(result.cells, copy.current_mesh().face_matrix()):
        move_vertices(copy, result.points)
    else:
        copy = rebuilt(copy, result)
    return copy_of_set(host.source, copy) if whole else standing_alone(copy)


def standing_alone(owner: Any) -> Any:
    """Current mesh of a private MeshSet, which then lives as long as that mesh is in use."""
    mesh = owner.current_mesh()
    weakref.finalize(mesh, lambda kept: None, owner).atexit = False
    return mesh


def private_copy(mesh: Any) -> Any:
    """Copy a mesh into a new MeshSet; compact, with everything that belongs to a mesh."""
    from pymeshlab import MeshSet

    out = MeshSet()
    add_copy(out, mesh)
    return out


def copy_of_set(meshes: Any, current: Any) -> Any:
    """Copy a MeshSet: its meshes with their ids, visibility, filter script.

    Parameters
    ----------
    meshes : pymeshlab.MeshSet     not changed
    current : pymeshlab.MeshSet    its mesh takes the place of the current mesh

    Warns
    -----
    DataNotKeptWarning    it holds rasters
    """
    from pymeshlab import Mesh, MeshSet

    out = MeshSet()
    unused = []
    found = next_id = 0
    while found < meshes.mesh_number():
        if meshes.mesh_id_exists(next_id):
            own = next_id == meshes.current_mesh_id()
            add_copy(out, current.current_mesh() if own else meshes.mesh(next_id))
            out.set_mesh_visibility(next_id, meshes.is_mesh_visible(next_id))
            found += 1
        else:
            out.add_mesh(Mesh(np.zeros((1, 3))))
            unused.append(next_id)
        next_id += 1
    for spare in unused:
        out.set_current_mesh(spare)
        out.delete_current_mesh()
    out.set_current_mesh(meshes.current_mesh_id())
    restore_script(out, saved_script(meshes))
    if rasters(meshes):
        msg = f"the copy of the MeshSet does not keep its {rasters(meshes)} rasters"
        warnings.warn(msg, DataNotKeptWarning, stacklevel=2)
    return out


def rasters(meshes: Any) -> int:
    """Number of rasters of a MeshSet; newer releases of pymeshlab have none."""
    count = getattr(meshes, "raster_number", None)
    return int(count()) if count else 0


def add_copy(meshes: Any, mesh: Any) -> None:
    """Add a copy of a mesh to a set and make it current, with what `add_mesh` leaves out.

    Warns
    -----
    DataNotKeptWarning    the mesh has more than one texture
    """
    from pymeshlab import Mesh

    if mesh.vertex_number():
        meshes.add_mesh(mesh, mesh.label())
    else:
        meshes.add_mesh(Mesh(np.zeros((1, 3))))
        meshes.apply_filter("set_selection_all", allfaces=False, allverts=True)
        meshes.apply_filter("meshing_remove_selected_vertices")
    meshes.current_mesh().set_label(mesh.label())
    _complete(meshes, mesh)


def _complete(meshes: Any, like: Any) -> None:
    """Give the current mesh the transform matrix and the texture of another."""
    matrix = np.array(like.transform_matrix())
    if not np.array_equal(matrix, np.eye(4)):
        meshes.set_matrix(transformmatrix=matrix, freeze=False)
    textures = like.textures()
    if len(textures) > 1:
        msg = (
            f"the images of the textures {', '.join(sorted(textures))} are not kept: only one "
            f"texture of a mesh can be copied; load them again with set_texture_per_mesh()"
        )
        warnings.warn(msg, DataNotKeptWarning, stacklevel=2)
    elif textures:
        with tempfile.TemporaryDirectory(prefix="odt-plugins-") as folder:
            ((name, image),) = textures.items()
            # Without loss, under its own name: Qt tells the format by the contents.
            image.save(str(Path(folder) / "image.png"))
            file = Path(folder) / (Path(name).name or "texture")
            (Path(folder) / "image.png").rename(file)
            meshes.set_texture_per_mesh(textname=str(file))


def custom_attributes(meshes: Any) -> list[Attribute]:
    """Custom attributes of the current mesh of a set.

    pymeshlab has no list of them, but its PLY exporter offers one switch for each.
    """
    found = []
    for name in meshes.filter_parameter_values("ply"):
        mark = name[:9]
        if mark in CUSTOM:
            found.append(Attribute(CUSTOM[mark], name[9:]))
    return found


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


def move_vertices(meshes: Any, points: NDArray[np.float64]) -> None:
    """Set the vertex coordinates of the current mesh, exactly, and nothing else.

    Linear morphing by 100 % towards a mesh of the same size is the only filter of MeshLab that
    sets coordinates from data; unlike the function filters it copes with custom attributes.
    """
    from pymeshlab import Mesh

    own = meshes.current_mesh_id()
    mesh = meshes.current_mesh()
    meshes.add_mesh(Mesh(points, mesh.face_matrix()), "target", True)
    target = meshes.current_mesh_id()
    meshes.set_current_mesh(own)
    try:
        meshes.apply_filter("compute_coord_linear_morphing", targetmesh=target, percentmorph=100.0)
    finally:
        meshes.set_current_mesh(target)
        meshes.apply_filter("delete_current_mesh")
        meshes.set_current_mesh(own)
    meshes.current_mesh().update_bounding_box()


def exchange(meshes: Any, new: Any) -> None:
    """Put a mesh in the place of the current one.

    Its id and its place in the list stay when the set holds only one mesh; otherwise it is added
    at the end, with a new id. Mesh objects taken before are void, as after delete_current_mesh().

    Parameters
    ----------
    meshes : pymeshlab.MeshSet    changed
    new : pymeshlab.MeshSet       of one mesh
    """
    from pymeshlab import Mesh

    own = meshes.current_mesh_id()
    visible = meshes.is_current_mesh_visible()
    if meshes.mesh_number() == 1 and not rasters(meshes):
        meshes.clear()
        for spare in range(own):
            meshes.add_mesh(Mesh(np.zeros((1, 3))))
            meshes.set_current_mesh(spare)
            meshes.apply_filter("delete_current_mesh")
        own = -1
    add_copy(meshes, new.current_mesh())
    added = meshes.current_mesh_id()
    meshes.set_current_mesh_visibility(visible)
    if own >= 0:
        meshes.set_current_mesh(own)
        meshes.apply_filter("delete_current_mesh")
        meshes.set_current_mesh(added)


def rebuilt(meshes: Any, result: Result, scalars: NDArray[np.float64] | None = None) -> Any:
    """Build the current mesh of a set with new faces: a MeshSet of one mesh.

    A PLY file is the only way into MeshLab that holds a selection; custom attributes are added
    last, since some filters crash in their presence.

    Parameters
    ----------
    meshes : pymeshlab.MeshSet    not changed
    result : Result               new points and faces
    scalars : (m',) float64       scalars of the new faces instead of the old ones

    Warns
    -----
    DataNotKeptWarning    the mesh has data that MeshLab does not take from outside
    """
    from pymeshlab import MeshSet

    old = meshes.current_mesh()
    _warn_of_losses(old)
    if scalars is None and old.has_face_scalar():
        scalars = old.face_scalar_array()[result.source]
    out = MeshSet()
    with tempfile.TemporaryDirectory(prefix="odt-plugins-") as folder:
        file = Path(folder) / "mesh.ply"
        file.write_bytes(_ply(old, result, scalars))
        out.load_new_mesh(str(file))
    private = MeshSet()
    private.add_mesh(out.current_mesh(), old.label())
    private.current_mesh().set_label(old.label())
    _complete(private, old)
    mesh = private.current_mesh()
    for attribute in custom_attributes(meshes):
        values = attribute.values(old)
        attribute.add(mesh, values[result.source] if "face" in attribute.reader else values)
    return private


def _warn_of_losses(mesh: Any) -> None:
    from pymeshlab import MissingComponentException

    lost = []
    for kind in ("vertex", "face"):
        with suppress(MissingComponentException), muted():
            getattr(mesh, f"{kind}_curvature_principal_dir1_matrix")()
            lost.append(f"the curvature directions per {kind}")
    if len(mesh.polygonal_face_list()) != mesh.face_number():
        lost.append("the polygons, which are now triangles")
    if lost:
        msg = f"edges were flipped; MeshLab does not take over {' and '.join(lost)}"
        warnings.warn(msg, DataNotKeptWarning, stacklevel=2)


def _ply(mesh: Any, result: Result, scalars: NDArray[np.float64] | None) -> bytes:
    """Binary PLY file of a mesh with new points and faces and the data that MeshLab reads."""
    n, m, source = len(result.points), len(result.cells), result.source
    header = ["ply", "format binary_little_endian 1.0"]

    vertex: list[tuple[str, str, Any]] = [
        (f"double {axis}", "<f8", column)
        for axis, column in zip("xyz", result.points.T, strict=True)
    ]
    vertex.append(("int flags", "<i4", SELECTED * mesh.vertex_selection_array()))
    if mesh.has_vertex_color():
        vertex += _colours(mesh.vertex_color_matrix())
    if mesh.has_vertex_scalar():
        vertex.append(("double quality", "<f8", mesh.vertex_scalar_array()))
    if mesh.has_vertex_tex_coord():
        uv = mesh.vertex_tex_coord_matrix()
        vertex += [("float texture_u", "<f4", uv[:, 0]), ("float texture_v", "<f4", uv[:, 1])]
    body = _element(header, "vertex", n, vertex)

    face: list[tuple[str, str, Any]] = [
        ("", "u1", np.full(m, 3)),
        ("list uchar int vertex_indices", "(3,)<i4", result.cells),
        ("int flags", "<i4", SELECTED * mesh.face_selection_array()[source]),
    ]
    if mesh.has_wedge_tex_coord():
        uv = carried_wedges(mesh.wedge_tex_coord_matrix(), mesh.face_matrix(), result)
        face += [("", "u1", np.full(m, 6)), ("list uchar float texcoord", "(6,)<f4", uv)]
    if mesh.has_face_color():
        face += _colours(mesh.face_color_matrix()[source])
    if scalars is not None:
        face.append(("double quality", "<f8", scalars))
    body += _element(header, "face", m, face)

    edges = mesh.edge_matrix()
    if len(edges):
        ends = [(f"int vertex{i + 1}", "<i4", edges[:, i]) for i in (0, 1)]
        body += _element(header, "edge", len(edges), ends)
    return "\n".join([*header, "end_header", ""]).encode() + body


def _element(
    header: list[str], name: str, count: int, columns: list[tuple[str, str, Any]]
) -> bytes:
    """Lay columns side by side in binary rows and name them in the header."""
    header.append(f"element {name} {count}")
    header += [f"property {title}" for title, _, _ in columns if title]
    rows = np.zeros(count, dtype=[(f"f{i}", kind) for i, (_, kind, _) in enumerate(columns)])
    for i, (_, _, values) in enumerate(columns):
        rows[f"f{i}"] = values
    return rows.tobytes()


def _colours(rgba: NDArray[np.float64]) -> list[tuple[str, str, Any]]:
    whole = np.rint(rgba * 255.0)
    names = ("red", "green", "blue", "alpha")
    return [(f"uchar {name}", "u1", column) for name, column in zip(names, whole.T, strict=True)]


def carried_wedges(
    uv: NDArray[np.float64], faces: NDArray[np.int32], result: Result
) -> NDArray[np.float64]:
    """Texture coordinates of the wedges of the new faces.

    Parameters
    ----------
    uv : (3 m, 2)      of the old wedges
    faces : (m, 3)     old faces
    result : Result    new faces and the old face each takes its data from

    Returns
    -------
    (m', 6)            a wedge takes the coordinates that its vertex has in the old face; in a new
                       face a vertex that the old face does not have takes those of any of its old
                       wedges, the one of the lowest face
    """
    corner = uv.reshape(-1, 3, 2)
    first = np.zeros((int(faces.max()) + 1, 2))
    first[faces.ravel()[::-1]] = uv[::-1]
    out = first[result.cells]
    old = faces[result.source]
    for i in range(3):
        for j in range(3):
            same = old[:, j] == result.cells[:, i]
            out[same, i] = corner[result.source[same], j]
    return np.asarray(out.reshape(-1, 6))


def saved_script(meshes: Any) -> bytes:
    """Filter script of a set, as a file."""
    with tempfile.TemporaryDirectory(prefix="odt-plugins-") as folder:
        file = Path(folder) / "script.mlx"
        meshes.save_filter_script(str(file))
        return file.read_bytes()


def restore_script(meshes: Any, script: bytes) -> None:
    """Make a file the filter script of a set."""
    meshes.clear_filter_script()
    if b"<filter" not in script and b"<xmlfilter" not in script:
        return
    with tempfile.TemporaryDirectory(prefix="odt-plugins-") as folder:
        file = Path(folder) / "script.mlx"
        file.write_bytes(script)
        with muted():
            meshes.load_filter_script(str(file))


@contextmanager
def muted() -> Iterator[None]:
    """Keep what MeshLab's C++ code writes to the process's stdout and stderr from being seen."""
    saved = []
    for stream in (1, 2):
        with suppress(OSError):
            saved.append((stream, os.dup(stream)))
    try:
        with open(os.devnull, "wb") as nowhere:
            for stream, _ in saved:
                os.dup2(nowhere.fileno(), stream)
            yield
    finally:
        for stream, copy in saved:
            os.dup2(copy, stream)
            os.close(copy)
