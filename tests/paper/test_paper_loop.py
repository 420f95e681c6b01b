"""The loops of Section 5: smoothing and reconnection in turns."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import planar_meshes as planar
import pytest
import reference as ref
import reference_flips
from scipy.spatial import Delaunay
from strategies import random_delaunay

from odt_plugins.engine.odt.sweeps import gauss_seidel_sweep
from odt_plugins.paper.loop import delaunay_cells, flip_once, iterate


def plain(points, topology):
    return gauss_seidel_sweep(points, topology, boundary_rule=False)


def rows(cells):
    return {tuple(row) for row in np.sort(cells, axis=1).tolist()}


def reconnections(d):
    return (flip_once, delaunay_cells) if d == 2 else (delaunay_cells,)


def test_energy_falls_in_every_step_of_the_loop(d):
    points, cells = random_delaunay(d, 80, 3)
    for reconnect in (None, *reconnections(d)):
        run = list(iterate(points, cells, plain, reconnect, 6))
        energies = [ref.energy(*mesh) for mesh in run]
        assert len(run) == 7
        assert all(b < a for a, b in pairwise(energies))
        assert all(reference_flips.volume(x, c) > 0 for x, t in run for c in t)


def test_one_pass_of_flips_is_less_than_delaunay():
    points, cells, _ = planar.jittered_grid(9, 9, np.random.default_rng(5))
    cells = reference_flips.random_flips(points, cells, np.random.default_rng(6), 60)
    once, passes = flip_once(points, cells), 0
    assert planar.energy(points, once) < planar.energy(points, cells)
    delaunay = rows(reference_flips.lawson(points, cells, np.zeros(len(cells), int))[0])
    assert rows(once) != delaunay
    while rows(once) != delaunay:
        once, passes = flip_once(points, once), passes + 1
        assert passes < 20
    assert rows(delaunay_cells(points, cells)) == delaunay


def test_delaunay_cells_are_those_of_qhull(d):
    points, cells = random_delaunay(d, 60, 7)
    moved, last = list(iterate(points, cells, plain, None, 3))[-1]
    assert rows(delaunay_cells(moved, last)) == rows(Delaunay(moved).simplices)


def test_connectivity_changes_after_every_second_step_only(d):
    points, cells = random_delaunay(d, 80, 9)
    run = list(iterate(points, cells, plain, delaunay_cells, 4, every=2))
    assert np.array_equal(run[0][1], run[1][1])
    assert np.array_equal(run[2][1], run[3][1])
    assert rows(run[1][1]) != rows(run[2][1])


@pytest.mark.parametrize("reconnect", [None, delaunay_cells])
def test_what_may_not_move_stays_and_the_caller_keeps_his_mesh(d, reconnect):
    points, cells = random_delaunay(d, 50, 11)
    before = points.copy(), cells.copy()
    hull = np.unique(Delaunay(points).convex_hull)
    fixed = np.zeros(len(points), dtype=bool)
    fixed[np.setdiff1d(np.arange(len(points)), hull)[0]] = True
    (first, _), *_, (last, _) = iterate(points, cells, plain, reconnect, 3, fixed=fixed)
    assert np.array_equal(first, before[0])
    assert np.array_equal(points, before[0])
    assert np.array_equal(cells, before[1])
    still = (last == points).all(axis=1)
    assert still[hull].all()
    assert still[fixed].all()
    assert not still.all()
