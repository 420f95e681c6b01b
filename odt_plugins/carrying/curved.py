"""Curved cells keep the promise too: none is folded, and their scaled Jacobian is no worse.

The engine knows the corners alone. After a run the nodes between them are put in place, and the
cells that changed are compared with those of the input. Where they are worse, cells and vertices
around them are held, and the engine runs again; at last all curved cells are held.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import factorial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.higher_order import HigherOrder, with_mid_nodes
from odt_plugins.adapters.host import HostMesh, Result
from odt_plugins.carrying.untangling import Tangle
from odt_plugins.engine.run.outcome import Outcome, unchanged
from odt_plugins.errors import TangledMeshError
from odt_plugins.figures import volumes
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.bernstein import jacobian_bounds, mean_determinants
from odt_plugins.mesh.simplex import SimplexMesh, freeze, reverse
from odt_plugins.promise.volume import held_vertices

STRAIGHT = 1e-12
"""Nodes that are off their place by less of the extent of a cell leave the cell straight."""

ROUNDED = 1e-6
"""A cell whose nodes are off by less does not count in the figures of curved cells."""

SLACK = 1e-9
"""By how much a figure may be smaller, by rounding."""

ATTEMPTS = 5
"""How often some vertices are held before all curved cells are."""

SPARE = 1.5
"""Cells are held that lost this many times what a mean lacks."""


class Curved(NamedTuple):
    """Curved cells of one mesh.

    Attributes
    ----------
    valid : (m,) bool          the determinant of the Jacobian is certainly positive everywhere
    scaled : (m,) float64      least determinant by the largest of a cell
    shrunk : (m,) float64      least determinant by that of the corners
    counts : (m,) bool         curved beyond rounding
    volume : (m,) float64      area or volume; of triangles in space that of their shadow on the
                               plane of the corners
    """

    valid: BoolArray
    scaled: FloatArray
    shrunk: FloatArray
    counts: BoolArray
    volume: FloatArray

    def figures(self) -> FloatArray:
        """Least and mean of both (4,) over the cells that count, 1 where none does."""
        values = np.stack([self.scaled, self.shrunk])[:, self.counts]
        if not values.size:
            return np.ones(4)
        return np.concatenate([values.min(axis=1), values.mean(axis=1)])


class Kept(NamedTuple):
    """What came of the curved cells.

    Attributes
    ----------
    mesh : SimplexMesh     the one of the engine, with what is held
    outcome : Outcome
    facts : dict or None   "cells", "vertices_held", and before and after least and mean scaled
                           Jacobian and the volume of all cells; None without curved cells
    """

    mesh: SimplexMesh
    outcome: Outcome
    facts: dict[str, float] | None


def measured(points: NDArray[Any], rows: NDArray[Any], shape: NDArray[np.int64]) -> Curved:
    """Measure cells.

    Parameters
    ----------
    points : (n, D)           all nodes
    rows : (m, k) int         nodes of the cells
    shape : (k, d + 1) int    lattice of a cell
    """
    d = shape.shape[1]
    x, bent, counts = _bent(points, rows, shape)
    flat = abs(volumes(x[:, :d].reshape(-1, x.shape[2]), np.arange(d * len(x)).reshape(-1, d)))
    out = Curved(
        np.ones(len(x), dtype=np.bool_), np.ones(len(x)), np.ones(len(x)), counts, flat)
    bounds = jacobian_bounds(x[bent], shape)
    corners = jacobian_bounds(x[bent, :d], np.eye(d, dtype=np.int64)).least
    out.valid[bent], out.scaled[bent] = bounds.valid, bounds.scaled
    out.volume[bent] = bounds.mean / factorial(d - 1)
    safe = np.where(corners > 0.0, corners, 1.0)
    out.shrunk[bent] = np.where(corners > 0.0, np.maximum(bounds.lower, 0.0) / safe, 0.0)
    return out


def _bent(
    points: NDArray[Any], rows: NDArray[Any], shape: NDArray[np.int64]
) -> tuple[FloatArray, NDArray[np.intp], BoolArray]:
    """Nodes (m, k, D) of cells from their first, cells that are not straight, those that count."""
    d = shape.shape[1]
    x = np.asarray(points[rows], dtype=np.float64)
    largest = np.abs(x).max(axis=(1, 2))
    x = x - x[:, :1]
    off = x[:, d:] - np.einsum("ec,mcx->mex", shape[d:] / shape[0].sum(), x[:, :d])
    off = np.sqrt((off * off).sum(axis=2)).max(axis=1)
    extent = np.sqrt((x * x).sum(axis=2)).max(axis=1)
    eps = float(np.finfo(points.dtype).eps)
    return (x, np.flatnonzero(off > STRAIGHT * extent),
            off > np.maximum(ROUNDED * extent, 8 * eps * largest))


def keep_curved(
    host: HostMesh,
    mesh: SimplexMesh,
    run: Callable[[SimplexMesh, int], Outcome],
    leave: Callable[[Outcome], Outcome],
    orientation: int,
    *,
    figures: bool,
    slides: bool,
    source: IntArray | None = None,
) -> Kept:
    """Run the engine until curved cells are as valid and as good as in the input.

    Parameters
    ----------
    host : HostMesh      the caller's mesh, with `nodes` and `shape`
    mesh : SimplexMesh   the same for the engine
    run : callable       the engine; takes the mesh and the number of the attempt
    leave : callable     lets an outcome leave
    orientation : int    -1 where all cells of the caller are negative
    figures : bool       whether the scaled Jacobian is kept, too
    slides : bool        whether vertices of the boundary may move
    source : (m,) int    where `mesh` was untangled, the cell of `host` that each comes from: cells
                         are compared with those of the untangled mesh
    """
    rows, shape = host.nodes, host.shape
    given = before = None if rows is None or shape is None else measured(host.points, rows, shape)
    if source is not None and before is not None:
        before = _all_measured(host, leave(unchanged(mesh, "")), orientation, source)
    if given is None or before is None or before.scaled.min(initial=1.0) == 1.0:
        return Kept(mesh, run(mesh, 0), None)
    now, was = mesh, before.figures()
    for attempt in range(ATTEMPTS + 2):
        outcome = run(now, attempt)
        if source is None:
            after, spoiled = _compared(host, before, outcome, orientation)
        else:
            after = _all_measured(host, outcome, orientation, source)
            spoiled = ~after.valid & before.valid[outcome.source]
        is_now = after.figures()
        worse = (is_now < was - SLACK) & figures
        if not spoiled.any() and not worse.any():
            break
        if attempt < ATTEMPTS:
            spoiled |= _at_fault(before, after, outcome, was, worse)
            now = _held(now, outcome, spoiled, strict=attempt + 1 == ATTEMPTS)
        elif attempt == ATTEMPTS:
            now = freeze(mesh, before.scaled < 1.0)
        else:
            why = "curved cells would be folded, or their scaled Jacobian worse"
            outcome = leave(replace(unchanged(mesh, why), fallback=f"the input is returned: {why}"))
            after, is_now, now = before, was, freeze(mesh, np.ones(len(mesh.cells), dtype=np.bool_))
            break
    stays = mesh.fixed if slides or now is mesh else held_vertices(mesh)
    facts = _facts(before, after, int((now.fixed & ~stays).sum()),
                   of_volume=source is None and not mesh.is_surface)
    if facts is not None and source is not None:
        folded = ~after.valid & given.valid[source[outcome.source]]
        facts["folded"] = int(folded.sum())
    return Kept(now, outcome, facts)


def facts_of_others(
    host: HostMesh, own: NDArray[Any] | None, result: Result
) -> dict[str, float] | None:
    """Facts of :class:`Kept` where other cells, all of the result, took the place of some.

    Parameters
    ----------
    host : HostMesh          the caller's mesh, with `nodes` and `shape`
    own : (m,) int or None   the cells that were optimised, None of all
    result : Result          with all nodes
    """
    shape: Any = host.shape
    rows: Any = host.nodes
    old, new = (slice(None),) * 2 if own is None else (own, np.isin(result.source, own))
    before = measured(host.points, rows[old], shape)
    if before.scaled.min(initial=1.0) == 1.0:
        return None
    after = measured(result.points, result.cells[new], shape)
    return _facts(before, after, 0, of_volume=not result.curved)


def curved_volume(host: HostMesh, flat: FloatArray) -> float:
    """Area or volume of a mesh, with cells as they are curved.

    Parameters
    ----------
    host : HostMesh        no curved surface
    flat : (m,) float64    those of the corners alone, with their signs; the result has these where
                           all cells are straight
    """
    volume = flat
    if host.nodes is not None and host.shape is not None:
        x, bent, counts = _bent(host.points, host.nodes, host.shape)
        if counts.any():
            mean = mean_determinants(x[bent], host.shape) / factorial(host.shape.shape[1] - 1)
            volume = flat.copy()
            volume[bent] = np.copysign(mean, flat[bent])
    return float(volume.sum())


def _facts(
    before: Curved, after: Curved, held: int, *, of_volume: bool
) -> dict[str, float] | None:
    """Facts of :class:`Kept`; None where no cell is curved beyond rounding."""
    if not (before.counts.any() or after.counts.any()):
        return None
    facts: dict[str, float] = {"cells": int(before.counts.sum()), "vertices_held": held}
    for side, found in (("before", before), ("after", after)):
        names = ("least", "least_of_corners", "mean", "mean_of_corners")
        facts |= {f"{name}_{side}": float(v)
                  for name, v in zip(names, found.figures(), strict=True)}
        facts |= {f"volume_{side}": float(found.volume.sum())} if of_volume else {}
    return facts


def _compared(
    host: HostMesh, before: Curved, outcome: Outcome, orientation: int
) -> tuple[Curved, BoolArray]:
    """Cells of the result, and which (m',) are folded though those of the input were not."""
    rows: Any = host.nodes
    source: Any = outcome.source
    q = placed(host, outcome, orientation)
    old = q.origin[q.cells]
    moved = (q.origin < 0) | (q.points != host.points[q.origin]).any(axis=1)
    same = (np.sort(old, axis=1) == np.sort(rows[source], axis=1)).all(axis=1)
    same &= ~moved[q.cells].any(axis=1)
    after = Curved(*(values[source].copy() for values in before))
    new = np.flatnonzero(~same)
    for values, found in zip(after, measured(q.points, q.cells[new], q.shape), strict=True):
        values[new] = found
    return after, ~after.valid & ~same & before.valid[source]


def untangled_around(
    host: HostMesh, mesh: SimplexMesh,
    untangle: Callable[[SimplexMesh], tuple[SimplexMesh, Tangle]],
) -> tuple[SimplexMesh, Tangle]:
    """Untangle a mesh with its valid curved cells frozen; if that fails, with them free.

    Parameters
    ----------
    host : HostMesh        the caller's mesh
    mesh : SimplexMesh     the same for the engine
    untangle : callable    gives a mesh without inverted or flat cells, and what was done
    """
    if host.nodes is None or host.shape is None:
        return untangle(mesh)
    found = measured(host.points, host.nodes, host.shape)
    bent = found.valid & found.counts
    if not bent.any():
        return untangle(mesh)
    try:
        after, tangle = untangle(freeze(mesh, bent))
    except TangledMeshError:
        return untangle(mesh)
    if tangle.facts["left"]:
        return untangle(mesh)
    after = replace(after, fixed=np.pad(mesh.fixed, (0, tangle.added)),
                    frozen=mesh.frozen[tangle.source])
    return after, tangle._replace(before=mesh, after=after)


def _all_measured(host: HostMesh, outcome: Outcome, orientation: int, source: IntArray) -> Curved:
    """The cells of an outcome of an untangled mesh, whose cells have a source in the caller's."""
    q = placed(host, replace(outcome, source=source[outcome.source]), orientation)
    return measured(q.points, q.cells, q.shape)


def placed(host: HostMesh, outcome: Outcome, orientation: int) -> HigherOrder:
    """All nodes of an outcome that left."""
    written: Any = outcome.written
    source: Any = outcome.source
    rows: Any = host.nodes
    shape: Any = host.shape
    cells = reverse(outcome.cells, np.full(len(outcome.cells), orientation < 0))
    result = Result(written, cells.astype(host.cells.dtype), source)
    q = with_mid_nodes(result, host.points, rows, np.zeros(0, dtype=np.int64), shape)
    return q if host.settle is None else host.settle(host, q, source)


def _at_fault(
    before: Curved, after: Curved, outcome: Outcome, was: FloatArray, worse: BoolArray
) -> BoolArray:
    """Cells (m',) below the least figure, and where a mean fell those that lost most."""
    fault = np.zeros(len(outcome.cells), dtype=np.bool_)
    for i, (old, new) in enumerate(((before.scaled, after.scaled), (before.shrunk, after.shrunk))):
        if worse[i]:
            fault |= new < was[i] - SLACK
        if worse[i + 2]:
            lost = np.maximum(old[outcome.source] - new, 0.0)
            lacking = was[i + 2] * after.counts.sum() - new[after.counts].sum()
            order = np.argsort(-lost, kind="stable")
            recovered = np.cumsum(lost[order])
            most = order[: np.searchsorted(recovered, SPARE * lacking) + 1]
            fault[most[lost[most] > SLACK]] = True
    return fault


def _held(mesh: SimplexMesh, outcome: Outcome, spoiled: BoolArray, *, strict: bool) -> SimplexMesh:
    """The mesh for the next attempt: corners of spoiled cells that moved are held.

    Where none of a cell moved, or to be `strict`, the cells of the input that share a facet with
    the corners are frozen, too.
    """
    rows = outcome.cells[spoiled]
    moved = (outcome.points != mesh.points).any(axis=1)
    around = np.zeros(len(mesh.points), dtype=np.bool_)
    around[rows if strict else rows[~moved[rows].any(axis=1)]] = True
    frozen = around[mesh.cells].sum(axis=1) >= mesh.dim
    return freeze(mesh, mesh.frozen | frozen, np.unique(rows[moved[rows]]))
