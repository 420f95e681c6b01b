"""Valid curved cells with inverted or flat corners: the engine does not see them, and they stay.

Their vertices are fixed, and their facets are boundary of what the engine sees.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.host import HostMesh
from odt_plugins.adapters.regions import are_names
from odt_plugins.errors import counted
from odt_plugins.mesh.arrays import FloatArray
from odt_plugins.mesh.bernstein import jacobian_bounds
from odt_plugins.mesh.numbers import vertex_mask
from odt_plugins.mesh.simplex import FLAT, cell_signs

if TYPE_CHECKING:
    from odt_plugins.options import Options

Indices = NDArray[np.int64]


def seen(host: HostMesh, points: FloatArray) -> Indices | None:
    """Cells of a mesh that the engine sees, ascending; None if it sees all, or would see none.

    Parameters
    ----------
    host : HostMesh
    points : (n, d) float64    as the engine wants them
    """
    if host.nodes is None or host.shape is None or points.shape[1] != host.shape.shape[1] - 1:
        return None
    rows = host.nodes.astype(np.int64)
    sign, extent = cell_signs(points, rows[:, : host.shape.shape[1]].astype(np.int32))
    x = points[rows]
    x = x - x[:, :1]
    off = np.abs(x[:, 1:] - np.einsum("kc,mcx->mkx", host.shape[1:] / host.shape[0].sum(),
                                      x[:, : host.shape.shape[1]])).max(axis=(1, 2))
    bent = np.flatnonzero(off > FLAT * extent)
    bounds = jacobian_bounds(x[bent], host.shape)
    turned = bounds.upper < 0.0
    aside = bent[turned | ((sign[bent] == 0) & (bounds.lower > 0.0))]
    if not 0 < len(aside) < len(rows):
        return None
    return np.setdiff1d(np.arange(len(rows)), aside)


def without_others(host: HostMesh, options: Options, cells: Indices) -> tuple[HostMesh, Options]:
    """The mesh of some cells alone, and the options for it: vertices of the others are fixed."""
    m = len(host.cells)
    other = np.setdiff1d(np.arange(m), cells)
    fixed = vertex_mask(options.fixed, len(host.points), "fixed", "vertices")
    fixed[host.cells[other].astype(np.int64)] = True
    selection = options.selection
    if selection is not None:
        selection = vertex_mask(selection, m, "selection", "cells")[cells]

    def own(values: Any) -> Any:
        return values[cells] if np.shape(values)[:1] == (m,) else values

    return replace(host, cells=host.cells[cells], regions=own(host.regions),
                   blocks=own(host.blocks), nodes=own(host.nodes)), replace(
                       options, fixed=fixed, selection=selection)


def of_cells(options: Options, cells: Indices | None, count: int) -> Options:
    """The options with the densities of some of so many cells, if they are given for cells."""
    density = options.density
    if cells is None or isinstance(density, str) or callable(density):
        return options
    values = np.asarray(density)
    return replace(options, density=values[cells]) if values.shape == (count,) else options


def of_optimised(options: Options, host: HostMesh) -> Options:
    """The options with arrays of all cells of an object, of any type, cut to its optimised ones.

    A selection is a mask then; as many densities as there are vertices are of these.
    """
    if host.ids is None or host.total == len(host.cells):
        return options
    of_all: dict[str, Any] = {}
    for name in ("selection", "regions", "density"):
        values = _one_each(getattr(options, name), host.total)
        if values is not None and not (name == "regions" and are_names(options.regions)) and (
            name == "regions" or (name == "selection" and values.dtype == np.bool_)
            or (name == "density" and host.total != len(host.points))
        ):
            of_all[name] = values[host.ids]
    return replace(options, **of_all)


def _one_each(values: Any, count: int) -> NDArray[Any] | None:
    """An array, or a list, of so many values as an array, anything else as None."""
    try:
        if isinstance(values, str) or len(values) != count:
            return None
        array = np.asarray(values)
    except (TypeError, ValueError):
        return None
    return array if array.shape == (count,) else None


def with_others(
    rows: NDArray[Any], cells: NDArray[Any], source: NDArray[Any], own: Indices,
    number: NDArray[Any],
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Cells and their source with those beside them, in the order of the caller's.

    Parameters
    ----------
    rows : (m, k)      the caller's cells
    cells : (q, k)     of the result
    source : (q,)      cell among `own` of which each has the data
    own : (m',)        cells that the engine saw
    number : (n,)      new index of every vertex
    """
    other = np.setdiff1d(np.arange(len(rows)), own)
    joined = np.concatenate([own[source], other])
    order = np.argsort(joined, kind="stable")
    return (np.concatenate([cells, number[rows[other]]]).astype(cells.dtype)[order],
            joined[order].astype(source.dtype))


def note(count: int) -> str:
    """Say how many cells stay."""
    which = "with inverted or flat corners but of valid shape"
    return counted(count, f"curved cell {which} stays as it is, and is in no figure",
                   f"curved cells {which} stay as they are, and are in no figure")
