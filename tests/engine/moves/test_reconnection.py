"""Reconnection: polyhedra are filled at least cost, within the bounds, and nothing else changes."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
import tet_meshes as tm
from complexes import OPEN, assert_sound, complex_of, contents
from scipy.spatial import Delaunay

from odt_plugins.engine.cells.cost import Cost
from odt_plugins.engine.cells.extremes import Bounds, Extremes
from odt_plugins.engine.cells.measures import QUALITY
from odt_plugins.engine.finish.phases import Phase
from odt_plugins.engine.finish.volume import finish
from odt_plugins.engine.moves.reconnection import reconnection_pass


def run_pass(mesh, power=4.0, bounds=OPEN, order=None):
    if order is None:
        live = mesh.live()
        order = live[np.argsort(tm.quality(mesh.points, mesh.cells[live]), kind="stable")]
    return reconnection_pass(mesh.tets, order.astype(np.int32), Cost(QUALITY, power), bounds)


def fillings(points, outside):
    """All ways to fill a polyhedron with cells between its vertices, by exhaustion.

    Parameters
    ----------
    outside : set of frozenset    its facets
    """
    cells = [c for c in map(list, combinations(range(len(points)), 4))
             if abs(np.linalg.det(points[c[1:]] - points[c[0]])) > 1e-9]
    rng = np.random.default_rng(0)
    samples = rng.dirichlet(np.ones(len(points)), 3000) @ points
    inside = []
    for c in cells:
        weights = np.linalg.solve(
            np.vstack([points[c].T, np.ones(4)]), np.vstack([samples.T, np.ones(len(samples))])
        )
        inside.append(frozenset(np.flatnonzero((weights > 0.0).all(axis=0))))
    found = []

    def fill(chosen, covered):
        left = next((s for s in range(len(samples)) if s not in covered), None)
        if left is None:
            facets = [frozenset(f) for k in chosen for f in combinations(cells[k], 3)]
            if {f for f in facets if facets.count(f) == 1} == outside:
                found.append(np.array([cells[k] for k in chosen]))
            return
        for k in range(len(cells)):
            if left in inside[k] and not inside[k] & covered:
                fill([*chosen, k], covered | inside[k])

    fill([], frozenset())
    return found


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_a_convex_polyhedron_gets_the_best_of_all_its_fillings(seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(7, 3))
    points /= np.linalg.norm(points, axis=1)[:, None]
    start = Delaunay(points).simplices
    facets = [frozenset(f) for cell in start.tolist() for f in combinations(cell, 3)]
    ways = fillings(points, {f for f in facets if facets.count(f) == 1})
    assert len(ways) > 3
    costs = [tm.cost(points, tm.oriented(points, way), 4.0).sum() for way in ways]
    worst = tm.oriented(points, ways[int(np.argmax(costs))]).astype(np.int32)
    mesh = complex_of(points, worst)
    assert run_pass(mesh, order=np.array([0])) == 1
    after = mesh.mesh_arrays()[0]
    assert tm.cost(points, after, 4.0).sum() == pytest.approx(min(costs), rel=1e-9)
    assert_sound(mesh, points, tm.signed_volumes(points, worst).sum())


@pytest.mark.parametrize("seed", [4, 5])
def test_what_is_filled_anew_lowers_the_sum_and_moves_nothing(seed):
    points, cells = tm.ball(300, seed)
    mesh = complex_of(points, cells)
    volume = tm.signed_volumes(points, cells).sum()
    assert run_pass(mesh) > 5
    after = mesh.mesh_arrays()[0]
    assert tm.cost(points, after, 4.0).sum() < tm.cost(points, cells, 4.0).sum()
    assert np.array_equal(mesh.points, points)
    assert np.array_equal(np.unique(after), np.unique(cells))
    assert_sound(mesh, points, volume)
    while run_pass(mesh):
        pass
    before = contents(mesh)
    assert run_pass(mesh) == 0
    assert contents(mesh) == before


def test_no_new_cell_passes_the_bounds():
    points, cells = tm.ball(300, 5)
    angles = tm.dihedral_angles(points, cells)
    least, smallest, largest = 0.3, np.quantile(angles.min(axis=1), 0.2), 150.0
    bound = Extremes(least, np.cos(np.radians(smallest)), np.cos(np.radians(largest)))
    mesh = complex_of(points, cells)
    assert run_pass(mesh, bounds=Bounds(bound, bound)) > 0
    q, now = tm.quality(points, cells), mesh.mesh_arrays()[0]
    for better, before, after in (
        (least, q, tm.quality(points, now)),
        (smallest, angles.min(axis=1), tm.dihedral_angles(points, now).min(axis=1)),
        (-largest, -angles.max(axis=1), -tm.dihedral_angles(points, now).max(axis=1)),
    ):
        assert (after < better).sum() <= (before < better).sum()


def test_it_goes_where_flips_alone_do_not():
    points, cells = tm.ball(300, 6)
    mesh = complex_of(points, cells)
    while finish(mesh, (Phase(4.0, 1.0, 20, 0),), OPEN, None, 1)[0]:
        pass
    flipped = tm.cost(points, mesh.mesh_arrays()[0], 4.0).sum()
    assert run_pass(mesh) > 0
    assert tm.cost(points, mesh.mesh_arrays()[0], 4.0).sum() < flipped


def test_regions_keep_their_facets():
    points, cells = tm.ball(500, 7)
    regions = (points[cells].mean(axis=1)[:, 0] > 0.0).astype(np.int32)
    mesh = complex_of(points, cells, regions)

    def interface(some, labels):
        facets = {}
        for cell, label in zip(some.tolist(), labels, strict=True):
            for facet in combinations(sorted(cell), 3):
                facets.setdefault(facet, set()).add(int(label))
        return {facet for facet, sides in facets.items() if len(sides) == 2}

    assert run_pass(mesh) > 5
    assert interface(*mesh.mesh_arrays()) == interface(cells, regions)
