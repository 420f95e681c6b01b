"""Coarser triangles beside thin layers, whose poor triangles become no fewer."""

from __future__ import annotations

import numpy as np
import pytest

import odt_plugins
from odt_plugins.engine.retile import run
from odt_plugins.figures import summarize
from odt_plugins.mesh.simplex import simplex_mesh
from odt_plugins.options import KEPT
from odt_plugins.promise.good import fallen_since, filled_up


def layered(tilt):
    """A square with two thin layers along its middle, labelled 1 and 2, in the plane or tilted."""
    x = np.linspace(0.0, 1.0, 17)
    y = np.concatenate([np.linspace(0.0, 1.0, 17), [1.015, 1.03], np.linspace(1.03, 2.03, 17)[1:]])
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    i, j = np.meshgrid(np.arange(len(x) - 1), np.arange(len(y) - 1), indexing="ij")
    a = (len(y) * i + j).ravel()
    b, c, d = a + len(y), a + len(y) + 1, a + 1
    odd = ((i + j) % 2 == 1).ravel()
    cells = np.concatenate([
        np.where(odd[:, None], np.stack([a, b, c], 1), np.stack([a, b, d], 1)),
        np.where(odd[:, None], np.stack([a, c, d], 1), np.stack([b, c, d], 1))]).astype(np.int32)
    middle = points[cells][:, :, 1].mean(axis=1)
    labels = np.where(middle < 1.0, 0, np.where(middle < 1.015, 1, np.where(middle < 1.03, 2, 3)))
    if tilt:
        points = points @ np.array([[0.6, 0.0, 0.8], [0.0, 1.0, 0.0]])
    return points, cells, labels


def poor(points, cells):
    """Mark the triangles that have an angle below 20 degrees."""
    x = points[cells]
    sides = np.linalg.norm(x - x[:, [1, 2, 0]], axis=2)
    a, b, c = np.sort(sides, axis=1).T
    return np.degrees(np.arccos((b**2 + c**2 - a**2) / (2.0 * b * c))) < 20.0


def area(points, cells):
    """Sum of the areas of triangles by Heron's formula."""
    x = points[cells]
    sides = np.linalg.norm(x - x[:, [1, 2, 0]], axis=2)
    half = sides.sum(axis=1) / 2
    return np.sqrt(half * (half[:, None] - sides).prod(axis=1)).sum()


@pytest.mark.parametrize("tilt", [False, True])
@pytest.mark.parametrize("wish", [{"scale": 2.0}, {"scale": 1.6}])
def test_a_mesh_with_thin_layers_becomes_coarser(wish, tilt):
    points, cells, labels = layered(tilt)
    (new, rows, parts), report = odt_plugins.remesh_with_report(
        (points, cells, labels), free="layers", **wish)
    assert len(rows) < 0.6 * len(cells)
    assert 0 < poor(new, rows).sum() <= poor(points, cells).sum()
    assert report.after.min_angle >= report.before.min_angle * (1.0 - 1e-9)
    assert any("good ones fewer: " in note and "share_below_20 rose" in note
               for note in report.notes)
    for label in range(4):
        assert area(new, rows[parts == label]) == pytest.approx(
            area(points, cells[labels == label]), rel=1e-9)


def test_nothing_is_resized_twice(monkeypatch):
    given, resize = [], run.resize

    def noted(base, sizes, reach, *more, **options):
        given.append(b"".join(a.tobytes() for a in (base.triangles, base.fixed, sizes, reach)))
        return resize(base, sizes, reach, *more, **options)

    monkeypatch.setattr(run, "resize", noted)
    _, report = odt_plugins.remesh_with_report(layered(tilt=False), scale=2.0, free="layers")
    assert any("good ones fewer: " in note for note in report.notes)
    assert len(set(given)) == len(given) > 1


def test_figures_that_are_named_do_not_fall_beside_thin_layers():
    _, report = odt_plugins.remesh_with_report(
        layered(tilt=False), scale=2.0, free="layers", keep=("share_below_20",))
    assert report.after.share_below_20 <= report.before.share_below_20


def test_filled_up_figures_fall_where_more_are_poor_and_not_where_good_ones_are_gone():
    points, cells, _ = layered(tilt=False)
    mesh, _ = simplex_mesh(points, cells)
    thin, none = mesh.cells[poor(points, mesh.cells)], np.zeros((0, 0))
    for rows, falls in ((thin[::2], False), (thin, False), (np.tile(thin, (2, 1)), True)):
        assert summarize(*filled_up(points, rows, len(cells))).n_cells == len(cells)
        assert bool(fallen_since(mesh, points, rows, none, KEPT, full=len(cells))) is falls
        assert fallen_since(mesh, points, rows, none, KEPT)
