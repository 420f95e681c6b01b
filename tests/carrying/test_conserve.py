"""Values on a new mesh keep their integrals: exact fractions, closed forms, and every host."""

from __future__ import annotations

import warnings
from fractions import Fraction
from itertools import pairwise

import contract
import meshio
import numpy as np
import pytest
import surface_meshes
import tet_meshes
from scipy.spatial import Delaunay

import odt_plugins
from odt_plugins.carrying.conserve import After, conserved
from odt_plugins.errors import InvalidOptionError, TangledMeshError, UnsupportedMeshError
from odt_plugins.mesh.simplex import simplex_mesh

KINDS = {2: "triangle", 3: "tetra"}


def sizes(points, cells):
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    if edges.shape[1] < edges.shape[2]:
        return np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) / 2.0
    return np.abs(np.linalg.det(edges)) / (2.0 if points.shape[1] == 2 else 6.0)


def integrals(mesh, values, regions, *, of_points=False):
    """Integral of values over every region, and of their absolute values."""
    points, cells = mesh
    rows = values[cells].mean(axis=1) if of_points else values
    size = np.abs(values)[cells].mean(axis=1) if of_points else np.abs(rows)
    volume = sizes(points, cells)[(...,) + (None,) * (rows.ndim - 1)]
    return [[(volume * x)[regions == label].sum(axis=0) for x in (rows, size)]
            for label in np.unique(regions)]


def scattered(d, n, seed, grain=1 << 10):
    """A mesh of the unit cube, of points whose coordinates are whole multiples of 1 / grain."""
    corners = np.stack(np.meshgrid(*[[0, grain]] * d), axis=-1).reshape(-1, d)
    inside = np.random.default_rng(seed).integers(1, grain, (n, d))
    points = np.concatenate([corners, inside]) / grain
    return simplex_mesh(points, Delaunay(points).simplices)[0]


def nearest_after(before, mesh):
    """The new mesh, which has no vertex of the old one, with sources that may lie far away."""
    source = np.arange(len(mesh.cells)) % len(before.cells)
    return After(mesh.points, mesh.cells, source, np.full(len(mesh.points), -1))


def exact(points):
    return [[Fraction(float(x)) for x in row] for row in points]


def area(p, q, r):
    return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])


def clipped(polygon, triangle):
    """Convex polygon without what lies outside of a triangle, in fractions."""
    for a, b in pairwise([*triangle, triangle[0]]):
        out = []
        for p, q in pairwise([*polygon, *polygon[:1]]):
            s, t = area(a, b, p), area(a, b, q)
            out += [p] if s >= 0 else []
            if s * t < 0:
                out.append([x + (y - x) * s / (s - t) for x, y in zip(p, q, strict=True)])
        polygon = out
    return polygon


def linear(triangle, values, x):
    a, b, c = triangle
    return (values[0] * area(x, b, c) + values[1] * area(a, x, c)
            + values[2] * area(a, b, x)) / area(a, b, c)


def test_overlaps_of_triangles_are_those_of_exact_fractions():
    before, after = scattered(2, 7, 1), scattered(2, 6, 2)
    rng = np.random.default_rng(3)
    heat, height = rng.random(len(before.cells)), rng.random(len(before.points))
    between = rng.random(len(after.points))
    cells, points = conserved(before, nearest_after(before, after), {"heat": heat},
                              {"height": (height, between)})
    old, new = exact(before.points), exact(after.points)
    u, v = [[Fraction(float(x)) for x in values] for values in (height, between)]
    missed, around = [[Fraction(0)] * len(new) for _ in range(2)]
    for j, row in enumerate(after.cells.tolist()):
        here, mean = [new[i] for i in row], Fraction(0)
        for i in row:
            around[i] += area(*here) / 3
        for c, other in enumerate(before.cells.tolist()):
            there = [old[i] for i in other]
            polygon = clipped(here, there)
            for p, q in pairwise(polygon[1:]):
                part = [polygon[0], p, q]
                mean += area(*part) * Fraction(float(heat[c]))
                gap = [linear(there, [u[i] for i in other], x)
                       - linear(here, [v[i] for i in row], x) for x in part]
                for a, i in enumerate(row):
                    hat = [linear(here, [int(a == b) for b in range(3)], x) for x in part]
                    both = sum(x * y for x, y in zip(gap, hat, strict=True))
                    missed[i] += area(*part) * (sum(gap) * sum(hat) + both) / 12
        assert cells["heat"][j] == pytest.approx(float(mean / area(*here)), rel=1e-13)
    expected = [float(x + y / z) for x, y, z in zip(v, missed, around, strict=True)]
    assert points["height"] == pytest.approx(expected, rel=1e-12)


def test_tetrahedra_of_a_cube_take_what_lies_left_of_its_middle():
    fine, coarse = contract.grid(3, 2), contract.grid(3, 1)
    before, after = (simplex_mesh(*mesh[:2])[0] for mesh in (fine, coarse))
    left = (before.points[before.cells].mean(axis=1)[:, 0] < 0.5).astype(np.float64)
    heat = conserved(before, nearest_after(before, after), {"heat": left}, {})[0]["heat"]
    right = (after.points[after.cells][:, :, 0] > 0.5).sum(axis=1)
    assert heat == pytest.approx(np.array([0.0, 0.875, 0.5, 0.125])[right], abs=1e-14)


@pytest.mark.parametrize("d", [2, 3])
def test_meshes_that_share_nothing(d, many_threads):
    before, after = scattered(d, 60, 4), scattered(d, 40, 5)
    slope = np.arange(1.0, d + 1.0)
    x, y = before.points, after.points
    of_points = {"linear": (x @ slope - 1.0, y @ slope - 1.0), "one": (0 * x[:, 0] + 1.7,) * 2,
                 "wave": (np.sin(9 * x), np.cos(9 * y))}
    of_points["one"] = (of_points["one"][0], 0 * y[:, 0] + 1.7)
    of_cells = {"even": np.full(len(before.cells), 0.3),
                "flux": np.random.default_rng(6).normal(size=(len(before.cells), 2, 2)),
                "phase": np.exp(1j * np.arange(len(before.cells))),
                "gap": np.full(len(before.cells), np.nan)}
    new = nearest_after(before, after)
    cells, points = conserved(before, new, of_cells, of_points)
    assert (cells["even"] == 0.3).all()
    assert (points["one"] == 1.7).all()
    assert points["linear"] == pytest.approx(y @ slope - 1.0, abs=1e-12)
    assert "gap" not in cells
    old, now = (x, before.cells), (y, after.cells)
    for found, given, kind in ((cells, of_cells, False),
                               (points, {k: v[0] for k, v in of_points.items()}, True)):
        for name, values in found.items():
            (want, scale), = integrals(old, given[name], before.regions, of_points=kind)
            (got, _), = integrals(now, values, after.regions, of_points=kind)
            assert (np.abs(got - want) <= 1e-13 * scale).all()
    again = conserved(before, new, of_cells, of_points, threads=2)
    for found, same in zip((cells, points), again, strict=True):
        assert all(found[name].tobytes() == same[name].tobytes() for name in found)


def made(d, host):
    points, cells, _ = contract.grid(d, 5, 3)
    middle = points[cells].mean(axis=1)
    of_points = {"height": np.exp(2 * points[:, 0]) * np.cos(5 * points[:, 1]),
                 "linear": points[:, 0] - 2 * points[:, 1]}
    of_cells = {"heat": np.exp(middle[:, 0]) - 1.5, "marker": (middle[:, 0] > 0.5).astype(int),
                "step": np.arange(len(cells))}
    if host == "meshio":
        return meshio.Mesh(points, [(KINDS[d], cells)], point_data=of_points,
                           cell_data={name: [values] for name, values in of_cells.items()})
    space = np.pad(points, ((0, 0), (0, 3 - d)))
    if host == "trimesh":
        trimesh = pytest.importorskip("trimesh")
        return trimesh.Trimesh(space, cells, vertex_attributes=of_points, process=False,
                               face_attributes=of_cells)
    if host == "open3d":
        open3d = pytest.importorskip("open3d")
        mesh = open3d.t.geometry.TriangleMesh(space, cells.astype(np.int32))
        for at, values in ((mesh.vertex, of_points), (mesh.triangle, of_cells)):
            for name, x in values.items():
                at[name] = open3d.core.Tensor(x.reshape(-1, 1))
        return mesh
    if host == "pymeshlab":
        pymeshlab = pytest.importorskip("pymeshlab")
        mesh = pymeshlab.Mesh(space, cells)
        for name, x in of_points.items():
            mesh.add_vertex_custom_scalar_attribute(x, name)
        for name, x in of_cells.items():
            mesh.add_face_custom_scalar_attribute(x.astype(float), name)
        return mesh
    pyvista = pytest.importorskip("pyvista")
    mesh = pyvista.UnstructuredGrid({10 if d == 3 else 5: cells}, space)
    mesh.point_data.update(of_points)
    mesh.cell_data.update(of_cells)
    return mesh


def view(mesh, d):
    """Points, cells, point arrays and cell arrays."""
    name = type(mesh).__module__.partition(".")[0]
    if name == "meshio":
        return (mesh.points, mesh.cells[0].data, mesh.point_data,
                {key: values[0] for key, values in mesh.cell_data.items()})
    if name == "trimesh":
        return (mesh.vertices[:, :d], mesh.faces, mesh.vertex_attributes, mesh.face_attributes)
    if name == "open3d":
        point, cell = ({key: np.asarray(values.numpy()) for key, values in at.items()}
                       for at in (mesh.vertex, mesh.triangle))
        point, cell = ({key: x[:, 0] if x.shape[1] == 1 else x for key, x in part.items()}
                       for part in (point, cell))
        return point["positions"][:, :d], cell["indices"], point, cell
    if name == "pymeshlab":
        return (mesh.vertex_matrix()[:, :d], mesh.face_matrix(),
                {key: mesh.vertex_custom_scalar_attribute_array(key)
                 for key in ("height", "linear")},
                {key: mesh.face_custom_scalar_attribute_array(key)
                 for key in ("heat", "marker", "step")})
    cells = mesh.cells_dict[10 if d == 3 else 5]
    return np.asarray(mesh.points)[:, :d], cells, mesh.point_data, mesh.cell_data


def check(before, after, d, *, linear=True):
    (x, old, point0, cell0), (y, new, point1, cell1) = view(before, d), view(after, d)
    assert len(x) != len(y) or (x != y).any() or not np.array_equal(old, new)
    for name, of_points, bound in (("heat", False, 1e-12), ("height", True, 1e-9),
                                   ("linear", True, 1e-9)):
        source, found = (point0, point1) if of_points else (cell0, cell1)
        want, got = (integrals((p, c), np.asarray(values), np.asarray(labels),
                               of_points=of_points)
                     for p, c, values, labels in (
                         (x, old, source[name], cell0["marker"]),
                         (y, new, found[name], cell1["marker"])))
        assert len(want) == 2
        for (now, _), (then, scale) in zip(got, want, strict=True):
            assert abs(now - then) <= bound * scale, name
    assert set(np.asarray(cell1["step"]).tolist()) <= set(range(len(old)))
    if linear:
        assert np.asarray(point1["linear"]) == pytest.approx(y[:, 0] - 2 * y[:, 1], abs=1e-12)


@pytest.mark.parametrize("host", ["meshio", "pyvista", "trimesh", "open3d", "pymeshlab"])
def test_every_host_keeps_integrals_in_the_plane(host):
    mesh = made(2, host)
    out, report = odt_plugins.optimize_with_report(mesh, fields="conserve")
    check(mesh, out, 2)
    assert report.integrals == report.point_integrals == {}
    assert sorted(report.interpolated) == ["height", "linear"]


def test_pymeshlab_keeps_integrals_of_faces_alone_that_all_stay():
    pymeshlab = pytest.importorskip("pymeshlab")
    points, cells = surface_meshes.sphere(2, noise=0.02)
    heat = np.random.default_rng(2).random(len(cells))
    mesh = pymeshlab.Mesh(points, cells, f_scalar_array=heat)
    mesh.add_face_custom_scalar_attribute(heat, "heat")
    mesh.add_face_custom_point_attribute(np.stack([heat] * 3, axis=1), "flow")
    out = odt_plugins.optimize(mesh, fields="conserve", smoothing={"connectivity": "none"})
    assert np.array_equal(out.face_matrix(), cells)
    assert (out.vertex_matrix() != points).any()

    def areas(places):
        a, b, c = places[cells].transpose(1, 0, 2)
        return 0.5 * np.sqrt((np.cross(b - a, c - a) ** 2).sum(axis=1))

    want, now = (areas(points) * heat).sum(), areas(out.vertex_matrix())
    for values in (out.face_scalar_array(), out.face_custom_scalar_attribute_array("heat"),
                   *out.face_custom_point_attribute_matrix("flow").T):
        assert (now * values).sum() == pytest.approx(want, rel=1e-12)


@pytest.mark.parametrize(("d", "options"), [
    (3, {}), (3, {"insert": True})])
def test_regions_keep_integrals(d, options):
    mesh = made(d, "meshio")
    check(mesh, odt_plugins.optimize(mesh, fields="conserve", **options), d)


@pytest.mark.parametrize(("d", "options"), [
    (2, {"scale": 0.7}), (3, {"scale": 1.3}), (3, {"scale": 0.8, "boundary": "fixed"})])
def test_remeshed_regions_keep_integrals(d, options):
    mesh = made(d, "pyvista")
    out, report = odt_plugins.remesh_with_report(mesh, fields="conserve", **options)
    check(mesh, out, d, linear="boundary" in options)
    assert report.integrals == report.point_integrals == {}


def test_integrals_of_fields_are_told_where_they_change():
    mesh = made(2, "meshio")
    out, report = odt_plugins.remesh_with_report(mesh, scale=0.7)
    x, y = ((m.points, m.cells[0].data) for m in (mesh, out))
    (old, u), (new, v) = ((sizes(*mesh), field.point_data["height"][mesh[1]].mean(axis=1))
                          for mesh, field in ((x, mesh), (y, out)))
    change = abs(new @ v - old @ u) / (old @ np.abs(u))
    assert set(report.point_integrals) == {"height"}
    assert report.point_integrals["height"] == pytest.approx(change, rel=1e-6)
    assert set(report.integrals) == {"heat"}
    assert "integrals of point arrays changed" in str(report)


def test_a_ball_that_slides_keeps_integrals_and_zeros():
    points, cells = tet_meshes.ball(150, 4)
    left = (points[cells].mean(axis=1)[:, 0] < -0.2) * 1.0
    mesh = meshio.Mesh(points, [("tetra", cells)], cell_data={"left": [left]},
                       point_data={"even": np.full(len(points), 2.0)})
    out = odt_plugins.remesh(mesh, scale=1.2, envelope=0.005, fields="conserve", regions=None)
    now, nothing = (out.points, out.cells[0].data), np.zeros(len(out.cells[0].data), dtype=int)
    old = (points, cells), nothing[:1].repeat(len(cells))
    new_left, even = out.cell_data["left"][0], out.point_data["even"]
    assert sizes(*now).sum() != pytest.approx(sizes(points, cells).sum(), rel=1e-9)
    for values, before, of_points in ((new_left, left, False),
                                      (even, mesh.point_data["even"], True)):
        want = integrals(old[0], before, old[1], of_points=of_points)[0][0]
        got = integrals(now, values, nothing, of_points=of_points)[0][0]
        assert got == pytest.approx(want, rel=1e-12)
    assert np.ptp(even) < 1e-12
    right = out.points[now[1]][:, :, 0].min(axis=1) > 0.2
    assert right.any()
    assert (new_left[right] == 0.0).all()


def test_a_curved_surface_keeps_integrals():
    points, cells = surface_meshes.sphere(3, 0.2)
    mesh = meshio.Mesh(np.asarray(points), [("triangle", np.asarray(cells))],
                       point_data={"height": np.asarray(points)[:, 2] + 2.0},
                       cell_data={"heat": [np.arange(len(cells)) * 1.5]})
    out = odt_plugins.optimize(mesh, envelope=1e-2, fields="conserve")
    for name, of_points in (("height", True), ("heat", False)):
        got, want = (integrals((m.points, m.cells[0].data), m.point_data[name] if of_points else
                               m.cell_data[name][0], np.zeros(len(m.cells[0].data)),
                               of_points=of_points)[0][0] for m in (out, mesh))
        assert got == pytest.approx(want, rel=1e-12)


def test_what_has_no_exact_overlaps_is_refused(tmp_path):
    points, cells, _ = contract.grid(2, 3, 1)
    mesh = meshio.Mesh(points, [("triangle", cells)], point_data={"T": points[:, 0]})
    folded = mesh.copy()
    folded.points[np.flatnonzero((np.abs(points - 0.5) < 0.4).all(axis=1))[0]] += 0.9
    with pytest.raises(TangledMeshError, match="fields='conserve'"):
        odt_plugins.optimize(folded, fields="conserve")
    pyvista = pytest.importorskip("pyvista")
    wide = pyvista.from_meshio(mesh)
    ends = points[cells[:, [0, 1, 2]]] / 2 + points[cells[:, [1, 2, 0]]] / 2
    nodes = np.concatenate([points[cells], ends], axis=1).reshape(-1, 2)
    nodes, rows = np.unique(np.round(nodes, 12), axis=0, return_inverse=True)
    wide = pyvista.UnstructuredGrid({22: rows.reshape(-1, 6)}, np.pad(nodes, ((0, 0), (0, 1))))
    with pytest.raises(UnsupportedMeshError, match="fields='conserve' for cells of higher order"):
        odt_plugins.optimize(wide, fields="conserve")
    with pytest.raises(InvalidOptionError, match="fields='conserve' for refinement"):
        odt_plugins.refine(mesh, 1, fields="conserve")
    with pytest.raises(InvalidOptionError, match="fields='conserve' for a mesh in pieces"):
        odt_plugins.optimize(str(tmp_path), target=str(tmp_path / "a.pvtu"), fields="conserve")


@pytest.mark.parametrize("run", [odt_plugins.optimize, odt_plugins.remesh])
def test_empty_arrays_come_back_empty(run):
    points = np.random.default_rng(5).random((60, 2))
    cells = Delaunay(points).simplices
    mesh = meshio.Mesh(points, [("triangle", cells)], {"none": np.zeros((len(points), 0))},
                       {"none": [np.zeros((len(cells), 0))]})
    better = run(mesh, fields="conserve", **({} if run is odt_plugins.optimize else {"scale": 0.8}))
    assert better.point_data["none"].shape == (len(better.points), 0)
    assert better.cell_data["none"][0].shape == (len(better.cells[0].data), 0)


@pytest.mark.parametrize("kind", [np.float16, np.longdouble, np.complex64, np.clongdouble])
def test_numbers_of_any_width_are_conserved(kind):
    points = np.random.default_rng(5).random((60, 2))
    cells = Delaunay(points).simplices
    mesh = meshio.Mesh(points, [("triangle", cells)], {"x": points[:, 0].astype(kind)},
                       {"one": [np.ones(len(cells), kind)]})
    finer = odt_plugins.remesh(mesh, scale=0.8, fields="conserve")
    assert finer.point_data["x"].dtype == finer.cell_data["one"][0].dtype == kind
    assert np.allclose(finer.point_data["x"], finer.points[:, 0], atol=1e-2)
    assert np.allclose(finer.cell_data["one"][0], 1.0, atol=1e-2)


@pytest.mark.parametrize("kinds", [(">f8", ">f8"), ("f4", "f8")])
def test_arrays_of_blocks_keep_their_types_with_their_integrals(kinds):
    points = np.random.default_rng(5).random((60, 2))
    parts = np.array_split(Delaunay(points).simplices, 2)
    mesh = meshio.Mesh(points, [("triangle", part) for part in parts], {}, {
        "one": [np.ones(len(part), kind) for part, kind in zip(parts, kinds, strict=True)]})
    finer = odt_plugins.remesh(mesh, scale=0.8, fields="conserve", regions=None)
    assert [values.dtype for values in finer.cell_data["one"]] == [np.dtype(kind) for kind in kinds]


@pytest.mark.parametrize(("unit", "kind"), [(1e-310, "f8"), (1.5e308, "f8"), (3e38, "f4")])
@pytest.mark.parametrize("fields", ["conserve", "interpolate"])
def test_units_of_fields_do_not_matter(unit, kind, fields):
    points = np.random.default_rng(5).random((60, 2))
    cells = Delaunay(points).simplices
    place = {}
    for name, scale in (("plain", 1.0), ("far", unit)):
        mesh = meshio.Mesh(points, [("triangle", cells)], {
            "x": (scale * points[:, 0]).astype(kind)}, {
            "c": [(scale * points[cells[:, 0], 0]).astype(kind)]})
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            finer = odt_plugins.remesh(mesh, scale=0.8, fields=fields)
        place[name] = [values.astype(float) / scale for values in (
            finer.point_data["x"], finer.cell_data["c"][0])]
    for plain, far in zip(*place.values(), strict=True):
        np.testing.assert_allclose(far, plain, rtol=1e-5, atol=1e-9)
