"""Curved quadratic cells get other sizes: what is new on the surface is on the curved one."""

from __future__ import annotations

from collections import Counter

import curved_meshes
import gmsh
import meshio
import numpy as np
import pytest

from odt_plugins import optimize_with_report, quality, remesh, remesh_with_report
from odt_plugins.adapters.elevated import _unfold
from odt_plugins.adapters.higher_order import lattice
from odt_plugins.carrying import aside
from odt_plugins.carrying.bending import note_on_flatter

SIDES = ((0, 2, 1, 6, 5, 4), (0, 1, 3, 4, 8, 7), (1, 2, 3, 5, 9, 8), (0, 3, 2, 7, 9, 6))
"""Corners of the facets of a tetrahedron, and the nodes on their edges (0, 1), (1, 2), (2, 0)."""


@pytest.fixture(scope="module", params=["ball", "can"])
def body(request, tmp_path_factory):
    """A body of Gmsh's with curved quadratic cells, and its name."""
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.add("body")
        if request.param == "ball":
            gmsh.model.occ.addSphere(0, 0, 0, 1)
        else:
            gmsh.model.occ.addCylinder(0, 0, 0, 0, 0, 1.5, 1)
        gmsh.model.occ.synchronize()
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.45)
        gmsh.model.mesh.generate(3)
        gmsh.model.mesh.setOrder(2)
        path = str(tmp_path_factory.mktemp("bent") / "body.msh")
        gmsh.write(path)
    finally:
        gmsh.finalize()
    read = meshio.read(path)
    rows = np.concatenate([block.data for block in read.cells if block.type == "tetra10"])
    used, number = np.unique(rows, return_inverse=True)
    return request.param, read.points[used], number.reshape(rows.shape)


def least(x, cells):
    """Least determinant of the Jacobian in every tetrahedron, by Gmsh."""
    return curved_meshes.qualities(x, cells[:, [0, 1, 2, 3, 4, 5, 6, 7, 9, 8]], 3, 2)[0]


def scaled(x, cells):
    """Least of the least determinants by the largest of every tetrahedron, by Gmsh."""
    low, high, _ = curved_meshes.qualities(x, cells[:, [0, 1, 2, 3, 4, 5, 6, 7, 9, 8]], 3, 2)
    return (low / high).min()


def volume(x, cells):
    """Volume of tetrahedra with ten nodes, by five places that integrate cubic polynomials.

    Source: Keast, Moderate-degree tetrahedral quadrature formulas, CMAME 55 (1986), 339-348.
    """
    near = np.full((4, 4), 1 / 6) + np.eye(4) / 3
    total = 0.0
    for share, place in [(-4 / 5, np.full(4, 0.25)), *((9 / 20, place) for place in near)]:
        slope = np.zeros((10, 4))
        slope[range(4), range(4)] = 4 * place - 1
        for k, (i, j) in enumerate([(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)], 4):
            slope[k, [i, j]] = 4 * place[[j, i]]
        rows = np.einsum("kd,mkx->mdx", slope[:, 1:] - slope[:, :1], x[cells])
        total += share * np.abs(np.linalg.det(rows)).sum() / 6
    return total


def skin(cells):
    """Facets (k, 6) of one cell alone."""
    facets = np.concatenate([cells[:, side] for side in SIDES])
    keys = list(map(tuple, np.sort(facets[:, :3], axis=1).tolist()))
    count = Counter(keys)
    return facets[[count[key] == 1 for key in keys]]


def off(name, x):
    """How far places are from the surface of the body."""
    if name == "ball":
        return np.abs(np.linalg.norm(x, axis=1) - 1)
    round_ = np.hypot(x[:, 0], x[:, 1]) - 1
    inside = np.minimum(np.abs(x[:, 2]), np.abs(x[:, 2] - 1.5))
    return np.minimum(np.where(round_ < 2e-3, inside, 1.0), np.abs(round_))


def flat_off(name, x, facets):
    """The same of the middles of straight edges."""
    pairs = np.concatenate([facets[:, [0, 1]], facets[:, [1, 2]], facets[:, [2, 0]]])
    return off(name, x[pairs].mean(axis=1))


@pytest.mark.parametrize("scale", [0.55, 1.0, 1.5])
def test_what_comes_on_the_surface_is_on_the_curved_one_and_no_cell_folds(body, scale):
    name, x, cells = body
    mesh = meshio.Mesh(x, [("tetra10", cells)], point_data={"f": x @ [1.0, -2, 3]})
    out, report = remesh_with_report(mesh, scale=scale)
    rows = out.cells[0].data
    assert report.fallback is None
    if scale < 1:
        assert len(rows) > 2 * len(cells)
    was = off(name, x[np.unique(skin(cells))]).max()
    now = off(name, out.points[np.unique(skin(rows))]).max()
    assert now < 0.1 * flat_off(name, x, skin(cells)).max()
    assert now < 6e-3
    assert was < 1e-9
    assert (least(out.points, rows) > 0).all()
    assert scaled(out.points, rows) > 0.3 < scaled(x, cells)
    assert report.curved["least_after"] == pytest.approx(scaled(out.points, rows), abs=2e-3)
    assert quality(mesh).volume == pytest.approx(volume(x, cells), rel=1e-12)
    assert report.before.volume == pytest.approx(volume(x, cells), rel=1e-12)
    assert report.after.volume == pytest.approx(volume(out.points, rows), rel=1e-12)
    assert report.slid["volume"] == pytest.approx(
        volume(out.points, rows) / volume(x, cells) - 1, abs=1e-12)
    assert np.array_equal(np.unique(rows), np.arange(len(out.points)))
    assert np.allclose(out.point_data["f"], out.points @ [1, -2, 3], atol=2e-3)


@pytest.mark.parametrize("body", ["can"], indirect=True)
def test_rims_stay_sharp(body):
    _, x, cells = body
    out = remesh(meshio.Mesh(x, [("tetra10", cells)]), scale=0.5)
    facets = skin(out.cells[0].data)
    height = out.points[facets, 2]
    caps = np.minimum(np.abs(height).max(axis=1), np.abs(height - 1.5).max(axis=1)) < 1e-14
    edges = [Counter(), Counter()]
    for flat, row in zip(caps, facets.tolist(), strict=True):
        for k in range(3):
            edges[int(flat)][(*sorted((row[k], row[(k + 1) % 3])), row[3 + k])] += 1
    rim = [edge for edge in edges[0] if edge in edges[1]]
    assert len(rim) >= 40
    nodes = out.points[np.unique(rim)]
    assert np.abs(np.hypot(nodes[:, 0], nodes[:, 1]) - 1).max() < 2e-3
    assert np.abs(nodes[:, 2] * (nodes[:, 2] - 1.5)).max() < 1e-12


@pytest.mark.parametrize("scale", [0.5, 1.6])
def test_rims_in_the_plane_are_curved_again(scale):
    shape = lattice(2, 2)
    x, cells = curved_meshes.annulus(shape, around=16)
    tilt = np.array([[1.0, 0, 0.5], [0, 1, 0.25]])
    for places in (x, x @ tilt):
        out = remesh(meshio.Mesh(places, [("triangle6", cells)]), scale=scale)
        rows = out.cells[0].data
        assert (len(rows) > len(cells)) == (scale < 1)
        pairs = [(row[k], row[(k + 1) % 3], row[3 + k]) for row in rows.tolist() for k in range(3)]
        count = Counter(tuple(sorted(p[:2])) for p in pairs)
        rim = np.array([p for p in pairs if count[tuple(sorted(p[:2]))] == 1])
        flat = np.linalg.lstsq(tilt.T, out.points.T, rcond=None)[0].T if places is not x else (
            out.points)
        radius = np.linalg.norm(flat[rim], axis=2)
        assert np.minimum(np.abs(radius - 1), np.abs(radius - 1.9)).max() < 3e-3
        assert (curved_meshes.qualities(flat, rows, 2, 2)[0] > 0).all()


@pytest.mark.parametrize("scale", [0.5, 1.0])
def test_nodes_of_a_curved_surface_are_on_it(body, scale):
    name, x, cells = body
    facets = skin(cells)
    used, number = np.unique(facets, return_inverse=True)
    out, report = remesh_with_report(
        meshio.Mesh(x[used], [("triangle6", number.reshape(facets.shape))]), scale=scale)
    assert report.fallback is None
    assert (len(out.cells[0].data) > 2 * len(facets)) == (scale < 1)
    assert off(name, out.points).max() < 6e-3


def test_curved_cells_stay_where_the_boundary_does_and_where_vertices_are_inserted(body):
    _, x, cells = body
    mesh = meshio.Mesh(x, [("tetra10", cells)])
    middle = x[cells[:, [[0, 1], [1, 2], [2, 0], [0, 3], [1, 3], [2, 3]]]].mean(axis=2)
    curved = (np.abs(x[cells[:, 4:]] - middle).max(axis=(1, 2)) > 1e-3)
    was = {tuple(sorted(map(tuple, rows))) for rows in x[cells[curved]].tolist()}
    for said, (out, report) in (
            ("the surface does; try boundary='slide'",
             remesh_with_report(mesh, scale=0.6, boundary="fixed")),
            ("vertices are inserted", optimize_with_report(mesh, insert=0.2))):
        now = {tuple(sorted(map(tuple, rows))) for rows in out.points[out.cells[0].data].tolist()}
        assert was <= now
        assert any(note.endswith(f"curved cells of the input stay as they are, since {said}")
                   for note in report.notes)
        assert not any("layers" in cell.hint for cell in report.binding)


def test_a_valid_cell_whose_corners_are_inverted_stays():
    x, cells = curved_meshes.notched(lattice(2, 2))
    mesh = meshio.Mesh(x, [("triangle6", cells)])
    for out in (remesh(mesh, scale=0.6), remesh(mesh, scale=1.5)):
        there = {frozenset(map(tuple, cell)) for cell in out.points[out.cells[0].data].tolist()}
        assert frozenset(map(tuple, x[cells[-1]].tolist())) in there
        low, high, _ = curved_meshes.qualities(out.points, out.cells[0].data, 2, 2)
        assert (np.sign(low) * np.sign(high) > 0).all()


def test_edges_of_folded_or_poor_cells_become_flatter():
    shape = lattice(3, 2)
    points = shape @ np.vstack([np.zeros(3), np.eye(3)]) / 2
    points[4] = [0.5, 0.3, 0.3]
    assert _unfold(points, np.arange(10)[None], shape, np.arange(4, 10), 0.1) == 1
    assert scaled(points, np.arange(10)[None]) >= 0.1
    bent = points.copy()
    assert _unfold(points, np.arange(10)[None], shape, np.arange(4, 10), 0.1) == 0
    assert np.array_equal(points, bent)
    assert _unfold(points, np.arange(10)[None], shape, np.arange(5, 10), 0.9) == 0
    assert np.array_equal(points, bent)
    assert _unfold(points, np.arange(10)[None], shape, np.arange(4, 10), 0.9) == 1
    assert scaled(points, np.arange(10)[None]) >= 0.9


def test_one_edge_and_one_cell_are_told_in_the_singular():
    assert note_on_flatter(1)[0].startswith("1 edge of cells is flatter")
    assert note_on_flatter(2)[0].startswith("2 edges of cells are flatter")
    assert "1 curved cell with" in aside.note(1)
    assert "stays as it is, and is in no figure" in aside.note(1)
    assert "stay as they are, and are in no figure" in aside.note(2)
