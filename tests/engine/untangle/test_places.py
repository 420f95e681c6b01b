"""Places at which no cell is inverted: the start, the descent, and all of it on tangled grids."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from contract import volumes
from tangled_meshes import tangled

from odt_plugins.engine.untangle.harmonic import harmonic
from odt_plugins.engine.untangle.places import lbfgs, untangled_places


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("how", ["random", "one point", "reflected", "one vertex", "bent"])
def test_tangled_grids_become_valid_and_what_is_locked_stays(dim, how):
    points, cells, movable = tangled(dim, 5 if dim == 2 else 4, how)
    before = points.copy()
    assert (volumes(points, cells) <= 0).any()
    found = untangled_places(points, cells, movable)
    assert (volumes(found, cells) > 0).all()
    assert (found[~movable] == before[~movable]).all()
    assert (points == before).all()


def test_cells_that_are_all_one_point_are_left():
    points, cells = np.full((4, 2), 0.7), np.array([[0, 1, 3], [1, 2, 3], [2, 0, 3]], np.int32)
    found = untangled_places(points, cells, np.arange(4) == 3)
    assert np.array_equal(found, points)


def test_far_from_an_inverted_cell_nothing_moves():
    points, cells, movable = tangled(2, 12, "one vertex")
    found = untangled_places(points, cells, movable)
    assert 0 < (found != points).any(axis=1).sum() < movable.sum() / 2


def test_the_places_do_not_depend_on_the_threads():
    points, cells, movable = tangled(3, 4, "random")
    alone = untangled_places(points, cells, movable)
    with ThreadPoolExecutor(3) as pool:
        assert (untangled_places(points, cells, movable, pool=pool) == alone).all()


@pytest.mark.parametrize("dim", [2, 3])
def test_a_reference_makes_the_shapes(dim):
    """With the cells of a valid mesh as references its places are found again."""
    points, cells, movable = tangled(dim, 4, "none")
    reference = np.moveaxis((points[cells[:, 1:]] - points[cells[:, :1]]), 1, 2)
    moved = points.copy()
    moved[movable] = 0.5
    found = untangled_places(moved, cells, movable, reference)
    plain = untangled_places(moved, cells, movable)
    assert (volumes(found, cells) > 0).all()
    assert np.abs(found - points).max() < 0.1 * np.abs(plain - points).max()


def test_what_no_place_makes_valid_is_left_with_few_inverted_cells():
    points, cells, movable = tangled(2, 4, "none")
    held = np.flatnonzero(movable)[:2]
    points[held] = points[held[::-1]]
    movable[held] = False
    found = untangled_places(points, cells, movable)
    assert 0 < (volumes(found, cells) <= 0).sum() <= (volumes(points, cells) <= 0).sum()


def test_harmonic_values_are_means_and_linear_ones_stay_on_a_symmetric_star():
    points, cells, movable = tangled(2, 4, "random")
    free = np.flatnonzero(movable)
    found = points.copy()
    found[free] = harmonic(points, cells, free)
    for v in free:
        around = np.setdiff1d(cells[(cells == v).any(axis=1)], v)
        assert found[v] == pytest.approx(found[around].mean(axis=0), abs=2e-3)


def test_lbfgs_finds_the_least_value_of_a_quadratic_and_of_rosenbrock():
    scales = np.geomspace(1.0, 100.0, 12)
    x, value = lbfgs(lambda x: (0.5 * (scales * x * x).sum(), scales * x), np.ones(12), 200,
                     lambda: False, gain=1e-12)
    assert value < 1e-8
    assert np.abs(x).max() < 1e-3

    def rosenbrock(x):
        a, b = x
        return (1 - a) ** 2 + 100 * (b - a * a) ** 2, np.array(
            [-2 * (1 - a) - 400 * a * (b - a * a), 200 * (b - a * a)])

    x, value = lbfgs(rosenbrock, np.array([-1.2, 1.0]), 200, lambda: False, gain=1e-15)
    assert x == pytest.approx([1.0, 1.0], abs=1e-3)
