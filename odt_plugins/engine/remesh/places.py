"""Where of its input a mesh that was given other sizes does not keep the promise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from odt_plugins.engine.cells.geometry import boundary_facets, signed_volumes
from odt_plugins.engine.ground.crossings import crossing_triangles
from odt_plugins.engine.record.figures import Figures, cell_shapes, figures
from odt_plugins.engine.record.relaxed import relaxed, spoiling
from odt_plugins.engine.remesh.distance import astray
from odt_plugins.engine.remesh.sizes import Sizes, lengths_of
from odt_plugins.engine.run.outcome import Outcome
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray, LongArray
from odt_plugins.mesh.seen import as_seen
from odt_plugins.mesh.simplex import SimplexMesh, vertices_of
from odt_plugins.options import Options
from odt_plugins.promise.good import filled_up, mean_but_poor
from odt_plugins.promise.region_sizes import other_sizes

REACH = 0.7
"""Largest distance, in sizes, for which a vertex of the input is near a place."""

NEAREST = 16
"""Places, the nearest ones to a vertex, whose distance in a metric is measured."""

MOST_UNLIKE = 0.5
"""Least part of the whole for which regions whose volume is another are not small."""


def seen_figures(mesh: SimplexMesh | Outcome, full: int = 0) -> Figures:
    """Figures of a mesh, as it is seen; where cells are filled up, as ``fallen_since`` has them."""
    seen = as_seen(mesh.points, mesh.cells, mesh.metric)
    if not full:
        return figures(*seen)
    return replace(figures(*filled_up(*seen, full)), mean_quality=mean_but_poor(*seen))


def allowed_figures(mesh: SimplexMesh, options: Options, full: int = 0) -> Figures:
    """Figures down to which those of a mesh may fall."""
    return relaxed(seen_figures(mesh, full), tuple(options.keep), 4)


def spoiled_cells(
    mesh: SimplexMesh, outcome: Outcome, sizes: Sizes, options: Options, full: int = 0
) -> BoolArray:
    """Cells (m,) of the input near cells that pass its extremes, or near triangles that cross."""
    shapes = cell_shapes(*as_seen(outcome.points, outcome.cells, outcome.metric))
    bad = spoiling(allowed_figures(mesh, options, full), seen_figures(outcome, full), shapes,
                   tuple(options.keep))
    near = _near(mesh, _corners(outcome, outcome.cells[bad]), sizes) | _near(
        mesh, _corners(outcome, _crossed(outcome)), sizes)
    return np.asarray(near[mesh.cells].any(axis=1))


def newly_cut(mesh: SimplexMesh, outcome: Outcome, sizes: Sizes) -> BoolArray:
    """Vertices (n,) of the input near triangles that cut others, but near none of its own."""
    return _near(mesh, _corners(outcome, _crossed(outcome)), sizes) & ~_near(
        mesh, _corners(mesh, _crossed(mesh)), sizes)


def of_small_regions(mesh: SimplexMesh, outcome: Outcome) -> BoolArray:
    """Vertices (n,) of the input of regions whose volume is another, if these are small."""
    others = other_sizes(mesh, outcome.points, outcome.cells, outcome.regions)
    whole = float(signed_volumes(mesh.points, mesh.cells).sum())
    near = np.zeros(len(mesh.points), dtype=np.bool_)
    if sum(first for _, first, _ in others) < MOST_UNLIKE * whole:
        labels = [label for label, *_ in others]
        near[mesh.cells[np.isin(mesh.bodies(), labels)]] = True
    return near


def gone_astray(
    mesh: SimplexMesh, outcome: Outcome, sizes: Sizes, envelope: float
) -> BoolArray:
    """Vertices (n,) of the input near surfaces that may be beyond an envelope."""
    return _near(mesh, astray(mesh, outcome, envelope), sizes)


def _crossed(outcome: SimplexMesh | Outcome) -> IntArray:
    """Triangles (k, 3) of the boundary that cut others."""
    facets = boundary_facets(outcome.cells)
    return facets[crossing_triangles(outcome.points, facets)]


def _corners(mesh: SimplexMesh | Outcome, rows: IntArray) -> FloatArray:
    """Places (k, 3) of the vertices of some simplices."""
    return mesh.points[vertices_of(rows)]


def _near(mesh: SimplexMesh, places: FloatArray, sizes: Sizes) -> BoolArray:
    """Vertices (n,) of the input near places (k, 3)."""
    near = np.zeros(len(mesh.points), dtype=np.bool_)
    if len(places):
        used = mesh.used
        near[used] = _distances(mesh, used, places) <= REACH * sizes.values[used]
    return near


def _distances(mesh: SimplexMesh, used: LongArray, places: FloatArray) -> FloatArray:
    """Distances of vertices to the nearest of places (k, 3), in the metric of each vertex."""
    from scipy.spatial import cKDTree

    points = mesh.points[used]
    if not len(mesh.metric):
        return np.asarray(cKDTree(places).query(points)[0])
    count = min(NEAREST, len(places))
    _, which = cKDTree(places).query(points, [*range(1, count + 1)])
    pairs = np.arange(2 * len(points), dtype=np.int32).reshape(2, -1).T
    metric = np.tile(mesh.metric[used], (2, 1))
    return np.min([lengths_of(np.concatenate([points, places[ends]]), pairs, metric)
                   for ends in np.transpose(which)], axis=0)
