"""Which point arrays sample a field, whose values belong to places and not to vertices; which cell
arrays are densities, whose integrals mean something.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.errors import InvalidOptionError

if TYPE_CHECKING:
    from odt_plugins.adapters.host import HostMesh

STAY = re.compile(
    r".*(ghost|original|pedigree|dimtags).*|(vtk|point|node|vertex|surface)?normals?|"
    r"(global|local)?(point|node|vertex|element|cell)?(id|index|indices|number|tag)s?")
"""Names, in small letters and without anything but letters, of arrays that say who a vertex is, or
that are computed anew, and which stay whatever their type."""


def field_names(
    arrays: Mapping[str, NDArray[Any]], besides: Collection[str | None] = ()
) -> tuple[str, ...]:
    """Names of the arrays of floating-point numbers that sample a field, or are densities.

    Parameters
    ----------
    arrays : dict of (n, ...)    point or cell arrays by their names
    besides : names              of arrays that do not, such as normals and texture coordinates
    """
    return tuple(name for name, values in arrays.items()
                 if values.dtype.kind in "fc" and name not in besides
                 and not STAY.fullmatch(re.sub(r"[^a-z]", "", name.lower())))


def sampled(
    arrays: Mapping[str, NDArray[Any]], besides: Collection[str | None] = ()
) -> dict[str, NDArray[Any]]:
    """Take the point or cell arrays of floating-point numbers that are no normals and tell no one.

    Parameters
    ----------
    arrays : dict of (n, ...) or (m, ...)    arrays by their names
    besides : names                          of others that are none, such as texture coordinates
    """
    return {name: arrays[name] for name in field_names(arrays, besides)}


def named_metric(host: HostMesh, name: str) -> NDArray[Any]:
    """Find the point array (n, ...) of a mesh that has a name and several numbers a vertex.

    Raises
    ------
    InvalidOptionError    there is none
    """
    if name in host.fields and host.fields[name].ndim > 1:
        return host.fields[name]
    known = [key for key, values in host.fields.items() if values.ndim > 1]
    msg = (f"got metric={name!r}; expected 'input', or the name of a point array of symmetric "
           f"tensors of this mesh, it has {', '.join(known) or 'none'}")
    raise InvalidOptionError(msg)


def named_array(host: HostMesh, name: str) -> NDArray[Any]:
    """Find the point array (n,) or cell array (m,) of a mesh that has a name.

    Values of as many cells as there are vertices come as their means at the vertices.

    Raises
    ------
    InvalidOptionError    there is none of one number each
    """
    points, cells = host.fields, host.densities
    if name not in points and name not in cells:
        known = [*(f"{key} (point)" for key in points), *(f"{key} (cell)" for key in cells)]
        msg = (f"got size={name!r}; expected the name of a point or cell array of floating-point "
               f"numbers of this mesh, it has {', '.join(known) or 'none'}")
        raise InvalidOptionError(msg)
    values = points[name] if name in points else cells[name]
    if values.ndim != 1 or values.dtype.kind == "c":
        msg = (f"got size={name!r}, an array of shape {values.shape} and {values.dtype}; expected "
               f"one real number for each")
        raise InvalidOptionError(msg)
    n, rows = len(host.points), np.asarray(host.cells, dtype=np.int64)
    if name in points or len(values) != n:
        return values
    count = np.bincount(rows.ravel(), minlength=n)
    total = np.bincount(rows.ravel(), np.repeat(values, rows.shape[1]), minlength=n)
    return np.divide(total, count, out=np.ones(n), where=count > 0)
