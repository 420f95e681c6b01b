"""While tetrahedra are resized none becomes worse than is allowed, and all that may vanish does."""

from dataclasses import dataclass

import numpy as np
import pytest
from tet_meshes import ball, dihedral_angles, quality

import odt_plugins
from odt_plugins.engine.cells.extremes import Extremes
from odt_plugins.engine.compiled.threads import pieces
from odt_plugins.engine.remesh import finish as remesh_finish
from odt_plugins.engine.remesh import volume
from odt_plugins.engine.remesh.body import FREELY
from odt_plugins.engine.remesh.collapse import collapse_edges
from odt_plugins.engine.remesh.guard import FLAT, POOR, move
from odt_plugins.engine.remesh.lay_out import FLOOR, edges_beyond, lay_out
from odt_plugins.engine.run.work import make_start
from odt_plugins.mesh.simplex import SimplexMesh

pytestmark = pytest.mark.usefixtures("nothing_compiled")


def shapes(points, cells):
    """Radius ratio, least and largest dihedral angle in degrees, (m, 3)."""
    angles = dihedral_angles(points, cells)
    return np.stack([quality(points, cells), angles.min(axis=1), angles.max(axis=1)], axis=1)


def laid_out(points, cells, least, envelope=0.0):
    mesh = SimplexMesh(points, np.ascontiguousarray(cells), np.zeros(len(cells), np.int32),
                       np.zeros(len(points), np.bool_))
    start = make_start(mesh)
    n = len(start.points)
    body, guard, scratch, _ = lay_out(
        start, np.full(n, FREELY, np.uint8), np.full(n, envelope * start.frame.scale), 40.0, least)
    return start, body, guard, scratch


def test_no_tetrahedron_of_a_fair_radius_ratio_has_an_extreme_angle():
    rng = np.random.default_rng(5)
    flat = rng.normal(size=(200_000, 4, 3)) * [1.0, 1.0, 0.3]
    found = shapes(flat.reshape(-1, 3), np.arange(800_000).reshape(-1, 4))
    fair = np.abs(found[:, 0]) >= POOR
    assert fair.sum() > 1000
    assert found[fair, 1].min() > 15
    assert found[fair, 2].max() < 150


@pytest.mark.parametrize("seed", range(3))
def test_a_vertex_moves_where_nothing_becomes_worse_than_allowed_and_only_there(seed):
    points, cells = ball(60, seed)
    least = Extremes(FLOOR, np.cos(np.radians(15.0)), np.cos(np.radians(150.0)))
    start, body, guard, scratch = laid_out(points, cells, least)
    rng = np.random.default_rng(seed)
    inside = np.flatnonzero(body.kind[: len(start.points)] == 0)
    verdicts = []
    for u in rng.choice(inside, 300):
        rows = body.tets.rows[body.tets.live()]
        rows = rows[(rows == u).any(axis=1)]
        place = body.points[u, :3] + rng.normal(size=3) * 0.05 * start.frame.scale
        moved = body.points[:, :3].copy()
        moved[u] = place
        old, new = shapes(body.points[:, :3], rows), shapes(moved, rows)
        fits = bool((new[:, 0] >= FLAT).all() and
                    new[:, 0].min() >= min(FLOOR, old[:, 0].min())
                    and new[:, 1].min() >= min(15, old[:, 1].min())
                    and new[:, 2].max() <= max(150, old[:, 2].max()))
        assert move(body, guard, u, tuple(place), scratch) == fits
        verdicts.append(fits)
    assert 30 < sum(verdicts) < 270


@dataclass
class Work:
    body: object
    guard: object
    scratch: object


def test_edges_that_are_left_out_of_later_passes_could_not_have_vanished():
    points, cells = ball(900, 4)
    pairs = []
    for _ in range(2):
        start, body, guard, scratch = laid_out(points, cells, Extremes(0.0, 1.0, -1.0))
        body.size[:] = 0.25 * start.frame.scale
        pairs.append(Work(body, guard, scratch))
    work, twin = pairs
    gone = volume._collapse(work)
    total, passes = 0, 0
    for _ in range(volume.PASSES):
        edges = edges_beyond(twin.body, volume.SHORT, longer=False)
        done = sum(int(collapse_edges(twin.body, twin.guard, edges[a:b],
                                      (volume.SHORT, volume.LONG), twin.scratch))
                   for a, b in pieces(0, len(edges)))
        total, passes = total + done, passes + 1
        if done <= volume.FEW * len(edges):
            break
    assert passes > 2
    assert gone == total > 100
    assert (work.body.tets.rows == twin.body.tets.rows).all()


def test_stage_1_goes_on_after_resizing_until_the_energy_settles(monkeypatch):
    told = []
    run = remesh_finish.run

    def noted(mesh, options, *args, **kwargs):
        told.append(options.smoothing.omega)
        outcome = run(mesh, options, *args, **kwargs)
        told.append(len(outcome.energy))
        return outcome

    monkeypatch.setattr(remesh_finish, "run", noted)
    odt_plugins.remesh(ball(900, 1), 0.2, envelope=0.01)
    assert told[0] == 2.0
    assert told[1] > 12
