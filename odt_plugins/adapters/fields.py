"""Which point arrays sample a field, whose values belong to places and not to vertices; which cell
arrays are densities, whose integrals mean something.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from typing import Any

from numpy.typing import NDArray

STAY = re.compile(
    r".*(ghost|original|pedigree|dimtags).*|(vtk|point|node|vertex|surface)?normals?|"
    r"(global|local)?(point|node|vertex|element|cell)?(id|index|indices|number|tag)s?")
"""Names, in small letters and without anything but letters, of arrays that say who a vertex is, or
that are computed anew, and which stay whatever their type."""


def field_names(
    arrays: Mapping[str, NDArray[Any]], besides: Collection[str | None] = ()
) -> tuple[str, ...]:
    """Names of the point arrays of floating-point numbers that sample a field.

    Parameters
    ----------
    arrays : dict of (n, ...)    point arrays by their names
    besides : names              of arrays that do not, such as normals and texture coordinates
    """
    return tuple(name for name, values in arrays.items()
                 if values.dtype.kind in "fc" and name not in besides
                 and not STAY.fullmatch(re.sub(r"[^a-z]", "", name.lower())))


def densities(
    arrays: Mapping[str, NDArray[Any]], besides: Collection[str | None] = ()
) -> dict[str, NDArray[Any]]:
    """Take the cell arrays of floating-point numbers that are no normals and tell no cell.

    Parameters
    ----------
    arrays : dict of (m, ...)    cell arrays by their names
    besides : names              of others that are none, such as texture coordinates
    """
    return {name: arrays[name] for name in field_names(arrays, besides)}
