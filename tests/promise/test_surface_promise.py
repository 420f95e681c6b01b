"""The judge of curved surfaces: every broken promise is named, what is kept is not."""

from __future__ import annotations

import numpy as np
import pytest
import surface_meshes as sm
from crossings import crossing_pairs, cut, new_crossings
from hypothesis import given
from strategies import SEEDS

from odt_plugins.engine.ground.crossings import crossing_triangles
from odt_plugins.engine.surface.judge import Kept, faults, feet_on, outside
from odt_plugins.mesh.surface import surface_mesh
from odt_plugins.options import Options
from odt_plugins.promise.surface import broken_surface_promises


def torus(**options):
    p, t = sm.torus(24, 12, noise=0.3)
    return surface_mesh(p, t, **options)


def judge(mesh, points=None, cells=None, regions=None, **options):
    points = mesh.points if points is None else points
    cells = mesh.cells if cells is None else np.asarray(cells, dtype=np.int32)
    regions = mesh.regions if regions is None else regions
    return broken_surface_promises(mesh, points, cells, regions, **options)


def flipped(cells, row=0):
    """The triangles with one edge flipped."""
    cells = cells.copy()
    a, b, c = cells[row]
    for other in range(len(cells)):
        if other != row and {b, c} <= set(cells[other].tolist()):
            (d,) = set(cells[other].tolist()) - {b, c}
            cells[row], cells[other] = (a, b, d), (a, d, c)
            return cells
    raise ValueError


def test_what_is_kept_is_not_named():
    mesh = torus()
    assert judge(mesh) == []
    assert judge(mesh, cells=flipped(mesh.cells), keep=()) == []
    moved = mesh.points.copy()
    moved[7] += 1e-3
    assert judge(mesh, points=moved, keep=()) == []
    assert judge(mesh, cells=np.roll(mesh.cells, 1, axis=1)[::-1], keep=()) == []


BROKEN = {
    "points have shape": lambda m: {"points": m.points[:-1]},
    "triangles have shape": lambda m: {"cells": m.cells[:-1]},
    "labels have": lambda m: {"regions": m.regions + (np.arange(len(m.cells)) == 0)},
    "vertex 3 is not finite": lambda m: {
        "points": np.where(np.arange(len(m.points))[:, None] == 3, np.nan, m.points)},
    "triangles name vertices": lambda m: {"cells": m.cells + len(m.points)},
    "has a vertex twice": lambda m: {
        "cells": np.concatenate([m.cells[:1][:, [0, 0, 1]], m.cells[1:]])},
    "disagree about the outside": lambda m: {
        "cells": np.concatenate([m.cells[:1][:, [0, 2, 1]], m.cells[1:]])},
    "triangle is there twice": lambda m: {
        "cells": np.concatenate([m.cells[1:2], m.cells[1:]])},
    "edges are not of two triangles": lambda m: {
        "cells": np.concatenate([m.cells[1:2], m.cells[1:]])},
    "folds back at": lambda m: {"points": _folded(m)},
    "have no area": lambda m: {"points": _flat(m)},
    "mean_quality fell": lambda m: {
        "points": m.points + 0.03 * np.random.default_rng(0).standard_normal(m.points.shape)},
}


def _folded(mesh):
    points = mesh.points.copy()
    star = mesh.cells[(mesh.cells == 7).any(axis=1)]
    ring = np.setdiff1d(star, [7])
    points[7] = points[ring].mean(axis=0) + 3.0 * (points[ring[0]] - points[ring].mean(axis=0))
    return points


def _flat(mesh):
    points = mesh.points.copy()
    a, b, _ = mesh.cells[0]
    points[a] = points[b]
    return points


@pytest.mark.parametrize("words", BROKEN)
def test_every_broken_promise_is_named(words):
    mesh = torus()
    keep = ("mean_quality",) if "quality" in words else ()
    sentences = judge(mesh, **BROKEN[words](mesh), keep=keep)
    assert any(words in s for s in sentences), sentences


def test_vertices_that_are_held_and_unused_ones():
    p, t = sm.torus(24, 12)
    mesh = surface_mesh(np.concatenate([p, [[9.0, 9, 9]]]), t, fixed=[4])
    for vertex, words in ((4, "vertex 4 moved"), (len(p), f"vertex {len(p)} moved")):
        points = mesh.points.copy()
        points[vertex, 0] = np.nextafter(points[vertex, 0], 10.0)
        assert any(words in s for s in judge(mesh, points=points))
    other = np.where(mesh.cells == 5, len(p), mesh.cells)
    assert any("vertex 5 came into use or out of it, 2 in all" in s
               for s in judge(mesh, cells=other))
    held = np.zeros(len(p) + 1, bool)
    held[11] = True
    points = mesh.points.copy()
    points[11] += 1e-6
    assert judge(mesh, points=points, keep=()) == []
    assert any("vertex 11 moved" in s for s in judge(mesh, points=points, held=held))


def test_lines_label_borders_and_frozen_triangles():
    p, t = sm.torus(24, 12)
    label = (p[t].mean(axis=1)[:, 0] > 0).astype(int)
    mesh = surface_mesh(p, t, regions=label, selection=np.arange(1, len(t)))
    row = next(i for i in range(1, len(t)) if label[i] == label[flip_partner(t, i)])
    flip = flipped(t, row)
    assert judge(mesh, cells=flip, keep=()) == []
    gone = t[row, 1:]
    assert any("feature edge" in s for s in judge(mesh, cells=flip, keep=(), lines=gone[None]))
    border = next(i for i in range(1, len(t)) if label[i] != label[flip_partner(t, i)])
    assert any("between labels" in s
               for s in judge(mesh, cells=flipped(t, border), keep=()))
    assert any("frozen triangle 0 is gone" in s for s in judge(mesh, cells=flipped(t, 0), keep=()))


def flip_partner(cells, row):
    b, c = cells[row, 1:]
    near = [i for i in range(len(cells)) if i != row and {b, c} <= set(cells[i].tolist())]
    return near[0]


def test_topology_that_differs_with_the_same_counts():
    # two spheres, against two spheres that exchanged a vertex for another place
    p, t = sm.sphere(1)
    q, u = np.concatenate([p, p + 5]), np.concatenate([t, t + len(p)])
    mesh = surface_mesh(q, u)
    swapped = u.copy()
    swapped[u == 3], swapped[u == 3 + len(p)] = 3 + len(p), 3
    assert any("connected pieces" in s for s in judge(mesh, cells=swapped, keep=()))
    # two spheres that meet in one vertex, against two that meet in another
    pinched = surface_mesh(q, np.where(u == len(p), 0, u))
    assert judge(pinched) == []
    assert any("number of fans" in s
               for s in judge(pinched, cells=np.where(u == len(p), 1, u), keep=()))


def test_distances_are_judged_both_ways():
    p, t = sm.sphere(3)
    mesh = surface_mesh(p, t)
    none = np.zeros((0, 2), int)
    kept = Kept(3.46, 0.01, none, np.zeros(len(p), bool), 0, 0)
    out = p.copy()
    out[20] *= 1.009
    broken, distance = faults(mesh, kept, out, mesh.cells, mesh.regions, Options(keep=()))
    assert broken == []
    assert 0.008 < distance.forward <= 0.01
    out[20] = p[20] * 1.02
    broken, distance = faults(mesh, kept, out, mesh.cells, mesh.regions, Options(keep=()))
    assert "beyond the envelope" in broken[0]
    assert distance.forward == pytest.approx(0.02, rel=0.05)
    near = outside(mesh, kept, out, mesh.cells)
    assert near[20]
    assert near.sum() < 60
    # a spike of the input that the result leaves out is as bad
    spiky = surface_mesh(out, t)
    broken, distance = faults(spiky, kept, p, mesh.cells, mesh.regions, Options(keep=()))
    assert "beyond the envelope" in broken[0]
    assert distance.backward == pytest.approx(0.02, rel=0.05)


def test_feet_are_where_points_of_a_surface_lie():
    p, t = sm.torus(24, 12)
    rng = np.random.default_rng(9)
    rows = rng.integers(0, len(t), 50)
    w = rng.dirichlet([1, 1, 1], 50)
    x = (w[:, :, None] * p[t[rows]]).sum(axis=1)
    face, weights = feet_on(p, t.astype(np.int32), x)
    assert (weights[:, :, None] * p[t[face]]).sum(axis=1) == pytest.approx(x, abs=1e-12)
    assert weights.min() >= 0
    assert weights.sum(axis=1) == pytest.approx(1)


def test_a_surface_that_cuts_through_itself_is_broken():
    # two parallel sheets, one of which is pushed through the other
    p, t = sm.bowl(12)
    p[:, 2] *= 0.01
    above = p + np.array([0.03, 0.05, 0.02])
    q, u = np.concatenate([p, above]), np.concatenate([t, t + len(p)])
    mesh = surface_mesh(q, u)
    kept = Kept(3.0, 0.05, np.zeros((0, 2), int), np.zeros(len(q), bool), 0, 0)
    pushed = q.copy()
    pushed[5 * 12 + 5, 2] += 0.04
    broken, _ = faults(mesh, kept, pushed, mesh.cells, mesh.regions, Options(keep=()))
    assert any("through other triangles" in s for s in broken)
    near = outside(mesh, kept, pushed, mesh.cells)
    assert near[5 * 12 + 5]
    assert near.sum() < 40
    # where it did so before, that is no fault
    cut = surface_mesh(pushed, u)
    again = pushed.copy()
    again[5 * 12 + 5, 2] += 0.001
    assert faults(cut, kept, again, cut.cells, cut.regions, Options(keep=()))[0] == []


def test_new_folds_and_flat_triangles_are_found_where_they_are():
    p, t = sm.bowl(12)
    mesh = surface_mesh(p, t)
    kept = Kept(3.0, 3.0, np.zeros((0, 2), int), np.zeros(len(p), bool), 0, 0)
    assert not outside(mesh, kept, p, mesh.cells).any()
    folded = p.copy()
    folded[5 * 12 + 5] = p[3 * 12 + 3] + np.array([0, 0, 0.2])
    near = outside(mesh, kept, folded, mesh.cells)
    assert near[5 * 12 + 5]
    assert near.sum() < 30
    flat = p.copy()
    flat[5 * 12 + 5] = flat[5 * 12 + 6]
    assert outside(mesh, kept, flat, mesh.cells)[[5 * 12 + 5, 5 * 12 + 6]].all()
    # what the input folds stays as it was
    old = surface_mesh(folded, t)
    assert not outside(old, kept, folded, old.cells).any()


def test_crossings_within_rounding_are_found_too():
    # every triangle around a pole has a copy of the pole of its own, within rounding
    angle = 2 * np.pi * np.arange(12) / 12
    ring = np.stack([np.cos(angle), np.sin(angle), np.full(12, 0.3)], axis=1)
    rng = np.random.default_rng(4)
    poles = 1e-15 * rng.standard_normal((12, 3)) + [0, 0, 1]
    i = np.arange(12)
    t = np.concatenate([np.stack([i, (i + 1) % 12, 12 + i], axis=1),
                        np.stack([(i + 1) % 12, 12 + (i + 1) % 12, 12 + i], axis=1)])
    points, cells = np.concatenate([ring, poles]), t.astype(np.int32)
    marked = np.isin(np.arange(len(cells)), crossing_pairs(points, cells))
    assert marked.any()
    assert not marked.all()
    assert np.array_equal(crossing_triangles(points, cells), marked)
    poles[:] = [0, 0, 1]
    assert not crossing_triangles(np.concatenate([ring, poles]), cells).any()


@given(seed=SEEDS)
def test_crossings_are_those_of_rational_numbers_in_engine_and_promise(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(5, 12))
    points = rng.standard_normal((n, 3))
    cells = np.array([sorted(rng.choice(n, 3, replace=False)) for _ in range(12)], dtype=np.int32)
    cells = np.unique(cells, axis=0)
    expected = [(i, j) for i in range(len(cells)) for j in range(i + 1, len(cells))
                if cut(points, cells[i], cells[j]) or cut(points, cells[j], cells[i])]
    pairs = crossing_pairs(points, cells)
    assert [tuple(pair) for pair in pairs.tolist()] == expected
    marked = np.isin(np.arange(len(cells)), pairs)
    assert np.array_equal(crossing_triangles(points, cells), marked)


def test_crossings_of_triangles_of_all_sizes_are_found_wherever_they_lie():
    p, t = sm.sphere(3, 0.2)
    blade = np.array([[-3.0, 0.01, 0.02], [3, 0.03, 0.01], [0, -3, 0.02]])
    pins = 1e-3 * np.array([[0.0, 0, 5], [1, 0, -5], [0, 1, -5]]) + [[[0.0, -2.5, 0.0192]]]
    points = np.concatenate([p, blade, pins.reshape(-1, 3)])
    cells = np.concatenate([t, len(p) + np.array([[0, 1, 2], [3, 4, 5]])]).astype(np.int32)
    for order in (np.arange(len(cells)), np.random.default_rng(1).permutation(len(cells))):
        pairs = crossing_pairs(points, cells[order])
        marked = np.isin(np.arange(len(cells)), pairs)
        assert np.array_equal(crossing_triangles(points, cells[order]), marked)
    shift = np.array([0, 0, 0.05])
    assert not len(crossing_pairs(p, t))
    assert len(new_crossings(points, cells, points, cells)) == 0
    away = points.copy()
    away[-3:] += 10 * shift
    assert new_crossings(away, cells, points, cells).tolist() == [[len(t), len(t) + 1]]
