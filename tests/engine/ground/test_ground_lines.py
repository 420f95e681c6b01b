"""Feature lines and the budget of the volume, in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from odt_plugins.engine.ground.budget import affordable, spend
from odt_plugins.engine.ground.lines import Lines, line_direction, line_is_near, on_line

pytestmark = pytest.mark.usefixtures("nothing_compiled")

GROUND = np.array([[0.0, 0, 0], [1, 0, 0], [1, 2, 0], [1, 2, 3]])


def bent(place=(0.0, 1.0, 3.0, 6.0)):
    """A chain of three edges of the lengths 1, 2 and 3, each along another axis."""
    nodes = np.arange(4, dtype=np.int32)
    return Lines(nodes, np.array([0.0, 1, 3, 6]), np.array(place),
                 np.array([10, 11, 12, -1], dtype=np.int32), nodes)


@pytest.mark.parametrize("slot", [1, 2])
@pytest.mark.parametrize(("place", "point"), [
    (0.25, (0.25, 0, 0, 10)), (2.5, (1, 1.5, 0, 11)), (4.5, (1, 2, 1.5, 12)),
    (-1.0, (0, 0, 0, 10)), (7.0, (1, 2, 3, 12)),
])
def test_a_place_on_a_chain_is_found_from_every_inner_vertex_and_ends_with_it(slot, place, point):
    assert on_line(bent(), GROUND, slot, place) == pytest.approx(point)


def test_the_direction_of_a_chain_is_that_from_neighbour_to_neighbour():
    assert line_direction(bent(), GROUND, 1) == pytest.approx((5**-0.5, 2 * 5**-0.5, 0))
    assert line_direction(bent(), GROUND, 2) == pytest.approx((0, 2 * 13**-0.5, 3 * 13**-0.5))
    assert line_direction(bent(), np.zeros((4, 3)), 1) == (0, 0, 0)


def test_a_chain_is_as_far_as_the_corner_that_its_edge_cuts():
    """A vertex that slides by 1 around the first corner leaves it half a diagonal away."""
    points = GROUND.copy()
    points[1] = 1, 1, 0
    slid = bent((0.0, 2.0, 3.0, 6.0))
    assert line_is_near(slid, points, GROUND, 1, 0.5 + 1e-12)
    assert not line_is_near(slid, points, GROUND, 1, 0.5 - 1e-12)
    assert line_is_near(bent(), GROUND, GROUND, 1, 0.0)
    assert not line_is_near(bent((0.0, 3.0, 3.0, 6.0)), points, GROUND, 1, 1e9)


@pytest.mark.parametrize(("whole", "own", "change", "may"), [
    (0.0, 0.0, 0.25, True), (0.0, 0.0, -0.25, True), (0.0, 0.0, 0.3, False),
    (0.9, -0.2, 0.2, False), (2.0, 0.5, -0.1, True), (2.0, 0.5, 0.1, False),
    (-2.0, -0.5, 0.1, True), (0.5, 0.5, 0.1, False),
])
def test_a_change_of_volume_is_within_both_budgets_or_pays_a_debt_back(whole, own, change, may):
    """The whole may change by 1, every vertex by a quarter of that."""
    volume = np.array([[whole, 1.0], [9.0, 9.0], [own, 0.25]])
    assert affordable(volume, change, 1) == may
    spend(volume, change, 1)
    assert volume == pytest.approx(np.array([[whole + change, 1], [9, 9], [own + change, 0.25]]))
