"""trimesh.Trimesh.

Everything survives: class, metadata, colours of vertices or faces, texture coordinates with their
material, material of every face, attributes of vertices and faces, density and centre of mass if
they were set. trimesh itself computes normals, and all else that it caches, anew when it is asked.
Texture coordinates are interpolated at the new places of the vertices.
Primitives, such as `trimesh.primitives.Box`, have no other vertices than their own and are refused.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from copy import deepcopy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.fields import dense, sampled
from odt_plugins.adapters.host import HostMesh, Result, is_instance
from odt_plugins.adapters.regions import region_labels
from odt_plugins.adapters.wedges import slid
from odt_plugins.errors import InvalidMeshError, UnsupportedMeshError, plain_values

MATERIALS, COLOURS, VISUAL = "face_materials", "vertex_colors", "visual."

REMEDIES = (
    (r"merging vertices at the same place", "mesh.merge_vertices()"),
    (r"(?<=try )repair='orient'", "mesh.fix_normals()"),
    (r"(?<=try )removing repeated cells", "mesh.update_faces(mesh.unique_faces())"),
    (r"(?<=try )removing such cells", "mesh.update_faces(mesh.nondegenerate_faces())"),
)
"""What error messages advise, and the methods of trimesh that do it."""


def matches(mesh: object) -> bool:
    """Say whether this is a Trimesh."""
    return is_instance(mesh, "trimesh", "Trimesh")


def read(mesh: Any, regions: str | Sequence[str] | None = None) -> HostMesh:
    """Take the arrays out of a Trimesh.

    Parameters
    ----------
    mesh : trimesh.Trimesh
    regions : names, "auto" or None
                               of face attributes of region labels, or "face_materials"

    Raises
    ------
    UnsupportedMeshError       a primitive, or no faces
    InvalidOptionError         there is no attribute of that name
    """
    if is_instance(mesh, "trimesh", "Primitive"):
        msg = (f"got a primitive, {type(mesh).__name__}, whose vertices follow from its size; "
               f"expected a Trimesh, try mesh.to_mesh()")
        raise UnsupportedMeshError(msg)
    n, m = len(mesh.vertices), len(mesh.faces)
    if not m:
        msg = f"got a Trimesh without faces ({n} vertices); expected at least one"
        raise UnsupportedMeshError(msg)
    cells = np.array(mesh.faces)
    arrays = _of_length(mesh.face_attributes, m)
    if _materials(mesh) is not None:
        arrays[MATERIALS] = np.asarray(_materials(mesh))
    uv = getattr(mesh.visual, "uv", None)
    fields = _of_length(_beside_uv(mesh), n) | _of_length(mesh.vertex_attributes, n)
    if mesh.visual.kind == "vertex":
        fields[COLOURS] = np.array(mesh.visual.vertex_colors)
    return HostMesh(
        np.array(mesh.vertices), cells, *region_labels(arrays, regions, cells), source=mesh,
        fields=sampled(fields), words=in_words,
        densities=dense(arrays),
        texture=None if uv is None or len(uv) != n else np.array(uv),
    )


def write(result: Result, host: HostMesh) -> Any:
    """Copy the caller's mesh and exchange its vertices, its faces and their data."""
    mesh = host.source
    same = np.array_equal(result.cells, host.cells) and np.array_equal(result.points, host.points)
    out = mesh.copy(include_cache=same)
    out.__class__ = type(mesh)
    vars(out).update({name: deepcopy(value) for name, value in vars(mesh).items()
                      if name not in vars(out)})
    beside = _beside_uv(mesh)
    for name, values in beside.items():
        out.visual.vertex_attributes[name.removeprefix(VISUAL)] = np.array(values)
    if same:
        return out
    colours = np.array(mesh.visual.face_colors) if mesh.visual.kind == "face" else None
    of_vertices = np.array(mesh.visual.vertex_colors) if mesh.visual.kind == "vertex" else None
    moved = result.vertices
    if moved is not None and of_vertices is not None:
        of_vertices = moved.carried(of_vertices, COLOURS)
    out.vertices, out.faces = result.points, result.cells
    if colours is not None:
        out.visual.face_colors = colours[result.source]
    if of_vertices is not None:
        out.visual.vertex_colors = of_vertices
    if _materials(mesh) is not None:
        out.visual.face_materials = np.asarray(_materials(mesh))[result.source]
    if host.texture is not None and result.feet is not None:
        out.visual.uv = slid(host.texture, host.cells, result.feet)
    for name, values in _of_length(mesh.face_attributes, len(host.cells)).items():
        out.face_attributes[name] = result.carried(values, name)
    if moved is not None:
        for attributes, own in ((mesh.vertex_attributes, out.vertex_attributes),
                                (beside, out.visual.vertex_attributes if beside else {})):
            for name, values in _of_length(attributes, len(host.points)).items():
                if moved.renumbered or name in host.fields:
                    own[name.removeprefix(VISUAL) if attributes is beside else name] = (
                        moved.carried(values, name, field=name in host.fields))
    return out


def in_words(text: str) -> str:
    """Put an error message into trimesh's words."""
    for advice, call in REMEDIES:
        text = re.sub(advice, call, text)
    return re.sub(r"\bcell(s?)\b", r"face\1", text)


def _materials(mesh: Any) -> Any:
    """Number of the material of every face, or None."""
    found = getattr(mesh.visual, MATERIALS, None)
    return found if found is not None and len(found) == len(mesh.faces) else None


def _beside_uv(mesh: Any) -> dict[str, Any]:
    """What a texture has for vertices beside its coordinates, such as colours of glTF.

    The names begin with "visual.", since the mesh may have attributes of the same.
    """
    attributes = mesh.visual.vertex_attributes if mesh.visual.kind == "texture" else {}
    return {VISUAL + name: values for name, values in attributes.items() if name != "uv"}


def _of_length(attributes: Any, count: int) -> dict[str, NDArray[Any]]:
    """Attributes that have one entry for each of the vertices or faces, of which none is masked."""
    arrays = {name: _as_array(plain_values(f"attribute {name!r}", values, InvalidMeshError))
              for name, values in attributes.items()}
    return {name: values for name, values in arrays.items() if values.ndim and len(values) == count}


def _as_array(values: Any) -> NDArray[Any]:
    """An attribute as an array; lists of several lengths are its entries as they are."""
    try:
        return np.asarray(values)
    except ValueError:
        return np.fromiter(values, dtype=object, count=len(values))
