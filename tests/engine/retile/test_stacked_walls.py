"""Surfaces of stacked bodies with thin walls between planes that have room for larger triangles."""

from __future__ import annotations

import numpy as np
import pytest

import odt_plugins


def stacked(n, heights):
    """Points and triangles of stacked boxes of side 1; planes between two boxes are there once."""
    level = np.concatenate([[0.0], np.cumsum(heights)])
    layers = len(heights)
    i, j, k = np.meshgrid(np.arange(n + 1), np.arange(n + 1), np.arange(layers + 1), indexing="ij")
    points = np.stack([i.ravel() / n, j.ravel() / n, level[k.ravel()]], axis=1)

    def at(i, j, k):
        return ((n + 1) * i + j) * (layers + 1) + k

    quads = []
    for a in range(n):
        for b in range(n):
            for c in range(layers + 1):
                quad = [at(a, b, c), at(a + 1, b, c), at(a + 1, b + 1, c), at(a, b + 1, c)]
                quads.append(quad if c else quad[::-1])
        for c in range(layers):
            for end, turn in ((0, 1), (n, -1)):
                quad = [at(a, end, c), at(a + 1, end, c), at(a + 1, end, c + 1), at(a, end, c + 1)]
                quads.append(quad[::turn])
                quad = [at(end, a, c), at(end, a + 1, c), at(end, a + 1, c + 1), at(end, a, c + 1)]
                quads.append(quad[::-turn])
    quads = np.array(quads)
    return points, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def quality(points, triangles):
    """Radius ratios of triangles, 1 for regular ones."""
    x = points[triangles]
    a, b, c = np.linalg.norm(x - x[:, [1, 2, 0]], axis=2).T
    return (b + c - a) * (c + a - b) * (a + b - c) / (a * b * c)


def on_planes(points, triangles):
    """Mark the triangles in planes of one height."""
    return np.ptp(points[triangles, 2], axis=1) < 1e-9


@pytest.mark.parametrize(("n", "heights"), [(4, [0.001] * 3), (4, [0.0005] * 2)])
def test_walls_that_stay_leave_the_planes_between_them_free(n, heights):
    points, triangles = stacked(n, heights)
    new, rows = odt_plugins.remesh((points, triangles), 2.0 / n)
    before = quality(points, triangles)[on_planes(points, triangles)]
    after = quality(new, rows)[on_planes(new, rows)]
    assert after.mean() > before.mean() + 0.03
    assert quality(new, rows).min() > 0.999 * quality(points, triangles).min()


def test_a_few_short_lines_do_not_make_many_times_as_many_triangles():
    points, triangles = stacked(4, [0.0005] * 2)
    _, rows = odt_plugins.remesh((points, triangles), 0.5, keep=())
    assert len(rows) < 10 * len(triangles)
