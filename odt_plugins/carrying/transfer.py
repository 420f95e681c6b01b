"""Arrays of the caller's own on the result, carried as those on the mesh are."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from odt_plugins.adapters.colours import varies
from odt_plugins.adapters.host import HostMesh, NewVertices
from odt_plugins.carrying.following import (
    CONSERVE,
    Prepared,
    around,
    follow,
    interpolates,
    new_vertices,
)
from odt_plugins.errors import InvalidOptionError, UnsupportedMeshError, expect, plain_values
from odt_plugins.mesh.numbers import even_rows
from odt_plugins.options import Options

if TYPE_CHECKING:
    from odt_plugins.engine.run.outcome import Outcome

At = Literal["points", "cells"]

OWN = "of the caller"
"""Name of the array that is carried."""


@dataclass(frozen=True)
class Transfer:
    """What is known of a run that carries arrays; made by :func:`transfer_of`.

    Attributes
    ----------
    work : Prepared            without adapter and toolkit
    outcome : Outcome          what the engine handed back
    written : Outcome          the same with the caller's coordinates and cells
    options : Options          with `fields` and `threads` of the run
    origin : (m',) int64       cell of the object from which each cell of the result has its data
    """

    work: Prepared
    outcome: Outcome
    written: Outcome
    options: Options
    origin: NDArray[np.int64]

    def __call__(self, values: ArrayLike, at: At | None = None) -> NDArray[Any]:
        """Values for the result; see :meth:`odt_plugins.Report.transfer`."""
        expect(at in (None, "points", "cells"), "at", at, "'points' or 'cells'")
        array = even_rows("values", plain_values("values", values))
        host = self.work.host
        cells = len(host.cells) if host.ids is None else host.total
        counts = {"points": len(host.points), "cells": cells}
        length = array.shape[0] if array.ndim else 0
        fits = [place for place, count in counts.items()
                if array.ndim and length == count and at in (None, place)]
        if len(fits) != 1:
            told = ", ".join(f"{count} {place}" for place, count in counts.items())
            hint = "; try at='points' or at='cells'" if len(fits) > 1 else ""
            there = "" if at is None else f", at={at!r}"
            msg = (f"got values of shape {array.shape}{there}; expected one for each of the "
                   f"{told} of the input{hint}")
            raise InvalidOptionError(msg)
        return self._of_cells(array) if fits == ["cells"] else self._of_points(array)

    def __getstate__(self) -> dict[str, Any]:
        """Give the fields alone to pickle."""
        return {name: value for name, value in vars(self).items() if name != "_vertices"}

    @cached_property
    def _vertices(self) -> NewVertices | None:
        """Where values at vertices come from."""
        fields = interpolates(self.work, self.options)
        near = partial(around, self.work, self.options.threads)
        return new_vertices(self.work, self.written, near, moved=fields,
                            always=fields and self.options.fields == CONSERVE)

    def _of_points(self, values: NDArray[Any]) -> NDArray[Any]:
        if self.work.host.higher_order:
            msg = ("got values at the points of cells of higher order; expected values of cells, "
                   "or linear cells; try a point array of the mesh itself")
            raise UnsupportedMeshError(msg)
        is_field = varies(OWN, values) and interpolates(self.work, self.options)
        host = replace(self.work.host, fields={OWN: values} if is_field else {})
        work = self.work._replace(host=host)
        vertices = follow(work, host, self.outcome, self._vertices, self.options).vertices
        if vertices is None:
            return values.copy()
        return vertices.carried(values, OWN, field=is_field)

    def _of_cells(self, values: NDArray[Any]) -> NDArray[Any]:
        out = values[self.origin]
        if values.dtype.kind not in "fc" or self.options.fields != CONSERVE:
            return out
        host = self.work.host
        ids = np.arange(len(host.cells)) if host.ids is None else host.ids
        told = replace(host, densities={OWN: values[ids]})
        kept = follow(self.work._replace(host=told), told, self.outcome, None, self.options)
        if OWN in kept.of_cells:
            out[np.isin(self.origin, ids)] = kept.of_cells[OWN].reshape(-1, *values.shape[1:])
        return out


def transfer_of(
    work: Prepared, given: HostMesh, outcome: Outcome, written: Outcome, options: Options,
    origin: NDArray[np.int64],
) -> Transfer:
    """Keep of a run what carries arrays, in arrays of its own: the caller may change the mesh."""
    host = HostMesh(
        np.array(work.host.points[: len(given.points)]), np.array(given.cells), ids=given.ids,
        total=given.total, follows=given.follows, higher_order=given.higher_order)
    plain = Options(fields=options.fields, threads=options.threads)
    no_adapter: Any = None
    bare = replace(work.mesh, smooth=None)
    slim = work._replace(adapter=no_adapter, host=host, mesh=bare)
    slimmer = replace(outcome, measured=None)
    return Transfer(slim, slimmer, replace(written, measured=None), plain, origin)
