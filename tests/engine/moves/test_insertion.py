"""Insertion and removal of vertices: cavities, the way back, what stays, and the budget."""

from __future__ import annotations

import numpy as np
import pytest
import tet_meshes as tm
from complexes import FREELY, OPEN, assert_sound, complex_of, contents, extremes_of

from odt_plugins.engine.cells.cost import Cost
from odt_plugins.engine.cells.extremes import Bounds, Extremes
from odt_plugins.engine.cells.measures import DIHEDRAL, QUALITY
from odt_plugins.engine.finish.resampling import (
    Resampling,
    make_ledger,
    resample,
    weights,
    with_spare_vertices,
)
from odt_plugins.engine.moves import insertion, star_cavity
from odt_plugins.engine.moves.compound import make_scratch
from odt_plugins.engine.moves.passes import grow, measures
from odt_plugins.engine.moves.worth import Weights, worth_of
from odt_plugins.engine.record.figures import COS_SMALL, cell_shapes

POWER = 4.0
COST = Cost(QUALITY, POWER)


def spare_complex(points, cells, regions=None, stays=None, insert=True):
    mesh = complex_of(points, cells, regions)
    n = len(points)
    stays = np.zeros(n, dtype=bool) if stays is None else stays
    labels = mesh.mesh_arrays()[1]
    return with_spare_vertices(
        points.copy(), cells, labels, mesh.locked, mesh.boundary, stays, insert)


def resampled(mesh, step, bounds=OPEN):
    """One pass over the worst cells; how many operations stayed."""
    scale = weights(cell_shapes(mesh.points, mesh.mesh_arrays()[0]))
    return resample(mesh, step, scale, bounds, 10**6)[0]


class Operation:
    """The steps of one operation at a cell, as the pass takes them."""

    def __init__(self, mesh):
        self.mesh = mesh
        self.scratch = make_scratch(1 << 15)
        self.proposal = insertion.make_proposal()
        self.cavity, self.new = self.proposal.cavity, self.proposal.new

    def propose(self, c, op):
        m = self.mesh
        if op < star_cavity.PLACES:
            m.locked[m.first[0]] = False
            return insertion.propose_vertex(
                m.tets, c, op, int(m.first[0]), COST, 10, OPEN, self.scratch, self.proposal)
        v = int(m.cells[c, op - star_cavity.PLACES])
        return insertion.propose_removal(
            m.tets, m.stays, c, v, COST, self.scratch, self.proposal)


@pytest.mark.usefixtures("nothing_compiled")
def test_cells_of_a_proposal_fill_the_cavity_and_the_gain_is_the_fall_of_the_sum():
    points, cells = tm.ball(200, 1)
    mesh = spare_complex(points, cells)
    step = Operation(mesh)
    count = {"vertex": 0, "removal": 0}
    for turn, c in enumerate(range(0, len(cells), 72)):
        # Vertices come nearly everywhere, but not every one can go.
        for op in range(star_cavity.PLACES if turn % 2 else 0, star_cavity.PLACES + 4):
            gain, n_old, n_new = step.propose(c, op)
            if not gain > -np.inf:
                continue
            old, new = mesh.cells[step.cavity[:n_old]], step.new[:n_new]
            assert len(np.unique(step.cavity[:n_old])) == n_old
            assert (tm.signed_volumes(mesh.points, new) > 0).all()
            assert tm.signed_volumes(mesh.points, new).sum() == pytest.approx(
                tm.signed_volumes(mesh.points, old).sum(), rel=1e-12)
            assert gain == pytest.approx(tm.cost(mesh.points, old, POWER).sum()
                                         - tm.cost(mesh.points, new, POWER).sum(), rel=1e-9)
            lost = set(old.ravel().tolist()) - set(new.ravel().tolist())
            if op < star_cavity.PLACES:
                assert not lost
                assert (new == mesh.first[0]).any(axis=1).all()
                count["vertex"] += 1
            else:
                assert lost == {int(cells[c, op - star_cavity.PLACES])}
                assert not mesh.locked[list(lost)].any()
                count["removal"] += 1
    assert count["vertex"] > 100
    assert count["removal"] > 50


@pytest.mark.usefixtures("nothing_compiled")
def test_no_cavity_around_the_seed_has_a_better_worst_cell():
    points, cells = tm.ball(200, 3)
    mesh = spare_complex(points, cells)
    step = Operation(mesh)
    rng = np.random.default_rng(0)
    p = int(mesh.first[0])

    def worst(cavity):
        rows = []
        for c in cavity:
            for f in range(4):
                if int(mesh.neighbors[c, f]) not in cavity:
                    rows.append(mesh.cells[c].copy())
                    rows[-1][f] = p
        rows = np.array(rows)
        if (tm.signed_volumes(mesh.points, rows) <= 0).any():
            return np.inf
        if not np.isin(mesh.cells[cavity], rows).all():
            return np.inf
        return tm.cost(mesh.points, rows, POWER).max()

    grown = rivals = 0
    for c in range(0, len(cells), 33):
        n = star_cavity.seed_cavity(mesh.tets, c, 10, p, 10, step.scratch.ring, step.cavity)
        start = step.cavity[:n].tolist()
        n_old = star_cavity.grow_cavity(mesh.tets, p, step.cavity, n, COST)
        least = worst(step.cavity[:n_old].tolist())
        grown += n_old > n
        assert least <= worst(start)
        for _ in range(20):
            cavity = list(start)
            for _ in range(12):
                across = sorted({int(t) for t in mesh.neighbors[cavity].ravel()} - {-1, *cavity})
                cavity.append(int(rng.choice(across)))
                rival = worst(cavity)
                rivals += rival < np.inf
                assert rival >= least * (1.0 - 1e-12)
    assert grown > 20
    assert rivals > 100


@pytest.mark.usefixtures("nothing_compiled")
def test_a_facet_of_the_boundary_gets_its_vertex_above_it():
    points, cells = tm.ball(200, 3)
    mesh = spare_complex(points, cells)
    step = Operation(mesh)
    p = int(mesh.first[0])
    outer = np.argwhere(mesh.neighbors[: len(cells)] < 0)
    assert len(outer) > 50
    for c, f in outer:
        n = star_cavity.seed_cavity(mesh.tets, c, 6 + f, p, 10, step.scratch.ring, step.cavity)
        assert step.cavity[:n].tolist() == [c]
        corners = np.delete(mesh.points[cells[c]], f, axis=0)
        lift = mesh.points[p] - corners.mean(axis=0)
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        assert np.linalg.norm(lift) == pytest.approx(0.64 * np.linalg.norm(normal) ** 0.5)
        assert abs(lift @ normal) == pytest.approx(
            np.linalg.norm(lift) * np.linalg.norm(normal), rel=1e-9)
        assert lift @ (mesh.points[cells[c, f]] - corners[0]) > 0


@pytest.mark.parametrize("seed", [1, 2])
def test_what_does_not_stay_leaves_every_bit_as_it_was(seed):
    points, cells = tm.ball(80, seed)
    order = np.random.default_rng(seed).permutation(len(cells))[:40].astype(np.int32)

    def at_price(price):
        mesh = spare_complex(points, cells)
        grow(mesh)
        scale = weights(cell_shapes(points, cells))
        ledger = make_ledger(mesh, scale)
        before = [*contents(mesh), *(a.tobytes() for a in (mesh.status, mesh.locked, ledger.worth))]
        step = Resampling(POWER, 0.1, 15, price=price).step
        tried = np.zeros(len(mesh.cells), dtype=bool)
        taken, seen = insertion.insertion_pass(
            mesh.tets, order, step, OPEN, scale, ledger, tried)
        assert seen == len(order)
        assert_sound(mesh, mesh.points, tm.signed_volumes(points, cells).sum())
        moved = (mesh.points[: len(points)] != points).any(axis=1).sum()
        # Where the next vertex would come is written into its free slot.
        mesh.points[mesh.first[0]:] = 0.0
        after = [*contents(mesh), *(a.tobytes() for a in (mesh.status, mesh.locked, ledger.worth))]
        return before == after, taken, moved, ledger.turn[0]

    same, taken, moved, ops = at_price(np.inf)
    assert same
    assert taken == moved == 0
    assert ops > 300
    # At another price the same operations, and what moves after them, stay.
    same, taken, moved, _ = at_price(0.0)
    assert not same
    assert taken > 30
    assert moved > 50


def cost_sum(mesh):
    return tm.cost(mesh.points, mesh.mesh_arrays()[0], POWER).sum()


@pytest.mark.parametrize("seed", [4, 5])
def test_what_stays_lowers_the_sum_within_the_bounds(seed):
    points, cells = tm.ball(300, seed)
    mesh = spare_complex(points, cells)
    volume = tm.signed_volumes(points, cells).sum()
    locked = mesh.locked.copy()
    last = cost_sum(mesh)
    before = extremes_of(points, cells)
    taken = resampled(mesh, Resampling(POWER, 0.1, 15), Bounds(before, FREELY))
    assert taken > 20
    after = mesh.mesh_arrays()[0]
    assert cost_sum(mesh) < last
    assert_sound(mesh, mesh.points, volume)
    assert np.array_equal(mesh.points[: len(points)][locked[: len(points)]],
                          points[locked[: len(points)]])
    n = len(points)
    used = np.zeros(len(mesh.points), dtype=bool)
    used[after] = True
    assert used[:n][locked[:n]].all()
    assert used[n:].sum() > 0
    assert (~used[:n]).sum() > 0
    assert mesh.first[0] == n + np.flatnonzero(used[n:]).max() + 1
    assert mesh.locked[~used].all()
    assert not mesh.locked[n:][used[n:]].any()
    now = extremes_of(mesh.points, after)
    assert now.quality >= before.quality - 1e-12
    assert now.large <= before.large + 1e-12
    assert now.small >= before.small - 1e-12


@pytest.mark.parametrize("price", [0.2, 2.0])
def test_every_vertex_is_worth_its_price_by_the_worth_of_all_cells(price):
    points, cells = tm.ball(300, 4)
    mesh = spare_complex(points, cells)
    grow(mesh)
    scale = weights(cell_shapes(points, cells))
    ledger = make_ledger(mesh, scale)
    start, before = ledger.worth.sum(), len(points)
    order = np.argsort(measures(mesh, QUALITY)).astype(np.int32)[:200]
    step = Resampling(2.0, 1.0, 15, price=price).step
    tried = np.zeros(len(mesh.cells), dtype=bool)
    taken, _ = insertion.insertion_pass(mesh.tets, order, step, OPEN, scale, ledger, tried)
    added = int(mesh.first[0]) - before
    assert added > 3
    assert not mesh.full
    now = make_ledger(mesh, scale).worth
    assert ledger.worth == pytest.approx(now, abs=1e-9)
    assert now.sum() - start >= added * price + (taken - added) * 0.1 * price


@pytest.mark.parametrize("best", [True, False])
def test_a_mesh_without_room_for_further_cells_grows_and_no_bit_changes(best):
    points, cells = tm.ball(150, 4)
    roomy, tight = (spare_complex(points, cells) for _ in range(2))
    for _ in range(8):
        grow(roomy)
    used = tight.used
    for name in ("cells", "neighbors", "regions", "status", "free"):
        setattr(tight, name, getattr(tight, name)[:used].copy())
    step = Resampling(2.0, 1.0, 15, best=best)
    assert resampled(roomy, step) == resampled(tight, step) > 10
    assert tight.used == roomy.used
    assert len(tight.cells) > used
    assert not roomy.full
    assert not tight.full
    assert tight.cells[: tight.used].tobytes() == roomy.cells[: roomy.used].tobytes()
    assert tight.points.tobytes() == roomy.points.tobytes()


@pytest.mark.usefixtures("nothing_compiled")
def test_the_worth_of_a_cell_falls_with_its_quality_and_its_angles():
    scale = Weights(mean=0.8, low=0.3, high=0.4, tail=2.0, depth=2.0, large=COS_SMALL, small=3.0,
                    least=0.1, sharp=0.2, height=0.0, worst=5.0)
    good = worth_of(Extremes(0.8, 0.5, -0.5), scale)
    assert good == pytest.approx(0.0)
    poor = [worth_of(Extremes(q, 0.5, -0.5), scale) for q in (0.5, 0.4, 0.35, 0.3, 0.2, 0.1, 0.05)]
    assert np.diff([good, *poor]).max() < 0
    assert poor[3] == pytest.approx(0.3 - 0.8 - 2.0)
    sharp = [worth_of(Extremes(0.8, np.cos(a), -0.5), scale) for a in np.radians([22, 19, 8, 3])]
    flat = [worth_of(Extremes(0.8, 0.5, np.cos(a)), scale) for a in np.radians([150, 172, 177])]
    assert sharp[1] == pytest.approx(-3.0)
    assert np.diff([good, *sharp[1:]]).max() < 0
    assert np.diff(flat).max() < 0


def test_the_smallest_angle_as_measure():
    points, cells = tm.ball(300, 6)
    mesh = spare_complex(points, cells)
    before = np.sort(measures(mesh, DIHEDRAL))[:10]
    assert resampled(mesh, Resampling(POWER, 0.05, 15, DIHEDRAL)) > 10
    after = np.sort(measures(mesh, DIHEDRAL))[:10]
    assert (after > before).all()


def test_within_reach_angles_outweigh_all_else():
    points, cells = tm.ball(300, 6)
    steps = [Resampling(POWER, 0.1, 15, DIHEDRAL, DIHEDRAL, reach=reach) for reach in (0.0, 0.1)]
    sines, means = [], []
    for step in steps:
        mesh = spare_complex(points, cells)
        for _ in range(3):
            shapes = cell_shapes(mesh.points, mesh.mesh_arrays()[0])
            scale = weights(shapes, "min_dihedral", step.reach)
            resample(mesh, step, scale, OPEN, 10**6)
        shapes = cell_shapes(mesh.points, mesh.mesh_arrays()[0])
        sines.append(np.sqrt(1.0 - np.abs(shapes[:, 1:3]).max(axis=1) ** 2).min())
        means.append(shapes[:, 0].mean())
    assert sines[1] > 1.2 * sines[0]
    assert means[1] < means[0]


def test_low_cells_are_worth_less_for_the_time_step_alone():
    points, cells = tm.ball(200, 3)
    mesh = spare_complex(points, cells)
    shapes = cell_shapes(points, cells)
    usual, scale = (weights(shapes, objective) for objective in ("radius_ratio", "time_step"))
    lost = (make_ledger(mesh, usual).worth - make_ledger(mesh, scale).worth)[: len(cells)]
    assert usual.height == 0.0
    low = shapes[:, 3] < scale.height
    assert 0 < low.sum() < 0.5 * len(cells)
    assert np.argmax(lost) == np.argmin(shapes[:, 3])
    assert (lost[low] > 0.0).all()
    assert (lost[~low] == 0.0).all()


def test_interfaces_stay():
    points, cells = tm.grid(4, 9)
    regions = (points[cells].mean(axis=1)[:, 0] > 2).astype(np.int32)
    mesh = spare_complex(points, cells, regions)
    assert resampled(mesh, Resampling(POWER, 0.2, 15)) > 5
    after, labels = mesh.mesh_arrays()
    face = {f for f, o in tm.facets_of(after).items()
            if len(o) == 2 and labels[o[0]] != labels[o[1]]}
    assert face == {f for f, o in tm.facets_of(cells).items()
                    if len(o) == 2 and regions[o[0]] != regions[o[1]]}
    for label in (0, 1):
        assert tm.signed_volumes(mesh.points, after[labels == label]).sum() == pytest.approx(
            tm.signed_volumes(points, cells[regions == label]).sum(), rel=1e-12)


def test_no_more_vertices_than_there_is_room_for():
    points, cells = tm.ball(100, 7)
    assert len(spare_complex(points, cells).points) == len(points) + len(points) // 2
    mesh = spare_complex(points, cells, insert=0.05)
    assert len(mesh.points) == len(points) + len(points) // 20
    for _ in range(3):
        resampled(mesh, Resampling(2.0, 0.3, 7, price=0.1))
    assert mesh.first[0] == len(mesh.points)
    assert_sound(mesh, mesh.points, tm.signed_volumes(points, cells).sum())


def test_anchored_vertices_stay():
    points, cells = tm.ball(300, 4)
    free = spare_complex(points, cells)
    step = Resampling(POWER, 0.1, 15)
    resampled(free, step)
    used = np.zeros(len(free.points), dtype=bool)
    used[free.mesh_arrays()[0]] = True
    gone = np.flatnonzero(~used[: len(points)])
    assert len(gone) > 3
    stays = np.zeros(len(points), dtype=bool)
    stays[gone] = True
    held = spare_complex(points, cells, stays=stays)
    resampled(held, step)
    assert np.isin(gone, held.mesh_arrays()[0]).all()
