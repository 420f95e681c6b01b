"""The nearest of some places against scipy's tree."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from odt_plugins.engine.topology.nearest import nearest


@pytest.mark.parametrize("kind", ["even", "flat", "dense", "far", "line"])
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("m", [1, 2, 30, 1500])
def test_the_nearest_place_is_found(m, d, kind):
    rng = np.random.default_rng(29)
    places, x = rng.random((m, d)), 1.2 * rng.random((200, d)) - 0.1
    if kind == "flat":
        places[:, -1] *= 1e-3
        x[:, -1] *= 1e-3
    elif kind == "dense":
        places, x = places**4, np.clip(x, 0.0, 1.0) ** 4
    elif kind == "far":
        places, x = places + 1e6, x + 1e6
    elif kind == "line":
        places[:, 1:] = 0.5
    gap = ((x - places[nearest(places, x)]) ** 2).sum(axis=1) ** 0.5
    assert np.allclose(gap, cKDTree(places).query(x)[0], rtol=1e-12, atol=0.0)


def test_of_several_nearest_places_the_first_is_taken():
    places = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0], [1.0, 0.0]])
    assert nearest(places, np.zeros((1, 2))).tolist() == [0]
    assert nearest(places[1:], np.array([[1.0, 0.0]])).tolist() == [3]
