"""No pass of one operation leaves a triangle worse than its bounds, or than the worst before."""

from __future__ import annotations

import numpy as np
import pytest
from surface_meshes import sphere

import odt_plugins
from odt_plugins.engine.cells.extremes import Extremes
from odt_plugins.engine.ground.replace import ROOM
from odt_plugins.engine.ground.sheet import LINE, SMOOTH
from odt_plugins.engine.retile import polish as polishing
from odt_plugins.engine.retile.passes import Passes
from odt_plugins.engine.retile.shift import slide_vertices
from odt_plugins.engine.retile.surface import resize

ROUNDING = 1e-9


def corners(points, cells):
    """Cosines (m, 3) at the corners of triangles."""
    sides = points[cells[:, [1, 2, 0]]] - points[cells]
    sides /= np.linalg.norm(sides, axis=2)[:, :, None]
    return -(sides * np.roll(sides, 1, axis=1)).sum(axis=2)


def qualities(points, cells):
    """Twice the inner by the outer radius, from the lengths of the sides."""
    sides = points[cells[:, [1, 2, 0]]] - points[cells[:, [2, 0, 1]]]
    a, b, c = np.linalg.norm(sides, axis=2).T
    return (b + c - a) * (c + a - b) * (a + b - c) / (a * b * c)


def figures(net):
    """Least radius ratio, and negatives of the largest cosines of a small and a large angle."""
    cells = net.triangles[: net.count[1]]
    cells = cells[cells[:, 0] >= 0]
    points = net.points[:, :3]
    cosine = corners(points, cells)
    return np.array([qualities(points, cells).min(), -cosine.max(), cosine.min()])


@pytest.mark.parametrize("kind", ["collapse", "flip", "shift"])
def test_a_pass_leaves_no_triangle_worse_than_allowed_or_than_all_before(kind, monkeypatch):
    rng = np.random.default_rng(4)
    points, cells = sphere(3)
    points = points * (1 + 0.05 * rng.standard_normal(len(points)))[:, None]
    wanted = np.array([0.8, -np.cos(np.radians(35.0)), np.cos(np.radians(100.0))])
    operation, seen = getattr(Passes, kind), []

    def strictly(base, sizes, reach, bounds, **options):
        return resize(base, sizes, reach, Extremes(wanted[0], -wanted[1], wanted[2]), **options)

    def watched(passes, net, *options):
        before, exchanges = figures(net), int(net.count[2])
        operation(passes, net, *options)
        seen.append((int(net.count[2]) - exchanges, before, figures(net)))

    monkeypatch.setattr("odt_plugins.engine.retile.run.resize", strictly)
    monkeypatch.setattr(Passes, kind, watched)
    odt_plugins.remesh((points, cells), scale=1.5, envelope=0.03)
    assert sum(done for done, _, _ in seen) > 100
    for _, before, after in seen:
        assert (after >= np.minimum(before, wanted) - ROUNDING).all(), (before, after)


def turns(points, cells):
    """Degrees by which a surface turns at each of its inner edges."""
    normals = np.cross(points[cells[:, 1]] - points[cells[:, 0]],
                       points[cells[:, 2]] - points[cells[:, 0]])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    ends = np.sort(cells[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2), axis=1)
    order = np.lexsort(ends.T)
    same = (ends[order[1:]] == ends[order[:-1]]).all(axis=1)
    one, other = (order[where][same] // 3 for where in (slice(1, None), slice(None, -1)))
    cosine = (normals[one] * normals[other]).sum(axis=1)
    return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))


def hairpin(rng):
    """Two plates close to each other that meet in a nose, at whose tip the surface turns by 60."""
    heading = np.radians([0.0] * 20 + [30.0, 60.0, 120.0, 150.0] + [180.0] * 20)
    step = np.where(np.isin(heading, np.radians([0.0, 180.0])), 0.05, 0.012)
    x, z = (np.concatenate([[0.0], np.cumsum(step * f(heading))]) for f in (np.cos, np.sin))
    n, across = len(x), np.linspace(0.0, 1.0, 31)
    points = np.column_stack([np.repeat(x, 31), np.tile(across, n), np.repeat(z, 31)])
    inner = (points[:, 1] > 0) & (points[:, 1] < 1)
    points[inner, 1] += 0.003 * rng.standard_normal(inner.sum())
    a = (np.arange(n - 1)[:, None] * 31 + np.arange(30)).ravel()
    return points, np.concatenate([np.column_stack([a, a + 31, a + 32]),
                                   np.column_stack([a, a + 32, a + 1])])


def test_a_surface_that_turns_little_at_its_creases_does_not_fold_back_there():
    points, cells = hairpin(np.random.default_rng(2))
    assert 40 < turns(points, cells).max() < 70
    (new, triangles), report = odt_plugins.remesh_with_report(
        (points, cells), scale=2, envelope=1e-2)
    assert "folds" not in (report.fallback or "")
    assert turns(new, triangles).max() < 120
    assert len(triangles) < 0.5 * len(cells)


def test_descents_that_would_fold_a_surface_leave_the_vertices_there(monkeypatch):
    points, cells = hairpin(np.random.default_rng(2))
    run, held = polishing._polished, []

    def folding(net, rules, metric, edges, folded):
        sheet, mark = run(net, rules, metric, edges, folded)
        held.append(int(folded.sum()))
        if len(held) == 1:
            smooth = (net.kind[sheet.triangles] == SMOOTH).all(axis=1)
            t = sheet.triangles[np.flatnonzero(smooth)[0]]
            a, b, c = sheet.points[t]
            sheet.points[t[0]] = b + c - a
        return sheet, mark

    monkeypatch.setattr(polishing, "_polished", folding)
    (new, triangles), report = odt_plugins.remesh_with_report(
        (points, cells), scale=1, envelope=1e-3)
    assert len(held) == 2
    assert held[1] > held[0]
    assert report.fallback is None
    assert turns(new, triangles).max() < 120


def test_a_vertex_with_more_triangles_than_there_is_room_for_stays_on_its_line(monkeypatch):
    count, moved, split = 2 * ROOM, [], Passes.split
    angle, j = 2 * np.pi * np.arange(count) / count, np.arange(count)
    points = np.concatenate([[[0.0, 0.0]], np.stack([np.cos(angle), np.sin(angle)], axis=1)])
    cells = np.stack([0 * j, 1 + j, 1 + (j + 1) % count], axis=1)

    def slid(passes, net, bounds):
        if not moved:
            hub = np.bincount(net.triangles[: net.count[1]].ravel()).argmax()
            assert net.kind[hub] == LINE
            goals = np.full(len(net.points), np.nan)
            goals[hub] = net.place[hub] + 0.3 * net.size[hub]
            moved.append(slide_vertices(net, passes.rules, goals, passes.room))
        return split(passes, net, bounds)

    monkeypatch.setattr(Passes, "split", slid)
    odt_plugins.remesh((points, cells, (j >= count // 2).astype(int)), scale=1, envelope=1e-2)
    assert moved == [0]
