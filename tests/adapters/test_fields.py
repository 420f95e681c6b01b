"""Fields follow places, not vertices: point arrays of floating-point numbers after a run."""

from __future__ import annotations

import contract
import meshio
import numpy as np
import pytest
import pyvista
import quadratic_meshes
import surface_meshes
import tet_meshes
from scipy.spatial import Delaunay

import odt_plugins
from odt_plugins.adapters.fields import field_names
from odt_plugins.carrying.sources import surrounding_cells
from odt_plugins.mesh.simplex import simplex_mesh

SLOPE = np.array([0.7, -1.3, 2.1])


def start(dim):
    if dim == 3:
        return tet_meshes.ball(250, 4)
    points = np.random.default_rng(8).random((300, 2))
    return np.pad(points, ((0, 0), (0, 1))), Delaunay(points).simplices.astype(np.int32)


def linear(points):
    return np.asarray(points, dtype=np.float64) @ SLOPE + 5.0


def data(points):
    """Point arrays that follow, and others that stay."""
    n = len(points)
    height = linear(points)
    follow = {"T": height, "flow": height[:, None] * [1.0, -2.0, 0.5],
              "single": height.astype(np.float32)}
    stay = {"count": np.arange(n), "flag": np.arange(n) % 3 == 0,
            "GlobalPointIds": np.arange(n) * 1.0, "vtkOriginalPointIds": np.arange(n) + 0.5,
            "Normals": np.tile([0.0, 0.6, 0.8], (n, 1)) * np.arange(1, n + 1)[:, None]}
    return follow, stay


def make(kind, dim):
    points, cells = start(dim)
    follow, stay = data(points)
    if kind == "meshio":
        stay["flag"] = stay["flag"].astype(np.uint8)
        block = "tetra" if dim == 3 else "triangle"
        return meshio.Mesh(points, [(block, cells)], point_data=follow | stay)
    if kind == "grid":
        mesh = pyvista.UnstructuredGrid({10 if dim == 3 else 5: cells}, points)
    else:
        mesh = pyvista.PolyData.from_regular_faces(points, cells)
    mesh.point_data.update(follow | stay)
    mesh.point_data["word"] = np.array([f"v{i}" for i in range(len(points))])
    mesh.point_data.active_normals_name = "Normals"
    return mesh


CASES = [("meshio", 2), ("meshio", 3), ("grid", 2), ("grid", 3), ("poly", 2)]


@pytest.mark.parametrize(("kind", "dim"), CASES)
def test_linear_fields_are_exact_and_everything_else_stays(kind, dim):
    mesh = make(kind, dim)
    out, report = odt_plugins.optimize_with_report(mesh)
    points, new = np.asarray(mesh.points), np.asarray(out.points)
    moved = (points != new).any(axis=1)
    assert moved.sum() > 50
    follow, stay = data(points)
    assert sorted(report.interpolated) == sorted(follow)
    assert "fields interpolated at the new places of vertices: " in str(report)
    assert report.to_dict()["interpolated"] == list(report.interpolated)
    for name, values in data(new)[0].items():
        found = np.asarray(out.point_data[name])
        assert found.dtype == values.dtype
        assert found[~moved].tobytes() == follow[name][~moved].tobytes()
        assert np.abs(found - values).max() < (1e-12 if found.dtype == np.float64 else 2e-6)
    for name, values in stay.items():
        assert np.array_equal(out.point_data[name], values), name
    if kind != "meshio":
        assert out.point_data.active_normals_name == "Normals"
        assert np.array_equal(out.point_data["word"], mesh.point_data["word"])
    kept, told = odt_plugins.optimize_with_report(mesh, fields="keep")
    assert np.array_equal(kept.points, new)
    assert told.interpolated == ()
    for name, values in (follow | stay).items():
        assert np.asarray(kept.point_data[name]).tobytes() == values.tobytes() or name == "flag"


@pytest.mark.parametrize("options", [{"boundary": "slide", "envelope": 1e-2}, {"insert": True}])
def test_linear_fields_are_exact_where_the_surface_slides_and_at_new_vertices(
        options, many_threads):
    mesh = make("grid", 3)
    out, report = odt_plugins.optimize_with_report(mesh, threads=2, **options)
    if "insert" in options:
        assert report.counts["vertices added"] > 0
    else:
        outer = np.linalg.norm(mesh.points, axis=1) > 0.999
        assert (mesh.points != out.points)[outer].any()
    assert np.abs(out["T"] - linear(out.points)).max() < 1e-12
    again = odt_plugins.optimize(mesh, **options)
    for name in out.point_data:
        assert np.asarray(again[name]).tobytes() == np.asarray(out[name]).tobytes()


def test_sets_and_other_blocks_of_meshio_stay_as_they_are():
    points, cells = start(2)
    inside = np.zeros(len(points), dtype=bool)
    inside[5:20] = True
    mesh = meshio.Mesh(points, [("triangle", cells), ("vertex", np.array([[0], [1]]))],
                       point_data={"T": linear(points)},
                       point_sets={"some": np.array([3, -1, 7]), "mask": inside})
    out = odt_plugins.optimize(mesh)
    assert np.abs(out.point_data["T"] - linear(out.points)).max() < 1e-12
    assert out.point_sets["some"].tolist() == [3, -1, 7]
    assert np.array_equal(out.point_sets["mask"], inside)
    assert np.array_equal(out.cells[1].data, [[0], [1]])


def test_a_kink_and_a_jump_between_regions_stay_sharp():
    points, cells, labels = contract.grid(3, 4)
    field = np.abs(points[:, 0] - 0.5)
    mesh = meshio.Mesh(points, [("tetra", cells)], point_data={"kink": field},
                       cell_data={"marker": [labels]})
    out = odt_plugins.optimize(mesh, keep=())
    assert (out.points != points).any(axis=1).sum() > 10
    assert np.abs(out.point_data["kink"] - np.abs(out.points[:, 0] - 0.5)).max() < 1e-12

    double = np.flatnonzero(points[:, 0] == 0.5)
    twin = np.arange(len(points))
    twin[double] = len(points) + np.arange(len(double))
    right = points[cells].mean(axis=1)[:, 0] > 0.5
    torn = np.where(right[:, None], twin[cells], cells)
    whole = np.concatenate([points, points[double]])
    side = np.zeros(len(whole))
    side[np.unique(torn[right])] = 1.0
    out = odt_plugins.optimize(meshio.Mesh(whole, [("tetra", torn)], point_data={"side": side}))
    assert (out.points != whole).any()
    assert np.array_equal(out.point_data["side"], side)


def test_walks_find_the_cell_around_a_point_in_meshes_with_holes():
    points, cells = tet_meshes.grid(4, 6, hole=True)
    mesh = simplex_mesh(points, cells)[0]
    rng = np.random.default_rng(1)
    weights = rng.dirichlet(np.ones(4), 400)
    home = rng.integers(0, len(cells), 400)
    x = np.einsum("kc,kcd->kd", weights, points[cells[home]])
    for begin in (None, np.zeros(400, dtype=np.int32), rng.integers(0, len(cells), 400)):
        for threads in (1, 2):
            cell, found = surrounding_cells(mesh, x, begin, threads)
            assert (found.min(axis=1) > -1e-11).all()
            assert np.abs(np.einsum("kc,kcd->kd", found, points[cells[cell]]) - x).max() < 1e-14
    away = x + 3.0
    cell, found = surrounding_cells(mesh, away)
    assert np.abs(np.einsum("kc,kcd->kd", found, points[cells[cell]]) - away).max() < 1e-12


def test_a_walk_stays_in_the_region_it_starts_in():
    points, cells, labels = contract.grid(2, 6)
    mesh = simplex_mesh(points, cells, regions=labels)[0]
    x = np.tile([[0.5 + 1e-9, 0.52]], (2, 1))
    begin = np.array([np.flatnonzero(mesh.regions == label)[0] for label in (0, 1)])
    cell, found = surrounding_cells(mesh, x, begin)
    assert mesh.regions[cell].tolist() == [0, 1]
    assert np.abs(found).max() < 2.0


def test_a_point_that_left_the_mesh_a_little_is_not_of_the_other_side_of_a_gap():
    points, cells = tet_meshes.grid(2, 3, jitter=0.0)
    upper = points + np.array([0.0, 0.0, 2.01])
    mesh = simplex_mesh(np.vstack([points, upper]), np.vstack([cells, cells + len(points)]))[0]
    x = np.array([[0.8, 0.9, 2.006], [0.8, 0.9, 2.004]])
    low = points[cells][:, :, 2].max(axis=1).argmax()
    high = upper[cells][:, :, 2].min(axis=1).argmin() + len(cells)
    cell, weights = surrounding_cells(mesh, x, np.array([low, high]))
    assert cell[0] < len(cells) <= cell[1]
    assert -0.1 < weights.min() < 0.0


@pytest.mark.parametrize("kind", ["pyvista", "meshio"])
@pytest.mark.parametrize("dim", [2, 3])
def test_fields_on_quadratic_cells(kind, dim):
    points, cells, labels = contract.grid(dim, 4)
    nodes, rows = quadratic_meshes.widened(points, cells)
    flat = nodes.copy()
    for (a, b), mid in quadratic_meshes.edges_of(rows, dim).items():
        flat[mid] = (points[a] + points[b]) / 2

    def square(x):
        return 1.0 + (x ** 2).sum(axis=1) - x[:, 0] * x[:, 1]

    def sloping(x):
        return 5.0 + x @ SLOPE[:dim]

    for place, field in ((nodes, sloping), (flat, sloping), (flat, square)):
        mesh = quadratic_meshes.MAKERS[kind](
            place, rows, labels, {"T": field(place), "id": np.arange(len(nodes)) * 1.0}, dim)
        out, report = odt_plugins.optimize_with_report(
            mesh, smoothing={"connectivity": "none"}, finish=False, keep=())
        new, _, data, _ = quadratic_meshes.view(out, dim)
        assert report.interpolated == ("T",)
        assert (new != place).any(axis=1).sum() > len(place) // 5
        assert np.abs(data["T"] - field(new)).max() < 1e-12
        assert np.array_equal(data["id"], np.arange(len(nodes)))
        del mesh.point_data["id"]
        out = odt_plugins.optimize(mesh)
        new, _, data, _ = quadratic_meshes.view(out, dim)
        assert np.abs(data["T"] - field(new)).max() < 1e-12
        kept = odt_plugins.optimize(
            mesh, smoothing={"connectivity": "none"}, finish=False, fields="keep")
        assert np.array_equal(quadratic_meshes.view(kept, dim)[2]["T"], field(place))


def test_fields_on_curved_surfaces_stay_unless_they_are_to_be_interpolated():
    points, cells = surface_meshes.sphere(3)
    points = points + 0.02 * np.random.default_rng(3).normal(size=points.shape)
    points /= np.linalg.norm(points, axis=1)[:, None]
    mesh = pyvista.PolyData.from_regular_faces(points, cells)
    mesh["z"] = points[:, 2].copy()
    out, report = odt_plugins.optimize_with_report(mesh, envelope=1e-2)
    assert report.interpolated == ()
    assert np.array_equal(out["z"], mesh["z"])
    follow, report = odt_plugins.optimize_with_report(mesh, envelope=1e-2, fields="interpolate")
    assert report.interpolated == ("z",)
    assert np.array_equal(out.points, follow.points)
    assert np.abs(follow["z"] - out.points[:, 2]).max() < 0.3 * np.abs(
        mesh["z"] - out.points[:, 2]).max()


@pytest.mark.parametrize("name", ["open3d-tensor", "pymeshlab-mesh"])
def test_hosts_whose_own_filters_keep_values_keep_them(name):
    contract.need(name)
    host = contract.HOSTS[name]
    mesh = host.make()
    out, report = odt_plugins.optimize_with_report(mesh, keep=())
    assert report.interpolated == ()
    before, after = host.view(mesh), host.view(out)
    assert (before.points != after.points).any()
    for key, values in before.point_data.items():
        assert np.array_equal(values, after.point_data[key]), key


def test_pymeshlab_interpolates_scalars_and_custom_attributes_when_asked_to():
    pymeshlab = pytest.importorskip("pymeshlab")
    points, cells = start(2)
    mesh = pymeshlab.Mesh(points, cells, v_scalar_array=linear(points))
    mesh.add_vertex_custom_scalar_attribute(linear(points) * 2.0, "twice")
    mesh.add_vertex_custom_point_attribute(points * 3.0, "thrice")
    mesh.add_vertex_custom_scalar_attribute(np.arange(len(points)) * 1.0, "node_id")
    for given in ({}, {"smoothing": {"connectivity": "none"}, "finish": False}):
        out, report = odt_plugins.optimize_with_report(mesh, fields="interpolate", **given)
        new = out.vertex_matrix()
        assert (new != points).any(axis=1).sum() > 50
        assert set(report.interpolated) == {"vertex scalar", "twice", "thrice"}
        assert np.abs(out.vertex_scalar_array() - linear(new)).max() < 1e-12
        for name, truth in (("twice", linear(new) * 2), ("node_id", np.arange(len(points)))):
            found = out.vertex_custom_scalar_attribute_array(name)
            assert np.abs(found - truth).max() < 1e-12
        found = out.vertex_custom_point_attribute_matrix("thrice")
        assert np.abs(found - 3.0 * new).max() < 1e-12


def test_the_filters_for_meshlab_have_the_option():
    pymeshlab = pytest.importorskip("pymeshlab")
    odt_plugins.register("pymeshlab")
    points, cells = start(2)
    for name in ("apply_coord_odt_smoothing", "meshing_odt_optimization"):
        for fields in ("auto", "keep", "interpolate"):
            meshes = pymeshlab.MeshSet()
            meshes.add_mesh(pymeshlab.Mesh(points, cells, v_scalar_array=linear(points)))
            meshes.apply_filter(name, fields=fields)
            new = meshes.current_mesh().vertex_matrix()
            truth = linear(new if fields == "interpolate" else points)
            assert (new != points).any()
            assert np.abs(meshes.current_mesh().vertex_scalar_array() - truth).max() < 1e-12


def test_open3d_interpolates_colours_and_attributes_when_asked_to():
    open3d = pytest.importorskip("open3d")
    points, cells = start(2)
    rgb = np.clip(points, 0.0, 1.0)
    tensor = open3d.core.Tensor
    mesh = open3d.t.geometry.TriangleMesh(tensor(points), tensor(cells))
    attributes = {"colors": rgb, "T": linear(points)[:, None],
                  "id": np.arange(len(points))[:, None]}
    for name, values in attributes.items():
        mesh.vertex[name] = tensor(values)
    out, report = odt_plugins.optimize_with_report(mesh, fields="interpolate")
    new = out.vertex["positions"].numpy()
    assert (new != points).any(axis=1).sum() > 50
    assert set(report.interpolated) == {"colors", "T"}
    assert np.abs(out.vertex["T"].numpy()[:, 0] - linear(new)).max() < 1e-12
    assert np.abs(out.vertex["colors"].numpy() - new).max() < 1e-12
    assert np.array_equal(out.vertex["id"].numpy(), attributes["id"])

    old = open3d.geometry.TriangleMesh(open3d.utility.Vector3dVector(points),
                                       open3d.utility.Vector3iVector(cells))
    solid = tet_meshes.ball(200, 4)
    tets = open3d.geometry.TetraMesh(open3d.utility.Vector3dVector(solid[0]),
                                     open3d.utility.Vector4iVector(solid[1]))
    for given, place in ((old, points), (tets, solid[0])):
        given.vertex_colors = open3d.utility.Vector3dVector(place * 0.1 + 0.5)
        kept = odt_plugins.optimize(given)
        assert np.array_equal(kept.vertex_colors, given.vertex_colors)
        out = odt_plugins.optimize(given, fields="interpolate")
        new = np.asarray(out.vertices)
        assert (new != place).any(axis=1).sum() > 20
        assert np.abs(np.asarray(out.vertex_colors) - (new * 0.1 + 0.5)).max() < 1e-12


def test_names_that_say_who_a_vertex_is_are_no_fields():
    ids = ("GlobalPointIds", "GlobalNodeId", "PedigreeNodeId", "vtkOriginalPointIds", "id", "index",
           "gmsh:dim_tags", "node_number", "Normals", "vtkGhostType")
    values = np.zeros(3)
    assert field_names(dict.fromkeys(ids, values)) == ()
    fields = ("T", "p", "u", "Temperature", "normal_stress", "identity", "tag_density", "rho")
    assert field_names(dict.fromkeys(fields, values)) == fields
    assert field_names(dict.fromkeys(fields, values), ("T", None)) == fields[1:]
    assert field_names({"a": values.astype(int), "b": values > 0, "c": np.array(["x"])}) == ()
    assert field_names({"a": values.astype("f2"), "b": values.astype("c16")}) == ("a", "b")
