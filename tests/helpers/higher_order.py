"""Meshes of cubic and quartic cells made node by node, by plain slow code."""

from __future__ import annotations

from collections import Counter
from itertools import combinations

import numpy as np


def raised(points, cells, shape, off=0.05):
    """Nodes, cells with all nodes of a lattice, and the place of every node.

    Nodes of the boundary lie beside their place, by up to `off`. A place is a set of pairs of a
    corner and its weight.
    """
    dim = cells.shape[1] - 1
    order = int(shape[0, 0])
    owners = Counter(f for c in cells.tolist() for f in combinations(sorted(c), dim))
    rim = sides(f for f, count in owners.items() if count == 1)
    nodes, rows = list(points), []
    places = {frozenset([(i, order)]): i for i in range(len(points))}
    for cell in cells.tolist():
        row = []
        for weights in shape.tolist():
            place = frozenset((v, w) for v, w in zip(cell, weights, strict=True) if w)
            if place not in places:
                places[place] = len(nodes)
                x = sum(w * points[v] for v, w in place) / order
                on_rim = frozenset(v for v, _ in place) in rim
                nodes.append(x + on_rim * off * np.sin(len(nodes) + np.arange(len(x))))
            row.append(places[place])
        rows.append(row)
    return np.array(nodes), np.array(rows), places


def sides(facets):
    """All sets of vertices of the facets."""
    return {frozenset(part) for facet in facets for k in range(1, len(facet) + 1)
            for part in combinations(facet, k)}


def places_of(rows, shape):
    """Node of every place; fails where a place has two, or a node two places."""
    found = {}
    corners = shape.shape[1]
    for row in np.asarray(rows).tolist():
        for node, weights in zip(row, shape.tolist(), strict=True):
            place = frozenset((v, w) for v, w in zip(row[:corners], weights, strict=True) if w)
            assert found.setdefault(place, node) == node
    assert len(set(found.values())) == len(found)
    return found
