"""Parts of a mesh: what rests, what is joined, and where the worst cells are looked for."""

from __future__ import annotations

import numpy as np
import tet_meshes

from odt_plugins.compare.start import ball
from odt_plugins.engine.run.plan import run
from odt_plugins.engine.run.within import Within
from odt_plugins.engine.topology.complex import make_complex
from odt_plugins.engine.topology.part import around, away_from, joined
from odt_plugins.mesh.simplex import simplex_mesh
from odt_plugins.options import Options
from odt_plugins.promise.volume import broken_promises


def rows(cells, regions):
    return sorted((*sorted(row), label) for row, label in
                  zip(cells.tolist(), regions.tolist(), strict=True))


def test_a_part_has_the_cells_without_some_vertices_and_locks_those_of_the_others():
    start = ball(300)
    regions = (np.arange(len(start.cells)) % 3).astype(np.int32)
    n = len(start.points)
    locked, rim = np.arange(n) % 7 == 0, np.arange(n) % 14 == 0
    whole = make_complex(start.points, start.cells, regions, locked, rim)
    some = start.points[:, 2] > 0.5
    part = away_from(whole, some)
    cells, labels = part.inside.mesh_arrays()
    away = ~some[start.cells].any(axis=1)
    assert rows(cells, labels) == rows(start.cells[away], regions[away])
    beside = np.isin(np.arange(n), start.cells[~away])
    assert np.array_equal(part.inside.locked, locked | beside)
    assert rows(*part.mesh_arrays()) == rows(start.cells, regions)
    again = joined(part)
    assert rows(*again.mesh_arrays()) == rows(start.cells, regions)
    assert np.array_equal(again.locked, locked)
    near = np.isin(start.cells, start.cells[~away]).any(axis=1)
    edge = around(part, some)
    assert rows(*edge.inside.mesh_arrays()) == rows(start.cells[near], regions[near])
    assert np.array_equal(edge.locked, locked)
    assert rows(*edge.mesh_arrays()) == rows(start.cells, regions)
    assert away_from(whole, np.ones(n, dtype=bool)) is None


def test_the_worst_cells_are_looked_for_away_from_a_cut():
    start = ball(2500)
    cut = start.points[:, 0] > 0.2
    mesh = simplex_mesh(start.points, start.cells, fixed=cut)[0]
    both = [run(mesh, Options(), within=Within(cut=c)) for c in (None, cut)]
    tails = []
    for outcome in both:
        assert not broken_promises(mesh, outcome.points, outcome.cells, outcome.regions)
        away = (outcome.points[outcome.cells][:, :, 0] < 0.0).all(axis=1)
        tails.append(np.quantile(tet_meshes.quality(outcome.points, outcome.cells)[away], 0.01))
    assert tails[1] > tails[0] + 0.02
