"""CGNS and MOAB files, of which a part is read: what is left out is named."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from odt_plugins.adapters.formats.decks import unread
from odt_plugins.adapters.formats.readers import reader_of
from odt_plugins.errors import MeshFileError

TYPES = {2: ("vertex", 1), 3: ("line", 2), 4: ("line3", 3), 5: ("triangle", 3),
         6: ("triangle6", 6), 7: ("quad", 4), 10: ("tetra", 4), 11: ("tetra10", 10),
         12: ("pyramid", 5), 14: ("wedge", 6), 17: ("hexahedron", 8)}
"""Elements of CGNS by their numbers: their names in meshio, and how many nodes they have."""

MAIN = "GridElements"
"""Section of the cells of the greatest dimension, of their first type, that are in no set."""

PLAIN = {MAIN, *(kind for kind, _ in TYPES.values())}
"""Names of sections of cells that are in no set."""

TETRA, MIXED = 10, 20
"""Numbers of linear tetrahedra, and of elements each of which tells its own type."""

HELD = ("GridCoordinates", "ZoneType", "Ordinal")
"""What is read of a zone, and what says nothing that a mesh does not hold."""

NUMBERS = "GLOBAL_ID"
"""Tag of MOAB that numbers what there is."""


def cgns(path: Path) -> Any:
    """Read the elements of the one zone of a file; several sections of it are cell sets.

    Raises
    ------
    MeshFileError    it has several zones, or elements of types that are not known
    """
    import h5py
    from meshio import Mesh

    with h5py.File(path, "r") as file:
        homes = [part for name in file for part in [_inside(file[name])]]
        bases = [part for part in homes for zone in part.values()
                 if "GridCoordinates" in _inside(zone)]
        if len(bases) != 1:
            msg = f"it has {len(bases)} zones, expected one, try a file for each zone"
            raise MeshFileError(msg)
        zones = [name for name, zone in bases[0].items() if "GridCoordinates" in _inside(zone)]
        zone = _inside(bases[0][zones[0]])
        found = _inside(zone["GridCoordinates"])
        points = np.column_stack([found[f"Coordinate{axis}"][" data"][()] for axis in "XYZ"
                                  if f"Coordinate{axis}" in found])
        parts = {name: part for name, part in zone.items()
                 if "ElementConnectivity" in _inside(part)}
        sections = [(name, kind, rows) for name, part in parts.items()
                    for kind, rows in _elements(part)]
        more = [name for name in bases[0] if name not in zones]
        more += [name for name in zone if name not in {*HELD, *parts}]
    sets: Any = {name: [np.arange(len(rows) * (own == name)) for own, _, rows in sections]
                 for name in parts if len(parts) > 1 and name not in PLAIN}
    mesh = Mesh(points, [(kind, rows) for _, kind, rows in sections], cell_sets=sets)
    # Names of HDF5's own bookkeeping start with a blank.
    mesh.info = unread("the nodes", [name for name in more if not name.startswith(" ")])
    return mesh


def _elements(section: Any) -> list[tuple[str, Any]]:
    """Types and nodes of the elements of a section of CGNS; meshio writes no type of tetrahedra."""
    number = int(np.ravel(section[" data"][()])[0]) if " data" in section else TETRA
    flat = np.ravel(section["ElementConnectivity"][" data"][()]).astype(np.int64)
    rows: dict[int, list[Any]] = {number: [flat]}
    at = 0
    while number == MIXED and at < len(flat):
        width = TYPES.get(int(flat[at]), ("", 0))[1]
        rows.setdefault(int(flat[at]), []).append(flat[at + 1: at + 1 + width])
        at += 1 + width
    other = sorted(rows.keys() - TYPES.keys() - {MIXED})
    if other:
        msg = (f"it has elements of type number {other[0]}, expected some of "
               f"{', '.join(map(str, TYPES))} or {MIXED}")
        raise MeshFileError(msg)
    return [(TYPES[kind][0], np.concatenate(parts).reshape(-1, TYPES[kind][1]) - 1)
            for kind, parts in rows.items() if kind != MIXED]


def h5m(path: Path) -> Any:
    """Read a file of MOAB."""
    import h5py

    with h5py.File(path, "r") as file:
        root = _inside(file["tstt"] if "tstt" in file else None)
        elements = _inside(root.get("elements"))
        more = [f"tag {name} of elements" for part in elements.values()
                for name in _inside(_inside(part).get("tags")) if name != NUMBERS]
        sets, tags = _inside(root.get("sets")), _inside(root.get("tags"))
        more += [f"tag {name}" for name in tags
                 if name != NUMBERS and "id_list" in _inside(tags[name])]
        more += [f"{len(sets['list'])} sets"] if "list" in sets else []
    mesh = _read(path, "h5m")
    mesh.info = unread("the", more)
    return mesh


def _inside(group: Any) -> dict[str, Any]:
    """What a group has; nothing of what is none."""
    return dict(group.items()) if hasattr(group, "items") else {}


def _read(path: Path, name: str) -> Any:
    # A number that is none would become an index.
    with np.errstate(all="raise", under="ignore"):
        return reader_of(name)(str(path))
