"""Cubic and quartic cells: corners are those of the linear mesh, every place has one node."""

from __future__ import annotations

from itertools import combinations, permutations

import contract
import meshio
import numpy as np
import pytest
from boxes import box
from higher_order import places_of, raised, sides
from quadratic_meshes import churned

import odt_plugins
from odt_plugins.adapters import files
from odt_plugins.adapters.higher_order import lattice
from odt_plugins.errors import DataNotKeptWarning, InvalidMeshError, UnsupportedMeshError

NAMES = {(2, 2): "triangle6", (3, 2): "tetra10",
         (1, 3): "line4", (2, 3): "triangle10", (3, 3): "tetra20",
         (1, 4): "line5", (2, 4): "triangle15", (3, 4): "tetra35"}
LAGRANGE = {1: 68, 2: 69, 3: 71}


@pytest.mark.parametrize("order", [2, 3, 4, 5])
def test_nodes_are_ordered_as_gmsh_orders_them(order):
    gmsh = pytest.importorskip("gmsh")
    gmsh.initialize(interruptible=False)
    try:
        for dim, name in ((1, "line"), (2, "triangle"), (3, "tetrahedron")):
            kind = gmsh.model.mesh.getElementType(name, order)
            _, _, _, count, flat, _ = gmsh.model.mesh.getElementProperties(kind)
            x = np.reshape(flat, (count, dim))
            x = (x + 1) / 2 if dim == 1 else x
            weights = np.column_stack([1 - x.sum(axis=1), x])
            assert np.array_equal(lattice(dim, order, "gmsh"), np.rint(order * weights)), name
    finally:
        gmsh.finalize()


@pytest.mark.parametrize("order", [2, 3, 4, 5])
@pytest.mark.parametrize("dim", [2, 3])
def test_nodes_are_ordered_as_vtk_orders_them(dim, order):
    model = pytest.importorskip("vtkmodules.vtkCommonDataModel")
    cell = model.vtkLagrangeTriangle() if dim == 2 else model.vtkLagrangeTetra()
    shape = lattice(dim, order, "vtk")
    cell.GetPointIds().SetNumberOfIds(len(shape))
    cell.GetPoints().SetNumberOfPoints(len(shape))
    cell.Initialize()
    for i, weights in enumerate(shape.tolist()):
        found = [0] * (dim + 1)
        cell.ToBarycentricIndex(i, found)
        # VTK tells the weight of the first corner last.
        assert [found[-1], *found[:-1]] == weights


def _mesh(host, nodes, rows, labels, dim, order):
    if host == "meshio":
        return meshio.Mesh(nodes, [(NAMES[dim, order], rows)],
                           point_data={"name": np.arange(len(nodes))},
                           cell_data={"marker": [labels]})
    pyvista = pytest.importorskip("pyvista")
    flat = np.column_stack([np.full(len(rows), rows.shape[1]), rows]).ravel()
    mesh = pyvista.UnstructuredGrid(flat, np.full(len(rows), LAGRANGE[dim], np.uint8),
                                    contract.in_space(nodes))
    mesh.point_data["name"] = np.arange(len(nodes))
    mesh.cell_data["marker"] = labels
    return mesh


def _view(mesh, dim):
    if isinstance(mesh, meshio.Mesh):
        return mesh.points, mesh.cells[0].data, mesh.point_data["name"]
    flat = np.asarray(mesh.cell_connectivity).reshape(mesh.n_cells, -1)
    return np.array(mesh.points)[:, :dim], flat, np.array(mesh.point_data["name"])


def _turned(rows, shape, exchanged):
    """The same cells with two corners exchanged."""
    order = np.arange(shape.shape[1])
    order[list(exchanged)] = order[list(exchanged)][::-1]
    place = {tuple(weights): i for i, weights in enumerate(shape.tolist())}
    return rows[:, [place[tuple(weights)] for weights in shape[:, order].tolist()]]


@pytest.mark.filterwarnings("ignore::odt_plugins.errors.DataNotKeptWarning")
@pytest.mark.parametrize("turned", [slice(0), slice(None), slice(None, None, 3)],
                         ids=["positive", "negative", "mixed"])
@pytest.mark.parametrize("order", [2, 3, 4])
@pytest.mark.parametrize("host", ["meshio", "pyvista"])
def test_linear_fields_stay_linear_whatever_the_orientation(host, order, turned, d):
    points, cells, labels = contract.grid(d, 4)
    shape = lattice(d, order, "gmsh" if host == "meshio" and order > 2 else "vtk")
    nodes, rows, _ = raised(points, cells, shape, off=0.0)
    rows[turned] = _turned(rows, shape, (0, 1))[turned]
    mesh = _mesh(host, nodes, rows, labels, d, order)
    slope = np.array([1.3, -0.7, 0.4])[:d]
    mesh.point_data["u"] = nodes @ slope
    out = odt_plugins.optimize(mesh)
    new = _view(out, d)[0]
    assert not np.array_equal(np.sort(new, axis=0), np.sort(nodes, axis=0))
    assert np.asarray(out.point_data["u"]) == pytest.approx(new @ slope, abs=1e-12)


@pytest.mark.filterwarnings("ignore::odt_plugins.errors.DataNotKeptWarning")
@pytest.mark.parametrize("churn", [False, True], ids=["engine", "churn"])
@pytest.mark.parametrize("order", [3, 4])
@pytest.mark.parametrize("host", ["meshio", "pyvista"])
def test_the_boundary_stays_and_all_else_is_on_straight_edges(host, order, churn, d, monkeypatch):
    if churn:
        churned(monkeypatch)
    points, cells, labels = contract.grid(d, 4)
    shape = lattice(d, order, "gmsh" if host == "meshio" else "vtk")
    nodes, rows, places = raised(points, cells, shape, off=0.005)
    mesh = _mesh(host, nodes, rows, labels, d, order)
    out = odt_plugins.optimize(mesh, keep=())
    assert type(out) is type(mesh)
    old = _view(mesh, d)
    assert np.array_equal(old[0], nodes)
    assert np.array_equal(old[1], rows)
    new_nodes, new_rows, name = _view(out, d)
    found = places_of(new_rows, shape)
    assert len(found) == len(new_nodes)

    # Corners are those of the linear mesh, and keep their index when they come first.
    linear, corners, _ = odt_plugins.optimize((nodes, rows[:, : d + 1], labels), keep=())
    assert np.array_equal(new_rows[:, : d + 1], corners)
    n = len(points)
    linear = linear[:n]
    assert new_nodes[:n].tobytes() == linear.tobytes()
    moved = {i for i in range(n) if (linear[i] != points[i]).any()}
    stay = sides(contract.facets(cells, labels))
    kept = fresh = held = 0
    for place, node in found.items():
        around = frozenset(v for v, _ in place)
        straight = sum(w * linear[v] for v, w in place) / order
        if around in stay:
            held += 1
            assert new_nodes[node].tobytes() == nodes[places[place]].tobytes()
        elif place not in places or around & moved:
            if place not in places and len(around) == order == 3:
                # The middle of a cubic face follows its edges.
                straight += sum(new_nodes[found[frozenset([(a, 2), (b, 1)])]]
                                - (2 * linear[a] + linear[b]) / 3
                                for a, b in permutations(around, 2)) / 4
            assert new_nodes[node] == pytest.approx(straight, abs=1e-14)
        if place in places:
            kept += 1
            assert name[node] == places[place]
        else:
            fresh += 1
            most = max(w for _, w in place)
            assert name[node] in {v for v, w in place if w == most}
    assert min(kept, fresh, held) > 0


@pytest.mark.filterwarnings("ignore::odt_plugins.errors.DataNotKeptWarning")
@pytest.mark.parametrize("order", [3, 4])
def test_lines_and_triangles_of_the_same_order_follow(order, monkeypatch):
    churned(monkeypatch)
    points, cells, labels = contract.grid(3, 4)
    shape = lattice(3, order, "gmsh")
    nodes, rows, places = raised(points, cells, shape)
    facets = np.array(sorted(contract.facets(cells, np.zeros(len(cells), int)))[:30])

    def beside(corners, dim):
        return np.array([[places[frozenset((v, w) for v, w in zip(c, weights, strict=True) if w)]
                          for weights in lattice(dim, order, "gmsh").tolist()]
                         for c in corners.tolist()])

    mesh = meshio.Mesh(nodes, [(NAMES[2, order], beside(facets, 2)), (NAMES[3, order], rows),
                               (NAMES[1, order], beside(facets[:, :2], 1))],
                       cell_data={"marker": [np.zeros(30, int), labels, np.zeros(30, int)]})
    out = odt_plugins.optimize(mesh, keep=())
    assert [block.type for block in out.cells] == [block.type for block in mesh.cells]
    found = places_of(out.cells[1].data, shape)
    assert len(out.points) != len(nodes)
    for i, dim in ((0, 2), (2, 1)):
        assert out.points[out.cells[i].data].tobytes() == nodes[mesh.cells[i].data].tobytes()
        for place, node in places_of(out.cells[i].data, lattice(dim, order, "gmsh")).items():
            assert found[place] == node


@pytest.mark.filterwarnings("ignore::odt_plugins.errors.DataNotKeptWarning")
@pytest.mark.parametrize("order", [2, 3, 4])
@pytest.mark.parametrize("suffix", [".msh", ".vtu"])
def test_files_of_gmsh_of_higher_order(suffix, order, tmp_path):
    gmsh = pytest.importorskip("gmsh")
    pytest.importorskip("vtkmodules")
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.occ.addSphere(0, 0, 0, 1)
        gmsh.model.occ.synchronize()
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.9)
        gmsh.model.mesh.generate(3)
        gmsh.model.mesh.setOrder(order)
        gmsh.write(str(tmp_path / "in.msh"))
    finally:
        gmsh.finalize()
    before = files.read_file(tmp_path / "in.msh")
    _, report = odt_plugins.optimize_with_report(tmp_path / "in.msh",
                                                 target=tmp_path / f"out{suffix}")
    assert report.after.mean_quality > report.before.mean_quality
    files.write_file(tmp_path / "back.msh", files.read_file(tmp_path / f"out{suffix}"))
    after = files.read_file(tmp_path / "back.msh")
    skins, tets = ([[block.data for block in mesh.cells if block.dim == dim]
                    for mesh in (before, after)] for dim in (2, 3))
    assert sum(map(len, tets[0])) > 50
    shape = lattice(3, order, "vtk" if order == 2 else "gmsh")
    assert len(places_of(np.concatenate(tets[1]), shape)) > 100
    rims = [np.unique(mesh.points[np.unique(np.concatenate(skin))], axis=0)
            for mesh, skin in zip((before, after), skins, strict=True)]
    assert np.array_equal(*rims)


def test_nodes_that_do_not_fit_are_named(d):
    points, cells, _ = contract.grid(d, 2)
    shape = lattice(d, 3, "gmsh")
    nodes, rows, _ = raised(points, cells, shape)
    spoilt = rows.copy()
    # The two nodes on an edge the other way round, in one of the cells at that edge.
    spoilt[0, [d + 1, d + 2]] = spoilt[0, [d + 2, d + 1]]
    owners = [set(pair) <= set(row) for row in cells.tolist()
              for pair in [cells[0, :2].tolist()]]
    if sum(owners) < 2:
        spoilt[0, [d + 3, d + 4]] = spoilt[0, [d + 4, d + 3]]
    nodes = np.vstack([nodes, nodes[:1]])
    for mesh_rows in (spoilt,):
        with pytest.raises(InvalidMeshError, match="places of an edge, face or cell with more"):
            odt_plugins.optimize(meshio.Mesh(nodes, [(NAMES[d, 3], mesh_rows)]))


def test_lagrange_cells_of_several_orders_are_refused():
    pyvista = pytest.importorskip("pyvista")
    points, cells, _ = contract.grid(3, 1)
    nodes, rows, _ = raised(points, cells, lattice(3, 3))
    parts = [*rows.tolist(), rows[0, :10].tolist()]
    flat = np.concatenate([[len(part), *part] for part in parts])
    grid = pyvista.UnstructuredGrid(flat, np.full(len(parts), 71, np.uint8), nodes)
    message = rf"1 Lagrange tetrahedron of another order than 3 \(first: cell {len(rows)}\)"
    with pytest.raises(UnsupportedMeshError, match=message):
        odt_plugins.optimize(grid)


def test_other_orders_beside_are_refused_by_name():
    points, cells, _ = contract.grid(3, 1)
    nodes, rows, _ = raised(points, cells, lattice(3, 3, "gmsh"))
    mesh = meshio.Mesh(nodes, [("tetra20", rows), ("triangle6", rows[:1, :6])])
    with pytest.raises(UnsupportedMeshError, match="1 cell of type triangle6"):
        odt_plugins.optimize(mesh)
    both = meshio.Mesh(nodes, [("triangle6", rows[:1, :6]), ("triangle", rows[:1, :3])])
    with pytest.raises(UnsupportedMeshError,
                       match="1 cell of type triangle6 beside triangle; expected cells of one or"):
        odt_plugins.optimize(both)


def test_values_at_places_that_are_gone_are_named(monkeypatch):
    churned(monkeypatch)
    points, cells, labels = contract.grid(2, 4)
    nodes, rows, _ = raised(points, cells, lattice(2, 3, "gmsh"), off=0.0)
    mesh = meshio.Mesh(nodes, [("triangle10", rows)], cell_data={"marker": [labels]},
                       point_data={"linear": nodes @ [1.0, 2.0], "name": np.arange(len(nodes))})
    edges = {frozenset(pair) for cell in cells.tolist() for pair in combinations(cell, 2)}
    with pytest.warns(DataNotKeptWarning, match="point data 'name' of ") as caught:
        out = odt_plugins.optimize(mesh, keep=())
    assert len(caught) == 1
    assert len(edges) > 20
    assert out.point_data["linear"].shape == (len(out.points),)


@pytest.mark.parametrize(("d", "order"), [(2, 3), (3, 3), (3, 4)])
def test_fixed_nodes_within_faces_and_cells_stay(d, order):
    points, cells = box(d, 4)
    shape = lattice(d, order, "gmsh")
    nodes, rows, _ = raised(points, cells, shape, 0.0)
    for size in range(3, d + 2):
        own = np.unique(rows[:, (shape > 0).sum(axis=1) == size])[::20]
        out = odt_plugins.optimize(meshio.Mesh(nodes, [(NAMES[d, order], rows)]), fixed=own)
        assert not np.array_equal(out.points, nodes)
        there = {row.tobytes() for row in out.points[np.unique(out.cells[0].data)]}
        assert all(place.tobytes() in there for place in nodes[own])
