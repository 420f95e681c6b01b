"""What the last descents make of a resized surface, and that they leave lines as they are."""

from __future__ import annotations

import numpy as np
import pytest
from surface_meshes import cube, cylinder, torus

import odt_plugins
from odt_plugins.engine.cells.extremes import FREELY
from odt_plugins.engine.retile import surface as resizing
from odt_plugins.engine.retile.surface import Base, resize
from odt_plugins.mesh.surface import surface_edges


def qualities(points, cells):
    """Twice the inner by the outer radius, from the lengths of the sides."""
    sides = points[cells[:, [1, 2, 0]]] - points[cells[:, [2, 0, 1]]]
    a, b, c = np.linalg.norm(sides, axis=2).T
    return (b + c - a) * (c + a - b) * (a + b - c) / (a * b * c)


def least_angles(points, cells):
    """Degrees, the least of every triangle, by the law of cosines."""
    sides = points[cells[:, [1, 2, 0]]] - points[cells[:, [2, 0, 1]]]
    a, b, c = np.sort(np.linalg.norm(sides, axis=2), axis=1).T
    return np.degrees(np.arccos((b * b + c * c - a * a) / (2 * b * c)))


def nets(monkeypatch, points, triangles, scale, reach=0.02):
    """The net of a surface before and after the last descents."""
    before = []
    whole = resizing.polish

    def watched(net, rules, metric):
        before.append(net._replace(
            **{name: np.copy(array) for name, array in net._asdict().items()}))
        whole(net, rules, metric)

    monkeypatch.setattr(resizing, "polish", watched)
    triangles = triangles.astype(np.int32)
    edges = surface_edges(triangles, len(points))
    length = np.linalg.norm(np.diff(points[edges.vertices], axis=1)[:, 0], axis=1).mean()
    none = np.zeros(len(edges.degree), dtype=np.bool_)
    base = Base(np.pad(points, ((0, 0), (0, 3 - points.shape[1]))), triangles,
                np.zeros(len(triangles), np.int32), edges, np.zeros(len(points), np.bool_),
                none, none, np.zeros((len(points), 0)), 0.0)
    net, _ = resize(base, np.full(len(points), scale * length),
                    np.broadcast_to(reach, len(triangles)).copy(), FREELY, feature_angle=40.0)
    return before[0], net


def unevenness(net):
    """Sum over the vertices on no line of what their triangles differ from 6 by."""
    cells = net.triangles[: net.count[1]]
    degree = np.bincount(cells.ravel(), minlength=net.count[0])
    return np.abs(degree[(net.kind[: net.count[0]] == 0) & (degree > 0)] - 6).sum()


@pytest.mark.parametrize("shape", ["torus", "cylinder"])
def test_defects_annihilate_and_f_2_falls(monkeypatch, shape):
    points, cells = torus() if shape == "torus" else cylinder()
    before, after = nets(monkeypatch, points, cells, 0.8)
    assert unevenness(after) < 0.9 * unevenness(before)
    q = [qualities(net.points[:, :3], net.triangles[: net.count[1]]) for net in (before, after)]
    assert (q[1] ** -2).sum() < (q[0] ** -2).sum()
    assert q[1].mean() > 0.97


def test_edges_on_lines_stay_and_keep_their_line(monkeypatch):
    def lines(net):
        cells, marks = net.triangles[: net.count[1]], net.marks[: net.count[1]]
        row, corner = np.nonzero(marks >= 0)
        ends = cells[row[:, None], (corner[:, None] + [1, 2]) % 3]
        return np.unique(np.column_stack([np.sort(ends, axis=1), marks[row, corner]]), axis=0)

    before, after = nets(monkeypatch, *cube(6), 0.7)
    assert (lines(before) == lines(after)).all()
    on = before.kind != 0
    assert (before.points[on] == after.points[on]).all()
    assert (before.points[~on] != after.points[~on]).any()
    # A cube has twelve edges of length 1.
    _, number = np.unique(lines(after)[:, 2], return_inverse=True)
    ends = after.points[lines(after)[:, :2], :3]
    length = np.bincount(number, np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1))
    assert len(length) == 12
    assert length == pytest.approx(length[0])


def test_vertices_stay_where_the_envelope_is_narrower(monkeypatch):
    points, cells = torus()
    left = points[cells, 0].mean(axis=1) < 0
    before, after = nets(monkeypatch, points, cells, 0.8, np.where(left, 0.01, 0.02))
    alive = np.unique(after.triangles[: after.count[1]])
    moved = (before.points != after.points).any(axis=1)[alive]
    there = left[before.foot[alive]]
    assert there.sum() > 100
    assert not moved[there].any()
    assert moved[~there].mean() > 0.8


def test_sizes_beyond_the_chords_of_a_surface_are_not_tried():
    points, cells = torus()
    diagonal = np.linalg.norm(np.ptp(points, axis=0))
    made, report = odt_plugins.remesh_with_report((points, cells), 0.3 * diagonal, envelope=2e-3)
    new, triangles = made
    assert least_angles(new, triangles).min() > 30
    assert np.quantile(qualities(new, triangles), 0.01) > 0.75
    assert any("the envelope allows no longer edges" in note for note in report.notes)


def test_a_flat_surface_in_space_takes_any_size():
    points, cells = cube(8)
    _, report = odt_plugins.remesh_with_report((points, cells), 0.5, envelope=1e-3)
    assert not any("no longer edges" in note for note in report.notes)
