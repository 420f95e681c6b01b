"""The step of stage 1 that every pair of method and solver has."""

from __future__ import annotations

import numpy as np
import planar_meshes as planar
import pytest

from odt_plugins.engine.odt.rounds import STEPS, position_step
from odt_plugins.engine.topology.stencil import make_topology
from odt_plugins.options import Options


def stepped(method, solver, *, inverse_volume):
    points, cells, boundary = planar.jittered_grid(6, 6, np.random.default_rng(3))
    topology = make_topology(cells, ~boundary, boundary)
    options = Options(method=method, solver=solver)
    return position_step(points, topology, None, options, inverse_volume)[0]


@pytest.mark.parametrize(("method", "solver"), list(STEPS))
def test_cells_that_count_alike_are_heeded_where_cells_are_weighed(method, solver):
    alike = stepped(method, solver, inverse_volume=True)
    weighed = stepped(method, solver, inverse_volume=False)
    assert np.array_equal(alike, weighed) == (method == "laplacian")


def test_no_two_steps_are_the_same():
    results = [stepped(*pair, inverse_volume=False).tobytes() for pair in STEPS]
    assert len(set(results)) == len(STEPS)
