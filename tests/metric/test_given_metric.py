"""What a caller gives as a metric, the metric that a mesh has, and limits."""

from __future__ import annotations

import numpy as np
import pytest
import surface_meshes as sm
import tet_meshes
from scipy.optimize import brentq
from strategies import jittered

import odt_plugins
from odt_plugins.adapters.fields import named_metric
from odt_plugins.adapters.host import HostMesh
from odt_plugins.engine.cells import tensors as ts
from odt_plugins.engine.remesh.sizes import grown, unique_edges
from odt_plugins.errors import InvalidOptionError
from odt_plugins.mesh.plane import PlaneFrame, plane_frame
from odt_plugins.mesh.simplex import simplex_mesh
from odt_plugins.metric.given import metric_at_vertices
from odt_plugins.metric.implied import cell_logarithms, implied_metric
from odt_plugins.metric.limits import bounded_metric, grown_metric


def lattice_mesh(d, n=3):
    return simplex_mesh(*jittered(d, n, 1))[0]


def random_metric(n, d, seed=0):
    parts = np.random.default_rng(seed).normal(size=(n, d, d))
    out = np.einsum("nij,nkj->nik", parts, parts) + 0.1 * np.eye(d)
    return 0.5 * (out + out.swapaxes(1, 2))


def test_every_shape_is_the_same_metric(d):
    mesh = lattice_mesh(d)
    metric = random_metric(len(mesh.points), d)
    flat = metric.reshape(len(metric), -1)
    for given in (metric, flat, ts.packed(metric), metric.tolist(), lambda _: metric,
                  lambda x: ts.packed(metric)[: len(x)]):
        assert np.array_equal(metric_at_vertices(mesh, given), metric)
    assert np.allclose(metric_at_vertices(mesh, metric.astype(np.float32)), metric, rtol=1e-6)


def test_vertices_without_cells_may_have_anything(d):
    points, cells = jittered(d, 2, 0)
    mesh = simplex_mesh(np.concatenate([points, points[:1] + 9.0]), cells)[0]
    metric = random_metric(len(mesh.points), d)
    metric[-1] = np.nan
    found = metric_at_vertices(mesh, metric)
    assert np.array_equal(found[:-1], metric[:-1])
    assert np.array_equal(found[-1], np.eye(d))
    assert np.array_equal(metric_at_vertices(mesh, "input")[-1], np.eye(d))


def test_a_metric_of_space_is_seen_in_the_plane_of_its_triangles():
    flat, cells = jittered(2, 3, 0)
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    space = np.pad(flat, ((0, 0), (0, 1))) @ turn.T + 3.0
    frame = plane_frame(space, cells)
    mesh = simplex_mesh(frame.to_plane(space), cells)[0]
    metric = random_metric(len(space), 3)
    found = metric_at_vertices(mesh, metric, frame)
    edges = np.random.default_rng(2).normal(size=(len(space), 2))
    assert np.allclose(ts.squared_lengths(edges, found),
                       ts.squared_lengths(edges @ frame.axes, metric))
    seen = []
    metric_at_vertices(mesh, lambda x: seen.append(x) or metric, frame)
    assert np.allclose(seen[0], space)
    with pytest.raises(InvalidOptionError, match=r"axes are ambiguous .* expected \(16, 3, 3\)"):
        metric_at_vertices(mesh, random_metric(len(space), 2), frame)
    upright = PlaneFrame(np.array([0.0, 0, 5]), np.eye(3)[:2])
    plane = random_metric(len(space), 2)
    assert np.array_equal(metric_at_vertices(mesh, ts.packed(plane), upright), plane)


@pytest.mark.parametrize(("spoil", "message"), [
    (lambda m: m[:-1], r"got a metric of shape \(15, 2, 2\); expected \(16, 2, 2\), or \(16, 3\)"),
    (lambda m: m[:, 0, 0], r"got a metric of shape \(16,\); expected .*, try size= for lengths"),
    (lambda m: m[0], r"got a metric of shape \(2, 2\); .*, try numpy.broadcast_to"),
    (lambda m: np.ones((16, 6)), r"got a metric of shape \(16, 6\); expected .* m11 m12 m22$"),
    (lambda m: m * np.where(np.arange(16) > 3, np.nan, 1.0)[:, None, None],
     r"got a metric with NaN or infinite entries at vertex 4 \(12 of them\)"),
    (lambda m: m + np.where(np.arange(16) % 5 == 2, 1.0, 0.0)[:, None, None] * [[0, 1], [0, 0]],
     r"got a metric that is not symmetric at vertex 2 \(3 of them\)"),
    (lambda m: m * np.where(np.arange(16) == 7, -1.0, 1.0)[:, None, None],
     r"got a metric that is not positive definite at vertex 7 \(1 of them\)"),
    (lambda m: 0.0 * m, r"got a metric that is not positive definite at vertex 0 \(16 of them\)"),
    (lambda m: m * 0 + np.diag([1.0, 1.1e12]),
     r"got a metric with lengths whose ratio is beyond 1e\+06 at vertex 0 \(16 of them\)"),
    (lambda m: m * 1e300,
     r"got a metric with lengths beyond 1.41e-20 to 1.41e\+20 at vertex 0 \(16 of them\)"),
    (lambda m: m * np.where(np.arange(16) == 3, 1e-300, 1.0)[:, None, None],
     r"got a metric with lengths beyond 1.41e-20 to 1.41e\+20 at vertex 3 \(1 of them\)"),
    (lambda m: m.astype(complex), "got a metric that is no array of real numbers: they are of typ"),
    (lambda m: "length", "got a metric that is no array of real numbers"),
    (lambda m: [[1.0], [1.0, 2.0]], "got a metric that is no array of real numbers"),
])
def test_what_is_no_metric_is_refused_in_one_sentence(spoil, message):
    mesh = lattice_mesh(2)
    metric = random_metric(16, 2)
    with pytest.raises(InvalidOptionError, match=message) as raised:
        metric_at_vertices(mesh, spoil(metric))
    assert "\n" not in str(raised.value)
    with pytest.raises(InvalidOptionError, match=message):
        metric_at_vertices(mesh, lambda _: spoil(metric))


@pytest.mark.parametrize("unit", [1e-39, 1.0, 1e39])
@pytest.mark.parametrize("part", [1e-19, 1e19])
def test_cells_become_regular_in_a_metric_of_any_length_that_is_taken(unit, part):
    points, cells = tet_meshes.ball(100, 2)
    metric = np.tile(np.eye(3) * (unit * part) ** -2, (len(points), 1, 1))
    report = odt_plugins.optimize_with_report((unit * points, cells), metric=metric)[1]
    assert report.after.mean_quality > report.before.mean_quality + 0.1


def test_ratios_up_to_a_million_are_taken_however_they_are_turned(d):
    mesh = lattice_mesh(d, 6)
    axes = np.linalg.qr(np.random.default_rng(0).normal(size=(len(mesh.points), d, d)))[0]
    values = np.array([1.0, 1e12, 1e5])[:d]
    metric = np.einsum("nij,j,nkj->nik", axes, values, axes)
    assert np.allclose(metric_at_vertices(mesh, metric), metric)


def test_names_of_arrays_of_tensors():
    arrays = {"u": np.ones(3), "m": np.ones((3, 6)), "v": np.ones((3, 3)),
              "z": 1j * np.ones((3, 6))}
    host = HostMesh(np.zeros((3, 3)), np.array([[0, 1, 2]]), fields=arrays)
    assert named_metric(host, "m") is arrays["m"]
    for name in ("u", "w"):
        with pytest.raises(InvalidOptionError, match=f"got metric='{name}'; .* it has m$"):
            named_metric(host, name)


def test_cells_are_regular_with_unit_edges_in_their_metric(d):
    mesh = lattice_mesh(d)
    metric = ts.exponential(cell_logarithms(mesh.points, mesh.cells))
    for a in range(d + 1):
        for b in range(a):
            edge = mesh.points[mesh.cells[:, a]] - mesh.points[mesh.cells[:, b]]
            assert ts.squared_lengths(edge, metric) == pytest.approx(1.0, rel=1e-10)


def test_the_metric_of_an_affine_image_is_the_image_of_the_metric(d):
    # all metrics of a lattice of one shape of cell are alike, so that means are exact
    regular = np.array([[1.0, 0, 0], [0.5, 0.75**0.5, 0], [0.5, 12**-0.5, (2 / 3) ** 0.5]])[:d, :d]
    change = regular @ np.diag([1.0, 0.1, 1e-3][:d]) @ np.linalg.qr(
        np.random.default_rng(0).normal(size=(d, d)))[0]
    cell = np.arange(d + 1)[None].astype(np.int32)
    points = np.concatenate([np.zeros((1, d)), change])
    found = implied_metric(points, cell)
    inverse = np.linalg.inv(np.linalg.inv(regular) @ change)
    assert np.allclose(found, inverse @ inverse.T, rtol=1e-8)


def test_the_metric_of_a_sphere_is_tangential():
    points, cells = sm.sphere(2)
    metric = implied_metric(points, cells)
    values = np.linalg.eigvalsh(metric)
    assert (values[:, 2] < 2.0 * values[:, 0]).all()
    stretched = implied_metric(points * [1.0, 1.0, 0.1], cells)
    side = np.argmax(points[:, 0])
    values, axes = ts.eigenvalues(stretched[side])
    assert abs(axes[1, np.argmin(values)]) > 0.99
    assert np.ptp(np.sort(values)[1:]) < 0.2 * values.max()


def test_growth_of_sizes_is_that_of_size_fields(d):
    points, cells = jittered(d, 8, 0)
    size = 0.02 + 2.0 * np.abs(points[:, 0] - 0.5)
    expected = grown(points, unique_edges(cells), size, 1.3)
    found = grown_metric(points, cells, size[:, None, None] ** -2.0 * np.eye(d), 1.3)
    assert np.allclose(found, found[:, :1, :1] * np.eye(d), atol=1e-12 * found.max())
    assert np.allclose(found[:, 0, 0] ** -0.5, expected, rtol=0.03)


def test_no_length_changes_by_more_than_the_growth_along_an_edge(d):
    points, cells = jittered(d, 8, 0)
    metric = random_metric(len(points), d) * np.exp(10.0 * points[:, :1, None])
    found = grown_metric(points, cells, metric, 1.5)
    probes = np.random.default_rng(0).normal(size=(50, 1, d))
    assert (ts.squared_lengths(probes, found) >= 0.999 * ts.squared_lengths(probes, metric)).all()
    edges = unique_edges(cells)
    for p, q in (edges.T, edges.T[::-1]):
        length = np.sqrt(ts.squared_lengths(points[q] - points[p], found[p]))
        allowed = found[p] / ((1.0 + 0.5 * length) ** 2)[:, None, None]
        ratio = ts.squared_lengths(probes, allowed) / ts.squared_lengths(probes, found[q])
        assert ratio.max() < 1.03
    again = grown_metric(points, cells, found, 1.5)
    assert np.array_equal(again, found)


def test_bounds_of_lengths_and_ratios():
    metric = np.diag([1e8, 1.0, 1e-8])[None]
    found = np.diagonal(bounded_metric(metric, 1e3, 1e-3, 10.0)[0])
    assert found == pytest.approx([1e6, 1.0, 1.0])
    assert np.allclose(bounded_metric(metric, 1e9), metric)


@pytest.mark.parametrize("norm", [1.0, 2.0, 8.0])
def test_lengths_at_their_bound_are_those_of_a_larger_second_derivative(d, norm):
    """M is c det(G)^(-1 / (2 p + d)) G of the form G whose own M is just at the bound."""
    form = np.array([3.0, 0.2, 1e-6])[-d:]
    best = 100.0 * form * form.prod() ** (-1.0 / (2.0 * norm + d))
    found = np.diagonal(bounded_metric(np.diag(best)[None], 1e9, 0.0, 1.0, norm)[0])
    free = best >= found
    assert found[~free] == pytest.approx(1.0)
    assert (found[free] < best[free]).all()
    larger = np.where(free, form, form[free][0] / found[free][0])
    again = 100.0 * larger * larger.prod() ** (-1.0 / (2.0 * norm + d))
    assert found == pytest.approx(again, rel=1e-12)


def test_bounded_lengths_leave_the_least_error():
    """Half of the places curve along one axis alone; as many cells, none longer than 1."""
    forms = np.array([[1e-9, 1.0], [1.0, 1.0]])
    best = forms * (forms.prod(axis=1) ** (-1.0 / 6.0))[:, None]

    def error(norm):
        def bounded(scale):
            scaled = scale * best[:, :, None] * np.eye(2)
            return np.diagonal(bounded_metric(scaled, 1e9, 0.0, 1.0, norm), axis1=1, axis2=2)

        scale = brentq(lambda s: np.sqrt(bounded(np.exp(s)).prod(axis=1)).mean() - 50.0, 0.0, 40.0)
        return ((forms / bounded(np.exp(scale))).sum(axis=1) ** 2).mean()

    assert error(2.0) < 0.9 * error(np.inf)


def test_an_array_called_input_is_not_offered():
    points, cells = jittered(2, 3, 0)
    tensors = np.tile([1.0, 0.0, 1.0], (len(points), 1))
    host = HostMesh(points, cells, fields={"input": tensors, "M": tensors})
    with pytest.raises(InvalidOptionError, match=r"of this mesh, it has M$"):
        named_metric(host, "other")
