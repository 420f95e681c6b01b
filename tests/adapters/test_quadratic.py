"""Quadratic cells: the corners are those of the linear mesh, and every edge has one mid-node."""

from __future__ import annotations

import itertools
import warnings
from collections import Counter

import contract
import meshio
import numpy as np
import pytest
from quadratic_meshes import EDGES, MAKERS, MESHIO, WITH_DATA, churned, edges_of, view, widened

import odt_plugins
from odt_plugins.adapters import files
from odt_plugins.adapters.higher_order import (
    carried_point_data,
    check_mid_nodes,
    lattice,
    with_mid_nodes,
)
from odt_plugins.adapters.host import Result
from odt_plugins.engine.run import plan
from odt_plugins.errors import DataNotKeptWarning, InvalidMeshError, UnsupportedMeshError


def quadratic_grid(dim, n=4, shuffle=True):
    """Nodes, cells with mid-nodes and labels of a grid; boundary mid-nodes are off.

    With `shuffle` corners and mid-nodes are numbered in any order.
    """
    points, cells, labels = contract.grid(dim, n)
    nodes, rows = widened(points, cells)
    if shuffle:
        place = np.random.default_rng(3).permutation(len(nodes))
        nodes = nodes[np.argsort(place)]
        rows = place[rows]
    return nodes, rows, labels


@pytest.fixture(params=["engine", "churn"])
def _engine(request, monkeypatch):
    if request.param == "churn":
        churned(monkeypatch)


TURNED = {2: [0, 2, 1, 5, 4, 3], 3: [0, 1, 3, 2, 4, 8, 7, 6, 5, 9]}
"""Nodes of a cell whose last two corners are exchanged."""


@pytest.mark.parametrize("host", WITH_DATA)
def test_mid_nodes_stay_on_the_edges_of_cells_that_are_turned(host, d):
    pytest.importorskip(host)
    points, rows, labels = quadratic_grid(d)
    mixed = rows.copy()
    mixed[::3] = rows[::3][:, TURNED[d]]
    results = [view(odt_plugins.optimize(MAKERS[host](points, cells, labels, {}, d)), d)
               for cells in (rows, mixed)]
    for plain, turned in zip(*results, strict=True):
        np.testing.assert_equal(turned, plain)


@pytest.mark.usefixtures("_engine")
@pytest.mark.parametrize("host", WITH_DATA)
def test_mid_nodes_follow_their_edges(host, d):
    pytest.importorskip(host)
    points, rows, labels = quadratic_grid(d)
    linear = points @ np.arange(1.0, d + 1)
    old_edges = edges_of(rows, d)
    for (a, b), mid in old_edges.items():
        linear[mid] = (linear[a] + linear[b]) / 2
    data = {"linear": linear, "name": np.arange(len(points))}
    mesh = MAKERS[host](points, rows, labels, data, d)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        out = odt_plugins.optimize(mesh, keep=(), fields="keep")
    assert type(out) is type(mesh)
    old = view(mesh, d)
    assert np.array_equal(old[0], points)
    assert np.array_equal(old[1], rows)
    assert np.array_equal(old[2]["name"], data["name"])
    new_points, new_rows, point, cell = view(out, d)

    # Who is who: a node that is still there has its old name.
    new_edges = edges_of(new_rows, d)
    corners = np.unique(new_rows[:, : d + 1])
    was = dict(zip(corners.tolist(), point["name"][corners].tolist(), strict=True))
    assert sorted(was.values()) == np.unique(rows[:, : d + 1]).tolist()
    assert len(np.unique(new_rows)) == len(new_points)
    kept, fresh = 0, 0
    for (a, b), mid in new_edges.items():
        x, y = new_points[a], new_points[b]
        before = tuple(sorted((was[a], was[b])))
        middle = (x + y) / 2
        assert point["linear"][mid] == pytest.approx(
            (point["linear"][a] + point["linear"][b]) / 2, abs=1e-14)
        if before not in old_edges:
            fresh += 1
            assert new_points[mid] == pytest.approx(middle, abs=1e-15)
            assert point["name"][mid] in before
            continue
        kept += 1
        name = old_edges[before]
        assert point["name"][mid] == name
        offset = points[name] - (points[before[0]] + points[before[1]]) / 2
        assert new_points[mid] - middle == pytest.approx(offset, abs=1e-14)
        if (x == points[was[a]]).all() and (y == points[was[b]]).all():
            assert (new_points[mid] == points[name]).all()
    assert kept > fresh > 0
    named = [str(w.message) for w in caught if issubclass(w.category, DataNotKeptWarning)]
    gone = len(old_edges) - kept
    assert len(named) == (gone > 0)
    assert all(f"point data 'name' of {gone} mid-nodes" in text for text in named)

    # The corners are what the linear mesh gives.
    lone, cells, marker = odt_plugins.optimize((points, rows[:, : d + 1], labels), keep=())
    back = np.vectorize(was.get)(new_rows[:, : d + 1])
    assert np.array_equal(back, cells)
    assert np.array_equal(cell["marker"], marker)
    assert new_points[corners].tobytes() == lone[[was[c] for c in corners.tolist()]].tobytes()
    there = {tuple(sorted(c)): i for i, c in enumerate(rows[:, : d + 1].tolist())}
    same = [(i, there[tuple(sorted(c))]) for i, c in enumerate(back.tolist())
            if tuple(sorted(c)) in there]
    assert len(same) > 5
    assert all(cell["origin"][i] == j for i, j in same)
    now = {name: node for node, name in was.items()}
    for facet in contract.facets(rows[:, : d + 1], labels):
        for a in facet:
            assert new_points[now[a]].tobytes() == points[a].tobytes()


@pytest.mark.parametrize("host", WITH_DATA)
def test_the_report_counts_the_nodes_of_before_and_afterwards(host):
    pytest.importorskip(host)
    points, rows, labels = quadratic_grid(3)
    mesh = MAKERS[host](points, rows, labels, {}, 3)
    out, report = odt_plugins.optimize_with_report(mesh)
    now = view(out, 3)[0]
    assert len(now) != len(points)
    assert (report.before.n_points, report.after.n_points) == (len(points), len(now))


@pytest.mark.parametrize("host", WITH_DATA)
def test_without_flips_all_indices_stay_and_nothing_is_lost(host, d):
    pytest.importorskip(host)
    points, rows, labels = quadratic_grid(d)
    mesh = MAKERS[host](points, rows, labels, {"name": np.arange(len(points)) / 7}, d)
    out = odt_plugins.optimize(
        mesh, smoothing={"connectivity": "none"}, finish=False, fields="keep")
    new_points, new_rows, point, _ = view(out, d)
    assert np.array_equal(new_rows, rows)
    assert np.array_equal(point["name"], np.arange(len(points)) / 7)
    assert not np.array_equal(new_points, points)


@pytest.mark.parametrize("host", WITH_DATA)
def test_a_mesh_that_does_not_change_comes_back_bit_for_bit(host, d):
    pytest.importorskip(host)
    points, rows, labels = quadratic_grid(d)
    mesh = MAKERS[host](points, rows, labels, {"name": np.arange(len(points))}, d)
    out = odt_plugins.optimize(mesh, fixed=np.arange(len(points)),
                               smoothing={"connectivity": "none"}, finish=False)
    for a, b in zip(view(mesh, d)[:2], view(out, d)[:2], strict=True):
        assert a.tobytes() == b.tobytes()


def test_corners_keep_their_index_when_they_come_first(monkeypatch, d):
    churned(monkeypatch)
    points, rows, labels = quadratic_grid(d, shuffle=False)
    out = odt_plugins.optimize(MAKERS["meshio"](points, rows, labels, {}, d))
    n = int(rows[:, : d + 1].max()) + 1
    assert out.cells[0].data[:, : d + 1].max() == n - 1
    lone, *_ = odt_plugins.optimize((points, rows[:, : d + 1]), regions=labels)
    assert out.points[:n].tobytes() == lone[:n].tobytes()


FIVE = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0.3, 0.3, 1], [0.3, 0.3, -1]])
TWO, THREE = [[0, 1, 2, 3], [0, 2, 1, 4]], [[0, 1, 4, 3], [1, 2, 4, 3], [2, 0, 4, 3]]


def wide(cells):
    """Nodes, rows and mid-nodes by edge of a straight quadratic mesh of FIVE."""
    mid, nodes, rows = {}, list(FIVE), []
    for cell in cells:
        row = list(cell)
        for i, j in EDGES[3]:
            edge = tuple(sorted((cell[i], cell[j])))
            if edge not in mid:
                mid[edge] = len(nodes)
                nodes.append((FIVE[edge[0]] + FIVE[edge[1]]) / 2)
            row.append(mid[edge])
        rows.append(row)
    return np.array(nodes), np.array(rows), mid


@pytest.mark.parametrize("host", WITH_DATA)
def test_other_cells_follow_when_the_indices_close_up(host, monkeypatch):
    pytest.importorskip(host)
    nodes, rows, mid = wide(THREE)
    line = [1, 2, mid[1, 2]]
    assert line[2] > mid[3, 4]
    monkeypatch.setattr(plan, "run", lambda mesh, options, _: plan.Outcome(
        mesh.points, np.array(TWO, dtype=np.int32), np.zeros(2, dtype=np.int32)))
    if host == "meshio":
        mesh = meshio.Mesh(nodes, [("tetra10", rows), ("line3", [line])])
        out = odt_plugins.optimize(mesh)
        new, beside = out.cells[0].data, out.cells[1].data[0]
    else:
        import pyvista

        flat = np.concatenate([[len(p), *p] for p in [line, *rows.tolist()]])
        types = np.array([21, 24, 24, 24], dtype=np.uint8)
        out = odt_plugins.optimize(pyvista.UnstructuredGrid(flat, types, nodes))
        new, beside = out.cells_dict[24], np.array(out.get_cell(0).point_ids)
    assert len(out.points) == len(nodes) - 1
    assert np.array_equal(out.points[beside], nodes[line])
    assert edges_of(new, 3)[1, 2] == beside[2] == line[2] - 1


def test_more_edges_get_nodes_at_the_end_and_fewer_close_up():
    """Two tetrahedra on one face become three around an edge, and back."""
    nodes, rows, _ = wide(TWO)
    result = Result(nodes, np.array(THREE), np.array([0, 0, 1], dtype=np.int32))
    q = with_mid_nodes(result, nodes, rows, np.zeros(0, dtype=int), lattice(3, 2))
    assert len(q.points) == len(nodes) + 1
    assert q.points[-1] == pytest.approx([0.3, 0.3, 0.0])
    assert q.number.tolist() == list(range(len(nodes)))
    assert q.gone.size == 0
    assert carried_point_data("x", nodes[:, 2], q)[-1] == 0.0

    nodes, rows, mid = wide(THREE)
    result = Result(nodes, np.array(TWO), np.array([0, 1], dtype=np.int32))
    lost = mid[3, 4]
    for kept in ([], [lost]):
        q = with_mid_nodes(result, nodes, rows, np.array(kept, dtype=int), lattice(3, 2))
        assert q.gone.tolist() == [lost]
        assert len(q.points) == len(nodes) - 1 + len(kept)
        assert (q.number[lost] >= 0) == bool(kept)
        alive = np.flatnonzero(q.number >= 0)
        assert q.points[q.number[alive]].tobytes() == nodes[alive].tobytes()
        assert edges_of(q.cells, 3)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        carried_point_data("kept", np.arange(len(nodes)), q)
    q = with_mid_nodes(result, nodes, rows, np.zeros(0, dtype=int), lattice(3, 2))
    with pytest.warns(DataNotKeptWarning, match=rf"'label' of 1 mid-nodes \(first: node {lost}\)"):
        assert len(carried_point_data("label", np.arange(len(nodes)), q)) == len(nodes) - 1


def test_boundary_cells_and_point_sets_beside_them_follow(monkeypatch):
    churned(monkeypatch)
    points, rows, labels = quadratic_grid(3)
    mid = edges_of(rows, 3)
    outer = sorted(contract.facets(rows[:, :4], np.zeros(len(rows), int)))[:20]
    skin = np.array([[*f, *(mid[tuple(sorted((f[i], f[j])))] for i, j in EDGES[2])]
                     for f in outer])
    lines = skin[:, [0, 1, 3]]
    mesh = meshio.Mesh(points, [("triangle6", skin), ("tetra10", rows), ("line3", lines),
                                ("vertex", skin[:4, 5:])],
                       cell_data={"gmsh:physical": [np.arange(20), labels, np.arange(20),
                                                    np.arange(4)]},
                       point_sets={"skin": np.unique(skin)})
    out = odt_plugins.optimize(mesh)
    assert len(out.points) > len(points)
    assert [b.type for b in out.cells] == [b.type for b in mesh.cells]
    new = edges_of(out.cells[1].data, 3)
    for i in (0, 2, 3):
        a, b = mesh.cells[i].data, out.cells[i].data
        assert out.points[b].tobytes() == points[a].tobytes()
        assert np.array_equal(out.cell_data["gmsh:physical"][i], np.arange(len(a)))
    for row in out.cells[0].data.tolist():
        assert [new[tuple(sorted((row[i], row[j])))] for i, j in EDGES[2]] == row[3:]
    assert np.array_equal(np.unique(out.cells[0].data), np.sort(out.point_sets["skin"]))


def test_new_nodes_of_gmsh_files_lie_in_the_entity_of_their_cells(tmp_path, monkeypatch, d):
    churned(monkeypatch)
    points, rows, labels = quadratic_grid(d)
    labels = np.where(labels == 7, 1, 2)
    rim = contract.facets(rows[:, : d + 1], np.zeros(len(rows), int))
    mid = edges_of(rows, d)
    tags = np.zeros((len(points), 2), dtype=np.int32)
    tags[rows] = np.stack([np.full(len(rows), d), labels], axis=1)[:, None]
    for facet in rim:
        tags[[*facet, *(mid[e] for e in itertools.combinations(sorted(facet), 2))]] = [d - 1, 5]
    space = np.zeros((len(points), 3))
    space[:, :d] = points
    mesh = meshio.Mesh(space, [(MESHIO[d], rows)], point_data={"gmsh:dim_tags": tags},
                       cell_data={"gmsh:physical": [labels], "gmsh:geometrical": [labels]})
    out = odt_plugins.optimize(mesh)
    new = edges_of(out.cells[0].data, d)
    was = {p.tobytes(): tag for p, tag in zip(space, tags.tolist(), strict=True)}
    fresh = 0
    for row, label in zip(out.cells[0].data, out.cell_data["gmsh:geometrical"][0], strict=True):
        for i, j in EDGES[d]:
            node = new[tuple(sorted((row[i], row[j])))]
            tag = out.point_data["gmsh:dim_tags"][node].tolist()
            place = out.points[node].tobytes()
            fresh += place not in was
            assert tag == was.get(place, [d, label])
    assert fresh
    files.write_file(tmp_path / "out.msh", out)
    back = files.read_file(tmp_path / "out.msh")
    assert np.array_equal(np.unique(back.points, axis=0), np.unique(out.points, axis=0))


def test_a_point_set_of_a_volume_has_the_nodes_that_took_the_place_of_others(monkeypatch):
    churned(monkeypatch)
    points, rows, labels = quadratic_grid(2)
    mesh = MAKERS["meshio"](points, rows, labels, {}, 2)
    mesh.point_sets["all"] = np.arange(len(points))
    mesh.point_sets["most"] = np.arange(1, len(points))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        out = odt_plugins.optimize(mesh)
    assert np.array_equal(np.sort(out.point_sets["most"]), np.arange(1, len(out.points)))
    assert np.array_equal(out.point_sets["all"], np.arange(len(out.points)))


def test_other_cells_of_a_grid_take_the_new_numbers(monkeypatch):
    pyvista = pytest.importorskip("pyvista")
    churned(monkeypatch)
    points, rows, _ = quadratic_grid(3)
    mid = edges_of(rows, 3)
    face = sorted(contract.facets(rows[:, :4], np.zeros(len(rows), int)))[5]
    skin = [*face, *(mid[tuple(sorted((face[i], face[j])))] for i, j in EDGES[2])]
    parts = [skin, *rows.tolist(), [skin[0], skin[1], skin[3]], [skin[4]]]
    types = [22, *[24] * len(rows), 21, 1]
    flat = np.concatenate([[len(p), *p] for p in parts])
    mesh = pyvista.UnstructuredGrid(flat, np.array(types, dtype=np.uint8), points)
    mesh.cell_data["row"] = np.arange(len(parts))
    mesh.point_data["x"] = points[:, 0]
    mesh.point_data.active_scalars_name = "x"
    out = odt_plugins.optimize(mesh)
    assert out.n_points > mesh.n_points
    assert out.point_data.active_scalars_name == "x"
    for i in (0, len(parts) - 2, len(parts) - 1):
        (j,) = np.flatnonzero(out.cell_data["row"] == i)
        assert out.celltypes[j] == types[i]
        assert out.points[out.get_cell(int(j)).point_ids].tobytes() == points[parts[i]].tobytes()


@pytest.mark.parametrize("suffix", [".vtu", ".msh"])
def test_files_of_quadratic_cells(suffix, tmp_path, d):
    points, rows, labels = quadratic_grid(d)
    space = np.zeros((len(points), 3))
    space[:, :d] = points
    name = "gmsh:physical" if suffix == ".msh" else "marker"
    cell = {name: [np.where(labels == 7, 1, 2).astype(np.int32)]}
    if suffix == ".msh":
        cell["gmsh:geometrical"] = cell[name]
    files.write_file(tmp_path / f"in{suffix}", meshio.Mesh(space, [(MESHIO[d], rows)],
                                                          cell_data=cell))
    _, report = odt_plugins.optimize_with_report(tmp_path / f"in{suffix}",
                                                 target=tmp_path / f"out{suffix}")
    out = files.read_file(tmp_path / f"out{suffix}")
    assert out.cells[0].type == MESHIO[d]
    edges_of(out.cells[0].data, d)
    assert report.after.mean_quality > report.before.mean_quality
    assert odt_plugins.quality(out).mean_quality == pytest.approx(report.after.mean_quality)


def _two_nodes_on_one_edge(rows, spare):
    rows[3, 9] = spare


def _one_node_on_two_edges(rows, spare):
    rows[rows == rows[0, 4]] = rows[0, 5]


def _a_corner_as_mid_node(rows, spare):
    rows[rows == rows[0, 4]] = rows[0, 3]


def _an_index_too_large(rows, spare):
    rows[3, 9] = spare + 1


@pytest.mark.parametrize(("spoil", "message"), [
    (_two_nodes_on_one_edge, r"1 edges with more than one mid-node \(first: node"),
    (_one_node_on_two_edges, "1 mid-nodes that lie on more than one edge"),
    (_a_corner_as_mid_node, "1 mid-nodes that are corners of other cells"),
    (_an_index_too_large, r"out of range \(first: cell 3\); expected 0 to 27"),
])
def test_mid_nodes_that_do_not_fit_are_named(spoil, message):
    points, rows, _ = quadratic_grid(3, n=1)
    points = np.vstack([points, points[:1]])
    check_mid_nodes(rows, len(points), lattice(3, 2))
    spoil(rows, len(points) - 1)
    with pytest.raises(InvalidMeshError, match=message):
        odt_plugins.optimize(meshio.Mesh(points, [("tetra10", rows)]))


@pytest.mark.parametrize("beside", [False, True])
def test_other_quadratic_cells_are_refused_by_name(beside):
    pyvista = pytest.importorskip("pyvista")
    points, rows, _ = quadratic_grid(3, n=2)
    parts, types = ([rows[0]], [24]) if beside else ([], [])
    flat = np.concatenate([[len(p), *p] for p in [*parts, range(20)]])
    grid = pyvista.UnstructuredGrid(flat, np.array([*types, 25], dtype=np.uint8), points)
    message = rf"QUADRATIC_HEXAHEDRON \(first: cell {len(parts)}\)"
    with pytest.raises(UnsupportedMeshError, match=message):
        odt_plugins.optimize(grid)


def on_rim(rows, count):
    """Nodes of the facets that one cell alone has, of quadratic tetrahedra."""
    sides = [(0, 1, 2, 4, 5, 6), (0, 1, 3, 4, 7, 8), (1, 2, 3, 5, 8, 9), (0, 2, 3, 6, 7, 9)]
    keys = [tuple(sorted(row[list(side[:3])])) for row in rows for side in sides]
    size = Counter(keys)
    found = [row[list(side)] for row in rows for side in sides
             if size[tuple(sorted(row[list(side[:3])]))] == 1]
    return np.isin(np.arange(count), np.unique(found)).astype(np.int32)


@pytest.mark.parametrize("boundary", ["fixed", "slide"])
@pytest.mark.parametrize("host", WITH_DATA)
def test_nodes_of_new_edges_inside_have_the_marker_of_those_inside(host, boundary):
    pytest.importorskip(host)
    nodes, rows, _ = quadratic_grid(3)
    rim = {"rim": on_rim(rows, len(nodes))}
    mesh = MAKERS[host](nodes, rows, np.zeros(len(rows), int), rim, 3)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DataNotKeptWarning)
        _, cells, point, _ = view(odt_plugins.optimize(mesh, boundary=boundary, keep=()), 3)
    assert len(cells) != len(rows)
    assert np.array_equal(np.asarray(point["rim"]), on_rim(np.asarray(cells), len(point["rim"])))
