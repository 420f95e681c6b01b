"""The promise as the engine and hosts ask for it, with the envelope of a surface that slides."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from odt_plugins.engine.cells.geometry import boundary_facets, signed_volumes
from odt_plugins.errors import counted
from odt_plugins.figures import CellFigures
from odt_plugins.mesh.arrays import FloatArray, IntArray, LongArray
from odt_plugins.mesh.numbering import in_old_numbers, old_numbers
from odt_plugins.mesh.seen import NO_METRIC
from odt_plugins.mesh.simplex import SimplexMesh
from odt_plugins.options import Options
from odt_plugins.promise.region_sizes import broken_sizes, other_sizes
from odt_plugins.promise.volume import broken_promises

TOLERANCE = 0.02
"""Distances are bounded to this part of the envelope."""


class Slid(NamedTuple):
    """How far the boundary of a tetrahedral mesh slid.

    Attributes
    ----------
    envelope : float      length that was allowed
    forward : float       no point of the new boundary is further from that of the input
    backward : float      no point of the input's boundary is further from the new one
    volume : float        relative change of the volume
    vertices : int        boundary vertices that moved
    """

    envelope: float
    forward: float
    backward: float
    volume: float
    vertices: int


def slides(mesh: SimplexMesh, options: Options) -> bool:
    """Whether the boundary of this mesh may move."""
    return options.boundary == "slide" and mesh.points.shape[1] == 3


def envelope_length(mesh: SimplexMesh, options: Options) -> float:
    """The envelope as a length: ``options.envelope`` times the diagonal of the bounding box."""
    return options.envelope * mesh.extent


def measure_slide(mesh: SimplexMesh, points: FloatArray, cells: IntArray, options: Options) -> Slid:
    """Measure the boundary of a result against that of the input, with certified distances.

    Parameters
    ----------
    mesh : SimplexMesh                          the input
    points : (n', 3) float64, cells : (m, 4)    the result, vertices of the input first
    options : Options
    """
    from odt_plugins.engine.ground.envelope import distances

    length = envelope_length(mesh, options)
    if mesh.ground is not None:
        length *= 2.0  # both surfaces are within the envelope of the ground
    old, new = boundary_facets(mesh.cells), boundary_facets(cells)
    both = distances((points, new), (mesh.points, old), TOLERANCE * length)
    was = float(signed_volumes(mesh.points, mesh.cells).sum())
    moved = (points[: len(mesh.points)] != mesh.points).any(axis=1)
    return Slid(
        length,
        both.forward_upper,
        both.backward_upper,
        float(signed_volumes(points, cells).sum()) / was - 1.0,
        int(moved[np.unique(old)].sum()),
    )


def faults(
    mesh: SimplexMesh, points: FloatArray, cells: IntArray, regions: IntArray, options: Options,
    origin: LongArray | None = None, metric: FloatArray = NO_METRIC,
    figures: Callable[[], CellFigures] | None = None,
) -> tuple[list[str], Slid | None]:
    """Say what of the promise does not hold, and how far the boundary slid if it may.

    Parameters as for :func:`odt_plugins.promise.volume.broken_promises`.
    """
    sliding = slides(mesh, options)
    broken = broken_promises(mesh, points, cells, regions, tuple(options.keep), slides=sliding,
                             origin=origin, insert=options.insert, threads=options.threads,
                             metric=metric, figures=figures)
    if sliding:
        known = figures() if figures is not None and not broken else None
        broken += broken_sizes(mesh, points, cells, regions, known)
    if broken or not sliding:
        return broken, None
    from odt_plugins.engine.ground.crossings import count_crossings

    if origin is not None:
        cells = old_numbers(origin, len(mesh.points))[cells]
        points = in_old_numbers(mesh.points, points, origin)
    slid = measure_slide(mesh, points, cells, options)
    furthest = max(slid.forward, slid.backward)
    if not furthest <= slid.envelope:
        broken.append(
            f"the boundary is up to {furthest:.3g} from the input's, beyond the envelope of "
            f"{slid.envelope:.3g}"
        )
    crossings = count_crossings(points, boundary_facets(cells))
    if crossings and crossings > count_crossings(mesh.points, boundary_facets(mesh.cells)):
        broken.append(f"the boundary cuts through itself at {counted(crossings, 'edge')}")
    return broken, slid


def cut_vertices(
    before: FloatArray, cells_before: IntArray, points: FloatArray, cells: IntArray
) -> IntArray:
    """List the vertices of boundary triangles that cross others now, and did not before."""
    from odt_plugins.engine.ground.crossings import crossing_triangles

    old, new = boundary_facets(cells_before), boundary_facets(cells)
    places, were = (np.ascontiguousarray(x[:, :3]) for x in (points, before))
    cut = np.unique(new[crossing_triangles(places, new)])
    return np.setdiff1d(cut, old[crossing_triangles(were, old)]).astype(np.int32)


def vertices_of_other_sizes(
    mesh: SimplexMesh, points: FloatArray, cells: IntArray, regions: IntArray
) -> IntArray:
    """List the boundary vertices of the regions whose volume changed too much, if not of all."""
    labels = [label for label, *_ in other_sizes(mesh, points, cells, regions)]
    own = np.isin(mesh.bodies(), labels)
    if own.all():
        return np.zeros(0, dtype=np.int32)
    return np.intersect1d(mesh.cells[own], boundary_facets(mesh.cells)).astype(np.int32)
