"""Curved cells whose vertices come and go: what comes on their surface goes onto the curved one.

The engine knows the corners alone, and a surface of flat facets. A quadratic facet is off its flat
one by the sum over its edges of 4 w_i w_j d_ij, where w are barycentric coordinates and d_ij is how
far the node of the edge is from its middle. Feature lines stay lines: what is on one goes onto the
curved edge there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.elevated import BentEdges, curved_edges, elevated
from odt_plugins.adapters.host import HostMesh, Result
from odt_plugins.carrying.curved import facts_of_others
from odt_plugins.carrying.following import Prepared
from odt_plugins.carrying.onto import LARGEST, came_or_moved, edges_onto
from odt_plugins.errors import counted
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.faces import labels_at
from odt_plugins.mesh.facets import row_keys
from odt_plugins.mesh.plane import PlaneFrame
from odt_plugins.mesh.simplex import SimplexMesh, Smooth, diagonal, freeze
from odt_plugins.mesh.surface import surface_edges
from odt_plugins.options import Options
from odt_plugins.promise.locked_facets import locked_facets

if TYPE_CHECKING:
    from odt_plugins.engine.run.outcome import Leaving, Outcome

ON_LINE = 1e-9
"""Distance, as a part of the diagonal, within which a vertex is on a feature line."""

NEAR_LINE = 0.25
"""Distance of the middle of a new feature edge from those of the input, in lengths of the edge,
from which on it is on none of them."""

ROUNDS = 30
"""How often a place under a curved facet is corrected at most."""

CLOSE = 1e-7
"""Distance along a facet, in its lengths, within which a place is under the curved one."""

ASTRAY = 100.0
"""Square of a distance, in that of the nearest place found, beyond which none is looked for."""


class Bent(NamedTuple):
    """The curved surface of a mesh, or the curved lines of one in the plane.

    Attributes
    ----------
    points : (n, 3) float64         corners
    triangles : (q, 3) int32        flat facets, none in the plane
    of_triangle : (q, 3, 3)         offsets of the nodes on the edges (0, 1), (1, 2) and (2, 0)
    lines : (k, 2) int32            feature edges; in the plane the boundary and borders of regions
    of_line : (k, 3)                offsets of their nodes
    surface : bool                  whether all cells are of it
    angle : float                   degrees by which the surface turns at a feature edge
    """

    points: FloatArray
    triangles: IntArray
    of_triangle: FloatArray
    lines: IntArray
    of_line: FloatArray
    surface: bool
    angle: float

    @property
    def sag(self) -> float:
        """Distance within which the curved surface is from the flat facets."""
        # The sum of 4 w_i w_j over three edges is 4 / 3 at most.
        return 4.0 / 3.0 * max(float(np.sqrt((offset * offset).sum(axis=-1)).max(initial=0.0))
                               for offset in (self.of_triangle, self.of_line))


def with_bent(
    work: Prepared, given: HostMesh, options: Options, *, free: bool
) -> tuple[Prepared, Options, Bent | None]:
    """The mesh of the corners of quadratic cells, and its curved surface if what comes goes there.

    The envelope is around that. Else, and where the engine does not see all cells, the curved ones
    stay.
    """
    edges = curved_edges(given)
    if not len(edges.ends):
        return work, options, None
    if not free or work.own is not None:
        return _still(work, given, edges.ends, insert=bool(options.insert)), options, None
    nodes = np.asarray(given.points, dtype=np.float64)
    nodes = _in_space(nodes if work.frame is None else work.frame.to_plane(nodes))
    mesh, n = work.mesh, len(nodes)
    offset = nodes[edges.node] - 0.5 * (nodes[edges.ends[:, 0]] + nodes[edges.ends[:, 1]])
    facets, sharp = _surface(mesh, options.feature_angle, surface=mesh.is_surface)
    key = row_keys(edges.ends, n)
    order = np.argsort(key)

    def offsets(ends: NDArray[Any]) -> FloatArray:
        """Offsets (..., 3) of the nodes of edges (..., 2)."""
        wanted = row_keys(np.sort(ends.reshape(-1, 2), axis=1), n)
        place = order[np.minimum(np.searchsorted(key[order], wanted), len(key) - 1)]
        found = np.where((key[place] == wanted)[:, None], offset[place], 0.0)
        return found.reshape(*ends.shape[:-1], 3)

    around = np.stack([facets, np.roll(facets, -1, axis=1)], axis=2)
    bent = Bent(_in_space(mesh.points), facets, offsets(around), sharp, offsets(sharp),
                mesh.is_surface, options.feature_angle)
    envelope = min(options.envelope + bent.sag / mesh.extent,
                   LARGEST)
    mesh = replace(mesh, smooth=Smooth(bent.sag, partial(_put, bent, mesh.points)))
    return work._replace(mesh=mesh), replace(options, envelope=envelope), bent


def leaving_bent(leaving: Leaving, mesh: SimplexMesh) -> Leaving:
    """What ``leaving`` does, and vertices of triangles go onto the curved surface before."""
    smooth = mesh.smooth
    if smooth is None or mesh.dim != 2:
        return leaving
    return lambda outcome: leaving(replace(outcome, points=smooth.put(outcome)))


def bent_again(
    work: Prepared, given: HostMesh, outcome: Outcome, bent: Bent | None, result: Result,
    locate: Callable[[NDArray[Any], NDArray[Any]], Any], *, moves: bool,
) -> tuple[Result, tuple[str, ...], dict[str, float] | None]:
    """A result of the corners with a node on every edge, notes, and facts of its curved cells.

    Parameters
    ----------
    work, given, outcome : Prepared, HostMesh, Outcome    of the run
    bent : Bent or None                                   on which nodes of the surface are
    result : Result                                       of the corners
    locate : callable                                     as :func:`elevated` takes it
    moves : bool                                          whether the surface is other triangles
    """
    edges = None if bent is None else _middles(bent, outcome, work.frame)
    edges = edges_onto(work, outcome, edges) if moves else edges
    result, flatter = elevated(result, given, locate, edges)
    return result, note_on_flatter(flatter), facts_of_others(given, work.own, result)


def note_on_flatter(count: int) -> tuple[str, ...]:
    """What a report says of edges that are flatter lest cells be poor."""
    are = counted(count, "edge of cells is", "edges of cells are")
    return (f"{are} flatter than the curved surface, where cells would fold or be poor, as none of "
            f"the input is",) if count else ()


def _in_space(points: FloatArray) -> FloatArray:
    """Points (n, 3) of points (n, d)."""
    return np.pad(points, ((0, 0), (0, 3 - points.shape[1])))


def _surface(
    mesh: SimplexMesh | Outcome, angle: float, *, surface: bool
) -> tuple[IntArray, IntArray]:
    """Triangles (q, 3) of the boundary and of interfaces, and feature edges (k, 2) of them.

    In the plane there are no triangles, and boundary and borders are feature edges.
    """
    from odt_plugins.engine.ground.features import label_borders, marked_edges, sharp_edges

    n, facets, labels = len(mesh.points), mesh.cells, mesh.regions
    if not surface:
        facets = locked_facets(mesh.cells, mesh.regions, n).facets.astype(np.int32)
        facets = facets[np.unique(row_keys(np.sort(facets, axis=1), n), return_index=True)[1]]
        if facets.shape[1] == 2:
            return np.zeros((0, 3), dtype=np.int32), np.sort(facets, axis=1)
        labels = labels_at(facets, mesh.faces[1])
    edges = surface_edges(facets, n)
    sharp = sharp_edges(mesh.points, facets, edges, angle) | (edges.degree != 2)
    sharp |= label_borders(edges, labels) | marked_edges(edges, mesh.faces[0].rows, n)
    return facets, edges.vertices[sharp]


def _still(
    work: Prepared, given: HostMesh, ends: NDArray[np.int64], *, insert: bool
) -> Prepared:
    """Freeze the cells at curved edges, and at edges of cells that are not optimised."""
    own, rows = work.own, np.asarray(work.mesh.cells)
    if own is not None:
        ends = np.concatenate([ends, _edges_of(np.delete(np.asarray(given.cells), own, axis=0))])
    key = row_keys(np.concatenate([_edges_of(rows), np.sort(ends, axis=1)]), len(work.mesh.points))
    stays: Any = np.isin(key[: -len(ends)], key[-len(ends):]).reshape(len(rows), -1).any(axis=1)
    notes = work.notes
    if own is None:
        why = "vertices are inserted" if insert else "the surface does; try boundary='slide'"
        stay = counted(int(stays.sum()), "curved cell of the input stays as it is",
                       "curved cells of the input stay as they are")
        notes += (f"{stay}, since {why}",)
    return work._replace(mesh=freeze(work.mesh, stays), notes=notes)


def _edges_of(rows: NDArray[Any]) -> NDArray[np.int64]:
    """Edges (m e, 2) of cells (m, d + 1), ascending, cell by cell."""
    pairs = np.array(np.triu_indices(rows.shape[1], 1)).T
    return np.sort(rows[:, pairs].reshape(-1, 2), axis=1).astype(np.int64)


def _put(bent: Bent, before: FloatArray, outcome: Outcome) -> FloatArray:
    """Points (n, d), those of surface and lines on the curved ones where they moved or came."""
    facets, lines = _surface(outcome, bent.angle, surface=bent.surface)
    points, used = outcome.points.copy(), np.unique(facets if facets.size else lines)
    used = used[came_or_moved(before, outcome)[used]]
    reach = np.full(len(points), ON_LINE * diagonal(bent.points))
    if len(lines):
        a, b = (points[lines[:, i]] for i in range(2))
        length = np.full(len(points), np.inf)
        np.minimum.at(length, lines, np.sqrt(((b - a) ** 2).sum(axis=1))[:, None])
        reach = np.where(np.isfinite(length), NEAR_LINE * length, reach)
    points[used] = _over(bent, points[used], reach[used])
    return points


def _middles(bent: Bent, outcome: Outcome, frame: PlaneFrame | None) -> BentEdges:
    """Edges of the surface of a mesh and where their nodes are on the curved one."""
    facets, ends = _surface(outcome, bent.angle, surface=bent.surface)
    n, sharp = len(outcome.points), ends
    if len(facets):
        ends = surface_edges(facets, n).vertices
    a, b = (outcome.points[ends[:, i]] for i in range(2))
    reach = NEAR_LINE * np.sqrt(((b - a) ** 2).sum(axis=1))
    reach[~np.isin(row_keys(ends, n), row_keys(sharp, n))] = -1.0
    places = _over(bent, 0.5 * (a + b), reach)
    return BentEdges(ends, places if frame is None else frame.to_space(places))


def _over(bent: Bent, places: FloatArray, reach: FloatArray) -> FloatArray:
    """Places (k, d) on the curved surface near others, on its lines within reach (k,) of them."""
    from odt_plugins.engine.ground.reference import make_reference

    x = _in_space(places)
    out, on_line = np.empty_like(x), np.zeros(len(x), dtype=np.bool_)
    if len(bent.lines) and len(x):
        far, line, foot = make_reference(bent.points, bent.lines[:, [0, 1, 1]]).closest(x)
        on_line = (far <= reach) | (len(bent.triangles) == 0)
        a, b = (bent.points[bent.lines[line[on_line], i]] for i in range(2))
        along = b - a
        square = (along * along).sum(axis=1)
        t = (((foot[on_line] - a) * along).sum(axis=1) / np.where(square > 0.0, square, 1.0))[
            :, None]
        out[on_line] = a + t * along + 4.0 * t * (1.0 - t) * bent.of_line[line[on_line]]
    out[~on_line] = _on_facets(bent, x[~on_line])
    return out[:, : places.shape[1]]


def _on_facets(bent: Bent, x: FloatArray) -> FloatArray:
    """Places (k, 3) on curved facets whose way from x (k, 3) is across the flat ones."""
    from odt_plugins.engine.surface.judge import feet_on

    out, off = np.empty_like(x), np.full(len(x), np.inf)
    left, under = np.arange(len(x)), x
    for _ in range(ROUNDS):
        if not len(left):
            break
        face, w = feet_on(bent.points, bent.triangles, under)
        a, b, c = (bent.points[bent.triangles[face, i]] for i in range(3))
        bumps = 4.0 * w * w[:, [1, 2, 0]]
        found = w[:, :1] * a + w[:, 1:2] * b + w[:, 2:] * c + (
            bumps[:, :, None] * bent.of_triangle[face]).sum(axis=1)
        normal = np.cross(b - a, c - a)
        size = (normal * normal).sum(axis=1)
        away = x[left] - found
        far = (away * away).sum(axis=1)
        along = away - ((away * normal).sum(axis=1) / np.where(size > 0.0, size, 1.0))[
            :, None] * normal
        better = far < off[left]
        out[left[better]], off[left[better]] = found[better], far[better]
        open_ = ((along * along).sum(axis=1) > CLOSE * CLOSE * np.sqrt(size)) & (
            far <= ASTRAY * off[left])
        left, under = left[open_], (under + along)[open_]
    return out
