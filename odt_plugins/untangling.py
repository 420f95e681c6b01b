"""A caller's mesh with inverted or flat cells: untangled on its way to the engine, or refused."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.carry import in_input_order
from odt_plugins.errors import FacetPair, InvalidMeshError, TangledMeshError, counted
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.plane import PlaneFrame
from odt_plugins.mesh.simplex import SimplexMesh, cell_signs
from odt_plugins.options import FIGURES, Options
from odt_plugins.promise.volume import worse_figures
from odt_plugins.quality import QualitySummary, summarize


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


class Wanted(NamedTuple):
    """What a caller of :func:`odt_plugins.untangle` asks for besides a valid mesh.

    Attributes
    ----------
    rest : (n, d) float64 or None    places at which all cells have the shapes they should have
    partial : bool                   whether a mesh with fewer inverted cells will do
    """

    rest: FloatArray | None = None
    partial: bool = False


def untangle_mesh(
    mesh: SimplexMesh, options: Options, rounded: Callable[[FloatArray], FloatArray],
    wanted: Wanted,
) -> tuple[SimplexMesh, Tangle]:
    """Make a mesh valid for the engine.

    Parameters
    ----------
    mesh : SimplexMesh     cells that agree about their orientation, some inverted or flat
    options : Options
    rounded : callable     points as the caller's type has them
    wanted : Wanted

    Raises
    ------
    TangledMeshError       some cells stay inverted or flat
    """
    from odt_plugins.engine.untangle.run import untangled

    sign, _ = cell_signs(mesh.points, mesh.cells)
    bad = sign <= 0
    if (bad & mesh.frozen).any() and not wanted.partial:
        raise _left(mesh, mesh.points, np.flatnonzero(bad & mesh.frozen),
                    "which must stay as they are", "try a larger selection")
    found = untangled(mesh, options.threads, wanted.rest, rounded)
    moved = replace(mesh, points=found.points)
    cells, regions, source = in_input_order(moved, found.points, found.cells, found.regions,
                                            options.threads)
    if found.bad.any() and not wanted.partial:
        left = cell_signs(found.points, cells)[0] <= 0
        why, facets = _overlapping(mesh, cells[left])
        raise _left(mesh, found.points, np.unique(source[left]),
                    f"for which neither other places of their vertices nor flips were found{why}",
                    "try moving what holds them, or untangle(mesh, partial=True) for the best mesh "
                    "there is", facets)
    facts = {
        "inverted": int((sign < 0).sum()),
        "flat": int((sign == 0).sum()),
        "left": int(found.bad.sum()),
        "moved": int((found.points != mesh.points).any(axis=1).sum()),
        "flips": found.flips,
    }
    new = replace(moved, cells=cells, regions=regions, frozen=mesh.frozen[source],
                  valid_before=None if bad.all() else (mesh.points, mesh.cells[~bad]))
    return new, Tangle(mesh, new, source, facts)


def _overlapping(mesh: SimplexMesh, left: IntArray) -> tuple[str, tuple[FacetPair, ...]]:
    """The facets that must stay and make cells (k, d + 1) impossible: what to say, and all."""
    from odt_plugins.engine.untangle.overlaps import overlaps

    near = np.zeros(len(mesh.points), dtype=np.bool_)
    near[left] = True
    found = overlaps(mesh, near)
    if not len(found.facets):
        return "", ()
    place = ", ".join(f"{x:.6g}" for x in found.places[0])
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
    msg = (
        f"got {counted(len(cells), 'inverted or flat cell')} (first: cell {first} with vertices "
        f"{corners.tolist()} around ({place})) {why}; expected a boundary, interfaces and fixed "
        f"vertices that leave every cell room, {hint}"
    )
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
    InvalidMeshError                 they are of other vertices, or cells are inverted or flat there
    """
    if rest.shape != points.shape:
        msg = (f"got a rest mesh with points of shape {rest.shape}; expected {points.shape}, "
               f"places of the same vertices")
        raise InvalidMeshError(msg)
    places = np.asarray(rest, dtype=np.float64)
    places = places if frame is None else frame.to_plane(places)
    bad = np.flatnonzero(~(cell_signs(places, cells)[0] > 0))
    if bad.size:
        msg = (f"got {counted(len(bad), 'cell')} (first: cell {bad[0]}) that {_are(len(bad))} "
               f"inverted or flat in the rest mesh; expected the shapes that cells should have")
        raise InvalidMeshError(msg)
    return places


def _are(count: int) -> str:
    return "is" if count == 1 else "are"
