"""A surface goes back to the input where it breaks the promise, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest
import surface_meshes as sm

import odt_plugins
from odt_plugins.engine.surface.judge import Kept, faults, outside
from odt_plugins.engine.surface.mending import Pieces, mended, patches
from odt_plugins.mesh.surface import surface_edges, surface_mesh
from odt_plugins.options import Options


def flipped(cells, rng, count, n):
    """The triangles of a lattice of rows of n with some diagonals flipped; which have changed."""
    cells, changed = cells.copy(), np.zeros(len(cells), bool)
    neighbors = surface_edges(cells, cells.max() + 1).neighbors
    for t in rng.permutation(len(cells)):
        corner = next(i for i in range(3) if abs(cells[t, i - 1] - cells[t, i - 2]) not in (1, n))
        s = neighbors[t, corner]
        around = np.concatenate([neighbors[t], neighbors[s]])
        if changed.sum() >= 2 * count or s < 0 or changed[around[around >= 0]].any():
            continue
        a, b, c = np.roll(cells[t], -corner)
        (d,) = set(cells[s].tolist()) - {b, c}
        cells[t], cells[s] = (a, b, d), (a, d, c)
        changed[[t, s]] = True
    return cells, changed


def test_patches_are_filled_by_as_many_triangles_of_both():
    _, t = sm.bowl(16)
    rng = np.random.default_rng(3)
    new, changed = flipped(t, rng, 40, 16)
    order = rng.permutation(len(t))
    was, now = patches(t, new[order], t.max() + 1)
    count = np.bincount(was)
    assert np.array_equal(count, np.bincount(now, minlength=len(count)))
    assert np.array_equal(np.bincount(count)[1:3], [(~changed).sum(), changed.sum() // 2])
    for row in range(len(t)):
        there = new[order][now == was[row]]
        assert set(t[row].tolist()) <= set(there.ravel().tolist())
        if not changed[row]:
            assert there.shape == (1, 3)


def test_where_several_sheets_meet_patches_stay_apart_from_others():
    p, t = sm.bowl(12)
    fin = np.array([[0, 1, len(p)], [40, 41, len(p) + 1]])
    cells = np.concatenate([t, fin])
    was, now = patches(cells, cells[::-1].copy(), len(p) + 2)
    assert np.array_equal(was, now[::-1])
    assert np.bincount(was).max() <= 3


def test_only_the_surroundings_of_a_bad_place_go_back():
    """A sheet above another is moved and flipped everywhere, and pushed through it at one place."""
    p, t = sm.bowl(16)
    p[:, 2] *= 0.01
    q = np.concatenate([p, p + np.array([0.03, 0.05, 0.05])])
    u = np.concatenate([t, t + len(p)])
    mesh = surface_mesh(q, u)
    kept = Kept(3.0, 0.2, np.zeros((0, 2), int), np.zeros(len(q), bool), 0, 0)
    rng = np.random.default_rng(8)
    cells, changed = flipped(mesh.cells, rng, 150, 16)
    moved = q.copy()
    inner = np.setdiff1d(np.arange(len(q)), u[np.isin(u, rim(u)).any(axis=1)])
    moved[inner] += 0.01 * rng.uniform(-1, 1, (len(inner), 3)) * [1, 1, 0.1]
    pushed = 7 * 16 + 7
    moved[pushed, 2] += 0.1
    options = Options(keep=())
    broken, _ = faults(mesh, kept, moved, cells, mesh.regions, options)
    assert "through other triangles" in broken[0]
    found = mended(
        Pieces(mesh.points, mesh.cells, mesh.regions), Pieces(moved, cells, mesh.regions),
        lambda s: outside(mesh, kept, s.points, s.cells), 8,
    )
    assert faults(mesh, kept, found.points, found.cells, found.regions, options)[0] == []
    assert np.array_equal(found.points[pushed], q[pushed])
    back = np.flatnonzero((found.points != moved).any(axis=1))
    assert 0 < len(back) < 40
    assert np.abs(q[back, :2] - q[pushed, :2]).max() < 0.6
    assert (found.cells != cells).any(axis=1).sum() < 30
    assert (found.cells[changed] != mesh.cells[changed]).any(axis=1).mean() > 0.8


def rim(cells):
    return np.unique([v for e, d in sm.edge_set(cells).items() if d == 1 for v in e])


def test_both_triangles_of_a_crossing_are_near_it():
    """One is where the input crosses itself, the other one is not; both may be to blame."""
    points = np.array([[0, 0, 0], [4.0, 0, 0], [0, 4, 0], [1.5, 1.5, 1], [1.7, 1.5, 1],
                       [1.5, 1.7, -1], [0.2, 0.2, 0.05], [0.4, 0.2, 0.05], [0.3, 0.3, 0.4]])
    cells = np.arange(9, dtype=np.int32).reshape(3, 3)
    mesh = surface_mesh(points, cells)
    kept = Kept(20.0, 20.0, np.zeros((0, 2), int), np.zeros(9, bool), 0, 0)
    assert not outside(mesh, kept, points, cells).any()
    tilted = points.copy()
    tilted[0, 2] = 0.2
    assert outside(mesh, kept, tilted, cells).tolist() == 3 * [True] + 3 * [False] + 3 * [True]


@pytest.mark.parametrize(("height", "often", "seed"), [(2e-3, (9, 7), 1), (5e-4, (25, 21), 3)])
def test_sheets_that_cross_many_times_gain_with_every_larger_envelope(height, often, seed):
    def low(x, y):
        return 0.1 * np.sin(3 * x) * np.cos(2 * y)

    def high(x, y):
        return low(x, y) + height * np.sin(often[0] * x) * np.sin(often[1] * y)

    one = sm.uneven_sheet(20, low, 0, 0.0)
    two = sm.uneven_sheet(20, high, seed, 0.003 + 0.001 * (seed == 3))
    mesh = np.concatenate([one[0], two[0]]), np.concatenate([one[1], two[1] + len(one[0])])
    means = [odt_plugins.optimize_with_report(mesh, envelope=size)[1].after.mean_quality
             for size in (1e-3, 7e-4, 3e-4, 1e-4, 5e-5)]
    assert np.diff(means).max() < 2e-3
    assert means[0] > 0.97
