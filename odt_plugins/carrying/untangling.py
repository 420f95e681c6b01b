"""A caller's mesh with inverted or flat cells: untangled on its way to the engine, or refused."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.host import HostMesh
from odt_plugins.adapters.staying import held_vertices
from odt_plugins.carrying.sources import in_input_order
from odt_plugins.engine.cells.geometry import boundary_vertices
from odt_plugins.errors import FacetPair, InvalidMeshError, TangledMeshError, counted, place_within
from odt_plugins.figures import QualitySummary, summarize
from odt_plugins.mesh.arrays import FloatArray, IntArray, LongArray
from odt_plugins.mesh.numbering import most_vertices
from odt_plugins.mesh.plane import PlaneFrame
from odt_plugins.mesh.simplex import SimplexMesh, cell_signs, with_vertices
from odt_plugins.options import FIGURES, Options
from odt_plugins.progress import silent
from odt_plugins.promise.volume import worse_figures


class Tangle(NamedTuple):
    """A mesh as it was before it was untangled, and what was done.

    Attributes
    ----------
    before : SimplexMesh       cells that agree about their orientation, some inverted or flat
    after : SimplexMesh        the same without those
    source : (m',) int32       its cell of which every cell of the untangled mesh takes the data
    facts : dict               what the report says of it
    """

    before: SimplexMesh
    after: SimplexMesh
    source: IntArray
    facts: Mapping[str, Any]

    @property
    def added(self) -> int:
        """Vertices that were inserted: the last ones of the mesh after."""
        return len(self.after.points) - len(self.before.points)

    @property
    def around(self) -> SimplexMesh:
        """A mesh of the vertices that have data, where these are after: cells around every place.

        Those after, and where vertices were inserted those before, of which some are inverted.
        """
        if not self.added:
            return self.after
        return replace(self.before, points=self.after.points[: len(self.before.points)])

    @property
    def source_around(self) -> IntArray:
        """Cell of `around` that is near each of the cells after."""
        return self.source if self.added else np.arange(len(self.source), dtype=np.int32)

    def origin(self, of: LongArray | None) -> LongArray | None:
        """Vertices before, -1 for others, from vertices `of` the mesh after; None if the same."""
        if not self.added:
            return of
        own = np.arange(len(self.after.points)) if of is None else of
        return np.where(own < len(self.before.points), own, -1)


class Wanted(NamedTuple):
    """What a caller of :func:`odt_plugins.untangle` or :func:`odt_plugins.remesh` asks for.

    Attributes
    ----------
    rest : (n, d) float64 or None    places at which all cells have the shapes they should have
    partial : bool                   whether a mesh with fewer inverted cells will do
    share : float                    part of the run that this is, for its progress
    linear : bool                    whether cells of higher order are refused
    sizes : str                      name of the array that holds the densities, if one does
    growth : float or None           largest growth of a metric along an edge of length 1
    refused : tuple of str           options, some with a value, that the call does not take, of
                                     which nothing is to be said therefore
    held : tuple of (str, (q, 1))    what is said of vertices that stay, and they
    """

    rest: FloatArray | None = None
    partial: bool = False
    share: float = 0.3
    linear: bool = False
    sizes: str = ""
    growth: float | None = None
    refused: tuple[str, ...] = ()
    held: tuple[tuple[str, NDArray[Any]], ...] = ()

    def seen(self, host: HostMesh) -> Wanted:
        """The same of a mesh whose labels and sets are known."""
        none = ("regions",) if host.regions is None else ()
        return self._replace(refused=(*self.refused, *none), held=tuple(held_vertices(host)))


def untangle_mesh(
    mesh: SimplexMesh, options: Options, rounded: Callable[[FloatArray], FloatArray],
    wanted: Wanted,
) -> tuple[SimplexMesh, Tangle]:
    """Make a mesh valid for the engine.

    Parameters
    ----------
    mesh : SimplexMesh     cells that agree about their orientation, some inverted or flat
    options : Options
    rounded : callable     points as the caller's type has them, more of them than the mesh has too
    wanted : Wanted

    Raises
    ------
    TangledMeshError       some cells stay inverted or flat
    """
    from odt_plugins.engine.untangle.run import Wishes, untangled

    sign, _ = cell_signs(mesh.points, mesh.cells)
    bad = sign <= 0
    if (bad & mesh.frozen).any() and not wanted.partial:
        raise _left(mesh, mesh.points, np.flatnonzero(bad & mesh.frozen),
                    "which must stay as they are", "try a larger selection")
    n = len(mesh.points)
    used = len(mesh.used)
    room = most_vertices(used, options.insert) - used if options.insert else 0
    tell = options.progress if callable(options.progress) else silent
    flips = options.smoothing.connectivity != "none"
    found = untangled(mesh, options.threads, Wishes(wanted.rest, room, rounded, tell, flips))
    moved = replace(mesh, points=found.points[:n])
    cells, regions, source = in_input_order(moved, found.points, found.cells, found.regions,
                                            options.threads)
    if found.bad.any() and not wanted.partial:
        left = cell_signs(found.points, cells)[0] <= 0
        tried = ("no other places of their vertices were found, with "
                 "smoothing={'connectivity': 'none'}")
        may = "smoothing={'connectivity': 'auto'}, "
        if flips:
            more = "flips nor vertices more" if options.insert else "flips"
            tried = f"neither other places of their vertices nor {more} were found"
            may = "" if options.insert or mesh.dim == 2 or (
                "insert" in wanted.refused) else "insert=True, "
        why, facets = _overlapping(mesh, cells[left])
        near = mesh.regions[np.isin(mesh.cells, cells[left]).any(axis=1)]
        may += "regions=None, " * (len(np.unique(near)) > 1 and "regions" not in wanted.refused)
        inner = np.setdiff1d(cells[left], np.flatnonzero(boundary_vertices(mesh.cells, n)))
        held = "".join(f", and {note}" for note, rows in wanted.held if np.isin(rows, inner).any())
        raise _left(mesh, moved.points, np.unique(source[left]),
                    f"for which {tried}{why}{held}",
                    f"try {may}moving what holds them, or untangle(mesh, partial=True) for the "
                    f"best mesh there is", facets)
    facts = {
        "inverted": int((sign < 0).sum()),
        "flat": int((sign == 0).sum()),
        "left": int(found.bad.sum()),
        "moved": int((moved.points != mesh.points).any(axis=1).sum()),
        "added": len(found.points) - n,
        "flips": found.flips,
    }
    new = replace(with_vertices(mesh, found.points), cells=cells, regions=regions,
                  frozen=mesh.frozen[source],
                  valid_before=None if bad.all() else (mesh.points, mesh.cells[~bad]))
    return new, Tangle(mesh, new, source, facts)


def _overlapping(mesh: SimplexMesh, left: IntArray) -> tuple[str, tuple[FacetPair, ...]]:
    """The facets that must stay and make cells (k, d + 1) impossible: what to say, and all."""
    from odt_plugins.engine.untangle.overlaps import overlaps

    near = np.zeros(len(mesh.points), dtype=np.bool_)
    near[left[left < len(near)]] = True
    found = overlaps(mesh, near)
    if not len(found.facets):
        return "", ()
    place = place_within(mesh.extent, found.places[0], 6)
    why = (f", since {len(found.facets)} facets of the boundary or of interfaces (first: "
           f"that of vertices {found.facets[0].tolist()}, with that of {found.others[0].tolist()}, "
           f"at ({place})) cross or overlap others")
    pairs = zip(found.facets.tolist(), found.others.tolist(), strict=True)
    return why, tuple((tuple(one), tuple(other)) for one, other in pairs)


def _left(
    mesh: SimplexMesh, points: FloatArray, cells: NDArray[np.integer], why: str, hint: str,
    facets: Iterable[FacetPair] = (),
) -> TangledMeshError:
    """The error that names the cells of the input which stay inverted or flat."""
    first = int(cells[0])
    corners = mesh.cells[first]
    place = ", ".join(f"{x:.6g}" for x in points[corners].mean(axis=0))
    msg = (f"got {counted(len(cells), 'inverted or flat cell')} (first: cell {first} with vertices "
           f"{corners.tolist()} around ({place})) {why}; expected a boundary, interfaces and fixed "
           f"vertices that leave every cell room, {hint}")
    return TangledMeshError(msg, cells, facets)


def worse_than_valid(
    tangle: Tangle, after: QualitySummary, keep: tuple[str, ...] = FIGURES
) -> tuple[str, ...]:
    """Say which figures of a result are worse than those of the valid cells of the input."""
    if tangle.after.valid_before is None:
        return ()
    return tuple(worse_figures(summarize(*tangle.after.valid_before), after, keep))


def rest_places(
    rest: NDArray[Any], points: NDArray[Any], cells: IntArray, frame: PlaneFrame | None
) -> FloatArray:
    """Check the places of a rest mesh, and bring them into the plane of a mesh that lies in one.

    Parameters
    ----------
    rest : (n, D) array              in the caller's space
    points : (n, D) array            of the mesh itself
    cells : (m, d + 1) int32
    frame : PlaneFrame, optional

    Raises
    ------
    InvalidMeshError                 they are of other vertices or not finite, or cells are inverted
                                     or flat there
    """
    if rest.shape != points.shape:
        msg = (f"got a rest mesh with points of shape {rest.shape}; expected {points.shape}, "
               f"places of the same vertices")
        raise InvalidMeshError(msg)
    places = np.asarray(rest, dtype=np.float64)
    lost = np.flatnonzero(~np.isfinite(places).all(axis=1))
    if lost.size:
        msg = (f"got {counted(len(lost), 'point')} (first: point {lost[0]}) with NaN or infinite "
               f"coordinates in the rest mesh; expected finite numbers")
        raise InvalidMeshError(msg)
    places = places if frame is None else frame.to_plane(places)
    bad = np.flatnonzero(~(cell_signs(places, cells)[0] > 0))
    if bad.size:
        verb = "is" if len(bad) == 1 else "are"
        msg = (f"got {counted(len(bad), 'cell')} (first: cell {bad[0]}) that {verb} "
               f"inverted or flat in the rest mesh; expected the shapes that cells should have")
        raise InvalidMeshError(msg)
    return places
