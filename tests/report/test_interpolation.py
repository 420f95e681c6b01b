"""Errors of linear interpolation: closed forms, and reports of every kind of mesh."""

from __future__ import annotations

import itertools
import math

import meshio
import numpy as np
import pytest
from scipy.spatial import Delaunay
from strategies import jittered

import odt_plugins
from odt_plugins.errors import InvalidOptionError
from odt_plugins.figures import volumes
from odt_plugins.report.interpolation import conical_rule, interpolation_errors


def square(x):
    return (x**2).sum(axis=1)


@pytest.mark.parametrize(("d", "degree"), [(2, 10), (3, 9)])
def test_the_rule_is_exact_for_its_degree(d, degree):
    """The mean of products of powers of barycentric coordinates is d! prod a_i! / (d + sum a)!."""
    weights, places = conical_rule(d)
    assert weights.min() > 0.0
    assert places.min() > 0.0
    assert np.allclose(places.sum(axis=1), 1.0)
    for powers in itertools.product(range(degree + 1), repeat=d + 1):
        if sum(powers) == degree:
            exact = math.factorial(d) * math.prod(map(math.factorial, powers)) / math.factorial(
                d + degree)
            assert (weights * (places**powers).prod(axis=1)).sum() == pytest.approx(exact)


def test_the_error_of_the_square_is_the_energy(d):
    """(1.1): the sum over edges of their squares, times |tau| / ((d + 1) (d + 2))."""
    points, cells = jittered(d, 4, 0)
    squares = sum(square(points[cells[:, a]] - points[cells[:, b]])
                  for a in range(d + 1) for b in range(a))
    energy = (np.abs(volumes(points, cells)) * squares).sum() / ((d + 1) * (d + 2))
    found = interpolation_errors(points, cells, square)
    assert found.l1 == pytest.approx(energy)
    linear = interpolation_errors(points, cells, lambda x: x[:, 0] - 2.0 * x[:, -1])
    assert max(linear.l1, linear.l2, linear.largest) < 1e-14


def test_the_error_on_one_triangle_in_every_norm():
    """f = x on the sides of a right triangle: f - f_I = x^2 - x, and its integrals by hand."""
    points, cells = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), np.array([[0, 1, 2]])
    found = interpolation_errors(points, cells, lambda x: x[:, 0] ** 2)
    assert found.l1 == pytest.approx(1 / 12)
    assert found.l2 == pytest.approx(math.sqrt(1 / 60))
    assert 0.24 < found.largest <= 0.25
    in_space = interpolation_errors(points @ np.array([[0.0, 2, 0], [0, 0, 2]]), cells,
                                    lambda x: x[:, 1] ** 2)
    assert in_space.l1 == pytest.approx(16 / 12)


def plane_mesh(points, cells):
    return meshio.Mesh(points, [("triangle", cells)])


def test_reports_know_the_errors_before_and_after_in_the_coordinates_of_the_caller():
    points, cells = jittered(2, 6, 0)
    (better, rows), report = odt_plugins.optimize_with_report((points, cells))
    found = report.interpolation_error(square)
    assert found.before == interpolation_errors(points, cells, square)
    assert found.after == interpolation_errors(better, rows, square)
    assert found.after.l1 < found.before.l1
    assert f"{found.after.l2:.4g}" in str(found)
    assert found.to_dict()["before"]["l1"] == found.before.l1
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    space = np.pad(points, ((0, 0), (0, 1))) @ turn.T + 5.0
    _, tilted = odt_plugins.optimize_with_report(plane_mesh(space, cells))
    again = tilted.interpolation_error(square)
    assert again.before.l2 == pytest.approx(found.before.l2)
    assert "plane" not in tilted.to_dict()


def test_the_errors_of_several_meshes_are_those_of_all_together():
    pyvista = pytest.importorskip("pyvista")
    points, cells = jittered(2, 3, 0)
    part = pyvista.PolyData.from_regular_faces(np.pad(points, ((0, 0), (0, 1))), cells)
    _, one = odt_plugins.optimize_with_report(part)
    _, two = odt_plugins.optimize_with_report(pyvista.MultiBlock([part, part.copy()]))
    single, both = one.interpolation_error(square).after, two.interpolation_error(square).after
    assert both.l1 == pytest.approx(2.0 * single.l1)
    assert both.l2 == pytest.approx(math.sqrt(2.0) * single.l2)
    assert both.largest == pytest.approx(single.largest)


@pytest.mark.parametrize(("f", "message"), [
    (lambda x: x, r"got values of shape \(3, 2\) and type float64 .* expected \(3,\) real numbers"),
    (lambda x: x[:, 0] + 1j, "type complex128"),
    (lambda x: np.where(x[:, 0] > 0.5, np.inf, 0.0), r"got inf of the function at \[1.0, 0.0\]"),
])
def test_what_is_no_function_is_refused(f, message):
    points, cells = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), np.array([[0, 1, 2]])
    with pytest.raises(InvalidOptionError, match=message):
        interpolation_errors(points, cells, f)


def test_values_in_place_of_a_function_are_refused_by_name():
    points = np.random.default_rng(3).random((30, 2))
    cells = Delaunay(points).simplices
    _, report = odt_plugins.optimize_with_report((points, cells))
    with pytest.raises(InvalidOptionError, match="got f= of type ndarray; expected a function"):
        report.interpolation_error(points[:, 0])
