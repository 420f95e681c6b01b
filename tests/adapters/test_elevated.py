"""Quadratic cells with straight edges: vertices come and go, and every edge has its node."""

from __future__ import annotations

import warnings
from functools import partial
from itertools import combinations

import meshio
import numpy as np
import pytest
from boxes import EDGES, FACES, box, quadratic

from odt_plugins import optimize, optimize_with_report, remesh, remesh_with_report
from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.errors import DataNotKeptWarning, TangledMeshError, UnsupportedMeshError

THREE = [(0, 1), (1, 2), (2, 0)]


def field(x):
    return x[:, 0] ** 2 + x[:, 0] * x[:, 1] - x[:, 2] ** 2


def solid(n=4):
    """Nodes and cells of a box, and its sides with a label each."""
    points, cells = box(3, n, plane=0.5)
    x, nodes = quadratic(points, cells)
    middle = {tuple(sorted((row[a], row[b]))): row[4 + k]
              for row in nodes.tolist() for k, (a, b) in enumerate(EDGES)}
    facets = np.sort(cells[:, FACES].reshape(-1, 3), axis=1)
    facets, count = np.unique(facets, axis=0, return_counts=True)
    sides = [[*row, *(middle[tuple(sorted((row[a], row[b])))] for a, b in THREE)]
             for row in facets[count == 1].tolist()]
    corners = x[np.array(sides)[:, :3]]
    flat = np.ptp(corners, axis=1) == 0
    labels = 1 + 2 * flat.argmax(axis=1) + (corners.mean(axis=1)[flat] > 0.5)
    return x, nodes, np.array(sides), labels


def expect_whole(points, cells, sides=None):
    """Each edge has one node, at its middle, and all nodes are used."""
    assert np.array_equal(np.unique(cells), np.arange(len(points)))
    assert (np.linalg.det(points[cells[:, 1:4]] - points[cells[:, :1]]) > 0).all()
    middles = {}
    for rows, pairs in ((cells, EDGES), (sides, THREE)):
        for k, (a, b) in enumerate(pairs if rows is not None else ()):
            node = rows[:, (4 if pairs is EDGES else 3) + k]
            ends = np.sort(rows[:, [a, b]], axis=1)
            assert np.allclose(points[node], points[ends].mean(axis=1), atol=1e-15)
            for edge, one in zip(map(tuple, ends.tolist()), node.tolist(), strict=True):
                assert middles.setdefault(edge, one) == one


def areas(points, sides, labels):
    x = points[sides[:, :3]]
    size = np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1) / 2
    return np.bincount(labels, size)


@pytest.mark.parametrize("scale", [0.6, 1.8])
def test_meshio_has_a_node_on_every_edge_and_fields_of_second_order_are_exact(scale):
    x, nodes, sides, labels = solid()
    mesh = meshio.Mesh(x, [("tetra10", nodes), ("triangle6", sides)],
                       point_data={"f": field(x), "whole": np.arange(len(x))},
                       cell_data={"medit:ref": [np.zeros(len(nodes), int), labels]},
                       point_sets={"all": np.arange(len(x))})
    out = remesh(mesh, scale=scale, free=("periodic",))
    cells, faces = (block.data for block in out.cells)
    assert (len(cells) > len(nodes)) == (scale < 1)
    expect_whole(out.points, cells, faces)
    assert areas(out.points, faces, out.cell_data["medit:ref"][1])[1:] == pytest.approx(np.ones(6))
    assert np.allclose(out.point_data["f"], field(out.points), atol=1e-13)
    assert np.array_equal(np.sort(out.point_sets["all"]), np.arange(len(out.points)))
    stay = out.point_data["whole"]
    same = (x[stay] == out.points).all(axis=1)
    assert same.any()


@pytest.mark.parametrize("scale", [0.6, 1.8])
def test_beams_and_fins_beside_sides_that_are_resized_keep_their_nodes(scale):
    x, nodes, sides, labels = solid()
    n, top = len(x), int(np.flatnonzero((x == 1).all(axis=1))[0])
    [fin] = sides[(x[sides[:, :3]] == [1, 1, 1]).all(axis=2).any(axis=1) & (labels == 6)][:1]
    x = np.concatenate([x, [[1, 1, 1.5], [1, 1, 1.2], [2, 2, 2], [1.5, 1.5, 1.5], [1.5, 2, 2]]])
    fin = [fin[0], fin[1], n + 2, fin[3], n + 3, n + 4]
    edge = nodes[:, [0, 1, 4]]
    edge = np.unique(edge[(x[edge][:, :, :2] == 0).all(axis=(1, 2))], axis=0)
    lines = np.concatenate([[[top, n, n + 1]], edge])
    mesh = meshio.Mesh(x, [("tetra10", nodes), ("triangle6", np.concatenate([[fin], sides])),
                           ("line3", lines)],
                       cell_data={"medit:ref": [np.zeros(len(nodes), int), np.append(9, labels),
                                                np.append(9, np.ones(len(edge), int))]})
    out = remesh(mesh, scale=scale, free=("periodic",))
    (_, faces, rows), (_, own, of) = (b.data for b in out.cells), out.cell_data["medit:ref"]
    assert np.array_equal(out.points[faces[own == 9][0]], x[fin])
    assert np.array_equal(out.points[rows[of == 9][0]], x[lines[0]])
    assert areas(out.points, faces, own)[1:7] == pytest.approx(np.ones(6))
    assert len(faces) != len(sides) + 1


def test_as_many_corners_come_as_vertices_are_asked_for():
    x, nodes, *_ = solid(3)
    out = remesh(meshio.Mesh(x, [("tetra10", nodes)]), vertices=200, free=("periodic",))
    assert len(np.unique(out.cells[0].data[:, :4])) == pytest.approx(200, rel=0.05)


@pytest.mark.parametrize("n", [2, 3])
def test_no_edge_of_the_input_need_be_left(n):
    x, nodes = quadratic(*box(3, n))
    mesh = meshio.Mesh(x, [("tetra10", nodes)], point_data={"f": x[:, 0]})
    out = remesh(mesh, scale=6)
    assert len(out.cells[0].data) < len(nodes) / 3
    expect_whole(out.points, out.cells[0].data)
    assert np.allclose(out.point_data["f"], out.points[:, 0])


@pytest.mark.parametrize("scale", [0.7, 1.6])
def test_nodes_of_edges_that_stay_keep_their_place_and_data(scale):
    x, nodes, *_ = solid(5)
    frozen = (x[nodes[:, :4]][:, :, 0] < 0.5).all(axis=1)
    number = np.arange(len(x)) + 7
    mesh = meshio.Mesh(x, [("tetra10", nodes)], point_data={"id": number})
    out = remesh(mesh, scale=scale, selection=np.flatnonzero(~frozen))
    expect_whole(out.points, out.cells[0].data)
    kept = np.unique(nodes[frozen])
    now = {place.tobytes(): i for place, i in zip(out.points, out.point_data["id"], strict=True)}
    assert [now[place.tobytes()] for place in x[kept]] == number[kept].tolist()


@pytest.mark.parametrize("scale", [0.6, 1.8])
def test_grids_of_vtk_keep_their_sides(scale):
    pyvista = pytest.importorskip("pyvista")
    x, nodes, sides, labels = solid()
    grid = pyvista.UnstructuredGrid({24: nodes, 22: sides}, x)
    own = np.zeros(grid.n_cells, dtype=int)
    own[grid.celltypes == 22] = labels
    grid["side"], grid.point_data["f"] = own, field(x)
    out = remesh(grid, scale=scale, free=("periodic",))
    found = out.cells_dict
    expect_whole(out.points, found[24], found[22])
    assert areas(out.points, found[22], out["side"][out.celltypes == 22])[1:] == pytest.approx(
        np.ones(6))
    assert np.allclose(out["f"], field(out.points), atol=1e-13)
    assert out.compute_cell_sizes()["Volume"].sum() == pytest.approx(1)


@pytest.mark.parametrize("scale", [0.6, 1.8])
def test_scikit_fem_integrates_over_boundaries_and_subdomains(scale):
    skfem = pytest.importorskip("skfem")
    points, cells = box(3, 4, plane=0.5)
    mesh = skfem.MeshTet2.from_mesh(skfem.MeshTet(points.T.copy(), cells.T.copy()))
    mesh = mesh.with_boundaries({"left": lambda x: x[0] == 0, "top": lambda x: x[2] == 1})
    mesh = mesh.with_subdomains({"near": lambda x: x[0] < 0.5})
    out = remesh(mesh, scale=scale, free=("periodic",))
    assert isinstance(out, skfem.MeshTet2)
    assert out.t.shape[1] != mesh.t.shape[1]
    one = skfem.Functional(lambda w: 1 + 0 * w.x[0])
    element = skfem.ElementTetP2()
    assert one.assemble(skfem.Basis(out, element)) == pytest.approx(1, abs=1e-5)
    assert one.assemble(skfem.Basis(out, element, elements=out.subdomains["near"])) == (
        pytest.approx(0.5, abs=1e-5))
    for name in ("left", "top"):
        facets = skfem.FacetBasis(out, element, facets=out.boundaries[name])
        assert one.assemble(facets) == pytest.approx(1, abs=1e-5)


@pytest.mark.usefixtures("gmsh_ends")
@pytest.mark.parametrize("scale", [0.7, 1.5])
def test_the_model_of_gmsh_keeps_its_groups(scale):
    gmsh = pytest.importorskip("gmsh")
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.add("elevated")
    gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
    gmsh.model.occ.addBox(1, 0, 0, 1, 1, 1)
    gmsh.model.occ.fragment([(3, 1)], [(3, 2)])
    gmsh.model.occ.synchronize()
    gmsh.model.addPhysicalGroup(2, [1, 2], name="some")
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.3)
    gmsh.model.mesh.generate(3)
    gmsh.model.mesh.setOrder(2)
    before = len(gmsh.model.mesh.getNodes()[0])

    def measure(dim, entity):
        (tags,) = gmsh.model.mesh.getElements(dim, entity)[1]
        return gmsh.model.mesh.getElementQualities(tags, "volume").sum()

    report = remesh_with_report(gmsh.model, scale=scale)[1]
    assert report.fallback is None
    assert (report.before.n_points, report.after.n_points) == (
        before, len(gmsh.model.mesh.getNodes()[0]))
    types, tags, _ = gmsh.model.mesh.getElements(3)
    assert types.tolist() == [11]
    assert gmsh.model.mesh.getElementQualities(tags[0], "minDetJac").min() > 0
    assert [measure(3, i) for i in (1, 2)] == pytest.approx([1, 1])
    assert [measure(2, i) for i in (1, 2)] == pytest.approx([1, 1])
    assert (len(gmsh.model.mesh.getNodes()[0]) > before) == (scale < 1)


def test_nodes_that_a_deck_names_stay_on_their_edges(tmp_path):
    x, nodes, *_ = solid(3)
    inner = ((x > 0.2) & (x < 0.8)).all(axis=1)
    named = np.flatnonzero(inner)[np.flatnonzero(inner) >= nodes[:, :4].max() + 1][:3] + 1
    text = "*NODE\n" + "".join(f"{i}, {a!r}, {b!r}, {c!r}\n" for i, (a, b, c) in enumerate(
        x.tolist(), 1)) + "*ELEMENT, TYPE=C3D10\n" + "".join(
        ", ".join(map(str, [i, *row])) + "\n" for i, row in enumerate((nodes + 1).tolist(), 1))
    text += "*BOUNDARY\n" + "".join(f"{i}, 1, 3\n" for i in named.tolist())
    source, target = tmp_path / "a.inp", tmp_path / "b.inp"
    source.write_text(text)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*last digits", category=DataNotKeptWarning)
        write_file(target, remesh(read_file(source), scale=0.7, free=("periodic",)))
    assert target.read_text().partition("*BOUNDARY")[2] == text.partition("*BOUNDARY")[2]
    rows = {int(line.split(",")[0]): [float(w) for w in line.split(",")[1:4]] for line in
            target.read_text().partition("*ELEMENT")[0].splitlines()[1:]}
    assert [rows[i] for i in named.tolist()] == x[named - 1].tolist()
    out = read_file(target)
    assert len(out.cells[0].data) > len(nodes)
    places = {row.tobytes() for row in out.points[np.unique(out.cells[0].data[:, 4:])]}
    assert all(place.tobytes() in places for place in x[named - 1])


@pytest.mark.parametrize("run", [optimize, partial(remesh, scale=0.7)])
@pytest.mark.parametrize("kind", ["mask", "indices"])
def test_fixed_nodes_between_corners_stay_on_their_edges(run, kind):
    x, nodes, *_ = solid(3)
    inner = ((x > 0.2) & (x < 0.8)).all(axis=1)
    own = np.flatnonzero(inner & (np.arange(len(x)) > nodes[:, :4].max()))[::4]
    out = run(meshio.Mesh(x, [("tetra10", nodes)]),
              fixed=own if kind == "indices" else np.isin(np.arange(len(x)), own))
    assert not np.array_equal(out.points, x)
    places = {row.tobytes() for row in out.points[np.unique(out.cells[0].data[:, 4:])]}
    assert all(place.tobytes() in places for place in x[own])


@pytest.mark.parametrize("fields", ["auto", "keep"])
def test_vertices_are_inserted_among_quadratic_cells(fields):
    x, nodes, *_ = solid()
    mesh = meshio.Mesh(x, [("tetra10", nodes)], point_data={"f": field(x)})
    out, report = optimize_with_report(mesh, insert=0.5, fields=fields)
    assert report.counts["vertices added"] > 0
    expect_whole(out.points, out.cells[0].data)
    exact = np.allclose(out.point_data["f"], field(out.points), atol=1e-13)
    assert exact == (fields == "auto")


@pytest.mark.parametrize("scale", [0.6, 1.8])
def test_the_set_of_a_side_has_all_nodes_there_and_none_of_the_sides_next_to_it(scale):
    x, nodes, *_ = solid()
    mesh = meshio.Mesh(x, [("tetra10", nodes)], point_sets={"left": np.flatnonzero(x[:, 0] == 0)})
    out = remesh(mesh, scale=scale, free=("periodic",))
    assert len(out.points) != len(x)
    there = np.flatnonzero(np.abs(out.points[:, 0]) < 1e-12)
    assert np.array_equal(np.sort(out.point_sets["left"]), there)


@pytest.mark.parametrize("turn", [1.0, 1.5, 2.0])
@pytest.mark.parametrize("scale", [0.7, 1.4])
def test_linear_fields_are_exact_in_cells_that_are_bent_far(scale, turn):
    x, nodes = quadratic(*box(3, 3))
    radius, angle = 0.3 + x[:, 0], turn * x[:, 1]
    x = np.stack([radius * np.cos(angle), radius * np.sin(angle), x[:, 2]], axis=1)
    mesh = meshio.Mesh(x, [("tetra10", nodes)], point_data={"x": x.copy()})
    out = remesh(mesh, scale=scale)
    assert len(out.points) != len(x)
    assert np.allclose(out.point_data["x"], out.points, rtol=0, atol=1e-8)


@pytest.mark.parametrize("turn", [1.0, 2.0, 2.5])
@pytest.mark.parametrize("scale", [0.7, 1.4])
def test_linear_fields_are_exact_in_triangles_of_a_plane_in_space_that_are_bent_far(scale, turn):
    corners, cells = box(2, 4)
    edges = np.sort(cells[:, THREE], axis=2).reshape(-1, 2)
    edges, place = np.unique(edges, axis=0, return_inverse=True)
    x = np.concatenate([corners, corners[edges].mean(axis=1)])
    radius, angle = 0.3 + x[:, 0], turn * x[:, 1]
    x = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle], axis=1)
    nodes = np.concatenate([cells, len(corners) + place.reshape(-1, 3)], axis=1)
    out = remesh(meshio.Mesh(x, [("triangle6", nodes)], point_data={"x": x.copy()}), scale=scale)
    assert len(out.points) != len(x)
    assert np.allclose(out.point_data["x"], out.points, rtol=0, atol=1e-8)


def test_triangles_of_second_order_in_the_plane():
    points, cells = box(2, 6)
    edges, place = np.unique(np.sort(cells[:, THREE], axis=2).reshape(-1, 2), axis=0,
                             return_inverse=True)
    x = np.concatenate([points, points[edges].mean(axis=1)])
    nodes = np.concatenate([cells, len(points) + place.reshape(-1, 3)], axis=1)
    mesh = meshio.Mesh(x, [("triangle6", nodes)], point_data={"f": x[:, 0] * x[:, 1]})
    out = remesh(mesh, scale=0.7)
    rows = out.cells[0].data
    assert len(rows) > 1.5 * len(nodes)
    for k, (a, b) in enumerate(THREE):
        assert np.allclose(out.points[rows[:, 3 + k]], out.points[rows[:, [a, b]]].mean(axis=1))
    assert np.allclose(out.point_data["f"], out.points[:, 0] * out.points[:, 1], atol=1e-13)


def test_inverted_cells_and_higher_orders_are_refused():
    x, nodes, *_ = solid(3)
    inverted = x.copy()
    inner = int(np.flatnonzero(((x > 0.3) & (x < 0.7)).all(axis=1))[0])
    inverted[inner] += 0.5
    for k, (a, b) in enumerate(EDGES):
        inverted[nodes[:, 4 + k]] = inverted[nodes[:, [a, b]]].mean(axis=1)
    with pytest.raises(TangledMeshError, match=r"cells of higher order.*untangling"):
        remesh(meshio.Mesh(inverted, [("tetra10", nodes)]), scale=1)
    corners, cubic = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], []
    for weights in np.ndindex(4, 4, 4, 4):
        if sum(weights) == 3:
            cubic.append(weights)
    order = sorted(cubic, key=lambda w: (sum(k > 0 for k in w), w))
    points = np.array(order) @ np.array(corners) / 3
    assert len(list(combinations(range(4), 2))) == len(EDGES)
    with pytest.raises(UnsupportedMeshError, match="higher order; expected linear ones, or quadr"):
        remesh(meshio.Mesh(points, [("tetra20", np.arange(20)[None])]), scale=1)


@pytest.mark.parametrize("run", [partial(remesh, scale=0.8),
                                 partial(optimize_with_report, insert=True)])
def test_tangled_cells_are_refused_beside_valid_ones_with_inverted_corners(run):
    cube, rows = quadratic(*box(3, 5, seed=2))
    radius, angle = 0.5 + cube[:, 0], 0.5 * np.pi * cube[:, 1]
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), cube[:, 2]], axis=1)
    with pytest.raises(TangledMeshError, match=r"cells of higher order.*untangling"):
        run(meshio.Mesh(points, [("tetra10", rows)]))
