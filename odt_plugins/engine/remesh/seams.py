"""A surface whose triangles share their vertices along seams, where they have some of their own.

Toolkits double the vertices of a surface where its texture is cut. Sewn up, a seam is a line with a
label, which gets other sizes as feature lines do; the result is cut along it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.engine.run.outcome import Leaving, Outcome, unchanged
from odt_plugins.engine.surface.sides import patches
from odt_plugins.mesh.arrays import FloatArray, IntArray, LongArray
from odt_plugins.mesh.components import components
from odt_plugins.mesh.faces import Faces, ends_of, joined, labels_at, renumbered
from odt_plugins.mesh.simplex import SimplexMesh, freeze
from odt_plugins.mesh.soup import (
    HELD,
    doubled_edges,
    doubled_rows,
    first_there,
    hold_twins,
    told_of_twins,
    twins,
)
from odt_plugins.mesh.surface import opposed, surface_edges
from odt_plugins.options import Options


class Sewn(NamedTuple):
    """A surface without seams.

    Attributes
    ----------
    mesh : SimplexMesh    vertices at one place on a seam count as the first of them
    same : (n,) int64     first vertex at the place of every vertex on a seam, others themselves
    label : int           of the lines that the seams are, -1 where vertices at one place stay
                          instead
    note : str            what was done
    """

    mesh: SimplexMesh
    same: LongArray
    label: int
    note: str


def sewn(mesh: SimplexMesh) -> Sewn | None:
    """Sew a surface up where triangles on both sides of an edge have vertices of their own.

    None where vertices that share their place with another one stay, and edges between them. Where
    lines with labels are there, or what is sewn up would be no such surface, all of them stay.
    """
    copies = twins(mesh.points, mesh.cells)
    doubled: IntArray = doubled_edges(mesh.points, mesh.cells, copies).astype(np.int32)
    held = Faces(mesh.stays, np.zeros(len(mesh.stays), dtype=np.int32))
    if mesh.fixed[copies].all() and (labels_at(doubled, held) >= 0).all():
        return None
    same, seam = _same_on_seams(mesh, copies)
    if not len(seam) or np.isin(copies, mesh.faces[0].rows).any():
        note = told_of_twins(copies, HELD)
        return Sewn(hold_twins(mesh, copies), np.arange(len(same)), -1, note)
    label = int(mesh.faces[0].labels.max(initial=-1)) + 1
    lines = Faces(seam, np.full(len(seam), label, dtype=np.int32))
    cells, lines_before, stays, doubled = (
        same[rows].astype(np.int32) for rows in (mesh.cells, mesh.lines, mesh.stays, doubled))
    doubled = doubled[labels_at(doubled, lines) < 0]
    still = freeze(mesh, mesh.frozen | doubled_rows(mesh.points, mesh.cells, copies))
    fixed, anchored, coupled = still.fixed.copy(), mesh.anchored.copy(), mesh.coupled.copy()
    for marks in (fixed, anchored, coupled):
        np.logical_or.at(marks, same, marks)
    left = twins(mesh.points, cells)
    fixed[left] = True
    whole = replace(
        still, cells=cells, fixed=fixed | ends_of(lines, len(same)), anchored=anchored,
        coupled=coupled, stays=np.concatenate([stays, doubled]),
        lines=np.concatenate([lines_before, seam]),
        faces=(joined(mesh.faces[0], lines), mesh.faces[1]))
    stay = int(np.isin(same[copies], left).sum())
    told = "are on seams, both sides of which get the same other sizes" + (
        f"; {stay} of them stay, so that patches do not come apart there" if stay else "")
    note = told_of_twins(copies, f"{told}; try merging them if no data jump there")
    return Sewn(whole, same, label, note)


def as_sewn(
    mesh: SimplexMesh, seams: Sewn, options: Options, leaving: Leaving,
    run: Callable[[SimplexMesh, Options, Leaving], Outcome],
) -> Outcome:
    """Run as on a surface without seams, and cut its outcome along them."""
    given = options.density
    if isinstance(given, np.ndarray) and given.shape == seams.same.shape:
        least = given.copy()
        np.minimum.at(least, seams.same, given)
        options = replace(options, density=least)
    found = run(seams.mesh, options, leaving)
    if found.origin is None:
        outcome = leaving(unchanged(mesh, found.stop_reason))
        return replace(outcome, fallback=found.fallback, notes=(seams.note, *found.notes))
    outcome = found if seams.label < 0 else leaving(_cut(mesh, seams, found))
    return replace(outcome, notes=(seams.note, *found.notes))


def _same_on_seams(mesh: SimplexMesh, copies: LongArray) -> tuple[LongArray, IntArray]:
    """First vertex (n,) at the place of every vertex on a seam, and the edges (k, 2) of seams.

    Edges at which other than two triangles would meet, or which disagree about the outside, are no
    seams; none is where there would be such edges nevertheless, or triangles twice.
    """
    n = len(mesh.points)
    same, there = np.arange(n), np.arange(n)
    there[copies] = copies[first_there(mesh.points[copies])]
    old = surface_edges(mesh.cells, n)
    new = surface_edges(there[mesh.cells].astype(np.int32), n)
    pairs = np.unique(np.stack([new.of_cell.ravel(), old.of_cell.ravel()], axis=1), axis=0)
    count = np.bincount(pairs[:, 0], minlength=len(new.degree))
    seam = (count == 2) & (new.degree == 2)
    seam[opposed(new)] = False
    ends = old.vertices[pairs[seam[pairs[:, 0]], 1]]
    turned = there[ends[:, 0]] > there[ends[:, 1]]
    ends[turned] = ends[turned, ::-1]
    part = components(ends[::2].ravel(), ends[1::2].ravel(), n)
    sewn_up = np.unique(part, return_index=True)[1][part]
    cells = sewn_up[mesh.cells].astype(np.int32)
    after = surface_edges(cells, n)
    if ((after.degree > 2).sum() > (old.degree > 2).sum()
            or len(opposed(after)) > len(opposed(old))
            or len(np.unique(np.sort(cells, axis=1), axis=0)) < len(cells)):
        return same, ends[:0]
    return sewn_up, sewn_up[ends[::2]].astype(np.int32)


def _cut(mesh: SimplexMesh, seams: Sewn, found: Outcome) -> Outcome:
    """An outcome whose triangles have vertices of their own on both sides of seams."""
    n, cells, lines = len(found.points), found.cells, found.faces[0]
    origin: Any = found.origin
    fan = _fans(cells, lines.rows[lines.labels == seams.label], n)
    there = origin < 0
    there[~there] = seams.same[origin[~there]] == origin[~there]
    there[cells] = False
    alone = np.flatnonzero(there)
    vertex = np.concatenate([cells.ravel()[np.unique(fan, return_index=True)[1]], alone])
    origin = _origins(mesh, seams, found, fan, vertex)
    key = np.where(origin < 0, len(mesh.points) + np.arange(len(origin)), origin)
    _, first, number = np.unique(key, return_index=True, return_inverse=True)
    rows: IntArray = number[fan].reshape(-1, 3).astype(np.int32)
    of_vertex = np.full(n, -1, dtype=np.int32)
    of_vertex[vertex] = number
    own = Faces(lines.rows[lines.labels != seams.label], lines.labels[lines.labels != seams.label])
    vertex = vertex[first]
    return replace(
        found, points=found.points[vertex], cells=rows, origin=origin[first],
        faces=(renumbered(own, of_vertex), found.faces[1]), written=None, source=None,
        metric=found.metric[vertex] if len(found.metric) else found.metric)


def _fans(cells: IntArray, seam: IntArray, n: int) -> NDArray[np.int64]:
    """Number (3 m,) of the fan that every corner of triangles belongs to.

    Corners at one vertex are of one fan where their triangles share edges that are on no seam; all
    are where the vertex is on none.
    """
    edges = surface_edges(cells, n)
    cut = labels_at(edges.vertices, Faces(seam, np.zeros(len(seam), dtype=np.int32))) >= 0
    corner = np.arange(3 * len(cells)).reshape(-1, 3)
    start, end = np.roll(corner, -1, axis=1), np.roll(corner, -2, axis=1)
    low = np.where(edges.forward, start, end).ravel()
    high = np.where(edges.forward, end, start).ravel()
    edge = edges.of_cell.ravel()
    first = np.empty(len(cut), dtype=np.int64)
    first[edge[::-1]] = np.arange(len(edge))[::-1]
    inner = ~cut[edge]
    whole = np.ones(n, dtype=np.bool_)
    whole[seam] = False
    owner = np.empty(n, dtype=np.int64)
    owner[cells.ravel()] = corner.ravel()
    apart = np.flatnonzero(whole[cells.ravel()])
    links = [(low[inner], low[first[edge]][inner]), (high[inner], high[first[edge]][inner]),
             (apart, owner[cells.ravel()[apart]])]
    one, other = (np.concatenate(ends) for ends in zip(*links, strict=True))
    return components(one, other, corner.size).astype(np.int64)


def _origins(
    mesh: SimplexMesh, seams: Sewn, found: Outcome, fan: NDArray[np.int64], vertex: LongArray
) -> LongArray:
    """Old vertex (k,) of every new one, that at its place in the patch that its triangles are of.

    Where a patch has several at one place it is that whose rim runs as its does; fans for which
    none is left share one.

    Parameters
    ----------
    fan : (3 m',) int      new vertex of every corner
    vertex : (k,) int      vertex of the outcome that every new one is
    """
    before: Any = found.origin
    origin: LongArray = before[vertex]
    copies = np.flatnonzero(np.bincount(seams.same)[seams.same] > 1)
    copies = copies[np.argsort(seams.same[copies], kind="stable")]
    place = seams.same[copies]
    row = np.flatnonzero(np.isin(origin, place))
    first, last = (np.searchsorted(place, origin[row], side=side) for side in ("left", "right"))
    count = last - first
    item = np.repeat(row, count)
    copy = copies[np.arange(count.sum()) - np.repeat(np.cumsum(count) - count - first, count)]
    origin[row] = -1
    cells, points = fan.reshape(-1, 3).astype(np.int32), found.points[vertex]
    old_patch, patch = patches(mesh.points, mesh.cells, points, cells)
    of_new, n = np.zeros(len(points), dtype=np.int64), len(mesh.points)
    of_new[cells] = patch[:, None]
    fits = np.isin(of_new[item] * n + copy, (old_patch[:, None] * n + mesh.cells).ravel())
    alike = (_rims(points, cells)[item] * _rims(mesh.points, mesh.cells)[copy]).sum(axis=1)
    rank, taken = np.argsort(-alike, kind="stable"), np.zeros(n, dtype=np.bool_)
    for fit, shared in ((True, False), (True, True), (False, True)):
        for k in rank.tolist():
            if origin[item[k]] < 0 and fits[k] >= fit and (shared or not taken[copy[k]]):
                origin[item[k]], taken[copy[k]] = copy[k], True
    return origin


def _rims(points: FloatArray, cells: IntArray) -> FloatArray:
    """Directions (n, 6) of the open edges that leave every vertex and that arrive there."""
    edges = surface_edges(cells, len(points))
    triangle, corner = np.nonzero(edges.degree[edges.of_cell] == 1)
    start, end = (cells[triangle, (corner + k) % 3] for k in (1, 2))
    step = points[end] - points[start]
    length = np.sqrt((step * step).sum(axis=1))
    step /= np.where(length > 0.0, length, 1.0)[:, None]
    out = np.zeros((len(points), 6))
    np.add.at(out[:, :3], start, step)
    np.add.at(out[:, 3:], end, step)
    return out
