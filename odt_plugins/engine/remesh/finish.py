"""A mesh that was resized, optimised, with the faces that those with labels are then."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from odt_plugins.engine.odt.density import NodalDensity
from odt_plugins.engine.remesh.lay_out import surface_of
from odt_plugins.engine.run.outcome import Leaving, Outcome
from odt_plugins.engine.run.plan import run
from odt_plugins.engine.run.within import Within
from odt_plugins.mesh.arrays import FloatArray, IntArray, LongArray
from odt_plugins.mesh.faces import Faces, Pieces, followed, labels_at, no_faces, renumbered
from odt_plugins.mesh.numbering import new_numbers
from odt_plugins.mesh.simplex import SimplexMesh
from odt_plugins.options import Options

SLIDING = 0.4
"""Part of the allowed change of the volume that sliding may use."""


class Resized(NamedTuple):
    """A mesh whose edges are as long as they should be.

    Attributes
    ----------
    outcome : Outcome        its origin are vertices of the input
    lengths : (n,) float64   that edges are to have at the vertices
    multiple : (n,) float64  of these that was asked for
    lines : (k, 2) int32     feature lines
    """

    outcome: Outcome
    lengths: FloatArray
    multiple: FloatArray
    lines: IntArray


def finished(
    mesh: SimplexMesh, given: Resized, options: Options, leaving: Leaving
) -> tuple[Resized, bool]:
    """Optimise a mesh that was resized.

    Parameters
    ----------
    mesh : SimplexMesh    the input
    given : Resized
    options : Options
    leaving : callable    applied to every mesh before it is judged

    Returns
    -------
    Resized               its outcome has the faces of then
    bool                  whether these can be told apart
    """
    resized = given.outcome
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
    options = replace(
        options, density=NodalDensity(lengths / lengths.mean(), -float(mesh.dim + 2)))

    def as_it_leaves(outcome: Outcome) -> Outcome:
        left = leaving(replace(outcome, origin=_composed(origin, outcome.origin),
                               faces=_renumbered(resized, outcome.origin)))
        return replace(left, origin=outcome.origin)

    best = run(middle, options, as_it_leaves, within=Within(share=SLIDING))
    if best.written is None:
        best = as_it_leaves(best)
    outcome = replace(best, origin=_composed(origin, best.origin), fallback=None, slid=None)
    faces = _followed(resized, outcome, best.origin, slides=options.boundary == "slide")
    if best.origin is not None:
        given = given._replace(lengths=lengths[best.origin], multiple=given.multiple[best.origin],
                               lines=new_numbers(best.origin, len(origin))[given.lines])
    return given._replace(outcome=replace(outcome, faces=faces or no_faces())), faces is not None


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
    was, now = (Pieces(*_pieces(cells, x.regions)) for x, cells in (
        (resized, number[resized.cells]), (outcome, outcome.cells)))
    labels = followed(was, labels_at(was.rows, triangles), now, len(outcome.points))
    if labels is None:
        return None
    named = labels >= 0
    return old, Faces(now.rows[named], labels[named])


def _pieces(cells: IntArray, regions: IntArray) -> tuple[IntArray, IntArray]:
    """Triangles of surfaces (k, 3), and the pieces of them by the regions on their sides."""
    triangles, patch, _ = surface_of(cells, regions, no_faces()[1])
    return triangles, patch


def _composed(first: LongArray, second: LongArray | None) -> LongArray:
    """Vertex of the first mesh of every vertex of the third, by way of the second."""
    return first if second is None else np.where(second < 0, -1, first[second])
