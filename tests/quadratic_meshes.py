"""Quadratic meshes made node by node, and what is checked of them, all by plain slow code."""

from __future__ import annotations

import contract
import numpy as np

EDGES = {2: [(0, 1), (1, 2), (2, 0)], 3: [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]}


def quadratic_grid(dim, n=4, shuffle=True):
    """Nodes, cells with mid-nodes (as VTK orders them) and labels; boundary mid-nodes are off.

    With `shuffle` corners and mid-nodes are numbered in any order.
    """
    points, cells, labels = contract.grid(dim, n)
    outer = contract.facets(cells, np.zeros(len(cells), int))
    rim = {(a, b) for f in outer for a in f for b in f if a < b}
    nodes = list(points)
    mid = {}
    rows = []
    for cell in cells.tolist():
        row = list(cell)
        for i, j in EDGES[dim]:
            edge = tuple(sorted((cell[i], cell[j])))
            if edge not in mid:
                mid[edge] = len(nodes)
                middle = (points[edge[0]] + points[edge[1]]) / 2
                off = 0.02 if edge in rim else 0.0
                nodes.append(middle + off * np.sin(np.arange(1, dim + 1) * (1 + edge[0])))
            row.append(mid[edge])
        rows.append(row)
    nodes, rows = np.array(nodes), np.array(rows)
    if shuffle:
        place = np.random.default_rng(3).permutation(len(nodes))
        nodes = nodes[np.argsort(place)]
        rows = place[rows]
    return nodes, rows, labels


def edges_of(rows, dim):
    """Mid-node of every edge, by its corners; fails where an edge has two."""
    found = {}
    for row in np.asarray(rows).tolist():
        for (i, j), node in zip(EDGES[dim], row[dim + 1 :], strict=True):
            edge = tuple(sorted((row[i], row[j])))
            assert found.setdefault(edge, node) == node
    assert len(set(found.values())) == len(found)
    return found
