"""Plain arrays: `(points, cells)` or `(points, cells, regions)`, as a tuple or a list.

This is also what pytetwild.tetrahedralize returns. Everything survives: the class of the
sequence, the dtypes, the orientation; the regions come back exactly, one per output cell, also
those that were given by keyword.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from odt_plugins.adapters.host import HostMesh, Result
from odt_plugins.adapters.regions import AUTO, region_labels


def matches(mesh: object) -> bool:
    """Say whether this is a tuple or list of two or three arrays."""
    return (
        isinstance(mesh, tuple | list)
        and len(mesh) in (2, 3)
        and all(isinstance(part, np.ndarray) for part in mesh)
    )


def read(mesh: Any, regions: str | Sequence[str] | None = None) -> HostMesh:
    """Take the arrays as they are; a third one holds the region labels (m,)."""
    points, cells = mesh[:2]
    given = len(mesh) == 3 and regions == AUTO
    labels = mesh[2] if given else region_labels({}, regions, cells).values
    return HostMesh(points, cells, regions=labels, source=mesh)


def write(result: Result, host: HostMesh) -> Any:
    """Give back a sequence of the same class with new arrays, and labels if any were given."""
    parts = [result.points, result.cells]
    labels = host.source[2] if len(host.source) == 3 else host.regions
    if labels is not None:
        parts.append(labels[result.source])
    kind = type(host.source)
    if hasattr(kind, "_make"):
        return kind._make(parts) if len(parts) == len(host.source) else tuple(parts)
    return kind(parts)
