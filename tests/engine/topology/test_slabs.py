"""Slabs: cut and healed adjacency, independence of the slabs, the same bits in any order."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import tet_meshes as tm
from complexes import OPEN, assert_sound, complex_of, free_slots

from odt_plugins.engine.cells.cost import ENERGY, Cost
from odt_plugins.engine.cells.measures import QUALITY
from odt_plugins.engine.compiled import threads
from odt_plugins.engine.finish.phases import Phase
from odt_plugins.engine.finish.volume import compound_moves
from odt_plugins.engine.moves.passes import flip_pending
from odt_plugins.engine.topology import order, slabs
from odt_plugins.engine.topology.active import PENDING
from odt_plugins.engine.topology.tets import USED


class Backwards:
    """A pool that takes the last task first."""

    def map(self, work, *arguments):
        tasks = list(zip(*arguments, strict=True))
        return [work(*task) for task in tasks[::-1]][::-1]


@pytest.fixture(autouse=True)
def thin(monkeypatch):
    monkeypatch.setattr(order, "LAYERS", 2)
    monkeypatch.setattr(slabs, "WORTH", 0.0)


def start(regions=1):
    points, cells = tm.grid(9, 3)
    labels = (points[cells].mean(axis=1)[:, 1] > 9 / regions).astype(np.int32)
    mesh = complex_of(points, cells, labels)
    mesh.locked[:] = mesh.boundary
    return mesh


def contents(mesh):
    used = mesh.used
    return [mesh.slots.tolist(), free_slots(mesh).tolist(), mesh.points.tobytes(),
            mesh.cells[:used].tolist(), mesh.neighbors[:used].tolist()]


def test_slabs_are_equal_shares_across_the_longest_axis_and_the_second_ones_half_a_slab_on():
    rng = np.random.default_rng(7)
    points = rng.uniform(size=(1000, 3)) * [1.0, 5.0, 2.0]
    first, second = order.make_slabs(points)
    assert np.bincount(first).tolist() == [250] * 4
    assert np.bincount(second).tolist() == [125, 250, 250, 250, 125]
    by_height = np.argsort(points[:, 1])
    assert np.all(np.diff(first[by_height].astype(int)) >= 0)
    assert np.all(np.diff(second[by_height].astype(int)) >= 0)
    assert not order.make_slabs(points[:60]).any()


def test_walls_are_the_facets_between_slabs_and_heal():
    mesh = start()
    rng = np.random.default_rng(5)
    slab = rng.integers(3, size=len(mesh.points)).astype(np.uint8)
    cells = mesh.mesh_arrays()[0]
    before = mesh.neighbors.copy()
    cut = np.zeros(len(mesh.points), dtype=bool)
    middle = -(-mesh.used // 2)
    parts = [(middle, mesh.used), (0, middle)]
    counts = [slabs.cut_walls(mesh.cells, mesh.neighbors, slab, cut, *part) for part in parts]
    home = slab[cells].min(axis=1)
    expected = [facet for facet, owners in tm.facets_of(cells).items()
                if len(owners) == 2 and home[owners[0]] != home[owners[1]]]
    assert sum(counts) == len(expected) > 100
    assert min(counts) > 10
    assert set(np.flatnonzero(cut)) == {v for f in expected for v in f}
    codes, count = np.unique(mesh.neighbors[mesh.neighbors < -1], return_counts=True)
    sides = [8 * first + side for (first, _), found in zip(parts, counts, strict=True)
             for side in range(2 * found)]
    assert (-2 - codes).tolist() == sorted(sides, reverse=True)
    assert np.all(count == 1)
    wall = np.cumsum([0, *counts[::-1]])
    ends = np.zeros((wall[-1], 2), dtype=np.int64)
    for part in parts:
        slabs.find_walls(mesh.cells, mesh.neighbors, wall, 4 * middle, ends, *part)
    slabs.heal_walls(mesh.neighbors, ends)
    assert np.array_equal(mesh.neighbors, before)


def test_every_cell_is_visited_once_and_in_order():
    mesh = start()
    mesh.cells[7, 0] = -1
    mesh.neighbors[mesh.neighbors == 7] = -1
    visits = np.random.default_rng(1).permutation(len(mesh.live()) + 1).astype(np.int32)
    seen = []

    def work(part, tets):
        rank = np.argsort(visits)[part]
        assert np.all(np.diff(rank) > 0)
        assert tets.slots[USED] <= len(tets.cells) <= len(mesh.cells)
        seen.append(part.tolist())
        return len(part)

    assert slabs.side_by_side(mesh, visits, None, work) == len(visits) - 1
    assert sorted(c for part in seen for c in part) == mesh.live().tolist()
    assert len(seen) >= 4


def test_slabs_that_run_when_one_is_interrupted_stop_at_their_next_piece():
    mesh = start()
    tasks = []

    class Interrupted:
        def map(self, work, *arguments):
            calls = list(zip(*arguments, strict=True))
            if len(arguments) > 1:
                return [work(*call) for call in calls]
            tasks.extend((work, *call) for call in calls)
            raise KeyboardInterrupt

    seen = []
    visits = mesh.live().astype(np.int32)
    with pytest.raises(KeyboardInterrupt):
        slabs.side_by_side(mesh, visits, Interrupted(), lambda part, *_: seen.append(part) or 0)
    assert len(tasks) > 1
    for work, k in tasks:
        assert work(k) == 0
    assert not seen


def test_work_ends_where_it_no_longer_pays(monkeypatch):
    monkeypatch.setattr(slabs, "TRIES", 10)
    monkeypatch.setattr(slabs, "WORTH", 1.0)
    mesh = start()
    visits = mesh.live().astype(np.int32)
    seen = []

    def work(part, tets):
        gain = int((part < 10).sum())
        seen.extend(part)
        return gain

    for length in (3, 100):
        monkeypatch.setattr(threads, "COSTLY", length)
        seen.clear()
        assert slabs.side_by_side(mesh, visits, None, work, costly=True, rare=0.5) == 10
        assert seen == visits[:30].tolist()
    seen.clear()
    assert slabs.side_by_side(mesh, visits, None, work, costly=True) == 10
    assert seen == visits.tolist()


def flips(mesh, objective, pool):
    mesh.status[:] = PENDING
    return flip_pending(mesh, Cost(objective, 2.0), 10, OPEN, 20, pool)


def compound(mesh, objective, pool):
    tried = np.zeros(len(mesh.cells), dtype=bool)
    return compound_moves(mesh, Phase(2.0, 0.1, 0, 0), OPEN, tried, pool)


@pytest.mark.parametrize(("run", "objective"), [
    (flips, ENERGY), (flips, QUALITY), (compound, QUALITY)
])
@pytest.mark.parametrize("regions", [1, 2])
def test_slabs_side_by_side_give_the_same_bits_as_one_after_another(run, objective, regions):
    first = start(regions)
    points, volume = first.points.copy(), tm.signed_volumes(first.points, first.mesh_arrays()[0])
    count = run(first, objective, None)
    assert count > 20
    assert_sound(first, first.points, volume.sum())
    assert np.array_equal(first.points[first.locked], points[first.locked])
    for pool in (Backwards(), ThreadPoolExecutor(2), ThreadPoolExecutor(3)):
        other = start(regions)
        assert run(other, objective, pool) == count
        assert contents(other) == contents(first)


@pytest.mark.parametrize("objective", [ENERGY, QUALITY])
def test_slabs_reach_about_what_the_whole_mesh_reaches(objective, monkeypatch):
    mesh = start()
    flips(mesh, objective, None)
    monkeypatch.setattr(slabs, "WORTH", 2.0)
    whole = start()
    flips(whole, objective, None)

    def cost(mesh):
        cells = mesh.mesh_arrays()[0]
        if objective == ENERGY:
            return tm.energy(mesh.points, cells)
        return tm.cost(mesh.points, cells, 2.0).sum()

    before = cost(start())
    assert before - cost(mesh) > 0.9 * (before - cost(whole))


def test_slabs_that_run_out_of_room_lose_nothing():
    mesh = start()
    room = mesh.used + 3
    mesh.cells, mesh.neighbors = mesh.cells[:room].copy(), mesh.neighbors[:room].copy()
    mesh.regions, mesh.status = mesh.regions[:room].copy(), mesh.status[:room].copy()
    volume = tm.signed_volumes(mesh.points, mesh.mesh_arrays()[0]).sum()
    assert flips(mesh, ENERGY, None) > 20
    assert_sound(mesh, mesh.points, volume)
