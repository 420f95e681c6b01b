"""CGNS files: one zone of points and sections of elements, which are sets, as CGNS's library reads.

What meshio writes has none of the labels by which CGNS finds its nodes, and no triangles.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from odt_plugins.adapters.formats.decks import indices, refuse_types
from odt_plugins.adapters.formats.hdf import MAIN, TYPES

NUMBERS = {kind: number for number, (kind, _) in TYPES.items()}
"""Numbers of elements by types of cells."""

VERSION = 3.4
"""Of CGNS's library."""

LONGEST = 32
"""Most bytes of a name."""

KINDS = {"int32": "I4", "int64": "I8", "float32": "R4", "float64": "R8", "int8": "C1"}
"""What types of numbers are called."""


def write(path: Path, mesh: Any, binary: bool | None) -> list[str]:
    """Write points and elements; those of a set are a section.

    Of cells of several sets the smallest sets that have none in common are whole, and others get
    what is left.

    Raises
    ------
    UnsupportedMeshError    there are cells that no element is known for
    """
    import h5py

    del binary
    refuse_types({block.type for block in mesh.cells if len(block.data)} - NUMBERS.keys())
    parts = _sections(mesh)
    top = _greatest(mesh)
    count = sum(len(block.data) for block in mesh.cells if block.dim == top)
    with h5py.File(path, "w", track_order=True) as file:
        for key, text in (("name", "HDF5 MotherNode"), ("label", "Root Node of HDF5 File")):
            file.attrs.create(key, np.bytes_(text), dtype="S33")
        file.attrs.create("type", np.bytes_("MT"), dtype="S3")
        file[" format"] = _letters("IEEE_LITTLE_32", 15)
        file[" hdf5version"] = _letters(f"HDF5 Version {h5py.version.hdf5_version}", 33)
        _put(file, "CGNSLibraryVersion", "CGNSLibraryVersion_t", np.array([VERSION], np.float32))
        base = _put(file, "Base", "CGNSBase_t", np.array([top, mesh.points.shape[1]], np.int32))
        zone = _put(base, "Zone1", "Zone_t", np.array([[len(mesh.points)], [count], [0]], np.int64))
        _put(zone, "ZoneType", "ZoneType_t", _letters("Unstructured"))
        places = _put(zone, "GridCoordinates", "GridCoordinates_t")
        for axis, values in zip("XYZ", np.asarray(mesh.points).T, strict=False):
            _put(places, f"Coordinate{axis}", "DataArray_t", np.ascontiguousarray(values))
        first = 1
        for name, kind, rows in parts:
            part = _put(zone, name, "Elements_t", np.array([NUMBERS[kind], 0], np.int32))
            ends = np.array([first, first + len(rows) - 1], dtype=np.int64)
            _put(part, "ElementRange", "IndexRange_t", ends)
            _put(part, "ElementConnectivity", "DataArray_t", rows.ravel().astype(np.int64) + 1)
            first += len(rows)
    return []


def _sections(mesh: Any) -> list[tuple[str, str, Any]]:
    """Names, types and nodes of the sections: cells of no set are called as meshio or by type.

    Those of the greatest dimension come first, since readers tell the boundary by that.
    """
    out: list[tuple[str, str, Any]] = []
    taken = {"GridCoordinates", "ZoneType"}
    top, order = _greatest(mesh), _order(mesh)
    for i, block in sorted(enumerate(mesh.cells), key=lambda pair: -pair[1].dim):
        rest = np.ones(len(block.data), dtype=np.bool_)
        members = [(name, indices(mesh.cell_sets[name][i])) for name in order]
        plain = MAIN if block.dim == top and MAIN not in taken else block.type
        for name, rows in [*members, (plain, np.arange(len(block.data)))]:
            own = np.unique(rows[rest[rows]])
            rest[own] = False
            if len(own):
                title = _free(name, taken)
                taken.add(title)
                out.append((title, block.type, np.asarray(block.data)[own]))
    return out


def _order(mesh: Any) -> list[str]:
    """Names of the sets, before others the smallest that have no cell in common."""
    starts = np.cumsum([0, *(len(block.data) for block in mesh.cells)])
    rows = {name: np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *(
        indices(part) + start for part, start in zip(members, starts, strict=False))]))
        for name, members in mesh.cell_sets.items()}
    free = np.ones(starts[-1], dtype=np.bool_)
    whole: list[str] = []
    others: list[str] = []
    for name in sorted(rows, key=lambda name: len(rows[name])):
        if free[rows[name]].all():
            whole.append(name)
            free[rows[name]] = False
        else:
            others.append(name)
    return whole + others


def _greatest(mesh: Any) -> int:
    """The greatest dimension that there are cells of."""
    return max((block.dim for block in mesh.cells if len(block.data)), default=0)


def _free(name: str, taken: set[str]) -> str:
    """A name that is short enough, has no slash, and is free."""
    for k in range(1, len(taken) + 2):
        end = f" {k}" if k > 1 else ""
        short = name.replace("/", "_").encode()[: LONGEST - len(end)].decode(errors="ignore")
        if short.strip(" .") and short + end not in taken:
            break
        name = name if short.strip(" .") else "unnamed"
    return short + end


def _letters(text: str, size: int = 0) -> Any:
    """A text as bytes, with zeros behind it up to a size."""
    return np.frombuffer(text.encode().ljust(size, b"\0"), dtype=np.int8)


def _put(home: Any, name: str, label: str, values: Any = None) -> Any:
    """Make a node of CGNS, which is a group with attributes and its data under ` data`."""
    node = home.create_group(name, track_order=True)
    kind = "MT" if values is None else KINDS[values.dtype.name]
    for key, text, size in (("name", name, 33), ("label", label, 33), ("type", kind, 3)):
        node.attrs.create(key, np.bytes_(text.encode()), dtype=f"S{size}")
    node.attrs["flags"] = np.array([1], dtype=np.int32)
    if values is not None:
        node[" data"] = values
    return node
