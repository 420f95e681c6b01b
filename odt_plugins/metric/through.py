"""A mesh with the metric that a caller gives, as the engine reads it."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations_with_replacement

import numpy as np

from odt_plugins.adapters.fields import named_metric
from odt_plugins.adapters.host import HostMesh
from odt_plugins.engine.cells.tensors import logarithm
from odt_plugins.errors import TangledMeshError
from odt_plugins.mesh.arrays import FloatArray
from odt_plugins.mesh.plane import PlaneFrame
from odt_plugins.mesh.simplex import SimplexMesh
from odt_plugins.metric.given import INPUT, metric_at_vertices
from odt_plugins.metric.limits import grown_metric
from odt_plugins.options import Options


def with_metric(
    mesh: SimplexMesh, options: Options, host: HostMesh, frame: PlaneFrame | None,
    growth: float | None = None,
) -> tuple[SimplexMesh, Options]:
    """Let a mesh have its metric.

    Parameters
    ----------
    mesh : SimplexMesh
    options : Options       of which `metric` is looked at
    host : HostMesh         among whose point arrays names are looked up
    frame : PlaneFrame      of triangles in one plane in space
    growth : float          see :func:`odt_plugins.metric.limits.grown_metric`

    Returns
    -------
    mesh, options           with the metric; without one, which takes the place of a
                            density

    Raises
    ------
    InvalidOptionError      it is no metric of this mesh
    TangledMeshError        cells were inverted, which have no shape to be seen
    """
    given = options.metric
    if given is None:
        return mesh, options
    if len(host.points) != len(mesh.points):
        msg = "got metric= for a mesh with inverted cells; expected valid ones, try untangle first"
        raise TangledMeshError(msg)
    if isinstance(given, str) and given != INPUT:
        given = named_metric(host, given)
    metric = metric_at_vertices(mesh, given, frame)
    if growth is not None:
        metric = grown_metric(mesh.points, mesh.cells, metric, growth)
    options = replace(options, metric=None, density="uniform")
    return replace(mesh, metric=halved_logarithms(metric)), options


def halved_logarithms(metric: FloatArray) -> FloatArray:
    """Upper triangles (n, d (d + 1) / 2), row by row, of log(M) / 2 of metrics (n, d, d)."""
    full = 0.5 * logarithm(metric)
    rows, columns = zip(*combinations_with_replacement(range(metric.shape[1]), 2), strict=True)
    return np.ascontiguousarray(full[:, rows, columns])
