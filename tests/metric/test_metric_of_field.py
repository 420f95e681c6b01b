"""Hessians recovered from values at vertices, and the metrics that are made of them."""

from __future__ import annotations

import itertools
import math

import meshio
import numpy as np
import pytest
import quadratic_meshes as qm
import surface_meshes as sm
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation
from strategies import jittered, random_delaunay

import odt_plugins
from odt_plugins.engine.cells import tensors as ts
from odt_plugins.engine.cells.geometry import boundary_facets
from odt_plugins.errors import InvalidOptionError
from odt_plugins.metric.field import cells_of_metric, error_by_signs, hessians_to_metric
from odt_plugins.metric.hessian import recovered_hessians, tangents
from odt_plugins.report.interpolation import interpolation_errors


def wave(x):
    return np.sin(3 * x[:, 0] + 2 * x[:, -1]) + np.cos(4 * x[:, -1])


def of_wave(x):
    out = np.zeros((len(x), x.shape[1], x.shape[1]))
    s = -np.sin(3 * x[:, 0] + 2 * x[:, -1])
    out[:, 0, 0], out[:, -1, -1] = 9 * s, 4 * s - 16 * np.cos(4 * x[:, -1])
    out[:, 0, -1] = out[:, -1, 0] = 6 * s
    return out


def projected_twice(points, cells, values):
    """Gradients of cells, averaged at vertices by volume, twice."""
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    size = np.abs(np.linalg.det(edges))

    def at_vertices(f):
        slope = np.linalg.solve(edges, (f[cells[:, 1:]] - f[cells[:, :1]])[..., None])[..., 0]
        total, whole = np.zeros_like(points), np.zeros(len(points))
        for corner in cells.T:
            np.add.at(total, corner, slope * size[:, None])
            np.add.at(whole, corner, size)
        return total / whole[:, None]

    first = at_vertices(values)
    second = np.stack([at_vertices(column) for column in first.T], axis=1)
    return 0.5 * (second + second.swapaxes(1, 2))


def on_rim(points, cells):
    out = np.zeros(len(points), dtype=bool)
    out[boundary_facets(cells).ravel()] = True
    return out


@pytest.mark.parametrize("make", [jittered, random_delaunay])
def test_hessians_of_quadratic_functions_are_exact(d, make):
    points, cells = make(d, {jittered: 5, random_delaunay: 60}[make], 0)
    form = np.random.default_rng(0).normal(size=(2, d, d))
    form = form + form.swapaxes(1, 2)
    values = 0.5 * np.einsum("ni,kij,nj->nk", points, form, points) + points[:, :1] + 7.0
    error = np.abs(recovered_hessians(points, cells, values) - form[:, None]).max(axis=(0, 2, 3))
    # values on a circle and in few places beside it do not tell all second derivatives
    assert np.quantile(error, {jittered: 1.0, random_delaunay: 0.8}[make]) < 5e-3
    # stretched by a thousand, cells see the same
    thin = points * np.array([1.0] * (d - 1) + [1e-3])
    change = np.diag([1.0] * (d - 1) + [1e-3])
    found = change @ recovered_hessians(thin, cells, values) @ change
    error = np.abs(found - form[:, None]).max(axis=(0, 2, 3))
    assert np.quantile(error, {jittered: 1.0, random_delaunay: 0.8}[make]) < 5e-3


@pytest.mark.parametrize(("d", "n", "inside", "rim"), [(2, 20, 0.06, 0.15), (3, 8, 0.14, 0.3)])
def test_fits_are_nearer_than_gradients_projected_twice(d, n, inside, rim):
    points, cells = jittered(d, n, 0)
    exact, on = of_wave(points), on_rim(points, cells)
    size = math.sqrt((exact**2).sum(axis=(1, 2)).mean())
    found, other = (np.sqrt(((h - exact) ** 2).sum(axis=(1, 2))) / size for h in (
        recovered_hessians(points, cells, wave(points)[:, None])[0],
        projected_twice(points, cells, wave(points))))
    for part, bound in ((~on, inside), (on, rim)):
        mine, theirs = (math.sqrt((e[part] ** 2).mean()) for e in (found, other))
        assert mine < bound
        assert mine < 0.5 * theirs


def test_a_slope_across_a_plate_of_one_layer_is_no_curvature():
    points, cells = jittered(3, 6, 0)
    layer = cells[(points[cells][..., 2] < 0.25).all(axis=1)]
    found = recovered_hessians(points, layer, points[:, 2:])
    assert np.abs(found).max() < 1e-2


def test_second_derivatives_along_a_sphere():
    """A linear function z on the unit sphere has the Hessian -z I along it."""
    points, cells = sm.sphere(3)
    along = tangents(points, cells)
    found = recovered_hessians(points, cells, points[:, 2:], along)[0]
    assert np.abs(found + points[:, 2, None, None] * np.eye(2)).max() < 0.1
    metric = odt_plugins.metric_from_field((points, cells), points[:, 2], 2000, ratio=3)
    assert metric.shape == (len(points), 3, 3)
    assert cells_of_metric(points, cells, metric, along) == pytest.approx(2000, rel=0.01)
    normal = ts.squared_lengths(along.normals, metric)
    values = np.linalg.eigvalsh(along.along(metric))
    assert np.allclose(normal, values[:, 1])


def test_the_metric_of_a_quadratic_function_is_its_form(d):
    points, cells = jittered(d, 5, 0)
    form = np.diag([100.0, -1.0, 9.0][:d])
    values = np.einsum("ni,ij,nj->n", points, form, points)
    for norm in (1, 2, math.inf):
        metric = odt_plugins.metric_from_field((points, cells), values, 5000, norm=norm)
        assert np.allclose(metric / metric[:, -1:, -1:], np.abs(form) / abs(form[-1, -1]),
                           atol=2e-2, rtol=1e-2)
        assert cells_of_metric(points, cells, metric) == pytest.approx(5000, rel=0.01)
    again = odt_plugins.metric_from_field((7.0 * points, cells), lambda x: 3 * values + 5, 5000,
                                          norm=math.inf)
    assert np.allclose(49.0 * again, metric, rtol=1e-6, atol=1e-6)


def test_errors_by_signs_are_means_over_rotations(d):
    """Rotations of the pentagon and the icosahedron average polynomials of degree 4 exactly."""
    regular = regular_corners(d)
    turns = np.array([[[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]
                      for a in np.arange(5) * 0.4 * np.pi])
    if d == 3:
        turns = Rotation.create_group("I").as_matrix()
    cells = np.arange(d + 1, dtype=np.int32)[None]

    def squared(signs):
        form = np.diag(signs)
        return np.mean([interpolation_errors(
            regular @ turn, cells, lambda x: np.einsum("ni,ij,nj->n", x, form, x)).l2 ** 2
            for turn in turns])

    for signs in itertools.product((-1.0, 1.0), repeat=d):
        ratio = squared(np.array(signs)) / squared(np.ones(d))
        assert error_by_signs(np.array([signs]))[0] == pytest.approx(np.sqrt(ratio), rel=1e-12)


def regular_corners(d):
    """Corners of a regular simplex."""
    corners = np.eye(d + 1) - 1.0 / (d + 1)
    return corners @ np.linalg.svd(corners)[2][:d].T


@pytest.mark.parametrize("norm", [1.0, 2.0, math.inf])
def test_cells_of_a_saddle_are_larger(norm):
    """Where the sign of u_yy changes, the squared error of one cell falls to an eighth."""
    points, cells = jittered(2, 12, 0, jitter=0.1)
    hessians = np.tile(np.eye(2), (len(points), 1, 1))
    hessians[points[:, 0] < 0.5, 1, 1] = -1.0
    metric = hessians_to_metric(points, cells, hessians[None], 1e-8, 900, norm, (1e3, 1e3))
    low, high = (metric[near, 0, 0].mean() for near in (points[:, 0] < 0.3, points[:, 0] > 0.7))
    part = 1.0 if norm == math.inf else 2.0 * norm / (2.0 * norm + 2.0)
    assert low / high == pytest.approx(8.0 ** (-0.5 * part), rel=1e-6)


@pytest.mark.parametrize("norm", [1.0, 2.0, math.inf])
def test_cells_as_stretched_as_they_may_be_are_best_for_what_they_are(norm):
    """Where nothing curves along y, a metric of ratio 10 is that of u_yy = u_xx / 100."""
    points, cells = jittered(2, 12, 0, jitter=0.1)
    hessians = np.tile(np.diag([1.0, 0.01]), (len(points), 1, 1))
    hessians[points[:, 0] < 0.5, 1, 1] = 0.0
    metric = hessians_to_metric(points, cells, hessians[None], 1e-8, 900, norm, (1e3, 10.0))
    low, high = (metric[near].mean(axis=0) for near in (points[:, 0] < 0.3, points[:, 0] > 0.7))
    part = 1.0 if norm == math.inf else 2.0 * norm / (2.0 * norm + 2.0)
    level = error_by_signs(np.array([[1.0, 0.0]]))[0]
    assert low / low[0, 0] == pytest.approx(np.diag([1.0, 0.01]))
    assert low[0, 0] / high[0, 0] == pytest.approx(level ** part, rel=1e-6)


@pytest.mark.parametrize("norm", [1.0, 2.0, 4.0, math.inf])
def test_the_norm_decides_where_cells_go(norm):
    """For x^3 + y^2, M_xx is 6 x (12 x)^(-1 / (2 p + 2)) but for a factor."""
    points, cells = jittered(2, 30, 0, jitter=0.1)
    points = points + np.array([1.0, 0.0])
    values = points[:, 0] ** 3 + points[:, 1] ** 2
    metric = odt_plugins.metric_from_field((points, cells), values, 900, norm=norm, growth=9)
    inner = ~on_rim(points, cells)
    x = points[inner, 0]
    ratio = metric[inner, 0, 0] / (6 * x * (12 * x) ** (-1 / (2 * norm + 2)))
    assert ratio == pytest.approx(ratio.mean(), rel=0.02)


def layers(d=2, n=14):
    points, cells = jittered(d, n, 0)
    data = {"u": np.tanh(10 * (points[:, 0] - 0.5)), "v": 1e6 * np.tanh(10 * (points[:, 1] - 0.5))}
    data["w"] = np.stack([data["u"], data["v"] / 1e6], axis=1)
    kind = "triangle" if d == 2 else "tetra"
    return meshio.Mesh(points, [(kind, cells)], point_data=data)


def test_several_fields_count_alike_whatever_their_units():
    mesh = layers()
    one, other, both, vector = (odt_plugins.metric_from_field(mesh, name, 1000, norm=math.inf)
                                for name in ("u", "v", ["u", "v"], "w"))
    for metric in (one, other, both, vector):
        assert cells_of_metric(mesh.points, mesh.cells[0].data, metric) == pytest.approx(
            1000, rel=0.01)
    share = [np.trace(m[:, :1, :1].mean(axis=0)) / np.trace(m.mean(axis=0))
             for m in (one, other, both, vector)]
    assert share[0] > 0.9
    assert share[1] < 0.1
    assert share[2] == pytest.approx(0.5, abs=0.1)
    assert share[3] == pytest.approx(0.5, abs=0.1)


def test_fields_that_are_linear_take_no_cells_from_others():
    mesh = layers()
    mesh.point_data |= {"zero": np.zeros(len(mesh.points)), "slope": 2.0 - mesh.points[:, 0]}
    alone = odt_plugins.metric_from_field(mesh, "u", 1000)
    beside = odt_plugins.metric_from_field(mesh, ["zero", "u", "slope"], 1000)
    assert np.array_equal(alone, beside)
    even = odt_plugins.metric_from_field(mesh, ["slope", "zero"], 1000)
    assert np.allclose(even, even[0, 0, 0] * np.eye(2))


def test_of_several_fields_the_one_that_is_refused_is_named():
    mesh = layers()
    mesh.point_data |= {"hole": np.full(len(mesh.points), np.nan), "wave": mesh.points[:, 0] * 1j}
    said = {"hole": "got adapt='hole' with NaN", "wave": "got adapt='wave'; .*hole$"}
    for name, message in said.items():
        with pytest.raises(InvalidOptionError, match=message):
            odt_plugins.remesh(mesh, adapt=["u", name], cells=100)


def test_triangles_in_a_plane_of_space_are_those_of_the_plane():
    mesh = layers()
    flat = odt_plugins.metric_from_field(mesh, "u", 500)
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    mesh.points = np.pad(mesh.points, ((0, 0), (0, 1))) @ turn.T
    found = odt_plugins.metric_from_field(mesh, "u", 500)
    assert np.allclose((turn.T @ found @ turn)[:, :2, :2], flat, rtol=0.04, atol=1e-3 * flat.max())


def test_lengths_grow_and_are_stretched_within_limits():
    mesh = layers(3, 6)
    found = odt_plugins.metric_from_field(mesh, "u", 20_000, ratio=5)
    values = np.linalg.eigvalsh(found)
    assert np.sqrt(values[:, 2] / values[:, 0]).max() < 5.01
    same = odt_plugins.metric_from_field(mesh, np.ones(len(mesh.points)), 3000)
    assert np.allclose(same, same[0, 0, 0] * np.eye(3))


@pytest.mark.parametrize(("change", "message"), [
    ({"values": "p"}, "got field 'p'; expected the name of a point array .* it has u, v, w"),
    ({"values": ["u", "p"]}, "got field 'p'"),
    ({"values": np.ones(3)}, r"got values of a field of shape \(3,\); expected \(225,\)"),
    ({"values": lambda x: x.T}, r"shape \(2, 225\); .* or \(225, c\), try their transpose"),
    ({"values": lambda x: np.where(x[:, 0] > 0.5, np.nan, 1.0)},
     r"got a field with NaN or infinite values at vertex \d+ \(\d+ of them\)"),
    ({"values": lambda x: 1j * x}, "are no real numbers: they are of type complex128"),
    ({"values": lambda x: x[:, 0] > 0.5}, "are no real numbers: they are of type bool"),
    ({"cells": 0}, "got cells=0; expected an integer of at least 1"),
    ({"cells": 1e3}, "got cells=1000.0"),
    ({"norm": 0.5}, "got norm=0.5; expected a number of at least 1, or inf"),
    ({"growth": 1.0}, "got growth=1.0; expected a number above 1"),
    ({"ratio": 0.5}, "got ratio=0.5; expected a number from 1 to"),
])
def test_what_is_no_field_is_refused(change, message):
    given = {"values": "u", "cells": 100} | change
    with pytest.raises(InvalidOptionError, match=message):
        odt_plugins.metric_from_field(layers(), **given)


@pytest.mark.parametrize("unit", [1e-250, 1e-120, 1e120, 1e250, 1e308])
def test_the_unit_of_a_field_changes_no_metric(unit):
    x, y = np.meshgrid(np.linspace(0, 1, 6), np.linspace(0, 1, 6))
    points = np.stack([x.ravel(), y.ravel()], axis=1)
    mesh = points, Delaunay(points).simplices
    field = 2.0 * points[:, 0] ** 2 + 0.6 * points[:, 1] ** 2 - 1.3
    known = odt_plugins.metric_from_field(mesh, field, 500)
    np.testing.assert_allclose(odt_plugins.metric_from_field(mesh, unit * field, 500), known,
                               rtol=1e-6, atol=1e-6 * known.max())


@pytest.mark.parametrize("host", ["pyvista", "meshio", "skfem"])
def test_nodes_between_corners_have_means_and_the_metric_may_be_carried(host, d):
    pytest.importorskip(host)
    points, cells = jittered(d, 3, 0)
    nodes, rows = qm.widened(points, cells)
    labels = np.zeros(len(rows), dtype=int)
    mesh = qm.MAKERS[host](nodes, rows, labels, {}, d)
    metric = odt_plugins.metric_from_field(
        mesh, lambda x: np.tanh(8.0 * (x[:, 0] - x[:, 1])), {2: 100, 3: 400}[d])
    for (a, b), node in qm.edges_of(qm.view(mesh, d)[1], d).items():
        assert np.allclose(metric[node], 0.5 * (metric[a] + metric[b]), rtol=1e-12)
    if host in qm.WITH_DATA:
        mesh.point_data["M"] = metric.reshape(len(metric), -1)
        once = odt_plugins.remesh(mesh, metric="M", keep=())
        found = np.asarray(once.point_data["M"])
        assert len(found) != len(metric)
        size = metric.shape[1]
        assert np.linalg.eigvalsh(found.reshape(-1, size, size)).min() > 0.0
