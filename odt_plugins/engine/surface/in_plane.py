"""Triangles in the plane whose rims and region borders slide: a surface with z = 0."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from odt_plugins.engine.cells.geometry import boundary_facets, signed_volumes
from odt_plugins.engine.ground.crossings import crossed_facets
from odt_plugins.engine.run import plan
from odt_plugins.engine.run.outcome import Leaving, Outcome, unchanged
from odt_plugins.engine.surface.driver import run_surface
from odt_plugins.engine.surface.rounds import check_method
from odt_plugins.mesh.arrays import FloatArray
from odt_plugins.mesh.simplex import SimplexMesh, with_same_cells
from odt_plugins.options import Options
from odt_plugins.promise.region_sizes import broken_sizes, other_sizes

IN_PLANE = [0, 1, 3]
"""Columns of xx, xy and yy among those of a metric in space."""


def run_any(mesh: SimplexMesh, options: Options, leaving: Leaving) -> Outcome:
    """Optimise a mesh of any kind by the engine for it; parameters as for the others."""
    if mesh.is_surface:
        return run_surface(mesh, options, leaving)
    if mesh.dim == 2 and options.boundary == "slide":
        return run_in_plane(mesh, options, leaving)
    return plan.run(mesh, options, leaving)


def run_in_plane(mesh: SimplexMesh, options: Options, leaving: Leaving) -> Outcome:
    """Optimise triangles in the plane, their rims and borders within the envelope.

    Parameters
    ----------
    mesh : SimplexMesh    triangles in the plane
    options : Options
    leaving : callable    applied to every state before it is judged

    Returns
    -------
    Outcome               triangles of positive area whose rims do not cross, in regions of the same
                          areas (0.3 %), at worst the input

    Raises
    ------
    InvalidOptionError    a method or solver that is not for rims that slide
    """
    check_method(options, "with boundary='slide' in the plane", ", or boundary='fixed'")
    held, whys = mesh, list[str]()
    for everywhere in (False, True):
        outcome = _slid(held, options, leaving)
        labels = [label for label, *_ in other_sizes(
            mesh, outcome.points, outcome.cells, outcome.regions)]
        if not labels:
            return _told(outcome, whys)
        whys += broken_sizes(mesh, outcome.points, outcome.cells, outcome.regions)
        fixed = held.fixed.copy()
        for label in np.unique(mesh.bodies()) if everywhere else labels:
            fixed[boundary_facets(mesh.cells[mesh.bodies() == label])] = True
        held = with_same_cells(held, fixed=fixed)
    return _told(_slid(held, options, leaving), whys)


def _told(outcome: Outcome, whys: list[str]) -> Outcome:
    """An outcome that says which borders stay, if some do."""
    if not whys or outcome.fallback is not None:
        return outcome
    return replace(outcome, fallback=f"some borders stay where they are, since {whys[0]}")


def _slid(mesh: SimplexMesh, options: Options, leaving: Leaving) -> Outcome:
    """Triangles whose rims and borders slid, at worst the input."""
    valid = mesh.valid_before and (in_space(mesh.valid_before[0]), mesh.valid_before[1])
    lifted = replace(mesh, points=in_space(mesh.points), metric=metric_in_space(mesh.metric),
                     valid_before=valid)
    density: Any = options.density
    if callable(density):
        options = replace(options, density=lambda x: density(x[:, :2]))

    def left(outcome: Outcome) -> Outcome:
        flat = leaving(replace(outcome, points=_flat(outcome.points)))
        return replace(flat, points=in_space(flat.points))

    outcome: Outcome = run_surface(lifted, options, left)
    points = _flat(outcome.points)
    spoiled = not (signed_volumes(points, outcome.cells) > 0.0).all()
    rims = boundary_facets(outcome.cells)
    if spoiled or (crossed_facets(points, rims) >= 0).any():
        why = "the input is returned, since its rims would cut through themselves"
        return replace(leaving(unchanged(mesh, outcome.stop_reason)), fallback=why)
    metric = outcome.metric[:, IN_PLANE[: mesh.metric.shape[1]]]
    return replace(outcome, points=points, metric=metric)


def in_space(points: FloatArray) -> FloatArray:
    """Points (n, 3): those of the plane with z = 0."""
    return np.ascontiguousarray(np.pad(points, ((0, 0), (0, 3 - points.shape[1]))))


def metric_in_space(metric: FloatArray) -> FloatArray:
    """Rows (n, 6): those of the plane, which see the third direction as it is."""
    if metric.shape[1] != 3:
        return metric
    out = np.zeros((len(metric), 6))
    out[:, IN_PLANE] = metric
    return out


def _flat(points: FloatArray) -> FloatArray:
    return np.ascontiguousarray(points[:, :2])
