"""Quantiles: those of numpy."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from odt_plugins.mesh.quantiles import between, quantile

NUMBERS = st.floats(-1e300, 1e300)
SHARES = st.one_of(st.sampled_from([0.0, 0.01, 0.5, 1.0]), st.floats(0.0, 1.0))


@given(st.lists(NUMBERS, min_size=1, max_size=40), SHARES)
def test_a_quantile_is_that_of_numpy(values, share):
    x = np.array(values)
    with np.errstate(over="ignore", invalid="ignore"):
        expected = np.quantile(x, share)
    assert np.array_equal(quantile(x, share), expected, equal_nan=True)
    assert x.tolist() == values


@given(st.lists(NUMBERS, max_size=5), SHARES)
def test_where_a_value_is_no_number_neither_is_the_quantile(values, share):
    assert np.isnan(quantile(np.array([*values, np.nan]), share))


@given(NUMBERS, NUMBERS)
def test_both_ends_are_reached(a, b):
    if abs(b - a) < np.inf:
        assert (between(a, b, 0.0), between(a, b, 1.0)) == (a, b)
