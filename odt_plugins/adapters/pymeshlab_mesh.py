"""pymeshlab.Mesh and the current mesh of a pymeshlab.MeshSet: planar triangles.

Everything survives: colours, scalars, texture coordinates per vertex and per wedge, textures,
custom attributes, selection, edges, label, visibility, transform matrix, the other meshes of the
set with their ids, and the filter script. Normals are recomputed. Faces of different textures or
charts of one never mix.

When edges were flipped the mesh is built anew, since MeshLab cannot set faces: then curvature
directions and polygons (faux edges) are lost. So they are in copies of a mesh with several
textures, or with one and no wedges. Warnings name them, and textures whose names no PLY file can
hold. Copies belong to no file, as far as `save_project()` is concerned.

Custom attributes that came into a MeshSet with `add_mesh()` are unsound in pymeshlab: its function
filters crash on them or replace their values by others. Copies that are made here are sound.

A vertex that does not move keeps its coordinates bit for bit, the sign of a zero included; in one
that moves a new -0.0 comes out as 0.0.

A Mesh that comes back belongs to a MeshSet of its own, which lives as long as it does.
"""

from __future__ import annotations

import os
import re
import tempfile
import warnings
import weakref
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters import pymeshlab_ply
from odt_plugins.adapters.host import HostMesh, KeptCells, Result, is_instance, region_array
from odt_plugins.adapters.wedges import charts
from odt_plugins.errors import DataNotKeptWarning, ODTWarning, UnsupportedMeshError, counted

CUSTOM = {
    "__ca_vs__": "vertex_custom_scalar_attribute_array",
    "__ca_vp__": "vertex_custom_point_attribute_matrix",
    "__ca_fs__": "face_custom_scalar_attribute_array",
    "__ca_fp__": "face_custom_point_attribute_matrix",
}
"""How the PLY exporter marks the names of custom attributes, and how each kind is read."""

BARE = {f"save_{name}": False for name in (
    "vertex_quality", "vertex_flag", "vertex_color", "vertex_coord", "vertex_normal",
    "vertex_radius", "face_quality", "face_flag", "face_color", "wedge_color", "wedge_normal")}
"""Parameters by which MeshLab writes nothing but geometry and wedges into a PLY file."""

PLAIN = re.compile(r"(?!.*\.\.)[\w.-][\w./-]*", re.ASCII)
"""File names that MeshLab finds when they stand in a PLY file."""


class InPlace(NamedTuple):
    """A MeshSet whose current mesh is to be changed itself instead of being copied."""

    meshes: Any


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
    if isinstance(mesh, InPlace):
        return True
    return is_instance(mesh, "pymeshlab", "Mesh") or is_instance(mesh, "pymeshlab", "MeshSet")


def read(mesh: Any, regions: str | None = None) -> HostMesh:
    """Take the arrays of a Mesh or of the current mesh of a MeshSet.

    Parameters
    ----------
    mesh : pymeshlab.Mesh, pymeshlab.MeshSet or InPlace
    regions : str or None      name of the custom scalar attribute per face that holds region
                               labels; None takes "marker" or another known name if it is there

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
        msg = (
            f"got a mesh without faces ({found}); expected triangles, try "
            f"generate_surface_reconstruction_ball_pivoting() on a point cloud"
        )
        raise UnsupportedMeshError(msg)
    copy = without_pictures(current)
    inner = copy.current_mesh()
    cells = np.array(inner.face_matrix())
    labels = region_array(_labels(inner, custom_attributes(copy)), regions)
    edges = np.array(inner.edge_matrix())
    kept = [KeptCells("edge", edges)]
    blocks = None
    if inner.has_wedge_tex_coord():
        chart, seams = charts(inner.wedge_tex_coord_matrix().reshape(-1, 3, 2), cells)
        kept.append(seams)
        numbers = textures(copy)[1]
        blocks = chart if numbers is None else chart * (int(numbers.max()) + 2) + numbers + 1
    return HostMesh(
        points=np.array(inner.vertex_matrix()),
        cells=cells,
        regions=labels,
        blocks=blocks,
        kept=tuple(part for part in kept if len(part.rows)),
        source=mesh,
        textured=inner.has_wedge_tex_coord() or inner.has_vertex_tex_coord(),
    )


def write(result: Result, host: HostMesh) -> Any:
    """Move the vertices or exchange the faces of the current mesh, in a copy unless InPlace."""
    source = host.source
    moves = result.feet is None and np.array_equal(result.cells, host.cells)
    if isinstance(source, InPlace):
        if moves:
            move_vertices(source.meshes, result.points)
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
    from pymeshlab import MeshSet

    out = MeshSet()
    fill(out, meshes, current)
    restore_script(out, saved_script(meshes))
    if rasters(meshes):
        msg = f"the copy of the MeshSet does not keep its {rasters(meshes)} rasters"
        warnings.warn(msg, DataNotKeptWarning, stacklevel=2)
    return out


def fill(out: Any, meshes: Any, current: Any) -> None:
    """Copy the meshes of a set, with their ids and visibility, into an empty one.

    Parameters
    ----------
    out : pymeshlab.MeshSet                changed
    meshes, current : pymeshlab.MeshSet    see :func:`copy_of_set`
    """
    unused = []
    found = next_id = 0
    while found < meshes.mesh_number():
        if meshes.mesh_id_exists(next_id):
            own = next_id == meshes.current_mesh_id()
            add_copy(out, current.current_mesh() if own else meshes.mesh(next_id))
            out.set_mesh_visibility(next_id, meshes.is_mesh_visible(next_id))
            found += 1
        else:
            out.add_mesh(_point())
            unused.append(next_id)
        next_id += 1
    for spare in unused:
        out.set_current_mesh(spare)
        out.delete_current_mesh()
    out.set_current_mesh(meshes.current_mesh_id())


def rasters(meshes: Any) -> int:
    """Number of rasters of a MeshSet; newer releases of pymeshlab have none."""
    count = getattr(meshes, "raster_number", None)
    return int(count()) if count else 0


def _point() -> Any:
    from pymeshlab import Mesh

    return Mesh(np.zeros((1, 3)))


def without_pictures(mesh: Any) -> Any:
    """Copy a mesh into a new MeshSet with all but transform and pictures of the textures."""
    from pymeshlab import MeshSet

    out = MeshSet()
    out.add_mesh(mesh)
    return out


def add_copy(meshes: Any, mesh: Any) -> None:
    """Add a copy of a mesh to a set and make it current, with what `add_mesh` leaves out.

    Custom attributes are left out first, as a copy inside of MeshLab does, and then added.

    Warns
    -----
    DataNotKeptWarning    the mesh has several textures, and data besides that no file holds
    """
    if _needs_file(mesh):
        faces = np.array(mesh.face_matrix())
        same = Result(mesh.vertex_matrix(), faces, np.arange(len(faces), dtype=np.int32))
        _add_from_file(meshes, mesh, same)
        return
    if not mesh.vertex_number():
        meshes.add_mesh(_point())
        meshes.apply_filter("set_selection_all", allfaces=False, allverts=True)
        meshes.apply_filter("meshing_remove_selected_vertices")
        _complete(meshes, mesh)
        return
    bare = without_pictures(mesh)
    attributes = custom_attributes(bare)
    if attributes:
        bare.apply_filter("generate_copy_of_current_mesh")
    meshes.add_mesh(bare.current_mesh(), mesh.label())
    _complete(meshes, mesh)
    for attribute in attributes:
        attribute.add(meshes.current_mesh(), attribute.values(mesh))


def _needs_file(mesh: Any) -> bool:
    """Say whether no filter sets the textures of a mesh, as when there are several."""
    several = mesh.texture_number() > 1 or not mesh.has_wedge_tex_coord()
    return several and bool(mesh.textures())


def _complete(meshes: Any, like: Any) -> None:
    """Give the current mesh the label, the transform matrix and the single texture of another."""
    meshes.current_mesh().set_label(like.label())
    matrix = np.array(like.transform_matrix())
    if not np.array_equal(matrix, np.eye(4)):
        meshes.set_matrix(transformmatrix=matrix, freeze=False)
    pictures = like.textures()
    if pictures and not _needs_file(like):
        with tempfile.TemporaryDirectory(prefix="odt-plugins-") as folder:
            ((name, image),) = pictures.items()
            file = Path(folder) / (Path(name).name or "texture")
            _save_picture(image, file)
            meshes.set_texture_per_mesh(textname=str(file))


def _save_picture(image: Any, file: Path) -> None:
    """Write a picture without loss under any name: Qt tells the format by the contents."""
    file.parent.mkdir(parents=True, exist_ok=True)
    png = file.with_name("picture.png")
    image.save(str(png))
    png.replace(file)


def textures(meshes: Any) -> tuple[list[str], NDArray[np.int32] | None]:
    """Names of the textures of the current mesh if there are several, and that of every face.

    Returns
    -------
    names : list of str             empty when there is no choice
    numbers : (m,) int32 or None    place among them of that of every face; None without choice
    """
    mesh = meshes.current_mesh()
    if mesh.texture_number() < 2 or not mesh.has_wedge_tex_coord():
        return [], None
    with tempfile.TemporaryDirectory(prefix="odt-plugins-") as folder:
        file = Path(folder) / "mesh.ply"
        meshes.save_current_mesh(str(file), save_textures=False, **BARE)
        return pymeshlab_ply.texture_numbers(
            file.read_bytes(), mesh.vertex_number(), mesh.face_number())


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


def exchange(meshes: Any, new: Any) -> None:
    """Put a mesh in the place of the current one, with its id.

    MeshLab gives ids only to meshes that are added, so the whole set is emptied and filled again
    in its order. Where that would do harm, since the set holds rasters, or another of its meshes
    is still in use as a Mesh object or has several textures, the new mesh is added at the end,
    with a new id.

    Parameters
    ----------
    meshes : pymeshlab.MeshSet    changed
    new : pymeshlab.MeshSet       of one mesh

    Warns
    -----
    ODTWarning                    the mesh has a new id, or a Mesh object taken before is void
    """
    own, held = meshes.current_mesh_id(), weakref.ref(meshes.current_mesh())
    if _may_be_emptied(meshes):
        copy = copy_of_set(meshes, new)
        meshes.clear()
        fill(meshes, copy, copy)
    else:
        visible = meshes.is_current_mesh_visible()
        add_copy(meshes, new.current_mesh())
        added = meshes.current_mesh_id()
        meshes.set_current_mesh_visibility(visible)
        meshes.set_current_mesh(own)
        meshes.apply_filter("delete_current_mesh")
        meshes.set_current_mesh(added)
        msg = (f"mesh {own} of the MeshSet was built anew and is now mesh {added}; ids stay where "
               f"its other meshes have no second texture and are in no variable, and no rasters")
        warnings.warn(msg, ODTWarning, stacklevel=2)
    mesh = held()
    if mesh is not None and mesh is not meshes.current_mesh():
        msg = ("the current mesh was built anew; the Mesh object taken from the MeshSet before is "
               "void, take current_mesh() again")
        warnings.warn(msg, ODTWarning, stacklevel=2)


def _may_be_emptied(meshes: Any) -> bool:
    """Say whether the other meshes of a set can be copied without loss and without harm."""
    if rasters(meshes):
        return False
    found = current = 0
    while found < meshes.mesh_number():
        if meshes.mesh_id_exists(current):
            found += 1
            if current != meshes.current_mesh_id() and (
                weakref.ref(meshes.mesh(current))() is not None
                or _needs_file(meshes.mesh(current))
            ):
                return False
        current += 1
    return True


def rebuilt(mesh: Any, result: Result) -> Any:
    """Build a mesh with new faces: a MeshSet of one mesh.

    Parameters
    ----------
    mesh : pymeshlab.Mesh    not changed
    result : Result          its new points and faces

    Warns
    -----
    DataNotKeptWarning    the mesh has data that MeshLab does not take from outside
    """
    from pymeshlab import MeshSet

    out = MeshSet()
    _add_from_file(out, mesh, result)
    return out


def _add_from_file(meshes: Any, mesh: Any, result: Result) -> None:
    """Add a mesh with new faces to a set.

    A PLY file is the only way into MeshLab that holds a selection; custom attributes are added
    last, since some filters crash in their presence.
    """
    bare = without_pictures(mesh)
    names, numbers = textures(bare)
    attributes = custom_attributes(bare)
    _warn_of_losses(mesh)
    pictures = mesh.textures() if _needs_file(mesh) else {}
    names = (names or list(pictures)) if pictures else []
    with tempfile.TemporaryDirectory(prefix="odt-plugins-") as folder:
        files = _plain_names(names)
        for name, file in zip(names, files, strict=True):
            _save_picture(pictures[name], Path(folder) / file)
        path = Path(folder) / "mesh.ply"
        path.write_bytes(pymeshlab_ply.encode(mesh, result, files, numbers))
        meshes.load_new_mesh(str(path))
    _complete(meshes, mesh)
    inner = meshes.current_mesh()
    for attribute in attributes:
        values = attribute.values(mesh)
        attribute.add(inner, values[result.source] if "face" in attribute.reader else values)


def _plain_names(names: list[str]) -> list[str]:
    """Names of textures that a PLY file can hold, with a warning where they are new."""
    plain = [name if PLAIN.fullmatch(name) else f"texture{i}.png" for i, name in enumerate(names)]
    if plain != names:
        new = ", ".join(f"{old!r} is {name!r}" for old, name in zip(names, plain, strict=True)
                        if old != name)
        msg = f"MeshLab does not take over the names of all textures: {new} now"
        warnings.warn(msg, DataNotKeptWarning, stacklevel=2)
    return plain


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
        msg = f"the mesh was built anew; MeshLab does not take over {' and '.join(lost)}"
        warnings.warn(msg, DataNotKeptWarning, stacklevel=2)


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
