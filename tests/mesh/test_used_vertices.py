"""Vertices that cells have, and the box around them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from odt_plugins.mesh.simplex import simplex_mesh, vertices_of


@given(arrays(st.sampled_from([np.int32, np.int64, np.float64]),
              st.tuples(st.integers(0, 9), st.integers(2, 4)), elements=st.integers(0, 40)))
def test_vertices_of_cells_are_their_sorted_set(cells):
    assert vertices_of(cells).tolist() == sorted({*cells.ravel().tolist()})


@pytest.mark.parametrize("dim", [2, 3])
def test_points_without_a_cell_do_not_count_for_the_extent(dim):
    corner = np.vstack([np.zeros(dim), np.eye(dim)])
    points = np.vstack([np.full(dim, -9.0), 2.0 * corner, np.full(dim, 99.0)])
    mesh, _ = simplex_mesh(points, np.arange(1, dim + 2)[None])
    assert mesh.used.tolist() == list(range(1, dim + 2))
    assert mesh.extent == pytest.approx(2.0 * math.sqrt(dim))
