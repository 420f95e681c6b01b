"""The step of stage 1 that every pair of method and solver has, and when its rounds end."""

from __future__ import annotations

import numpy as np
import planar_meshes as planar
import pytest
import tet_meshes as tm

from odt_plugins.engine.cells.extremes import Bounds, Extremes
from odt_plugins.engine.odt.density import make_density
from odt_plugins.engine.odt.rounds import STEPS, Log, position_step, smooth
from odt_plugins.engine.topology.complex import make_complex
from odt_plugins.engine.topology.stencil import make_topology
from odt_plugins.options import Options


def stepped(method, solver, *, inverse_volume):
    points, cells, boundary = planar.jittered_grid(6, 6, np.random.default_rng(3))
    topology = make_topology(cells, ~boundary, boundary)
    options = Options(method=method, smoothing={"solver": solver})
    return position_step(points, topology, None, options, inverse_volume)[0]


@pytest.mark.parametrize(("method", "solver"), list(STEPS))
def test_cells_that_count_alike_are_heeded_where_cells_are_weighed(method, solver):
    alike = stepped(method, solver, inverse_volume=True)
    weighed = stepped(method, solver, inverse_volume=False)
    assert np.array_equal(alike, weighed) == (method == "laplacian")


def test_no_two_steps_are_the_same():
    results = [stepped(*pair, inverse_volume=False).tobytes() for pair in STEPS]
    assert len(set(results)) == len(STEPS)


def test_vertices_without_a_cell_do_not_keep_stage_1_from_its_end():
    points, cells = tm.ball(700, 3)
    every = Extremes(0.0, 1.0, -1.0)
    ended = []
    for lone in (0, 5000):
        x = np.concatenate([points, np.zeros((lone, 3))])
        locked = np.ones(len(x), dtype=bool)
        locked[: len(points)] = ~tm.interior(points, cells)
        mesh = make_complex(
            x, cells.astype(np.int32), np.zeros(len(cells), dtype=np.int32), locked, locked.copy())
        used = mesh.cells[: mesh.used], mesh.neighbors[: mesh.used]
        density = make_density("uniform", None, x, *used)
        log = Log()
        mesh, _ = smooth(mesh, density, Options(), Bounds(every, every), log, lambda _: None)
        ended.append((len(log.energy), mesh.points[: len(points)].tobytes()))
    assert ended[0] == ended[1]
    assert ended[0][0] < Options().smoothing.rounds
