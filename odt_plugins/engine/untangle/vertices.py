"""Vertices inserted where neither places nor flips help: few, so in plain Python.

Around an inverted cell a cavity is grown until it is star-shaped: until all its facets face a place
in it, which a linear program finds, as far inside of all of them as can be (by the dual simplex of
HiGHS, which does without BLAS). Cells are added across
the facets that keep the place from being better.

References
----------
D. F. Watson, Computing the n-dimensional Delaunay tessellation with application to Voronoi
polytopes, Comput. J. 24 (1981) 167-172: cavities filled from a vertex.
B. M. Klingner, J. R. Shewchuk, Aggressive tetrahedral mesh improvement, 16th International Meshing
Roundtable (2007) 3-23, Section 3.3: their growth.
"""

from __future__ import annotations

from collections import Counter
from itertools import combinations
from typing import NamedTuple

import numpy as np

from odt_plugins.engine.topology.adjacency import cell_neighbors
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray, LongArray
from odt_plugins.mesh.simplex import SimplexMesh, determinant

LARGEST_CAVITY = 32
"""Cells at which a cavity stops growing."""

FEW = 1000
"""Most inverted or flat cells: more are no matter of single vertices."""

IN_VAIN = 10
"""Cells one after another around which no cavity is found: the others are left, each would take
hundreds of linear programs."""

LEAST_DEPTH = 1e-6
"""How far from all facets of a cavity its vertex is at least, in units of half its extent."""

Facet = tuple[int, int]
"""A cell, and the local vertex across from the facet."""


class Cavity(NamedTuple):
    """Cells, the facets around them, the place of a new vertex, its distance from the facets."""

    cells: list[int]
    facets: list[Facet]
    place: FloatArray
    depth: float


class Inserted(NamedTuple):
    """A mesh with vertices more.

    Attributes
    ----------
    points : (n + k, d) float64    new ones last
    cells : (m', d + 1) int32
    source : (m',) int64           a cell of the same region, the same one where it is still there
    """

    points: FloatArray
    cells: IntArray
    source: LongArray


def inserted(points: FloatArray, mesh: SimplexMesh, bad: BoolArray, most: int) -> Inserted | None:
    """Fill cavities around inverted or flat cells from new vertices; frozen cells stay.

    Parameters
    ----------
    points : (n, d) float64    where the vertices of the mesh are now
    mesh : SimplexMesh         of cells that agree about their orientation
    bad : (m,) bool            inverted or flat ones
    most : int                 most vertices that may come

    Returns
    -------
    Inserted                   with all cavities that were found, which do not overlap and are of
                               one region each; None where none was found
    """
    neighbors = cell_neighbors(mesh.cells)
    taken = mesh.frozen.copy()
    found: list[Cavity] = []
    numbers = np.flatnonzero(bad).tolist()
    in_vain = 0
    for number in numbers if len(numbers) <= FEW else []:
        if len(found) >= most or in_vain == IN_VAIN:
            break
        if taken[number]:
            continue
        cavity = _grown(points, mesh, neighbors, taken, number)
        if cavity is None:
            in_vain += 1
        else:
            in_vain = 0
            taken[cavity.cells] = True
            found.append(cavity)
    return _filled(points, mesh, found) if found else None


def _grown(
    points: FloatArray, mesh: SimplexMesh, neighbors: IntArray, taken: BoolArray, number: int
) -> Cavity | None:
    """The first cavity around a cell that is deep enough, if there is one; none around a point."""
    if not np.ptp(points[mesh.cells[number]], axis=0).any():
        return None
    now = _cavity(points, mesh.cells, neighbors, [number])
    while now.depth <= LEAST_DEPTH:
        larger = []
        for cell in sorted({int(neighbors[facet]) for facet in _binding(points, mesh.cells, now)}):
            if cell >= 0 and not taken[cell] and mesh.regions[cell] == mesh.regions[number]:
                cavity = _cavity(points, mesh.cells, neighbors, [*now.cells, cell])
                if _is_closed(mesh.cells, cavity):
                    larger.append(cavity)
        if not larger or len(now.cells) == LARGEST_CAVITY:
            return None
        now = max(larger, key=lambda cavity: cavity.depth)
    return now


def _cavity(points: FloatArray, cells: IntArray, neighbors: IntArray, numbers: list[int]) -> Cavity:
    """The place that is deepest in some cells: a linear program in its coordinates and depth."""
    from scipy.optimize import linprog

    facets = [(c, f) for c in numbers for f in range(cells.shape[1])
              if neighbors[c, f] not in numbers]
    centre, size = _frame(points, cells, numbers)
    normals, offsets = _planes(points, cells, facets, centre, size)
    d = points.shape[1]
    found = linprog(np.append(np.zeros(d), -1.0), np.column_stack([-normals, np.ones(len(facets))]),
                    offsets, bounds=[(-1.0, 1.0)] * d + [(None, 1.0)], method="highs-ds")
    if found.x is None:
        return Cavity(numbers, facets, centre, -np.inf)
    return Cavity(numbers, facets, found.x[:d] * size + centre, float(found.x[d]))


def _frame(points: FloatArray, cells: IntArray, numbers: list[int]) -> tuple[FloatArray, float]:
    """Middle and half the extent of some cells."""
    corners = points[cells[numbers].ravel()]
    low, high = corners.min(axis=0), corners.max(axis=0)
    return 0.5 * (low + high), 0.5 * float((high - low).max())


def _planes(
    points: FloatArray, cells: IntArray, facets: list[Facet], centre: FloatArray, size: float
) -> tuple[FloatArray, FloatArray]:
    """Unit normals into the cells of facets, and their distances from the centre."""
    d = points.shape[1]
    rows, local = (np.array(part) for part in zip(*facets, strict=True))
    corners = (points[cells[rows]] - centre) / size
    volumes = []
    for place in (np.zeros(d), *np.eye(d)):
        corners[np.arange(len(rows)), local] = place
        volumes.append(determinant(np.moveaxis(corners[:, 1:] - corners[:, :1], 0, -1)))
    normals = np.column_stack(volumes[1:]) - volumes[0][:, None]
    length = np.sqrt((normals * normals).sum(axis=1))
    length[length == 0.0] = 1.0
    return normals / length[:, None], volumes[0] / length


def _binding(points: FloatArray, cells: IntArray, cavity: Cavity) -> list[Facet]:
    """Facets of a cavity that are as near to its place as the nearest one."""
    centre, size = _frame(points, cells, cavity.cells)
    normals, offsets = _planes(points, cells, cavity.facets, centre, size)
    away = (normals * ((cavity.place - centre) / size)).sum(axis=1) + offsets
    near = away <= away.min() + LEAST_DEPTH
    return [facet for facet, is_near in zip(cavity.facets, near, strict=True) if is_near]


def _is_closed(cells: IntArray, cavity: Cavity) -> bool:
    """Whether two facets meet wherever facets meet, and no vertex lies behind all of them."""
    facets = [sorted(v for i, v in enumerate(cells[c].tolist()) if i != f)
              for c, f in cavity.facets]
    ridges = Counter(ridge for facet in facets for ridge in combinations(facet, len(facet) - 1))
    inside = set(cells[cavity.cells].ravel().tolist()).difference(*facets)
    return not inside and set(ridges.values()) == {2}


def _filled(points: FloatArray, mesh: SimplexMesh, cavities: list[Cavity]) -> Inserted:
    """The mesh with the facets of cavities joined to their places."""
    gone = [c for cavity in cavities for c in cavity.cells]
    kept = np.delete(np.arange(len(mesh.cells)), gone)
    cells, source = [mesh.cells[kept]], [kept]
    for vertex, cavity in enumerate(cavities, len(points)):
        rows, local = (np.array(part) for part in zip(*cavity.facets, strict=True))
        made = mesh.cells[rows]
        made[np.arange(len(rows)), local] = vertex
        cells.append(made)
        source.append(rows)
    places = np.array([cavity.place for cavity in cavities])
    return Inserted(np.concatenate([points, places]), np.concatenate(cells), np.concatenate(source))
