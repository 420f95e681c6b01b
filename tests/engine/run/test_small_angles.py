"""The share of cells with an angle below 20 degrees is kept as the other figures are."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
import tet_meshes as tm
from promises import mesh_of

from odt_plugins.engine.finish import polishing
from odt_plugins.engine.record.figures import figures
from odt_plugins.engine.run import work
from odt_plugins.engine.run.plan import run
from odt_plugins.options import FIGURES, Options
from odt_plugins.promise.volume import broken_promises

OTHERS = tuple(name for name in FIGURES if name != "share_below_20")


def plate(n=(6, 6, 2), size=(1.0, 1.0, 0.3)):
    """Flat boxes, each cut into six tetrahedra, inner vertices moved at random."""
    places = np.array([*np.ndindex(*(k + 1 for k in n))])
    stride = np.array([(n[1] + 1) * (n[2] + 1), n[2] + 1, 1])
    steps = [np.cumsum([0, *stride[list(order)]]) for order in itertools.permutations(range(3))]
    corners = places[(places < n).all(axis=1)] @ stride
    cells = (corners[:, None, None] + np.array(steps)).reshape(-1, 4)
    points = places.astype(float)
    inner = ((places > 0) & (places < n)).all(axis=1)
    points[inner] += 0.2 * np.random.default_rng(1).uniform(-1, 1, (inner.sum(), 3))
    return points * size, tm.oriented(points * size, cells)


def share(points, cells):
    return (tm.dihedral_angles(points, cells).min(axis=1) < 20.0).mean()


def test_a_result_with_more_small_angles_is_refused_unless_the_caller_leaves_them_out():
    mesh = mesh_of(*plate())
    before = share(mesh.points, mesh.cells)
    free = run(mesh, Options(keep=OTHERS))
    assert share(free.points, free.cells) > before
    assert broken_promises(mesh, free.points, free.cells, free.regions, OTHERS) == []
    rose = broken_promises(mesh, free.points, free.cells, free.regions)
    assert [sentence.split()[:2] for sentence in rose] == [["share_below_20", "rose"]]
    kept = run(mesh, Options())
    assert share(kept.points, kept.cells) <= before
    assert "share_below_20" in kept.fallback


@pytest.mark.parametrize("part", [0.9, 0.7])
def test_small_angles_beyond_those_of_the_input_are_worked_off(part, monkeypatch):
    points, cells = tm.ball(300, 4)
    mesh = mesh_of(points * [1.0, 1.0, 0.4], tm.oriented(points, cells))
    monkeypatch.setattr(polishing, "polish", lambda share: ())
    plain = run(mesh, Options())
    reached = share(plain.points, plain.cells)
    assert reached > 0.02

    def fewer(points, cells, objective, _):
        return replace(figures(points, cells, objective), small_angles=part * reached)

    monkeypatch.setattr(work, "figures", fewer)
    result = run(mesh, Options())
    assert result.counts["repairs"] >= 1
    assert share(result.points, result.cells) <= part * reached
    assert figures(result.points, result.cells).mean_quality > (
        figures(plain.points, plain.cells).mean_quality - 0.02)
