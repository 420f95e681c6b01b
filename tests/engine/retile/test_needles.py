"""Surfaces of CAD: caps cut into ears, and needles from edge to edge, become good triangles."""

from __future__ import annotations

import numpy as np
import pytest

import odt_plugins
from odt_plugins.engine.ground.features import find_features
from odt_plugins.engine.ground.feet import reaching
from odt_plugins.engine.topology.star import vertex_stars
from odt_plugins.mesh.surface import surface_edges


def cone(sections):
    """A cone whose cap has no vertex inside, cut into ears one after the other."""
    around = 2 * np.pi * np.arange(sections) / sections
    points = np.vstack([np.c_[0.5 * np.cos(around), 0.5 * np.sin(around), np.zeros(sections)],
                        [[0, 0, 1]]]).astype(np.float32).astype(np.float64)
    side = [[i, (i + 1) % sections, sections] for i in range(sections)]
    left, cap = list(range(sections)), []
    while len(left) > 2:
        for k in range(0, len(left) - 2, 2):
            cap.append([left[k + 2], left[k + 1], left[k]])
        left = [v for k, v in enumerate(left) if k % 2 == 0 or k == len(left) - 1]
    return points, np.array(side + cap, dtype=np.int32)


def fans(sections, tip):
    """A cylinder, or with a tip a cone, of needles; those of flat ends meet in the middle."""
    around = 2 * np.pi * np.arange(sections) / sections
    ring, k = np.c_[np.cos(around), np.sin(around)], np.arange(sections)
    after, foot, top = (k + 1) % sections, np.full(sections, 2 * sections), 0 * k + 2 * sections + 1
    points = np.vstack([np.c_[ring, 0 * k], np.c_[ring, 0 * k + 2.0], [[0, 0, 0], [0, 0, 2.0]]])
    ends = [np.c_[after, k, foot]]
    if tip:
        side = [np.c_[k, after, top]]
    else:
        ends.append(np.c_[sections + k, sections + after, top])
        side = [np.c_[k, after, sections + after], np.c_[k, sections + after, sections + k]]
    used, cells = np.unique(np.concatenate(side + ends), return_inverse=True)
    return points[used], cells.reshape(-1, 3).astype(np.int32)


def quality(points, cells):
    a, b, c = (np.linalg.norm(points[cells[:, i]] - points[cells[:, j]], axis=1)
               for i, j in ((0, 1), (1, 2), (2, 0)))
    return (b + c - a) * (c + a - b) * (a + b - c) / (a * b * c)


@pytest.mark.parametrize(("size", "mean"), [(0.1, 0.75), (0.05, 0.9), (0.02, 0.9)])
def test_a_cap_without_vertices_inside_gets_good_triangles(size, mean):
    points, cells = cone(40)
    assert quality(points, cells).min() < 0.02
    (made, new), report = odt_plugins.remesh_with_report((points, cells), size)
    assert report.fallback is None
    found = quality(made, new)
    assert found.min() > 0.3
    assert found.mean() > mean
    cap = new[(np.abs(made[new][:, :, 2]) < 1e-6).all(axis=1)]
    x = made[cap]
    area = np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1).sum() / 2
    assert area == pytest.approx(20 * 0.25 * np.sin(2 * np.pi / 40), rel=0.02)
    assert len(cap) > 0.5 * area / (size * size * 3**0.5 / 4)


def test_ears_are_in_the_plane_of_their_cap_and_the_rim_is_a_crease():
    points, cells = cone(40)
    edges = surface_edges(cells, len(points))
    found = find_features(points, cells, edges, vertex_stars(cells, len(points)), angle=40.0,
                          fixed=np.zeros(len(points), dtype=np.bool_))
    sharp = {tuple(pair) for pair in edges.vertices[found.edges].tolist()}
    assert sharp == {tuple(sorted((i, (i + 1) % 40))) for i in range(40)}


def test_every_triangle_has_a_foot_on_its_own_piece():
    _, cells = cone(40)
    patch = (np.arange(len(cells)) >= 40).astype(np.int32)
    foot = np.append(np.arange(40), 0).astype(np.int32)
    assert not (patch[foot[cells[40:]]] == 1).any()
    found = reaching(cells, foot, patch)
    assert (patch[found[cells]] == patch[:, None]).any(axis=1).all()
    assert all(v in cells[t] for v, t in enumerate(found.tolist()))
    assert reaching(cells, found, patch) is found


@pytest.mark.parametrize(("sections", "tip", "asked", "least"), [
    (400, False, {"size": 0.1}, 0.8), (400, False, {"scale": 1.0}, 0.7),
    (48, True, {"scale": 1.0}, 0.6),
    (200, True, {"size": 0.2}, 0.4), (48, True, {"size": "curvature"}, 0.6),
    (48, True, {"size": "curvature", "envelope": 1e-2}, 0.8),
    (200, True, {"size": "curvature", "envelope": 1e-2}, 0.8)])
def test_needles_that_meet_in_tips_become_good_triangles(sections, tip, asked, least):
    points, cells = fans(sections, tip)
    assert quality(points, cells).mean() < 0.2
    (made, new), report = odt_plugins.remesh_with_report((points, cells), **asked)
    assert report.fallback is None
    found = quality(made, new)
    assert found.min() > least
    assert found.mean() > 0.93


def spiked(n, length):
    """A bent square of n x n squares, with one needle on its rim."""
    at = np.linspace(0.0, 1.0, n + 1)
    x, y = np.meshgrid(at, at, indexing="ij")
    number = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = (number[i : n + i, j : n + j].ravel() for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))
    ends = number[-1, n // 2 : n // 2 + 2]
    points = np.vstack([np.column_stack([x.ravel(), y.ravel(), 0.1 * x.ravel() ** 2]),
                        [1.0 + length, y[-1, n // 2 : n // 2 + 2].mean(), 0.1]])
    needle = [[ends[0], len(points) - 1, ends[1]]]
    return points, np.concatenate([np.c_[a, b, c], np.c_[a, c, d], needle]).astype(np.int32)


@pytest.mark.parametrize(("keep", "scale", "cells"), [
    ("p1_quality", 0.7, (900, 1500)), ("p1_quality", 1.6, (200, 400)),
    ("share_below_20", 0.7, (900, 1500))])
def test_where_more_cells_would_be_bad_the_input_stays_there_alone(keep, scale, cells):
    given = spiked(18, 2.0)
    before = quality(*given)
    (made, new), report = odt_plugins.remesh_with_report(given, scale=scale, keep=(keep,))
    assert cells[0] < len(new) < cells[1]
    assert keep in report.fallback
    found = quality(made, new)
    assert np.quantile(found, 0.01) > min(np.quantile(before, 0.01), 0.5)
    assert (found < 0.1).sum() <= (before < 0.1).sum()
