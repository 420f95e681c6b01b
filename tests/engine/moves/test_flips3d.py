"""Flips in space: energy and cost fall, adjacency stays right, the best ring is found."""

from __future__ import annotations

import numpy as np
import pytest
import tet_meshes as tm
from complexes import OPEN, assert_sound, complex_of, extremes_of, free_slots

from odt_plugins.engine.cells import sphere
from odt_plugins.engine.cells.corner import corner_edges
from odt_plugins.engine.cells.cost import ENERGY, Cost
from odt_plugins.engine.cells.extremes import Bounds
from odt_plugins.engine.cells.measures import QUALITY, tet_cost
from odt_plugins.engine.cells.tetrahedron import tet_cosines, tet_energy, tet_quality
from odt_plugins.engine.compiled.threads import thread_pool
from odt_plugins.engine.moves import cavity, flips3d, passes
from odt_plugins.engine.moves.compound import compound_pass
from odt_plugins.engine.moves.passes import flip_pending
from odt_plugins.engine.moves.reconnection import reconnection_pass
from odt_plugins.engine.topology.active import PENDING
from odt_plugins.engine.topology.complex import renumbered


@pytest.mark.usefixtures("nothing_compiled")
@pytest.mark.parametrize("seed", [3, 4, 5])
def test_energy_falls_at_every_flip_in_space_and_stuck_cells_remain(seed):
    points, cells = tm.grid(4, seed)
    mesh = complex_of(points, cells)
    volume = tm.signed_volumes(points, cells).sum()
    last = tm.energy(points, cells)
    boundary = {f for f, owners in tm.facets_of(cells).items() if len(owners) == 1}
    flips = 0
    for _ in range(20):
        mesh.status[:] = 1
        done = flip_pending(mesh, Cost(ENERGY, 1.0), 7, OPEN, 1)
        now = tm.energy(points, mesh.mesh_arrays()[0])
        assert (now < last) == (done > 0)
        assert_sound(mesh, points, volume)
        last = now
        flips += done
        if done == 0:
            break
    else:
        pytest.fail("flipping did not end")
    assert flips > 20
    after = mesh.mesh_arrays()[0]
    assert boundary == {f for f, owners in tm.facets_of(after).items() if len(owners) == 1}
    stuck = sum(
        sphere.inside_sphere(points, after, a, int(np.setdiff1d(after[b], after[a])[0]),
                             *sphere.circumsphere(points, *after[a]))
        for f, (a, b) in ((f, o) for f, o in tm.facets_of(after).items() if len(o) == 2)
    )
    assert 0 <= stuck < 0.05 * len(after)


@pytest.mark.parametrize("power", [0.5, 1.0, 4.0])
def test_cost_falls_and_the_mesh_stays_sound(power):
    points, cells = tm.ball(300, 8)
    mesh = complex_of(points, cells)
    volume = tm.signed_volumes(points, cells).sum()

    before = tm.cost(points, cells, power).sum()
    mesh.status[:] = 1
    assert flip_pending(mesh, Cost(QUALITY, power), 10, OPEN, 20) > 0
    after = mesh.mesh_arrays()[0]
    assert tm.cost(points, after, power).sum() < before
    assert_sound(mesh, points, volume)


def test_interfaces_stay():
    points, cells = tm.grid(4, 9)
    regions = (points[cells].mean(axis=1)[:, 0] > 2).astype(np.int32)
    labels = lambda c, r: {  # noqa: E731
        f for f, o in tm.facets_of(c).items() if len(o) == 2 and r[o[0]] != r[o[1]]
    }
    before = labels(cells, regions)
    mesh = complex_of(points, cells, regions)
    mesh.status[:] = 1
    assert flip_pending(mesh, Cost(ENERGY, 1.0), 7, OPEN, 20) > 0
    after, new_regions = mesh.mesh_arrays()
    assert labels(after, new_regions) == before
    for label in (0, 1):
        assert tm.signed_volumes(points, after[new_regions == label]).sum() == pytest.approx(
            tm.signed_volumes(points, cells[regions == label]).sum(), rel=1e-12
        )


def all_triangulations(polygon):
    """Every triangulation of a polygon, as lists of index triples."""
    if len(polygon) < 3:
        return [[]]
    first, last = polygon[0], polygon[-1]
    found = []
    for m in range(1, len(polygon) - 1):
        for left in all_triangulations(polygon[: m + 1]):
            for right in all_triangulations(polygon[m:]):
                found.append([*left, (first, polygon[m], last), *right])
    return found


@pytest.mark.usefixtures("kernels_in_python")
@pytest.mark.parametrize("n", [3, 4, 5, 6, 7, 8])
def test_ring_triangulation_is_the_best_of_all(n):
    rng = np.random.default_rng(n)
    angle = 2 * np.pi * (np.arange(n) + 0.3 * rng.random(n)) / n
    ring = np.column_stack([np.cos(angle), np.sin(angle), 0.2 * rng.normal(size=n)])
    points = np.vstack([[0, 0, -0.9], [0, 0, 1.1], ring])
    room = cavity.make_ring(np.empty(0), False)
    room.vertices[:n] = np.arange(2, n + 2)

    def least_below(limit):
        return cavity.triangulate_ring(points, 0, 1, n, Cost(QUALITY, 2.0), limit, room)

    def cost(triangles):
        cells = np.array([c for i, j, k in triangles for c in ((0, i, j, k), (i, j, k, 1))])
        if (tm.signed_volumes(points, cells) <= 0).any():
            return np.inf
        return tm.cost(points, cells, 2.0).sum()

    expected = min(cost(t) for t in all_triangulations(list(range(2, n + 2))))
    assert least_below(np.inf) == pytest.approx(expected, rel=1e-9)
    none = least_below(expected)
    assert none == np.inf or none < expected
    assert least_below(expected * 1.001) == pytest.approx(expected, rel=1e-9)
    count = cavity.write_ring(0, 1, n, room)
    assert count == 2 * (n - 2)
    assert tm.cost(points, room.new[:count], 2.0).sum() == pytest.approx(expected, rel=1e-9)


def test_no_cell_beyond_the_bounds_unless_it_replaces_a_worse_one():
    points, cells = tm.ball(300, 12)
    q, angles = tm.quality(points, cells), tm.dihedral_angles(points, cells)
    before = extremes_of(points, cells)
    bounds = Bounds(before, before)
    mesh = complex_of(points, cells)
    mesh.status[:] = 1
    flip_pending(mesh, Cost(QUALITY, 1.0), 10, bounds, 20)
    after = mesh.mesh_arrays()[0]
    assert tm.quality(points, after).min() >= q.min() - 1e-12
    now = tm.dihedral_angles(points, after)
    assert now.min() >= angles.min() - 1e-7
    assert now.max() <= angles.max() + 1e-7


@pytest.mark.parametrize("count", [0, 20, 100_000])
def test_more_cells_come_and_none_is_poorer_than_allowed(count):
    points, cells = tm.ball(300, 8)
    mesh = complex_of(points, cells)
    volume = tm.signed_volumes(points, cells).sum()
    made = passes.more_cells(mesh, count, OPEN.with_quality(0.25))
    now, _ = mesh.mesh_arrays()
    assert len(now) == len(cells) + made
    assert made == count if count < 100 else 20 < made < count
    assert_sound(mesh, points, volume)
    known = {tuple(sorted(row)) for row in cells.tolist()}
    new = np.array([tuple(sorted(row)) not in known for row in now.tolist()])
    assert new.sum() >= made
    if made:
        assert tm.quality(points, now[new]).min() > 0.25 - 1e-9


def test_a_complex_without_room_grows():
    points, cells = tm.grid(4, 3)
    mesh = complex_of(points, cells)
    m = len(cells)
    for name in ("cells", "neighbors", "regions", "status", "free"):
        setattr(mesh, name, getattr(mesh, name)[:m].copy())
    mesh.status[:] = 1
    flip_pending(mesh, Cost(ENERGY, 2.0), 10, OPEN, 30)
    assert_sound(mesh, points, tm.signed_volumes(points, cells).sum())


@pytest.mark.usefixtures("nothing_compiled")
@pytest.mark.parametrize("seed", range(4))
def test_scalar_measures_agree_with_numpy(seed):
    points, cells = tm.ball(40, seed)
    q = tm.quality(points, cells)
    angles = tm.dihedral_angles(points, cells)
    for c, cell in enumerate(cells):
        edges = corner_edges(points, *cell)
        turned = corner_edges(points, *cell[[1, 0, 2, 3]])
        assert tet_quality(points, *cell) == pytest.approx(q[c], rel=1e-9)
        assert tet_quality(points, *cell[[1, 0, 2, 3]]) == pytest.approx(-q[c], rel=1e-9)
        large, small = tet_cosines(edges)
        assert large == pytest.approx(np.cos(np.radians(angles[c].min())), abs=1e-9)
        assert small == pytest.approx(np.cos(np.radians(angles[c].max())), abs=1e-9)
        for power in (0.5, 1.0, 2.0, 3.0, 4.0, 8.0):
            assert tet_cost(points, *cell, Cost(QUALITY, power)) == pytest.approx(
                tm.cost(points, cell[None], power)[0], rel=1e-9
            )
        assert tet_energy(edges) == pytest.approx(20.0 * tm.energy(points, cell[None]), rel=1e-9)
        assert tet_energy(turned) == np.inf


@pytest.mark.usefixtures("nothing_compiled")
def test_in_sphere_agrees_with_the_circumcenter():
    rng = np.random.default_rng(21)
    for _ in range(100):
        points = rng.normal(size=(5, 3))
        if np.linalg.det(points[1:4] - points[0]) < 0:
            points[[0, 1]] = points[[1, 0]]
        edges = points[1:4] - points[0]
        center = points[0] + np.linalg.solve(2 * edges, (edges**2).sum(axis=1))
        outside = np.linalg.norm(points[4] - center) > np.linalg.norm(points[0] - center)
        assert sphere.inside_sphere(
            points, np.arange(4, dtype=np.int32)[None], 0, 4,
            *sphere.circumsphere(points, 0, 1, 2, 3)
        ) == (not outside)


@pytest.mark.parametrize("labels", [1, 2])
def test_marked_cells_own_the_facets_that_are_not_delaunay(labels):
    points, cells = tm.grid(4, 17)
    regions = np.random.default_rng(2).integers(labels, size=len(cells)).astype(np.int32)
    mesh = complex_of(points, cells, regions)
    mesh.cells[5, 0] = -1
    bad = set()
    for facet, owners in tm.facets_of(cells).items():
        if len(owners) == 2 and 5 not in owners and regions[owners[0]] == regions[owners[1]]:
            a, b = sorted(owners)
            corners = points[cells[a]]
            edges = corners[1:] - corners[0]
            center = corners[0] + np.linalg.solve(2 * edges, (edges**2).sum(axis=1))
            apex = points[next(v for v in cells[b] if v not in facet)]
            if np.linalg.norm(apex - center) < np.linalg.norm(corners[0] - center) * (1 - 1e-9):
                bad.add(a)
    n = len(cells)
    mesh.neighbors[mesh.neighbors == 5] = -1
    for cut in (n, n // 3):
        mesh.status[:] = 0
        arrays = (points, mesh.cells, mesh.neighbors, mesh.regions, mesh.status)
        count = sphere.mark_non_delaunay(*arrays, 0, cut)
        count += sphere.mark_non_delaunay(*arrays, cut, n)
        assert set(np.flatnonzero(mesh.status).tolist()) == bad
        assert count == len(bad) > 20


def test_cells_come_worst_first_within_blocks_of_slots():
    rng = np.random.default_rng(4)
    slots = np.flatnonzero(rng.random(100_000) < 0.4).astype(np.int32)
    slots = slots[(slots < 20_000) | (slots > 60_000)]
    q = rng.integers(0, 50, len(slots)) / 50.0
    of_slot = np.zeros(slots.max() + 1)
    of_slot[slots] = q
    order = slots.copy()
    passes.worst_first(order, of_slot.__getitem__, None)
    assert np.array_equal(order, slots[np.lexsort((q, slots >> passes.BLOCK_BITS))])
    assert not np.array_equal(order, slots[np.argsort(q, kind="stable")])
    threaded = slots.copy()
    with thread_pool(2) as pool:
        passes.worst_first(threaded, of_slot.__getitem__, pool)
    assert np.array_equal(order, threaded)
    passes.worst_first(slots[:0], of_slot.__getitem__, None)


@pytest.mark.usefixtures("nothing_compiled")
@pytest.mark.parametrize("objective", [ENERGY, QUALITY])
def test_remembered_costs_are_those_of_the_cells(objective):
    points, cells = tm.grid(5, 12)
    meshes = [complex_of(points, cells) for _ in range(2)]
    remembered = np.full(len(meshes[0].cells), cavity.UNKNOWN)
    cost = Cost(objective, 1.0)
    counts = []
    for _ in range(3):
        flips = []
        for mesh, costs in zip(meshes, (remembered, np.empty(0)), strict=True):
            order = mesh.live().astype(np.int32)
            mesh.status[:] = PENDING
            flips.append(
                flips3d.flip_pass(mesh.tets, order, cost, 10, OPEN, costs, len(costs) > 0)
            )
        assert flips[0] == flips[1]
        counts.append(flips[0])
        assert np.array_equal(meshes[0].cells, meshes[1].cells)
        known = [c for c in meshes[0].live() if remembered[c] != cavity.UNKNOWN]
        assert len(known) > 20
        for c in known:
            assert remembered[c] == tet_cost(points, *meshes[0].cells[c], cost)
    assert counts[0] > 0


def test_renumbered_cells_are_the_same_mesh_in_order():
    points, cells = tm.ball(300, 5)
    regions = (points[cells].mean(axis=1)[:, 0] > 0).astype(np.int32)
    mesh = complex_of(points, cells, regions)
    mesh.status[:] = PENDING
    assert flip_pending(mesh, Cost(QUALITY, 2.0), 10, OPEN, 20) > 0
    assert len(free_slots(mesh)) > 0
    fresh = renumbered(mesh)
    assert len(free_slots(fresh)) == 0
    labels = [{tuple(cell): label for cell, label in zip(c.tolist(), r.tolist(), strict=True)}
              for c, r in (mesh.mesh_arrays(), fresh.mesh_arrays())]
    assert labels[0] == labels[1]
    assert np.all(np.diff(fresh.mesh_arrays()[0].min(axis=1)) >= 0)
    assert_sound(fresh, points, tm.signed_volumes(points, cells).sum())


@pytest.mark.usefixtures("kernels_in_python")
def test_two_cells_of_the_same_vertices_stay_next_to_each_other_at_the_same_facets():
    """Where all is flat, two cells of the same four vertices may share two facets."""
    before = np.array([[0, 1, 2, 3], [0, 1, 2, 4], [0, 1, 3, 4]], dtype=np.int32)
    between = np.array([[0, 1, 2, 3], [0, 2, 3, 4], [1, 2, 3, 4]], dtype=np.int32)
    mesh = complex_of(np.zeros((5, 3)), before)
    slots = np.array([1, 2, 0], dtype=np.int32)
    journal = cavity.make_journal(np.bool_(False), np.int64(0))
    border = np.zeros((16, 5), dtype=np.int32)

    def facets():
        return sorted(
            [sorted(np.delete(mesh.cells[c], f).tolist()),
             [sorted(mesh.cells[s].tolist()) for s in (c, mesh.neighbors[c, f]) if s >= 0]]
            for c in mesh.live() for f in range(4))

    start = facets()
    assert cavity.replace_cavity(mesh.tets, slots, 2, between, 3, border, journal)
    assert np.count_nonzero(mesh.neighbors[0] == slots[0]) == 2
    assert cavity.replace_cavity(mesh.tets, slots, 3, before[:0:-1].copy(), 2, border, journal)
    assert facets() == start


@pytest.mark.parametrize("seed", range(8))
def test_nothing_leads_to_cells_that_went_where_cells_are_inverted(seed):
    rng = np.random.default_rng(seed)
    points, cells = tm.ball(40, seed)
    mesh = complex_of(points, cells)
    for step in range(6):
        mesh.points[:] = points + rng.normal(size=points.shape) * 0.05 * step
        tried = np.zeros(len(mesh.cells), dtype=bool)
        for work, options in ((compound_pass, (10, OPEN, tried)), (reconnection_pass, (OPEN,))):
            mesh.status[:] = 0
            order = np.argsort(passes.measures(mesh, QUALITY), kind="stable")[:60]
            work(mesh.tets, order.astype(np.int32), Cost(QUALITY, 4.0), *options)
        mesh.status[:] = PENDING
        flip_pending(mesh, Cost(QUALITY, 1.0), 10, OPEN, 3)
        live = mesh.live()
        for c in live:
            for f, across in enumerate(mesh.neighbors[c]):
                if across >= 0:
                    assert mesh.cells[across, 0] >= 0
                    shared = set(np.delete(mesh.cells[c], f)) & set(mesh.cells[across])
                    assert len(shared) == 3
                    assert c in mesh.neighbors[across]
