"""Plain arrays: `(points, cells)` or `(points, cells, regions)`, as a tuple or a list.

Each of them may be rows of plain numbers in lists or tuples as well, and comes back as such a list.

This is also what pytetwild.tetrahedralize returns. Everything survives: the class of the
sequence, the dtypes, the orientation; the regions come back exactly, one per output cell, also
those that were given by keyword.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.host import HostMesh, Result
from odt_plugins.adapters.regions import AUTO, region_labels
from odt_plugins.errors import InvalidMeshError, plain_values


def matches(mesh: object) -> bool:
    """Say whether this is a tuple or list of two or three arrays, or of lists of rows."""
    return (
        isinstance(mesh, tuple | list)
        and len(mesh) in (2, 3)
        and all(isinstance(part, np.ndarray | list | tuple) for part in mesh)
    )


def read(mesh: Any, regions: str | Sequence[str] | None = None) -> HostMesh:
    """Take the arrays as they are; a third one holds the region labels (m,)."""
    names = ("points", "cells", "regions")
    points, cells, *rest = (
        _array(part, name) for part, name in zip(mesh, names[: len(mesh)], strict=True))
    labels = rest[0] if rest and regions == AUTO else region_labels({}, regions, cells).values
    return HostMesh(points, cells, regions=labels, source=mesh)


def write(result: Result, host: HostMesh) -> Any:
    """Give back a sequence of the same class with new arrays, and labels if any were given."""
    parts: list[Any] = [result.points, result.cells]
    labels = host.source[2] if len(host.source) == 3 else host.regions
    given = [*host.source, labels][: 2 if labels is None else 3]
    if labels is not None:
        parts.append(np.asarray(labels)[result.source])
    parts = [part if isinstance(old, np.ndarray) else part.tolist()
             for part, old in zip(parts, given, strict=True)]
    kind = type(host.source)
    if hasattr(kind, "_make"):
        return kind._make(parts) if len(parts) == len(host.source) else tuple(parts)
    return kind(parts)


def _array(part: Any, name: str) -> NDArray[Any]:
    """An array as it is; rows of numbers as one, points as floating-point numbers.

    Raises
    ------
    InvalidMeshError    the rows have different lengths, or hold other things than numbers, or some
                        of them are masked
    """
    plain_values(name, part, InvalidMeshError)
    if isinstance(part, np.ndarray):
        return part
    try:
        values = np.array(part)
        return values.astype(np.float64) if name == "points" else values
    except (TypeError, ValueError, OverflowError) as exc:
        msg = f"got {name} that are no rows of numbers of one length ({exc}); try an array"
        raise InvalidMeshError(msg) from exc
