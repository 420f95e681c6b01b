"""Planar edge flips: Section 3.1, the one-sweep loop of Section 5, quality flips."""

from __future__ import annotations

import numpy as np
import planar_meshes as planar
import pytest
import reference_flips as ref
from hypothesis import given, settings
from hypothesis import strategies as st
from planar_meshes import grid
from scipy.spatial import Delaunay

from odt_plugins.engine.cells.cost import Cost
from odt_plugins.engine.cells.extremes import FREELY, Extremes
from odt_plugins.engine.cells.measures import QUALITY
from odt_plugins.engine.moves.flips2d import (
    FLIPS,
    lawson_flips,
    make_queue,
    quality_flips,
    work_off,
)
from odt_plugins.engine.topology.triangles import Triangles
from odt_plugins.metric.through import halved_logarithms

SEEDS = st.integers(0, 10**6)
GENTLY, SQUARES = Cost(QUALITY, 0.1), Cost(QUALITY, 2.0)


def two_regions(points, cells):
    return (points[cells].mean(axis=1)[:, 0] > 3.5).astype(np.int32)


def edges(cells):
    return set(planar.edge_cells(cells))


def goodness(points, cells):
    """Three figures, each the better the larger: worst q, smallest angle, minus the largest."""
    q, angles = planar.shape(points, cells)
    return np.array([q.min(), angles.min(), -angles.max()])


def check_mesh(points, start, cells, neighbors, regions):
    """The adjacency is that of the cells, the domain and its interfaces are the old ones."""
    np.testing.assert_array_equal(neighbors, ref.brute_neighbors(cells))
    assert (planar.areas(points, cells) > 0).all()
    assert planar.kept_edges(cells, regions) == planar.kept_edges(start, regions)
    for label in np.unique(regions):
        here, there = (planar.areas(points, c[regions == label]).sum() for c in (start, cells))
        assert there == pytest.approx(here, rel=1e-12)


@settings(max_examples=30, deadline=None)
@given(seed=SEEDS, two=st.booleans(), flips=st.sampled_from([0, 60]))
def test_edge_flipping_ends_with_the_constrained_delaunay_mesh(seed, two, flips):
    points, start = grid(seed, flips=flips)
    regions = two_regions(points, start) * two
    cells, neighbors = start.copy(), ref.brute_neighbors(start)
    count = lawson_flips(points, cells, neighbors, regions)
    check_mesh(points, start, cells, neighbors, regions)
    for edge, own in planar.edge_cells(cells).items():
        if len(own) == 2 and regions[own[0]] == regions[own[1]]:
            (far,) = set(cells[own[1]].tolist()) - set(edge)
            assert ref.in_sphere(points, cells[own[0]], points[far]) <= 0
    assert count > 0
    assert planar.energy(points, cells) < planar.energy(points, start)
    again = cells.copy()
    assert lawson_flips(points, again, neighbors, regions) == 0
    np.testing.assert_array_equal(again, cells)


@pytest.mark.parametrize("seed", [5, 6])
@pytest.mark.parametrize("two", [False, True])
def test_equals_slow_twin_whose_energy_falls_at_every_flip(seed, two):
    points, start = grid(seed, n=5, holes={(2, 2)}, flips=20)
    regions = two_regions(points, start) * two
    twin, energies, drops = ref.lawson(points, start, regions)
    cells, neighbors = start.copy(), ref.brute_neighbors(start)
    lawson_flips(points, cells, neighbors, regions)
    assert edges(cells) == edges(twin)
    assert (np.diff(energies) < 0).all()
    np.testing.assert_allclose(-np.diff(energies), drops, rtol=1e-9)
    assert planar.energy(points, cells) == pytest.approx(energies[-1], rel=1e-12)


def test_energy_falls_at_every_single_flip_of_the_kernel():
    points, start = grid(12, flips=40)
    regions = np.zeros(len(start), dtype=np.int32)
    flipped = 0
    for edge, own in planar.edge_cells(start).items():
        if len(own) == 1:
            continue
        (far,) = set(start[own[1]].tolist()) - set(edge)
        wrong = ref.in_sphere(points, start[own[0]], points[far]) > 0
        active = np.zeros(len(start), dtype=bool)
        active[own] = True
        cells, neighbors = start.copy(), ref.brute_neighbors(start)
        assert lawson_flips(points, cells, neighbors, regions, active=active) == int(wrong)
        assert (planar.energy(points, cells) < planar.energy(points, start)) == wrong
        rest = np.delete(np.arange(len(start)), own)
        np.testing.assert_array_equal(cells[rest], start[rest])
        flipped += wrong
    assert flipped > 10


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_equals_scipy_on_a_convex_domain(seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(60, 2))
    best = planar.oriented(points, Delaunay(points).simplices)
    cells = ref.random_flips(points, best, rng, 200)
    assert edges(cells) != edges(best)
    neighbors = ref.brute_neighbors(cells)
    lawson_flips(points, cells, neighbors, np.zeros(len(cells), dtype=np.int32))
    assert edges(cells) == edges(best)


def test_cocircular_ties_and_needles_end():
    rng = np.random.default_rng(4)
    points, cells, _ = planar.jittered_grid(6, 6, rng, 0.0)
    neighbors = ref.brute_neighbors(cells)
    assert lawson_flips(points, cells, neighbors, np.zeros(len(cells), dtype=np.int32)) == 0
    thin = points * [1.0, 1e-7] + 1e5
    assert lawson_flips(thin, cells, neighbors, np.zeros(len(cells), dtype=np.int32)) >= 0
    assert (planar.areas(thin, cells) > 0).all()


def test_one_sweep_visits_every_edge_once():
    total, repeated = 0, 0
    for seed in range(8):
        points, start = grid(seed, flips=80)
        regions = np.zeros(len(start), dtype=np.int32)
        cells, neighbors = start.copy(), ref.brute_neighbors(start)
        counts, energies = [], [planar.energy(points, cells)]
        while not counts or counts[-1]:
            counts.append(lawson_flips(points, cells, neighbors, regions, one_sweep=True))
            energies.append(planar.energy(points, cells))
        check_mesh(points, start, cells, neighbors, regions)
        assert counts[0] <= len(edges(start)) - len(planar.kept_edges(start, regions))
        assert (np.diff(energies[:-1]) < 0).all()
        repeated += len(counts) > 2
        total += counts[0]
        full, neighbors = start.copy(), ref.brute_neighbors(start)
        lawson_flips(points, full, neighbors, regions)
        assert edges(full) == edges(cells)
    assert total > 0
    assert repeated > 0


def test_one_sweep_flips_each_edge_at_most_once():
    # in a fan around vertex 0 the sweep leaves work that only a second look finds
    angle = np.linspace(0.1, np.pi - 0.1, 12)
    ring = np.stack([np.cos(angle), 0.15 * np.sin(angle)], axis=1)
    points = np.vstack([[0.0, -3.0], ring])
    cells = np.array([[0, k + 1, k] for k in range(1, 12)], dtype=np.int32)
    cells = planar.oriented(points, cells)
    best = cells.copy()
    regions = np.zeros(len(cells), dtype=np.int32)
    one = lawson_flips(points, cells, ref.brute_neighbors(cells), regions, one_sweep=True)
    full = lawson_flips(points, best, ref.brute_neighbors(best), regions)
    assert 0 < one <= 10
    assert full > one
    assert planar.energy(points, best) < planar.energy(points, cells)


@pytest.mark.parametrize("share", [0.4, 1.0])
def test_guard_never_makes_a_stuck_triangle_worse(share):
    refused = 0
    for seed in range(6):
        points, start = grid(seed, flips=60)
        regions = np.zeros(len(start), dtype=np.int32)
        fixed = planar.kept_vertices(start, regions, len(points))
        fixed |= np.random.default_rng(seed).random(len(points)) < share
        cells, neighbors = start.copy(), ref.brute_neighbors(start)
        free, free_neighbors = start.copy(), ref.brute_neighbors(start)
        lawson_flips(points, cells, neighbors, regions, fixed=fixed, fixed_floor=0.6)
        lawson_flips(points, free, free_neighbors, regions)
        check_mesh(points, start, cells, neighbors, regions)
        worst = []
        for mesh in (start, cells):
            q = planar.shape(points, mesh)[0]
            worst.append(min(0.6, q[fixed[mesh].all(axis=1)].min()))
        assert worst[1] >= worst[0]
        refused += edges(free) != edges(cells)
    assert refused > 0


@settings(max_examples=30, deadline=None)
@given(seed=SEEDS, two=st.booleans(), power=st.sampled_from([1.0, 2.0, 8.0]))
def test_quality_flips_lower_the_sum_and_respect_the_mesh(seed, two, power):
    points, start = grid(seed, flips=60)
    regions = two_regions(points, start) * two
    cells, neighbors = start.copy(), ref.brute_neighbors(start)
    changed = np.zeros(len(cells), dtype=bool)
    count = quality_flips(Triangles(points, cells, neighbors, regions), Cost(QUALITY, power),
                          changed=changed)
    check_mesh(points, start, cells, neighbors, regions)
    before, after = planar.shape(points, start)[0], planar.shape(points, cells)[0]
    assert count > 0
    assert (after**-power).sum() < (before**-power).sum()
    replaced = np.array([set(a) != set(b) for a, b in
                         zip(start.tolist(), cells.tolist(), strict=True)])
    assert (changed >= replaced).all()
    assert (cells[~changed] == start[~changed]).all()
    for edge, own in planar.edge_cells(cells).items():
        if len(own) == 1 or regions[own[0]] != regions[own[1]]:
            continue
        (a,), (d,) = (set(cells[t].tolist()) - set(edge) for t in own)
        b, c = edge
        flipped = np.array([[a, b, d], [a, d, c]])
        size = planar.areas(points, flipped)
        if (size > 1e-9).all() or (size < -1e-9).all():
            q = planar.shape(points, flipped)[0]
            assert (q**-power).sum() >= (1 - 1e-8) * (after[own] ** -power).sum()


@pytest.mark.parametrize("which", [0, 1, 2])
def test_bounds_refuse_a_flip_that_is_worse_there_and_beyond(which):
    """Random quadrilaterals: worst q, smallest angle, minus the largest angle of the pair."""
    rng = np.random.default_rng(5)
    regions = np.zeros(2, dtype=np.int32)
    name = FREELY._fields[which]
    tight = FREELY._replace(**{name: (1.0, -1.0, 1.0)[which]})
    refused = within = 0
    for _ in range(2000):
        points = rng.normal(size=(4, 2)) * [3.0, 1.0]
        start = planar.oriented(points, [[0, 1, 2], [3, 2, 1]])
        if (start[0] == [0, 1, 2]).all() != (start[1] == [3, 2, 1]).all():
            continue
        figures = []
        for bounds in (FREELY, tight):
            cells, neighbors = start.copy(), ref.brute_neighbors(start)
            count = quality_flips(Triangles(points, cells, neighbors, regions), GENTLY, bounds)
            figures.append((count, goodness(points, cells)[which]))
        before = goodness(points, start)[which]
        if figures[0][0] == 0:
            assert figures[1][0] == 0
        elif figures[0][1] < before - 1e-9:
            assert figures[1][0] == 0
            refused += 1
            edge = figures[0][1] - 1e-6
            loose = tight._replace(
                **{name: edge if which == 0 else np.cos(np.radians(abs(edge)))})
            cells, neighbors = start.copy(), ref.brute_neighbors(start)
            within += quality_flips(Triangles(points, cells, neighbors, regions), GENTLY, loose)
        elif figures[0][1] > before + 1e-9:
            assert figures[1][0] == 1
    assert refused > 3
    assert within == refused


def test_bounds_hold_on_a_whole_mesh():
    for seed in range(6):
        points, start = grid(seed, flips=30)
        regions = np.zeros(len(start), dtype=np.int32)
        q, angles = planar.shape(points, start)
        bounds = Extremes(q.min(), np.cos(np.radians(angles.min())),
                          np.cos(np.radians(angles.max())))
        cells, neighbors = start.copy(), ref.brute_neighbors(start)
        assert quality_flips(Triangles(points, cells, neighbors, regions), GENTLY, bounds) > 0
        assert (goodness(points, cells) >= goodness(points, start) - 1e-9).all()


def test_quality_flips_look_at_seeds_and_movable_cells_only():
    points, start = grid(3, flips=60)
    regions = np.zeros(len(start), dtype=np.int32)
    nothing = np.zeros(len(start), dtype=bool)
    for options in ({"seeds": nothing}, {"movable_cells": nothing}):
        cells, neighbors = start.copy(), ref.brute_neighbors(start)
        assert quality_flips(Triangles(points, cells, neighbors, regions), SQUARES, **options) == 0
        np.testing.assert_array_equal(cells, start)
    movable = points[start].mean(axis=1)[:, 0] < 3.0
    cells, neighbors = start.copy(), ref.brute_neighbors(start)
    assert quality_flips(Triangles(points, cells, neighbors, regions), SQUARES,
                         movable_cells=movable) > 0
    np.testing.assert_array_equal(cells[~movable], start[~movable])
    settled = cells.copy()
    assert quality_flips(Triangles(points, settled, neighbors, regions), SQUARES, seeds=movable) > 0
    np.testing.assert_array_equal(neighbors, ref.brute_neighbors(settled))


def test_same_bits_again_and_no_cells():
    points, start = grid(8, flips=60)
    regions = np.zeros(len(start), dtype=np.int32)
    results = []
    for _ in range(2):
        cells, neighbors = start.copy(), ref.brute_neighbors(start)
        lawson_flips(points, cells, neighbors, regions)
        quality_flips(Triangles(points, cells, neighbors, regions), SQUARES)
        results.append(cells)
    np.testing.assert_array_equal(*results)
    empty = np.empty((0, 3), dtype=np.int32)
    assert lawson_flips(points, empty, empty.copy(), regions[:0]) == 0


def test_a_queue_that_never_empties_is_left_after_so_many_flips_an_edge():
    seen = []
    queue = make_queue(np.arange(10) % 4 == 1)

    def flip_some():
        assert len(seen) < 10 * FLIPS
        seen.append(queue.ends.tolist())
        return 7

    assert 10 * FLIPS <= work_off(queue, flip_some) < 10 * FLIPS + 7
    assert seen[0] == [0, 3]
    assert queue.ring[:3].tolist() == [1, 5, 9]


@pytest.mark.parametrize("seed", [3, 4])
def test_in_a_metric_flips_are_those_of_the_image(seed):
    points, start = grid(seed, flips=60)
    root = np.array([[4.0, 1.5], [1.5, 1.0]])
    rows = np.tile(halved_logarithms((root @ root)[None]), (len(points), 1))
    found = []
    for p in (np.column_stack([points, rows]), points @ root):
        cells = start.copy()
        regions = np.zeros(len(cells), dtype=np.int32)
        assert lawson_flips(p, cells, ref.brute_neighbors(cells), regions)
        found.append(cells)
    np.testing.assert_array_equal(*found)
