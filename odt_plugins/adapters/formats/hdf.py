"""CGNS and MOAB files, of which meshio reads a part: what it leaves out is named."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from odt_plugins.adapters.formats.decks import unread
from odt_plugins.adapters.formats.readers import reader_of
from odt_plugins.errors import MeshFileError

TETRA = 10
"""Number of linear tetrahedra among the types of elements of CGNS."""

HELD = ("GridCoordinates", "GridElements", "ZoneType")
"""What meshio reads of a zone, and what says nothing that a mesh does not hold."""

NUMBERS = "GLOBAL_ID"
"""Tag of MOAB that numbers what there is."""


def cgns(path: Path) -> Any:
    """Read the tetrahedra of the one zone of a file.

    Raises
    ------
    MeshFileError    it has several zones, or other elements
    """
    import h5py

    more: list[str] = []
    with h5py.File(path, "r") as file:
        base = file["Base"] if "Base" in file else {}
        zones = [name for name in base if "GridCoordinates" in _inside(base[name])]
        if len(zones) > 1:
            msg = f"it has {len(zones)} zones, expected one"
            raise MeshFileError(msg)
        for name in base:
            parts = _inside(base[name])
            more += [part for part in parts if part not in HELD] if name in zones else [name]
            kind = _inside(parts.get("GridElements")).get(" data")
            if kind is not None and int(np.ravel(kind)[0]) != TETRA:
                msg = f"it has elements of type number {int(np.ravel(kind)[0])}, expected {TETRA}"
                raise MeshFileError(msg)
    mesh = _read(path, "cgns")
    # Names of HDF5's own bookkeeping start with a blank.
    mesh.info = unread("the nodes", [name for name in more if not name.startswith(" ")])
    return mesh


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
