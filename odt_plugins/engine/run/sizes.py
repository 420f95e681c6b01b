"""Sizes that a run is asked for: the density as the engine reads it, its values as a run ends."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from odt_plugins.engine.odt.density import Density, NodalDensity, make_density
from odt_plugins.mesh.numbering import old_numbers

if TYPE_CHECKING:
    from odt_plugins.engine.run.outcome import Outcome
    from odt_plugins.engine.topology.frame import Frame
    from odt_plugins.mesh.arrays import FloatArray
    from odt_plugins.mesh.chunks import Pool
    from odt_plugins.mesh.simplex import SimplexMesh
    from odt_plugins.options import Options


def inner_density(mesh: SimplexMesh, options: Options, frame: Frame) -> Any:
    """``options.density`` in inner numbering and coordinates.

    Raises
    ------
    InvalidOptionError    an array does not fit the mesh, or holds bad values
    """
    spec = options.density
    if callable(spec):
        function = spec

        def inner(inner_points: FloatArray) -> Any:
            return function(frame.outside(inner_points))

        return inner
    if isinstance(spec, str):
        return spec
    if isinstance(spec, NodalDensity):
        return replace(spec, values=spec.values[frame.vertices])
    make_density(spec, options.smoothing.exponent, mesh.points, mesh.cells, mesh.cells)
    values = np.asarray(spec, dtype=np.float64)
    per_cell = len(values) == len(mesh.cells) and len(values) != len(mesh.points)
    return values[frame.active] if per_cell else values[frame.vertices]


def sizes_after(
    mesh: SimplexMesh, options: Options, frame: Frame, density: Density, outcome: Outcome,
    pool: Pool | None,
) -> FloatArray | None:
    """The values of a density that came with the vertices, None without."""
    if not isinstance(options.density, NodalDensity):
        return None
    n, origin = len(mesh.points), outcome.origin
    number = np.arange(n) if origin is None else old_numbers(origin, n)
    values = np.concatenate([options.density.values, np.ones(int((number >= n).sum()))])
    beside = np.zeros(len(values), dtype=np.int32)
    beside[frame.vertices] = density.walk_start(len(frame.vertices))
    cells = number[outcome.cells]
    old = cells.min(axis=1)
    near = np.full(len(values), -1, dtype=np.int32)
    near[cells] = np.where(old < n, old, -1)[:, None]
    added = np.arange(n, len(values))
    beside[added] = beside[near[added]]
    moved = number >= n
    moved[~moved] = (outcome.points[~moved] != mesh.points[number[~moved]]).any(axis=1)
    found = replace(density, power=1.0).at(
        frame.inside(outcome.points[moved]), pool, beside[number[moved]]
    )
    values[number[moved]] = found
    return values[number]


def keeps_sizes(options: Options) -> bool:
    """Whether the sizes of the input are asked for."""
    spec = options.density
    if isinstance(spec, NodalDensity):
        return spec.keeps
    return isinstance(spec, str) and spec == "keep"
