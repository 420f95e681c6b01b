"""Which point arrays sample a field, whose values belong to places and not to vertices; which cell
arrays are densities, whose integrals mean something.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.colours import is_paint, varies
from odt_plugins.errors import InvalidOptionError

if TYPE_CHECKING:
    from odt_plugins.adapters.host import HostMesh

STAY = re.compile(
    r".*(ghost|original|pedigree|dimtags).*|(vtk|point|node|vertex|surface)?normals?|"
    r"(global|local)?(point|node|vertex|element|cell)?(id|index|indices|number|tag)s?")
"""Names, in small letters and without anything but letters, of arrays that say who a vertex is, or
that are computed anew, and which stay whatever their type."""

INPUT = "input"
"""The metric that a mesh has, and no array of that name."""

OF_TENSORS = {2: (3, 4), 3: (6, 9)}
"""How many numbers a symmetric tensor has, by the dimension."""


def field_names(
    arrays: Mapping[str, NDArray[Any]], besides: Collection[str | None] = ()
) -> tuple[str, ...]:
    """Names of the arrays of floating-point numbers, and of colours, that sample a field.

    Parameters
    ----------
    arrays : dict of (n, ...)    point arrays by their names
    besides : names              of arrays that do not, such as normals and texture coordinates
    """
    return tuple(name for name, values in arrays.items()
                 if varies(name, values) and name not in besides
                 and not STAY.fullmatch(re.sub(r"[^a-z]", "", name.lower())))


def sampled(
    arrays: Mapping[str, NDArray[Any]], besides: Collection[str | None] = ()
) -> dict[str, NDArray[Any]]:
    """Take the point arrays that sample a field, see :func:`field_names`."""
    return {name: arrays[name] for name in field_names(arrays, besides)}


def dense(
    arrays: Mapping[str, NDArray[Any]], besides: Collection[str | None] = ()
) -> dict[str, NDArray[Any]]:
    """Take the cell arrays that are densities: of floating-point numbers."""
    return numbers(sampled(arrays, besides))


def numbers(fields: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Take the fields whose integrals and derivatives mean something: no colours."""
    return {name: values for name, values in fields.items()
            if values.dtype.kind in "fc" and not is_paint(name, values)}


def expect_arrays(
    host: HostMesh, *, size: Any = None, adapt: Any = (), metric: Any = None
) -> None:
    """Refuse names of sizes, fields and metrics that no array of a mesh has.

    Raises
    ------
    InvalidOptionError    there is none of such a name
    """
    if isinstance(size, str):
        named_array(host, size)
    for name in [adapt] if isinstance(adapt, str) else adapt:
        named_field(host, name, "adapt=")
    if isinstance(metric, str) and metric != INPUT:
        named_metric(host, metric)


def named_field(host: HostMesh, name: str, what: str) -> NDArray[Any]:
    """Find the point array (n, ...) of floating-point numbers of a mesh that has a name.

    ``what`` is before the name in the error.

    Raises
    ------
    InvalidOptionError    there is none
    """
    known = {key: one for key, one in numbers(host.fields).items() if one.dtype.kind == "f"}
    if name not in known:
        msg = (f"got {what}{name!r}; expected the name of a point array of floating-point "
               f"numbers of this mesh, it has {', '.join(known) or 'none'}")
        raise InvalidOptionError(msg)
    return known[name]


def named_metric(host: HostMesh, name: str) -> NDArray[Any]:
    """Find the point array (n, ...) of a mesh that has a name and several numbers a vertex.

    Raises
    ------
    InvalidOptionError    there is none
    """
    known = {key: values for key, values in numbers(host.fields).items() if values.ndim > 1}
    if name in known:
        return known[name]
    d = host.points.shape[1]
    tensors = [key for key, values in known.items()
               if key != INPUT and values.dtype.kind == "f" and values[:1].size in OF_TENSORS[d]]
    msg = (f"got metric={name!r}; expected 'input', or the name of a point array of symmetric "
           f"tensors of this mesh, it has {', '.join(tensors) or 'none'}")
    raise InvalidOptionError(msg)


def named_array(host: HostMesh, name: str) -> NDArray[Any]:
    """Find the point array (n,) or cell array (m,) of a mesh that has a name; (n, 1) is one, too.

    Values of as many cells as there are vertices come as their means at the vertices.

    Raises
    ------
    InvalidOptionError    there is none of one number each
    """
    points, cells = numbers(host.fields), host.densities
    if name not in points and name not in cells:
        known = [f"{key} ({at})" for at, arrays in (("point", points), ("cell", cells))
                 for key, values in arrays.items()
                 if values.dtype.kind == "f" and values[:1].size == 1]
        msg = (f"got size={name!r}; expected the name of a point or cell array of floating-point "
               f"numbers of this mesh, it has {', '.join(known) or 'none'}")
        raise InvalidOptionError(msg)
    values = points[name] if name in points else cells[name]
    if values[:1].size != 1 or values.dtype.kind == "c":
        msg = (f"got size={name!r}, an array of shape {values.shape} and {values.dtype}; expected "
               f"one real number for each")
        raise InvalidOptionError(msg)
    values = values.reshape(-1)
    n, rows = len(host.points), np.asarray(host.cells, dtype=np.int64)
    if name in points or len(values) != n:
        return values
    count = np.bincount(rows.ravel(), minlength=n)
    total = np.bincount(rows.ravel(), np.repeat(values, rows.shape[1]), minlength=n)
    return np.divide(total, count, out=np.ones(n), where=count > 0)
