"""Sizes for a mesh that was untangled: those of what stayed, spread over the rest."""

from __future__ import annotations

import math

import numpy as np

from odt_plugins.engine.cells.elementary import exp, log, power
from odt_plugins.engine.cells.geometry import signed_volumes
from odt_plugins.engine.odt.density import SMOOTHING_PASSES, NodalDensity, smooth_over_stars
from odt_plugins.engine.topology.star import star_sum
from odt_plugins.engine.untangle.energy import REGULAR
from odt_plugins.engine.untangle.harmonic import harmonic
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.simplex import SimplexMesh, determinant
from odt_plugins.promise.locked_facets import locked_facets


def kept_sizes(
    mesh: SimplexMesh, before: FloatArray, exponent: float | None = None
) -> NodalDensity | None:
    """The density "keep" of a mesh that was untangled, None where no cell inside stayed.

    Cells that were untangled have the sizes that this gave them by chance. So h is that of the
    cells that stayed; at other vertices of the boundary and of interfaces that of regular cells on
    the facets there; harmonic between these.

    Parameters
    ----------
    mesh : SimplexMesh               valid
    before : (k, d) float64          places before of the first k vertices; others came since
    exponent : float, optional       r in rho = h^-r, d + 2 unless given
    """
    points, cells, d = mesh.points, mesh.cells, mesh.dim
    n = len(points)
    held = np.zeros(n, dtype=np.bool_)
    held[:len(before)] = (points[:len(before)] == before).all(axis=1)
    stayed = cells[held[cells].all(axis=1)]
    facets = locked_facets(cells, mesh.bodies(), n).facets
    around, there = _at_vertices(_regular_sizes(points[facets]), facets, n)
    if there[stayed].all():
        return None
    size, known = _at_vertices(power(signed_volumes(points, stayed), 1.0 / d), stayed, n)
    size = smooth_over_stars(size, stayed, SMOOTHING_PASSES)
    size = np.where(known, size, around)
    used = np.zeros(n, dtype=np.bool_)
    used[cells] = True
    free = np.flatnonzero(used & ~known & ~there)
    size[free] = harmonic(size[:, None], cells, free)[:, 0]
    size[used] -= size[used].mean()
    return NodalDensity(exp(size), -float(d + 2 if exponent is None else exponent), keeps=True)


def _at_vertices(sizes: FloatArray, simplices: IntArray, n: int) -> tuple[FloatArray, BoolArray]:
    """Logarithms (n,) of the mean size of the simplices around, else 0; where any are."""
    count = star_sum(np.ones(len(simplices)), simplices, n)
    known = count > 0
    out = np.zeros(n)
    mean = star_sum(sizes, simplices, n)[known] / count[known]
    out[known] = log(np.maximum(mean, np.finfo(np.float64).tiny))
    return out, known


def _regular_sizes(corners: FloatArray) -> FloatArray:
    """Sizes |tau|^(1/d) (k,) of regular cells on facets (k, d, d)."""
    d = corners.shape[1]
    sides = corners[:, 1:] - corners[:, :1]
    if d == 2:
        edge = np.sqrt((sides[:, 0] ** 2).sum(axis=1))
    else:
        normal = np.cross(sides[:, 0], sides[:, 1])
        edge = np.sqrt(np.sqrt((normal**2).sum(axis=1)) / math.sqrt(0.75))
    return np.asarray(edge * (float(determinant(REGULAR[d])) / math.factorial(d)) ** (1.0 / d))
