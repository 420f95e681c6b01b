"""DOLFIN's XML: a mesh, and the functions of its cells and vertices in files beside it."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.decks import REMARKS, UNREAD
from odt_plugins.errors import MeshFileError

CELLS = {"interval": ("line", 2), "triangle": ("triangle", 3), "tetrahedron": ("tetra", 4)}
"""Types of cells by what files call them, and their numbers of nodes."""

TYPES: dict[str, Any] = {"int": np.int64, "uint": np.uint64, "float": np.float64,
                         "double": np.float64, "bool": np.bool_}
"""Types of values by what files call them."""

TRUE = ("1", "true", "True")


def read(path: Path) -> Any:
    """Read a mesh, and the functions of its cells and vertices in files `<its name>_*.xml`.

    Functions of facets and edges, which DOLFIN numbers itself, are named as what is not read. A
    file that belongs to another mesh, such as `mesh_fine_marker.xml` beside `mesh_fine.xml`, is
    none of `mesh.xml`.

    Raises
    ------
    MeshFileError    its parts do not fit together
    """
    from meshio import Mesh

    root = ElementTree.parse(path).getroot()
    found = root if root.tag == "mesh" else root.find("mesh")
    if found is None:
        msg = "it has no mesh"
        raise MeshFileError(msg)
    kind, width = _kind(found)
    dim = int(found.get("dim", "3"))
    points = _rows(found, "vertices", list("xyz"[:dim])).astype(np.float64)
    cells = _rows(found, "cells", [f"v{k}" for k in range(width)]).astype(np.int64)
    bad = cells[(cells < 0) | (cells >= len(points))]
    if bad.size:
        msg = f"a {kind} refers to vertex {bad[0]} of {len(points)}, counted from 0"
        raise MeshFileError(msg)
    strange = sorted({child.tag for child in found} - {"vertices", "cells"})
    unread = [f"the sections {', '.join(strange)}"] if strange else []
    mesh = Mesh(points, [(kind, cells)])
    remarks = []
    for part, name in _beside(path):
        function = _function(part)
        if function is None:
            unread.append(f"what {part.name} says")
            continue
        values, of = function
        if of == 0 and len(values) == len(points):
            mesh.point_data[name] = values
        elif of in (width - 1, dim) and len(values) == len(cells):
            mesh.cell_data[name] = [values]
        elif 0 < of < width - 1:
            sides = "edges" if (of, width) == (1, 4) else "facets"
            unread.append(f"what {part.name} says of {sides}")
        else:
            of_what, count = ("vertices", len(points)) if of == 0 else ("cells", len(cells))
            remarks.append(f"{part.name} is left out, it has {len(values)} values for {count} "
                           f"{of_what}")
    mesh.info = {UNREAD: unread}
    setattr(mesh, REMARKS, remarks)
    return mesh


def _kind(mesh: Any) -> tuple[str, int]:
    """Type of the cells and their number of nodes."""
    word = mesh.get("celltype", "")
    if word not in CELLS:
        msg = f"it has cells of type {word!r}"
        raise MeshFileError(msg)
    return CELLS[word]


def _rows(mesh: Any, section: str, keys: list[str]) -> NDArray[Any]:
    """Numbers of the entries of a section, as text, by their indices."""
    home = mesh.find(section)
    size = 0 if home is None else int(home.get("size", "0"))
    entries = [] if home is None else list(home)
    if len(entries) != size:
        msg = f"it declares {size} {section} and holds {len(entries)}"
        raise MeshFileError(msg)
    rows = np.array([[entry.get(key, "") for key in keys] for entry in entries], dtype=object)
    order = np.array([int(entry.get("index", "-1")) for entry in entries], dtype=np.int64)
    if not np.array_equal(np.sort(order), np.arange(size)):
        msg = f"the indices of its {section} are not 0 to {size - 1}"
        raise MeshFileError(msg)
    return rows.reshape(size, len(keys))[np.argsort(order)]


def _beside(path: Path) -> list[tuple[Path, str]]:
    """Files named after a mesh, with the rest of each name; files of other meshes are left out."""
    near = [part for part in sorted(path.parent.glob("*.xml"))
            if part.stem.startswith(path.stem + "_")]
    meshes = [part.stem for part in near if _holds_mesh(part)]
    return [(part, part.stem.removeprefix(path.stem + "_")) for part in near
            if part.stem not in meshes
            and not any(part.stem.startswith(stem + "_") for stem in meshes)]


def _holds_mesh(path: Path) -> bool:
    """Whether the first section of a file is a mesh."""
    try:
        for _, element in ElementTree.iterparse(path, events=("start",)):
            if element.tag.rpartition("}")[2] != "dolfin":
                return bool(element.tag == "mesh")
    except ElementTree.ParseError:
        return False
    return False


def _function(path: Path) -> tuple[NDArray[Any], int] | None:
    """Values of a function, and the dimension of what they are of; None of other files."""
    try:
        root = ElementTree.parse(path).getroot()
    except ElementTree.ParseError:
        return None
    home = root.find("mesh_function")
    if home is None or home.get("type") not in TYPES:
        return None
    entries = {int(entry.get("index", "-1")): entry.get("value", "") for entry in home}
    if sorted(entries) != list(range(int(home.get("size", "-1")))):
        return None
    words = [entries[i] for i in range(len(entries))]
    if home.get("type") == "bool":
        return np.array([word in TRUE for word in words]), int(home.get("dim", "-1"))
    return np.array(words, dtype=object).astype(TYPES[home.get("type", "")]), int(
        home.get("dim", "-1"))
