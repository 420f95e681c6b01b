"""Facets by their keys, sorted by any number of threads."""

from __future__ import annotations

import numpy as np
import pytest

from odt_plugins.mesh import facets


@pytest.mark.parametrize("threads", [1, 2, 3, 7])
def test_keys_are_sorted_by_any_number_of_threads(threads, monkeypatch):
    monkeypatch.setattr(facets, "SHARE", 5)
    rng = np.random.default_rng(threads)
    for size in (0, 3, 17, 1000):
        keys = rng.integers(0, 50, size).astype(np.uint64)
        expected = np.sort(keys)
        facets._sort(keys, threads)
        assert np.array_equal(keys, expected)
