"""Copies of one pymeshlab mesh, whole or with new faces, with all that MeshLab's own leave out."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters import pymeshlab_ply
from odt_plugins.adapters.fields import field_names
from odt_plugins.adapters.host import Result
from odt_plugins.adapters.reading import ALONE
from odt_plugins.errors import DataNotKeptWarning, warn

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


def private_copy(mesh: Any) -> Any:
    """Copy a mesh into a new MeshSet; compact, with everything that belongs to a mesh."""
    from pymeshlab import MeshSet

    out = MeshSet()
    add_copy(out, mesh)
    return out


def one_point() -> Any:
    """Give a mesh of a single vertex."""
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
    if needs_file(mesh):
        faces = np.array(mesh.face_matrix())
        same = Result(mesh.vertex_matrix(), faces, np.arange(len(faces), dtype=np.int32))
        _add_from_file(meshes, mesh, same)
        return
    if not mesh.vertex_number():
        meshes.add_mesh(one_point())
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


def needs_file(mesh: Any) -> bool:
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
    if pictures and not needs_file(like):
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
    from pymeshlab import MeshSet

    bare = without_pictures(mesh)
    names, numbers = textures(bare)
    attributes = custom_attributes(bare)
    _warn_of_losses(mesh)
    pictures = mesh.textures() if needs_file(mesh) else {}
    names = (names or list(pictures)) if pictures else []
    with tempfile.TemporaryDirectory(prefix="odt-plugins-") as folder:
        files = _plain_names(names)
        for name, file in zip(names, files, strict=True):
            _save_picture(pictures[name], Path(folder) / file)
        path = Path(folder) / "mesh.ply"
        path.write_bytes(pymeshlab_ply.encode(mesh, result, files, numbers))
        if mesh.label() or files:
            meshes.load_new_mesh(str(path))
        else:
            # A mesh of a file without a label has the name of the file.
            read = MeshSet()
            read.load_new_mesh(str(path))
            meshes.add_mesh(read.current_mesh())
    _complete(meshes, mesh)
    inner = meshes.current_mesh()
    for attribute in attributes:
        values = attribute.values(mesh)
        if "face" in attribute.reader:
            values = result.carried(values, attribute.name)
        elif result.vertices is not None:
            field = bool(field_names({attribute.name: values}))
            values = result.vertices.carried(values, attribute.name, field=field)
        attribute.add(inner, values)


def _plain_names(names: list[str]) -> list[str]:
    """Names of textures that a PLY file can hold, with a warning where they are new."""
    plain = [name if PLAIN.fullmatch(name) else f"texture{i}.png" for i, name in enumerate(names)]
    if plain != names:
        new = ", ".join(f"{old!r} is {name!r}" for old, name in zip(names, plain, strict=True)
                        if old != name)
        msg = f"MeshLab does not take over the names of all textures: {new} now"
        warn(msg, DataNotKeptWarning)
    return plain


def _warn_of_losses(mesh: Any) -> None:
    from pymeshlab import MissingComponentException

    lost = []
    for kind in ("vertex", "face"):
        with suppress(MissingComponentException), muted():
            getattr(mesh, f"{kind}_curvature_principal_dir1_matrix")()
            lost.append(f"the curvature directions per {kind}")
    if has_polygons(mesh):
        lost.append("the polygons, which are now triangles")
    if lost:
        msg = f"the mesh was built anew; MeshLab does not take over {' and '.join(lost)}"
        warn(msg, DataNotKeptWarning)


def has_polygons(mesh: Any) -> bool:
    """Whether MeshLab takes triangles of a mesh for parts of polygons.

    The list of polygons of a mesh never ends where a filter, such as one that subdivides, leaves
    edges within polygons that are such on one side alone.
    """
    with tempfile.TemporaryDirectory(prefix="odt-plugins-") as folder:
        file = Path(folder) / "mesh.ply"
        without_pictures(mesh).save_current_mesh(
            str(file), save_textures=False,
            **BARE | {"save_face_flag": True, "save_wedge_texcoord": False})
        return pymeshlab_ply.in_polygons(
            file.read_bytes(), mesh.vertex_number(), mesh.face_number())


@contextmanager
def muted() -> Iterator[None]:
    """Keep what MeshLab's C++ code writes to the process's stdout and stderr from being seen."""
    with ALONE:
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
