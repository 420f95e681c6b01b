"""Newton smoothing of a star: derivatives, descent, bounds, locked vertices."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import tet_meshes as tm
from complexes import FREELY, extremes_of
from tet_meshes import interior

from odt_plugins.engine.cells.cost import Cost
from odt_plugins.engine.cells.extremes import Extremes
from odt_plugins.engine.cells.measures import QUALITY, star_state
from odt_plugins.engine.moves.newton3d import smooth_vertices, sure_quality
from odt_plugins.engine.topology.active import spread
from odt_plugins.engine.topology.coloring import vertex_coloring
from odt_plugins.engine.topology.star import vertex_stars


def test_every_sweep_lowers_the_sum_and_keeps_the_rest():
    points, cells = tm.ball(250, 6)
    stars = vertex_stars(cells, len(points))
    free = interior(points, cells)
    order, blocks, *_ = vertex_coloring(cells, free)
    moved = np.zeros(len(points))
    now = points.copy()
    last = float(tm.cost(now, cells, 2.0).sum())
    for _ in range(4):
        for a, b in pairwise(blocks.tolist()):
            smooth_vertices(now, cells, stars, order, a, b, Cost(QUALITY, 2.0), FREELY, moved)
        cost = float(tm.cost(now, cells, 2.0).sum())
        assert cost < last
        last = cost
    assert (tm.signed_volumes(now, cells) > 0).all()
    assert np.array_equal(now[~free], points[~free])
    assert tm.quality(now, cells).mean() > tm.quality(points, cells).mean() + 0.05


def test_bounds_hold_for_angles_too():
    points, cells = tm.ball(250, 14)
    stars = vertex_stars(cells, len(points))
    order, blocks, *_ = vertex_coloring(cells, interior(points, cells))
    angles = tm.dihedral_angles(points, cells)
    limit = extremes_of(points, cells)
    moved = np.zeros(len(points))
    for _ in range(3):
        for a, b in pairwise(blocks.tolist()):
            smooth_vertices(points, cells, stars, order, a, b, Cost(QUALITY, 1.0), limit, moved)
    now = tm.dihedral_angles(points, cells)
    assert now.min() >= angles.min() - 1e-7
    assert now.max() <= angles.max() + 1e-7


def loose_tets(count, seed):
    """Tetrahedra that share nothing, from nearly regular ones to needles and slivers."""
    rng = np.random.default_rng(seed)
    flat = 10.0 ** rng.uniform(-2.0, 0.0, size=(count, 1, 3))
    points = (rng.normal(size=(count, 4, 3)) * flat).reshape(-1, 3)
    return points, tm.oriented(points, np.arange(4 * count, dtype=np.int32).reshape(-1, 4))


def test_no_cell_is_sure_to_keep_bounds_that_it_breaks():
    points, cells = loose_tets(20000, 3)
    quality, angles = tm.quality(points, cells), tm.dihedral_angles(points, cells)
    low, high = np.cos(np.radians(angles.min(axis=1))), np.cos(np.radians(angles.max(axis=1)))
    for a, b, q in zip(low, high, quality, strict=True):
        assert sure_quality(Extremes(0.0, float(a), -1.0)) >= q
        assert sure_quality(Extremes(0.0, 1.0, float(b))) >= q


def test_bounds_on_one_side_of_a_right_angle_leave_no_cell_sure():
    assert sure_quality(Extremes(0.0, -0.1, -0.9)) > 1.0
    assert sure_quality(Extremes(0.0, 0.9, 0.1)) > 1.0
    assert sure_quality(FREELY) < 1e-5


@pytest.mark.usefixtures("nothing_compiled")
def test_the_state_of_a_star_is_the_sum_and_the_extremes():
    points, cells = loose_tets(300, 8)
    cells = cells[tm.quality(points, cells) > 1e-3]
    star = np.arange(len(cells), dtype=np.int32)[::2]
    quality, angles = tm.quality(points, cells)[star], tm.dihedral_angles(points, cells)[star]
    costs, cost = tm.cost(points, cells, 2.0)[star], Cost(QUALITY, 2.0)
    for sure in (2.0, 0.3):
        asked = angles[quality < sure]
        total, found = star_state(points, cells, star, 0, len(star), cost, np.inf, sure)
        assert total == pytest.approx(costs.sum(), rel=1e-9)
        expected = (quality.min(), np.cos(np.radians(asked.min())),
                    np.cos(np.radians(asked.max())))
        assert tuple(found) == pytest.approx(expected, rel=1e-9)

    def total(limit):
        return star_state(points, cells, star, 0, len(star), cost, limit, 2.0)[0]

    assert total(1.01 * costs.sum()) < np.inf
    assert total(0.99 * costs.sum()) == np.inf
    cells[star[3]] = cells[star[3]][[1, 0, 2, 3]]
    assert total(np.inf) == np.inf


def test_what_moved_wakes_its_neighbours_only():
    points, cells = tm.grid(3, 1)
    stars = vertex_stars(cells, len(points))
    moved = np.zeros(len(points))
    moved[21] = 0.5
    active = np.ones(len(points), dtype=bool)
    status = np.zeros(len(cells), dtype=np.uint8)
    assert spread(cells, stars.indptr, stars.indices, moved, 0.1, active, status) == 1
    around = (cells == 21).any(axis=1)
    assert np.array_equal(status == 1, around)
    assert set(np.flatnonzero(active)) == set(cells[around].ravel())
