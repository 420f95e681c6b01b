"""Other sizes for surfaces with edges that have no length but for rounding."""

from __future__ import annotations

import numpy as np
import pytest
from surface_meshes import sphere

import odt_plugins
import odt_plugins.engine.remesh.triangles as remesh_triangles
from odt_plugins.engine.remesh.weld import welded
from odt_plugins.engine.run.outcome import unchanged
from odt_plugins.mesh.surface import surface_edges, surface_mesh


def drum(twins, sides=24, away=1e-17):
    """A long cylinder of needles, with fans at its ends; some lines of it are there twice."""
    number = np.sort(np.r_[np.arange(sides), twins])
    angle = 2 * np.pi * number / sides
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    circle[1:][np.diff(number) == 0, 1] += away
    k = len(number)
    points = np.concatenate([np.c_[circle, np.zeros(k)], np.c_[circle, np.full(k, 5.0)],
                             [[0, 0, 0], [0, 0, 5.0]]])
    i, j = np.arange(k), (np.arange(k) + 1) % k
    cells = np.concatenate([np.c_[i, j, k + j], np.c_[i, k + j, k + i],
                            np.c_[j, i, np.full(k, 2 * k)],
                            np.c_[k + i, k + j, np.full(k, 2 * k + 1)]])
    return points, cells.astype(np.int32)


def least_angle(points, cells):
    x = points[cells]
    u, v = x[:, [1, 2, 0]] - x, x[:, [2, 0, 1]] - x
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(u, v), axis=2), (u * v).sum(axis=2))).min()


def euler(cells):
    return len(np.unique(cells)) - len(surface_edges(cells, int(cells.max()) + 1).vertices) + len(
        cells)


@pytest.mark.parametrize("size", [0.2, 0.5])
def test_edges_without_length_spoil_no_sizes(size):
    twins = [3, 4, 11]
    points, cells = drum(twins)
    (new, rows), report = odt_plugins.remesh_with_report((points, cells), size, envelope=2e-3)
    (plain, few), _ = odt_plugins.remesh_with_report(drum([]), size, envelope=2e-3)
    assert report.fallback is None
    assert least_angle(new, rows) > 0.8 * least_angle(plain, few) > 10
    assert len(rows) == pytest.approx(len(few), rel=0.1)
    assert euler(rows) == 2


@pytest.mark.parametrize("of_cells", [False, True])
def test_lengths_for_vertices_and_for_cells_stay_with_theirs(of_cells):
    counts = []
    for twins in ([3], []):
        points, cells = drum(twins)
        at = 0.2 + 0.1 * points[:, 2]
        sizes = at[cells].mean(axis=1) if of_cells else at
        counts.append(len(odt_plugins.remesh((points, cells), sizes, envelope=1e-2)[1]))
    assert counts[0] == pytest.approx(counts[1], rel=0.1)


def test_only_what_may_be_one_is():
    points, cells = drum([3, 4, 11])
    small = welded(surface_mesh(points, cells))
    assert len(points) - len(small.kept) == 6
    assert (~small.left).sum() == 12
    assert euler(small.mesh.cells) == 2
    assert np.array_equal(small.mesh.points, points[small.kept])
    assert welded(surface_mesh(*drum([]))) is None
    assert welded(surface_mesh(*sphere(2))) is None
    assert welded(surface_mesh(points, cells, fixed=np.arange(len(points)))) is None
    labels = np.arange(len(cells))
    assert welded(surface_mesh(points, cells, regions=labels)) is None
    assert welded(surface_mesh(points, cells[: 2 * 27])) is None


def test_an_edge_stays_whose_ends_cannot_be_one():
    points, cells = drum([3])
    k = len(points) // 2 - 1
    for a, b, c in ((4, 3, 2 * k), (k + 3, k + 4, 2 * k + 1)):
        row = np.flatnonzero((cells == [a, b, c]).all(axis=1))
        middle = len(points)
        cells = np.concatenate([np.delete(cells, row, axis=0), np.array(
            [[a, b, middle], [b, c, middle], [c, a, middle]], dtype=np.int32)])
        points = np.concatenate([points, points[[[a, b, c]]].mean(axis=1)])
    assert welded(surface_mesh(points, cells)) is None
    assert euler(odt_plugins.remesh((points, cells), 0.5)[1]) == 2


def test_a_vertex_that_is_fixed_is_the_one_that_stays():
    points, cells = drum([3])
    twins = np.flatnonzero(np.linalg.norm(np.diff(points, axis=0), axis=1) < 1e-9)
    for first in (0, 1):
        fixed = twins + first
        small = welded(surface_mesh(points, cells, fixed=fixed))
        assert np.isin(fixed, small.kept).all()
        assert len(small.kept) == len(points) - len(twins)
        new, _ = odt_plugins.remesh((points, cells), 0.5, envelope=1e-2, fixed=fixed)
        assert (np.abs(new[:, None] - points[fixed]).max(axis=2) == 0).any(axis=0).all()


def test_where_the_smaller_surface_stays_the_mesh_does(monkeypatch):
    points, cells = drum([3])
    monkeypatch.setattr(
        remesh_triangles, "retile", lambda mesh, *_, **__: unchanged(mesh, "it must"))
    (new, rows), report = odt_plugins.remesh_with_report((points, cells), 0.5)
    assert np.array_equal(new, points)
    assert np.array_equal(rows, cells)
    assert report.stop_reason == "it must"


def test_the_ends_stay_apart_where_feature_lines_are_fixed():
    points, cells = drum([3])
    new, _ = odt_plugins.remesh((points, cells), 2.0, envelope=1e-2, boundary="fixed")
    for vertex in points[:50]:
        assert (new == vertex).all(axis=1).sum() == (points == vertex).all(axis=1).sum()
