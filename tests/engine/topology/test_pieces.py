"""Connected pieces against those of scipy."""

from __future__ import annotations

import numpy as np
import pytest

from odt_plugins.engine.topology.pieces import pieces_of
from odt_plugins.mesh.components import components


@pytest.mark.parametrize(("n", "links"), [(1, 0), (7, 0), (50, 20), (50, 60), (400, 900)])
def test_pieces_are_numbered_as_by_scipy(n, links):
    start, end = np.random.default_rng(n + links).integers(0, n, (2, links))
    assert np.array_equal(pieces_of(start, end, n), components(start, end, n))


def test_a_long_chain_is_one_piece():
    order = np.random.default_rng(5).permutation(3000)
    assert not pieces_of(order[:-1], order[1:], 3000).any()
