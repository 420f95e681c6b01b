"""Plain arrays: `(points, cells)` or `(points, cells, regions)`, as a tuple or a list.

This is also what pytetwild.tetrahedralize returns. Everything survives: the class of the
sequence, the dtypes, the orientation; the regions come back exactly, one per output cell.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from odt_plugins.adapters.host import HostMesh, Result, region_array


def matches(mesh: object) -> bool:
    """Say whether this is a tuple or list of two or three arrays."""
    return (
        isinstance(mesh, tuple | list)
        and len(mesh) in (2, 3)
        and all(isinstance(part, np.ndarray) for part in mesh)
    )


def read(mesh: Any, regions: str | None = None) -> HostMesh:
    """Take the arrays as they are; a third one holds the region labels (m,)."""
    points, cells = mesh[:2]
    labels = mesh[2] if len(mesh) == 3 else None
    if regions is not None:
        labels = region_array({}, regions)
    return HostMesh(points, cells, regions=labels, source=mesh)


def write(result: Result, host: HostMesh) -> Any:
    """Give back a sequence of the same class with new arrays."""
    parts = [result.points, result.cells]
    if len(host.source) == 3:
        parts.append(host.source[2][result.source])
    kind = type(host.source)
    return kind._make(parts) if hasattr(kind, "_make") else kind(parts)
