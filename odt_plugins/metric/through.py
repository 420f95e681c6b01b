"""A mesh with the metric that a caller gives, as the engine reads it."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations_with_replacement

import numpy as np

from odt_plugins.adapters.fields import INPUT, named_metric
from odt_plugins.adapters.host import HostMesh
from odt_plugins.engine.cells.tensors import (
    eigenvalues,
    intersection,
    logarithm,
    of_eigenvalues,
    positive_eigenvalues,
)
from odt_plugins.engine.run.judge import envelope_length
from odt_plugins.errors import TangledMeshError, counted
from odt_plugins.mesh.arrays import FloatArray
from odt_plugins.mesh.plane import PlaneFrame
from odt_plugins.mesh.simplex import SimplexMesh
from odt_plugins.metric.given import metric_at_vertices
from odt_plugins.metric.limits import grown_metric
from odt_plugins.options import Options

SHORTER = 1.1
"""Multiple of the longest length that the envelope allows beyond which a metric asks for more."""

LONGEST = 10.0
"""Multiple of the longest length of a metric that a chord has where nothing is curved."""


def with_metric(
    mesh: SimplexMesh, options: Options, host: HostMesh, frame: PlaneFrame | None,
    growth: float | None = None,
) -> tuple[SimplexMesh, Options, tuple[str, ...]]:
    """Let a mesh have its metric.

    Where a surface slides that is resized, of tetrahedra or in space, no length along it is longer
    than the envelope allows, unless the metric is that of the mesh itself.

    Parameters
    ----------
    mesh : SimplexMesh
    options : Options       of which `metric` is looked at
    host : HostMesh         among whose point arrays names are looked up
    frame : PlaneFrame      of triangles in one plane in space
    growth : float          see :func:`odt_plugins.metric.limits.grown_metric`

    Returns
    -------
    mesh, options, notes    with the metric; without one, which takes the place of a
                            density; what the report is to say

    Raises
    ------
    InvalidOptionError      it is no metric of this mesh
    TangledMeshError        cells were inverted, which have no shape to be seen
    """
    given = options.metric
    if given is None:
        return mesh, options, ()
    if len(host.points) != len(mesh.points):
        msg = "got metric= for a mesh with inverted cells; expected valid ones, try untangle first"
        raise TangledMeshError(msg)
    if isinstance(given, str) and given != INPUT:
        given = named_metric(host, given)
    metric = metric_at_vertices(mesh, given, frame)
    notes: tuple[str, ...] = ()
    if growth is not None:
        own = isinstance(given, str)
        curved = mesh.dim == 3 or mesh.is_surface
        if curved and options.boundary == "slide" and not own:
            metric, notes = _within_chords(mesh, metric, options)
        metric = grown_metric(mesh.points, mesh.cells, metric, growth)
    options = replace(options, metric=None, density="uniform")
    return replace(mesh, metric=halved_logarithms(metric)), options, notes


def _within_chords(
    mesh: SimplexMesh, metric: FloatArray, options: Options
) -> tuple[FloatArray, tuple[str, ...]]:
    """A metric (n, 3, 3) without lengths along surfaces beyond what the envelope allows."""
    from odt_plugins.engine.remesh.chords import chord_metric

    chords = chord_metric(mesh, envelope_length(mesh, options), options.feature_angle)
    values, axes = eigenvalues(chords)
    least = positive_eigenvalues(metric)[0].min(axis=1)
    curved = np.flatnonzero(values.max(axis=1) > SHORTER**2 * least)
    if not len(curved):
        return metric, ()
    floor = LONGEST**-2 * least[curved, None]
    out = metric.copy()
    out[curved] = intersection(
        metric[curved], of_eigenvalues(np.maximum(values[curved], floor), axes[curved]))
    return out, (
        f"lengths along the surface may be shorter than the metric asks for at "
        f"{counted(len(curved), 'vertex', 'vertices')} of the input: the envelope allows no longer "
        "edges",)


def halved_logarithms(metric: FloatArray) -> FloatArray:
    """Upper triangles (n, d (d + 1) / 2), row by row, of log(M) / 2 of metrics (n, d, d)."""
    full = 0.5 * logarithm(metric)
    rows, columns = zip(*combinations_with_replacement(range(metric.shape[1]), 2), strict=True)
    return np.ascontiguousarray(full[:, rows, columns])
