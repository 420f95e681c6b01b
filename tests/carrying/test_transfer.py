"""Arrays of the caller's own on the result: as those on the mesh, and as mathematics says."""

from __future__ import annotations

import pickle

import boxes
import contract
import meshio
import numpy as np
import pytest
import pyvista
import surface_meshes
import tangled_meshes
import tet_meshes
from gmsh_sessions import session

import odt_plugins
from odt_plugins.errors import InvalidOptionError, UnsupportedMeshError
from odt_plugins.figures import volumes

SLOPE = np.array([0.7, -1.3, 2.1])


def linear(points):
    return np.asarray(points, dtype=np.float64) @ SLOPE[: points.shape[1]] + 5.0


@pytest.mark.parametrize("name", [
    "pyvista-tet", "pyvista-tri", "vtk-polydata", "meshio-tet-blocks", "trimesh", "pymeshlab-mesh",
    "open3d-triangle", "pyvista-quadratic-tet", "skfem-tet"])
def test_arrays_of_the_mesh_are_carried_to_the_bits_that_the_host_has(name):
    contract.need(name)
    host = contract.HOSTS[name]
    mesh = host.make()
    before = host.view(mesh)
    out, report = odt_plugins.optimize_with_report(mesh)
    after = host.view(out)
    assert not contract.same_bits(before, after)
    places = [("cells", before.cell_data, after.cell_data)]
    if "quadratic" not in name:
        places.append(("points", before.point_data, after.point_data))
    for place, old, new in places:
        for key, values in old.items():
            if values.dtype.kind in "fiub":
                found = report.transfer(values, at=place)
                assert found.dtype == values.dtype
                assert found.tobytes() == new[key].tobytes(), key


@pytest.mark.parametrize("how", [{}, {"insert": True}, {"fields": "conserve"}])
def test_a_linear_field_is_exact_whatever_vertices_came(how):
    points, cells = tet_meshes.ball(250, 4)
    given = points.copy()
    (new, rows), report = odt_plugins.optimize_with_report((given, cells), **how)
    given[:] = 0.0  # the caller's arrays are the caller's
    assert (new[: len(points)] != points[: len(new)]).any()
    assert report.transfer(linear(points)) == pytest.approx(linear(new), abs=1e-9)
    vectors = report.transfer(points.astype(np.float32))
    assert vectors.dtype == np.float32
    assert vectors == pytest.approx(new, abs=1e-5)
    source = report.transfer(np.arange(len(cells)), at="cells")
    assert np.array_equal(source, report.cell_origin)
    assert len(source) == len(rows)
    again = pickle.loads(pickle.dumps(report))
    assert np.array_equal(again.transfer(linear(points)), report.transfer(linear(points)))


def test_remeshing_carries_fields_and_numbers_of_vertices():
    points, cells = tet_meshes.ball(250, 4)
    held = np.arange(0, len(points), 20)
    (new, rows), report = odt_plugins.remesh_with_report((points, cells), scale=1.5, fixed=held)
    assert len(rows) < len(cells)
    inside = np.abs(new).sum(axis=1) < 0.8
    assert report.transfer(linear(points))[inside] == pytest.approx(linear(new)[inside], abs=1e-9)
    number = report.transfer(np.arange(len(points)))
    here = (points[number] == new).all(axis=1)
    assert np.isin(held, number[here]).all()
    assert number.dtype == np.arange(1).dtype


def test_integrals_stay_where_the_run_keeps_them_and_vertices_keep_values_if_it_says_so():
    points, cells = tet_meshes.ball(250, 4)
    rng = np.random.default_rng(2)
    of_points, of_cells = rng.random(len(points)), rng.random((len(cells), 2))
    (new, rows), report = odt_plugins.optimize_with_report((points, cells), fields="conserve")
    old, now = volumes(points, cells), volumes(new, rows)
    values = report.transfer(of_points)
    assert np.sum(now * values[rows].mean(axis=1)) == pytest.approx(
        np.sum(old * of_points[cells].mean(axis=1)), rel=1e-12)
    assert now @ report.transfer(of_cells) == pytest.approx(old @ of_cells, rel=1e-12)
    _, report = odt_plugins.optimize_with_report((points, cells), fields="keep")
    assert np.array_equal(report.transfer(of_points), of_points)


def test_on_a_curved_surface_values_stay_unless_the_run_interpolates():
    points, cells = surface_meshes.sphere(2, noise=0.05)
    field = linear(points)
    (new, _), report = odt_plugins.optimize_with_report((points, cells), envelope=1e-2)
    assert (new != points).any()
    assert np.array_equal(report.transfer(field), field)
    (new, _), report = odt_plugins.optimize_with_report(
        (points, cells), fields="interpolate", envelope=1e-2)
    assert np.abs(report.transfer(field) - linear(new)).max() <= 0.1 * np.abs(
        field - linear(new)).max()


def test_values_of_a_mesh_that_is_untangled_stay_with_its_vertices():
    mesh = tangled_meshes.tangled(3, 3, "one vertex")[:2]
    (new, _), report = odt_plugins.optimize_with_report(mesh)
    assert report.untangled is not None
    assert report.transfer(np.arange(len(mesh[0]))).tolist() == list(range(len(mesh[0])))
    assert len(report.transfer(linear(mesh[0]))) == len(new)


def test_what_fits_nothing_or_two_things_is_refused():
    points = np.array([[0.0, 0], [2, 0], [2, 2], [0, 2], [1.2, 0.8]])
    fan = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    _, report = odt_plugins.optimize_with_report((points, fan))
    for values in ([1.0, 2.0, 3.0], 3.0):
        with pytest.raises(InvalidOptionError, match=r"one for each of the 5 points, 4 cells of"):
            report.transfer(values)
    with pytest.raises(InvalidOptionError, match="got values with rows of several lengths"):
        report.transfer([[1.0], [1.0, 2.0]])
    with pytest.raises(InvalidOptionError, match="at='cells'; expected"):
        report.transfer(np.ones(5), at="cells")
    with pytest.raises(InvalidOptionError, match="at='vertices'; expected 'points' or 'cells'"):
        report.transfer(np.ones(5), at="vertices")
    hexagon = np.exp(1j * np.pi / 3 * np.arange(6))
    ring = np.vstack([np.column_stack([hexagon.real, hexagon.imag]), [[0.1, 0.0], [0.4, 0.1]]])
    cells = np.array([[i, (i + 1) % 6, 6] for i in range(6)])
    cells = np.vstack([cells[cells[:, 0] != 0], [[0, 1, 7], [1, 6, 7], [6, 0, 7]]])
    _, report = odt_plugins.optimize_with_report((ring, cells))
    assert len(ring) == len(cells)
    with pytest.raises(InvalidOptionError, match="try at='points' or at='cells'"):
        report.transfer(np.ones(8))
    assert np.array_equal(report.transfer(np.arange(8), at="points"), np.arange(8))


def test_reports_of_several_meshes_send_to_their_parts_and_middle_nodes_to_the_mesh():
    points, cells = tet_meshes.ball(40, 1)
    grid = pyvista.UnstructuredGrid({10: cells}, points)
    _, report = odt_plugins.optimize_with_report(pyvista.MultiBlock([grid]))
    with pytest.raises(UnsupportedMeshError, match="of one of its parts"):
        report.transfer(np.ones(len(points)))
    assert len(report.parts[0].transfer(np.ones(len(points)), at="points")) == len(points)
    host = contract.HOSTS["pyvista-quadratic-tet"]
    mesh = host.make()
    _, report = odt_plugins.optimize_with_report(mesh)
    with pytest.raises(UnsupportedMeshError, match="a point array of the mesh itself"):
        report.transfer(np.ones(mesh.n_points))


@pytest.mark.parametrize("first", ["tetra", "triangle"])
@pytest.mark.parametrize("host", ["meshio", "pyvista"])
@pytest.mark.parametrize("scale", [1.6, 0.7])
def test_values_of_lines_and_triangles_follow_those_that_were_resized(scale, host, first):
    points, cells = boxes.box(3, 5)
    skin = np.array(sorted(contract.facets(cells, np.zeros(len(cells), int))))[:, :3]
    blocks = [("tetra", cells), ("triangle", skin)][:: 1 if first == "tetra" else -1]
    starts = np.cumsum([0, *(len(rows) for _, rows in blocks)])
    numbers = np.arange(starts[-1]) + 0.25
    mesh = meshio.Mesh(points, blocks, cell_data={"number": np.split(numbers, starts[1:-1])})
    if host == "pyvista":
        mesh = pyvista.from_meshio(mesh)
    out, report = odt_plugins.remesh_with_report(mesh, scale=scale, free="periodic")
    there = out.cell_data["number"]
    there = np.asarray(there) if host == "pyvista" else np.concatenate(there)
    assert len(there) != len(numbers)
    np.testing.assert_array_equal(report.transfer(numbers, at="cells"), there)
    np.testing.assert_array_equal(numbers[report.cell_origin], there)


def test_elements_of_a_model_that_was_resized_have_an_origin_each():
    with session() as gmsh:
        gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
        gmsh.model.occ.synchronize()
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.25)
        gmsh.model.mesh.generate(3)

        def entities():
            out = []
            for dim, tag in gmsh.model.getEntities():
                for tags in gmsh.model.mesh.getElements(dim, tag)[1]:
                    out += [(dim, tag)] * len(tags)
            return np.array(out)

        before = entities()
        report = odt_plugins.remesh_with_report(gmsh.model, scale=1.8)[1]
        after = entities()
        assert len(after) != len(before)
        np.testing.assert_array_equal(before[report.cell_origin], after)


def test_reports_of_a_model_on_its_geometry_can_be_pickled():
    with session() as gmsh:
        gmsh.model.occ.addSphere(0, 0, 0, 1)
        gmsh.model.occ.synchronize()
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.5)
        gmsh.model.mesh.generate(3)
        report = odt_plugins.remesh_with_report(gmsh.model, scale=0.8)[1]
    again = pickle.loads(pickle.dumps(report))
    values = np.random.default_rng(1).random(report.before.n_points)
    assert str(again) == str(report)
    assert np.array_equal(again.transfer(values), report.transfer(values))
