"""A mesh that was resized, optimised, with the faces that those with labels are then."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from odt_plugins.engine.cells.geometry import signed_volumes
from odt_plugins.engine.odt.density import NodalDensity
from odt_plugins.engine.odt.rounds import overrelaxes
from odt_plugins.engine.policy import POLICY
from odt_plugins.engine.remesh.lay_out import surface_of
from odt_plugins.engine.run.outcome import Leaving, Outcome
from odt_plugins.engine.run.plan import run
from odt_plugins.engine.run.within import Within
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray, LongArray
from odt_plugins.mesh.faces import Faces, Pieces, followed, labels_at, no_faces, renumbered
from odt_plugins.mesh.numbering import new_numbers
from odt_plugins.mesh.simplex import SimplexMesh
from odt_plugins.options import Options
from odt_plugins.progress import silent

SLIDING = 0.4
"""Part of the allowed change of the volume that sliding may use, where none can be given back."""

POOR = 0.6
"""Least 1 % quantile of the radius ratio for which no vertices are added."""

MORE = 0.1
"""Largest part of its vertices by which a mesh below that grows."""

Room = Callable[[Outcome], float]
"""Part of its vertices by which those of a mesh may become more."""


class Resized(NamedTuple):
    """A mesh whose edges are as long as they should be.

    Attributes
    ----------
    outcome : Outcome        its origin are vertices of the input
    lengths : (n,) float64   that edges are to have at the vertices
    multiple : (n,) float64  of these that was asked for
    lines : (k, 2) int32     feature lines
    firm : bool              whether sizes that give way to the surface would change nothing
    """

    outcome: Outcome
    lengths: FloatArray
    multiple: FloatArray
    lines: IntArray
    firm: bool


def finished(
    mesh: SimplexMesh, given: Resized, options: Options, leaving: Leaving, room: Room
) -> tuple[Resized, bool]:
    """Optimise a mesh that was resized.

    Parameters
    ----------
    mesh : SimplexMesh    the input
    given : Resized
    options : Options
    leaving : callable    applied to every mesh before it is judged
    room : callable       above 0 where vertices may come to a mesh with a poor tail

    Returns
    -------
    Resized               its outcome has the faces of then
    bool                  whether these can be told apart
    """
    resized = _placed(given.outcome, leaving)
    given = given._replace(outcome=resized)
    origin: LongArray = resized.origin if resized.origin is not None else np.arange(0)
    new = origin < 0
    number = new_numbers(origin, len(mesh.points))
    still = number[mesh.cells[mesh.frozen]].astype(np.int32)
    middle = SimplexMesh(
        resized.points, resized.cells, resized.regions,
        fixed=np.where(new, False, mesh.fixed[origin]),
        frozen=labels_at(resized.cells, Faces(still, np.zeros(len(still), dtype=np.int32))) >= 0,
        anchored=np.where(new, False, mesh.anchored[origin]), body=mesh.body,
        stays=number[mesh.stays], lines=given.lines, metric=resized.metric,
    )
    lengths = given.lengths
    options = replace(options, density=NodalDensity(lengths / lengths.mean(), -float(mesh.dim + 2)))
    if overrelaxes(options, mesh.dim):
        # the rounds of resizing have stirred enough
        options = replace(options, smoothing=replace(options.smoothing, omega=POLICY.overrelaxed))

    def as_it_leaves(outcome: Outcome) -> Outcome:
        left = leaving(replace(outcome, origin=_composed(origin, outcome.origin),
                               faces=_renumbered(resized, outcome.origin)))
        return replace(left, origin=outcome.origin)

    inserts = options.finish and options.smoothing.connectivity != "none"
    more = room(resized) if inserts and not len(middle.metric) else 0.0
    best = run(middle, replace(options, insert=more > 0.0 and more), as_it_leaves,
               within=Within(share=SLIDING, sized=mesh, tail=POOR))
    (options.progress or silent)("finishing", 1.0)
    if best.written is None:
        best = as_it_leaves(best)
    outcome = replace(best, origin=_composed(origin, best.origin), fallback=None, slid=None)
    faces = _followed(resized, outcome, best.origin, slides=options.boundary == "slide")
    if best.origin is not None:
        came = best.origin < 0
        sizes: FloatArray = np.ones(len(came)) if best.sizes is None else best.sizes
        given = given._replace(
            lengths=np.where(came, lengths.mean() * sizes, lengths[best.origin]),
            multiple=given.multiple[best.origin[_nearest(best.points, ~came)]],
            lines=new_numbers(best.origin, len(origin))[given.lines])
    return given._replace(outcome=replace(outcome, faces=faces or no_faces())), faces is not None


def _placed(resized: Outcome, leaving: Leaving) -> Outcome:
    """Move vertices to the coordinates in which they leave, so that later stages keep those.

    The caller's coordinates may be shorter numbers. Where cells would fold all stays.
    """
    cells, regions = resized.cells[:0], resized.regions[:0]
    places = leaving(replace(resized, cells=cells, regions=regions)).points
    if not (signed_volumes(places, resized.cells) > 0.0).all():
        return resized
    return replace(resized, points=places)


def sums(one: dict[str, Any], other: dict[str, Any]) -> dict[str, Any]:
    """Both, with the sums of what they share."""
    return one | {name: one.get(name, 0) + value for name, value in other.items()}


def _renumbered(resized: Outcome, origin: LongArray | None) -> tuple[Faces, Faces]:
    """Faces of a resized mesh by the numbers of its vertices in another one, some of those."""
    n = len(resized.points)
    number = np.arange(n, dtype=np.int32) if origin is None else new_numbers(origin, n)
    return renumbered(resized.faces[0], number), renumbered(resized.faces[1], number)


def _followed(
    resized: Outcome, outcome: Outcome, origin: LongArray | None, *, slides: bool
) -> tuple[Faces, Faces] | None:
    """Faces of a mesh that was optimised after it was resized, None where labels are in doubt.

    ``origin`` are its vertices of the resized mesh, of which borders between labels stay.
    """
    old, triangles = _renumbered(resized, origin)
    if not slides or not len(triangles.rows):
        return old, triangles
    n = len(resized.points)
    number = np.arange(n, dtype=np.int32) if origin is None else new_numbers(origin, n)
    rows, piece = _pieces(resized)
    was, now = Pieces(number[rows], piece), Pieces(*_pieces(outcome))
    labels = followed(was, labels_at(was.rows, triangles), now, len(outcome.points))
    if labels is None:
        return None
    named = labels >= 0
    return old, Faces(now.rows[named], labels[named])


def _pieces(mesh: Outcome) -> tuple[IntArray, IntArray]:
    """Triangles of surfaces (k, 3), and the pieces of them by the regions on their sides."""
    triangles, patch, _ = surface_of(mesh.cells, mesh.regions, no_faces()[1])
    return triangles, patch


def _nearest(points: FloatArray, known: BoolArray) -> LongArray:
    """Known vertex (n,) nearest to every vertex; a known one is nearest to itself."""
    from scipy.spatial import cKDTree

    number, old = np.arange(len(points)), np.flatnonzero(known)
    number[~known] = old[cKDTree(points[old]).query(points[~known])[1]]
    return number


def _composed(first: LongArray, second: LongArray | None) -> LongArray:
    """Vertex of the first mesh of every vertex of the third, by way of the second."""
    return first if second is None else np.where(second < 0, -1, first[second])
