"""Facets by their keys, sorted by any number of threads."""

from __future__ import annotations

from collections import Counter
from itertools import combinations

import numpy as np
import pytest
import tet_meshes as tm

from odt_plugins.mesh import chunks, facets


@pytest.mark.parametrize("threads", [1, 2, 3, 7])
def test_keys_are_sorted_by_any_number_of_threads(threads, monkeypatch):
    monkeypatch.setattr(facets, "SHARE", 5)
    rng = np.random.default_rng(threads)
    for size in (0, 3, 17, 1000):
        keys = rng.integers(0, 50, size).astype(np.uint64)
        expected = np.sort(keys)
        facets._sort(keys, threads)
        assert np.array_equal(keys, expected)


@pytest.mark.parametrize("length", [1, 2, 7, 5000])
def test_uneven_facets_are_found_in_chunks_of_any_length(length, monkeypatch):
    monkeypatch.setattr(chunks, "CHUNK", length)
    cells = tm.grid(2, 3)[1]
    cells = np.concatenate([cells[1:], cells[5:7]])
    sides = Counter()
    for cell in cells.tolist():
        for facet in ([1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]):
            vertices = [cell[i] for i in facet]
            turned = sum(a > b for a, b in combinations(vertices, 2)) % 2
            sides[tuple(sorted(vertices)), turned] += 1
    crowded = [list(facet) for facet, side in sides for _ in range(sides[facet, side] - 1)]
    lone = [list(facet) for facet, side in sides if (facet, 1 - side) not in sides]
    found = facets.uneven_facets(cells, int(cells.max()) + 1)
    assert sorted(found.crowded.tolist()) == sorted(crowded)
    assert {*map(tuple, lone)} <= {*map(tuple, found.open.tolist())}
    assert {*map(tuple, found.open.tolist())} <= {*map(tuple, lone), *map(tuple, crowded)}
    assert len(crowded) == 8
    assert len(lone) > 40
