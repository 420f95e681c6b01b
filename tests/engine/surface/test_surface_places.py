"""Creases, folds and crossings of surfaces: where they are, not how many."""

from __future__ import annotations

import numpy as np
import pytest
import surface_meshes as sm

import odt_plugins
from odt_plugins.engine.ground.crossings import crossing_triangles
from odt_plugins.mesh.surface import surface_edges, surface_mesh
from odt_plugins.promise.surface import bad_places, broken_surface_promises, new_folds


def strip(a, xa, c, xc):
    """Triangles between two rows of vertices from numbers a and c on, at abscissae xa and xc."""
    i, j, out = 0, 0, []
    while i < len(xa) - 1 or j < len(xc) - 1:
        if j == len(xc) - 1 or (i < len(xa) - 1 and xa[i + 1] <= xc[j + 1]):
            out.append([a + i, a + i + 1, c + j])
            i += 1
        else:
            out.append([a + i, c + j + 1, c + j])
            j += 1
    return np.array(out)


def wedge(ticks, angle):
    """Two planes that meet at an angle along the axis x, the line of meeting cut at some ticks."""
    u = np.linspace(0, 1, 5)
    up = np.array([0, np.cos(np.radians(angle)), np.sin(np.radians(angle))])
    rows = [np.stack([ticks, 0 * ticks, 0 * ticks], axis=1)]
    for way in (np.array([0, 1.0, 0]), up):
        rows += [np.array([1.0, 0, 0]) * u[:, None] + way * j / 4 for j in range(1, 5)]
    start = np.cumsum([0, *map(len, rows)])
    cells = [strip(0, ticks, start[1], u), strip(0, ticks, start[5], u)[:, ::-1]]
    for k in (1, 2, 3):
        cells += [strip(start[k], u, start[k + 1], u),
                  strip(start[k + 4], u, start[k + 5], u)[:, ::-1]]
    return np.concatenate(rows), np.concatenate(cells)


def pairs(cells):
    return {tuple(sorted(map(int, p))) for c in cells for p in (c[:2], c[1:], c[[2, 0]])}


@pytest.mark.parametrize("needle", [0.1, 0.02, 0.005, 1e-4])
@pytest.mark.parametrize("angle", [60, 90, 130])
def test_a_crease_is_kept_whatever_needles_lie_on_it(needle, angle):
    ticks = np.array([0, 0.25, 0.5, 0.5 + needle, 0.75, 1])
    points, cells = wedge(ticks, angle)
    better, report = odt_plugins.optimize_with_report((points, cells))
    line = {(i, i + 1) for i in range(len(ticks) - 1)}
    assert line <= pairs(better[1])
    assert np.abs(better[0][: len(ticks), 1:]).max() == 0.0
    assert report.after.mean_quality >= report.before.mean_quality


@pytest.mark.parametrize("height", [0.3, 0.05, 0.01])
def test_the_rim_of_a_round_hole_in_a_plate_is_kept(height):
    """A flat ring and the wall of its hole, whose triangles are needles where the plate is thin."""
    k = 48
    angle = 2 * np.pi * np.arange(k) / k
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rows = [np.column_stack([0.3 * circle, np.full(k, -height)]),
            np.column_stack([0.3 * circle, np.zeros(k)]),
            np.column_stack([0.6 * circle, np.zeros(k)]), np.column_stack([circle, np.zeros(k)])]
    i, j = np.arange(k), (np.arange(k) + 1) % k
    cells = np.concatenate([np.concatenate([
        np.stack([r * k + i, (r + 1) * k + j, (r + 1) * k + i], 1),
        np.stack([r * k + i, r * k + j, (r + 1) * k + j], 1)]) for r in range(3)])
    _, after = odt_plugins.optimize((np.concatenate(rows), cells))
    rim = {tuple(sorted((k + a, k + b))) for a, b in zip(i.tolist(), j.tolist(), strict=True)}
    assert rim <= pairs(after)


def prism(n, seed):
    """The side of a prism over a regular triangle; it turns by 120 degrees at its edges."""
    rng = np.random.default_rng(seed)
    corner = np.stack([np.cos(np.radians([90, 210, 330])), np.sin(np.radians([90, 210, 330]))], 1)
    side = [corner[i] + (corner[(i + 1) % 3] - corner[i]) * k / n for i in range(3)
            for k in range(n)]
    points = []
    for j in range(n + 1):
        for i, x in enumerate(side):
            move = np.zeros(3)
            if 0 < j < n and i % n:
                along = (corner[(i // n + 1) % 3] - corner[i // n]) / n
                move[:2], move[2] = along * rng.uniform(-0.3, 0.3), rng.uniform(-0.5, 0.5) / n
            points.append(np.array([*x, 2 * j / n]) + move)
    m = len(side)
    a = np.array([j * m + i for j in range(n) for i in range(m)])
    b = np.array([j * m + (i + 1) % m for j in range(n) for i in range(m)])
    cells = np.concatenate([np.stack([a, b, b + m], 1), np.stack([a, b + m, a + m], 1)])
    return np.array(points), cells


@pytest.mark.parametrize("seed", range(4))
def test_rounding_decides_no_fold(seed):
    _, report = odt_plugins.optimize_with_report(prism(8, seed))
    assert not report.fallback
    assert report.after.mean_quality > report.before.mean_quality + 0.1


def roof(turn, at):
    """Two triangles that meet at an edge at which the surface turns by some degrees."""
    angle = np.radians(180 - turn)
    return np.array([[at, 0, 0], [at + 1, 0, 0], [at + 0.5, 1, 0],
                     [at + 0.5, np.cos(angle), np.sin(angle)]])


def test_a_fold_that_goes_does_not_pay_for_one_that_comes_elsewhere():
    cells = np.array([[0, 1, 2], [1, 0, 3], [4, 5, 6], [5, 4, 7]], dtype=np.int32)
    before = np.concatenate([roof(170, 0), roof(80, 5)])
    after = np.concatenate([roof(80, 0), roof(170, 5)])
    edges = surface_edges(cells, 8)
    fresh = new_folds(before, cells, edges, after, cells, edges)
    assert edges.vertices[fresh].tolist() == [[4, 5]]
    assert not new_folds(before, cells, edges, before, cells, edges).any()
    slid = before + np.array([0.01, 0, 0])
    assert not new_folds(before, cells, edges, slid, cells, edges).any()


def test_a_fold_lies_within_the_envelope_of_one_of_the_input():
    cells = np.array([[0, 1, 2], [1, 0, 3], [4, 5, 6], [5, 4, 7]], dtype=np.int32)
    before = np.concatenate([roof(170, 0), roof(80, 0) + np.array([0.1, 0, 0.3])])
    after = np.concatenate([roof(170, 0), roof(170, 0) + np.array([0.1, 0, 0.3])])
    edges = surface_edges(cells, 8)
    for envelope, count in ((0.2, 1), (0.33, 0), (0.05, 1), (1e-9, 1)):
        fresh = new_folds(before, cells, edges, after, cells, edges, envelope)
        assert edges.vertices[fresh].tolist() == [[4, 5]][:count]
    mesh = surface_mesh(before, cells)
    for envelope, count in ((0.2, 1), (0.33, 0)):
        broken = broken_surface_promises(mesh, after, cells, mesh.regions, (), envelope=envelope)
        assert len(broken) == count


def test_a_fold_at_a_flat_triangle_counts():
    """Two triangles lie on each other, with one without area between them."""
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 0, 0], [0.5, 1, 0], [0.25, 0.5, 0],
                       [0.75, 0.5, 0]])
    cells = np.array([[0, 1, 2], [1, 0, 3], [0, 2, 4], [2, 1, 5]], dtype=np.int32)
    edges = surface_edges(cells, 6)
    flat, folds = bad_places(points, cells, edges)
    assert flat.tolist() == [True, False, False, False]
    up = np.cross(points[0] - points[1], points[3] - points[1])[2]
    other = np.cross(points[2] - points[0], points[4] - points[0])[2]
    assert folds.any() == (up * other < 0)
    points[4:, 1] *= -1
    assert bad_places(points, cells, edges)[1].any() == (up * other > 0)


def test_triangles_that_share_one_vertex_may_cross():
    points = np.array([[0.0, 0, 0], [2, -1, 0], [2, 1, 0], [1, 0, -1], [1.5, 0, 1]])
    cells = np.array([[0, 1, 2], [0, 3, 4]], dtype=np.int32)
    assert crossing_triangles(points, cells).all()
    points[3, 2] = 0.5
    assert not crossing_triangles(points, cells).any()


def test_a_larger_envelope_gives_no_less():
    """Two sheets that cross at a small angle: where they do, runs come into conflict."""
    def low(x, y):
        return 0.1 * np.sin(3 * x) * np.cos(2 * y)

    def high(x, y):
        return low(x, y) + 0.002 * np.sin(9 * x) * np.sin(7 * y)

    one, two = sm.uneven_sheet(20, low, 0, 0.0), sm.uneven_sheet(20, high, 1, 0.003)
    mesh = np.concatenate([one[0], two[0]]), np.concatenate([one[1], two[1] + len(one[0])])
    means = [odt_plugins.optimize_with_report(mesh, envelope=size)[1].after.mean_quality
             for size in (1e-3, 2.5e-4)]
    assert means[0] >= means[1] - 1e-3 > 0.85
