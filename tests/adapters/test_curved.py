"""Curved cells that were valid stay so, and are no worse on the whole; Gmsh measures them."""

from __future__ import annotations

import meshio
import numpy as np
import pytest
from curved_meshes import NAMES, annulus, notched, qualities

import odt_plugins
from odt_plugins.adapters.higher_order import lattice

pytestmark = pytest.mark.filterwarnings("ignore::odt_plugins.errors.DataNotKeptWarning")

LAGRANGE = {2: 69, 3: 71}


def made(host, nodes, rows, order, dim=2):
    if host == "meshio":
        return meshio.Mesh(nodes, [(NAMES[dim, order], rows)])
    pyvista = pytest.importorskip("pyvista")
    place = {tuple(w): i for i, w in enumerate(lattice(dim, order, "gmsh").tolist())}
    rows = rows[:, [place[tuple(w)] for w in lattice(dim, order, "vtk").tolist()]]
    space = np.zeros((len(nodes), 3))
    space[:, :dim] = nodes
    flat = np.column_stack([np.full(len(rows), rows.shape[1]), rows]).ravel()
    return pyvista.UnstructuredGrid(flat, np.full(len(rows), LAGRANGE[dim], np.uint8), space)


def read(mesh, order, dim=2):
    if isinstance(mesh, meshio.Mesh):
        return mesh.points, mesh.cells[0].data
    place = {tuple(w): i for i, w in enumerate(lattice(dim, order, "vtk").tolist())}
    rows = np.asarray(mesh.cell_connectivity).reshape(mesh.n_cells, -1)
    rows = rows[:, [place[tuple(w)] for w in lattice(dim, order, "gmsh").tolist()]]
    return np.asarray(mesh.points)[:, :dim], rows


def no_worse(old, new, dim, order):
    """Compare least and mean of Gmsh's figures of all cells that are curved."""
    least = []
    for points, rows in (old, new):
        low, high, _ = qualities(points, rows, dim, order)
        assert (low > 0).all()
        x = points[rows[:, : dim + 1]][:, :, :dim]
        corners = np.linalg.det(x[:, 1:] - x[:, :1])
        ratio, shrunk = low / high, low / corners
        curved = ratio < 1 - 1e-9
        least.append([f(v[curved]) for v in (ratio, shrunk) for f in (np.min, np.mean)])
    # Gmsh's bounds are as sharp as it needs them.
    assert (np.array(least[1]) >= np.array(least[0]) - 2e-3).all()


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize(("order", "around", "seed"), [(2, 7, 4), (2, 7, 7), (2, 9, 0), (3, 9, 3)])
@pytest.mark.parametrize("host", ["meshio", "pyvista"])
def test_valid_cells_at_round_rims_stay_valid(host, order, around, seed, turned):
    pytest.importorskip("gmsh")
    nodes, rows = annulus(lattice(2, order, "gmsh"), around, seed)
    given = nodes * [1, -1] if turned else nodes
    out, report = odt_plugins.optimize_with_report(made(host, given, rows, order))
    new, cells = read(out, order)
    no_worse((nodes, rows), (new * [1, -1] if turned else new, cells), 2, order)
    assert np.array_equal(new, given) == ((order, around, seed) == (2, 7, 4))
    facts = report.curved
    low, high, _ = qualities(nodes, rows, 2, order)
    assert facts["least_before"] == pytest.approx((low / high).min(), abs=2e-3)
    assert facts["least_after"] >= facts["least_before"] - 1e-9
    assert facts["mean_after"] >= facts["mean_before"] - 1e-9
    text = str(report)
    assert f"least scaled Jacobian {facts['least_before']:.4f}" in text
    assert ("vertices stay" in text) == (facts["vertices_held"] > 0)


def test_cells_stay_valid_though_no_figure_is_kept():
    pytest.importorskip("gmsh")
    nodes, rows = annulus(lattice(2, 2, "gmsh"), 7, 4)
    new, cells = read(odt_plugins.optimize(made("meshio", nodes, rows, 2), keep=()), 2)
    assert not np.array_equal(new, nodes)
    assert (qualities(new, cells, 2, 2)[0] > 0).all()


@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_straight_cells_have_no_such_figures(kind):
    points = np.array([[0.0, 0], [1.1, 0], [1.1, 1], [0, 1], [0.8, 0.7]])
    cells = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    edges = np.unique(np.sort(cells[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)), axis=0)
    place = {tuple(e): 5 + i for i, e in enumerate(edges.tolist())}
    rows = [[*c, *(place[tuple(sorted(e))] for e in zip(c, [*c[1:], c[0]], strict=True))]
            for c in cells.tolist()]
    nodes = np.concatenate([points, points[edges].mean(axis=1)]).astype(kind)
    out, report = odt_plugins.optimize_with_report(made("meshio", nodes, np.array(rows), 2))
    assert not np.array_equal(out.points, nodes)
    assert report.curved is None


@pytest.fixture(scope="module")
def torus(tmp_path_factory):
    """A file of Gmsh with quadratic tetrahedra."""
    gmsh = pytest.importorskip("gmsh")
    path = tmp_path_factory.mktemp("torus") / "torus.msh"
    own = not gmsh.isInitialized()
    if own:
        gmsh.initialize(interruptible=False)
    gmsh.model.add("torus")
    wanted = {"General.Terminal": 0, "Mesh.MeshSizeMax": 0.6, "Mesh.ElementOrder": 2,
              "Mesh.HighOrderOptimize": 1}
    before = {name: gmsh.option.getNumber(name) for name in wanted}
    try:
        for name, value in wanted.items():
            gmsh.option.setNumber(name, value)
        gmsh.model.occ.addTorus(0, 0, 0, 1, 0.3)
        gmsh.model.occ.synchronize()
        gmsh.model.mesh.generate(3)
        gmsh.write(str(path))
    finally:
        for name, value in before.items():
            gmsh.option.setNumber(name, value)
        gmsh.model.remove()
        if own:
            gmsh.finalize()
    return path


@pytest.mark.parametrize("suffix", [".msh", ".vtu"])
def test_a_torus_of_quadratic_tetrahedra_stays_valid(suffix, torus, tmp_path):
    source, target = tmp_path / f"a{suffix}", tmp_path / f"b{suffix}"
    mesh = meshio.read(torus)
    if suffix == ".msh":
        source = torus
    else:
        meshio.Mesh(mesh.points, {"tetra10": mesh.cells_dict["tetra10"]}).write(source)
    odt_plugins.optimize(source, target=target)
    # Gmsh exchanges the last two nodes of meshio's.
    found = [(m.points, m.cells_dict["tetra10"][:, [*range(8), 9, 8]])
             for m in (mesh, meshio.read(target))]
    no_worse(*found, 3, 2)


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("flat", [True, False])
@pytest.mark.parametrize("order", [2, 3])
@pytest.mark.parametrize("host", ["meshio", "pyvista"])
def test_valid_cells_with_inverted_or_flat_corners_stay(host, order, flat, turned):
    pytest.importorskip("gmsh")
    nodes, rows = notched(lattice(2, order, "gmsh"), flat=flat)
    # Gmsh takes the sign of the corners, and says nothing where they have none.
    low, high, _ = qualities(nodes, rows[:-1] if flat else rows, 2, order)
    assert (np.sign(low) * np.sign(high) > 0).all()
    rows = np.concatenate([rows[:5], rows[-1:], rows[5:-1]])
    given = nodes * [1, -1] if turned else nodes
    mesh = made(host, given, rows, order)
    slope = np.array([0.6, -1.1])
    mesh.point_data["u"] = given @ slope
    density = np.ones(len(rows))
    out, report = odt_plugins.optimize_with_report(mesh, density=density)
    new, cells = read(out, order)
    assert not np.array_equal(new, given)
    assert np.asarray(out.point_data["u"]) == pytest.approx(new @ slope, abs=1e-12)
    there = [i for i, c in enumerate(cells.tolist()) if set(c[:3]) == set(rows[5, :3].tolist())]
    assert len(there) == 1
    assert new[cells[there[0]]].tobytes() == given[rows[5]].tobytes()
    seen = np.delete(cells, there if flat else [], axis=0)
    low, high, _ = qualities(new * [1, -1] if turned else new, seen, 2, order)
    assert (np.sign(low) * np.sign(high) > 0).all()
    assert any("1 curved cell" in line for line in report.notes)
    assert report.cell_origin is not None
    assert report.cell_origin[there[0]] == 5
    assert len(report.cell_origin) == len(cells)


def knotted(order, around, seed):
    """An annulus with an inner corner moved until cells are inverted; its edges are straight."""
    shape = lattice(2, order, "gmsh")
    nodes, rows = annulus(shape, around, seed)
    corners = np.unique(rows[:, :3])
    radius = np.linalg.norm(nodes[corners], axis=1)
    inner = corners[np.argmin(np.abs(radius - 1.45))]
    way = np.array([-nodes[inner][1], nodes[inner][0]]) / np.linalg.norm(nodes[inner])
    for step in np.arange(0.2, 3.0, 0.2):
        out = nodes.copy()
        out[inner] += step * way
        for row in rows[(rows[:, :3] == inner).any(axis=1)]:
            weights = shape / order
            at = weights[:, row[:3].tolist().index(inner)] > 0
            out[row[at]] = weights[at] @ out[row[:3]]
        x = out[rows[:, :3]]
        if (np.linalg.det(x[:, 1:] - x[:, :1]) <= 0).any():
            return out, rows
    raise AssertionError


@pytest.mark.parametrize(("order", "around", "seed"), [(2, 5, 2), (2, 7, 4), (3, 9, 1)])
def test_valid_cells_stay_valid_where_others_are_untangled(order, around, seed):
    pytest.importorskip("gmsh")
    nodes, rows = knotted(order, around, seed)
    assert (qualities(nodes, rows, 2, order)[0] > 0).all()
    mesh = meshio.Mesh(nodes, [(NAMES[2, order], rows)])
    out, report = odt_plugins.optimize_with_report(mesh)
    assert report.untangled["inverted"] > 0
    assert report.curved["folded"] == 0
    assert (qualities(out.points, out.cells[0].data, 2, order)[0] > 0).all()
    for name in ("least", "mean"):
        assert report.curved[f"{name}_after"] >= report.curved[f"{name}_before"] - 1e-9
