"""Where the boundary slides, labels of lines and triangles on it stay on the piece they are of."""

from __future__ import annotations

import boxes
import meshio
import numpy as np
import pytest

from odt_plugins import optimize, remesh

LINES = [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]


def sides(points, cells):
    """Facets of a box where its last coordinate is 1."""
    rows = np.sort(np.concatenate([np.delete(cells, i, axis=1)
                                   for i in range(cells.shape[1])]), axis=1)
    return np.unique(rows[(points[rows][:, :, -1] == 1).all(axis=1)], axis=0)


def labelled(dim, *, curved):
    """A box with uneven cells, whose flat top has an inlet in its middle and walls around."""
    points, cells = boxes.box(dim, 8 if dim == 2 else 6)
    points = points**1.4
    faces = sides(points, cells)
    middle = points[faces].mean(axis=1)[:, :-1]
    inlet = (np.abs(middle - 0.35) < 0.3).all(axis=1)
    names = ["triangle", "line"] if dim == 2 else ["tetra", "triangle"]
    if curved:
        pairs = LINES[:3] if dim == 2 else LINES
        edges, place = np.unique(np.sort(cells[:, pairs], axis=2).reshape(-1, 2), axis=0,
                                 return_inverse=True)
        cells = np.hstack([cells, len(points) + place.reshape(len(cells), -1)])
        own = [(0, 1)] if dim == 2 else LINES[:3]
        key = {tuple(edge): len(points) + i for i, edge in enumerate(edges.tolist())}
        between = [[key[tuple(sorted((row[a], row[b])))] for a, b in own] for row in faces.tolist()]
        faces = np.hstack([faces, between])
        points = np.concatenate([points, points[edges].mean(axis=1)])
        names = ["triangle6", "line3"] if dim == 2 else ["tetra10", "triangle6"]
    return meshio.Mesh(points, [(names[0], cells), (names[1], faces)], cell_data={
        "side": [np.zeros(len(cells), dtype=int), np.where(inlet, 2, 1)]})


def sizes(mesh, dim):
    """Length or area of each label."""
    x = mesh.points[mesh.cells[1].data[:, :dim]]
    x = np.pad(x, ((0, 0), (0, 0), (0, 3 - mesh.points.shape[1])))
    edges = x[:, 1:] - x[:, :1]
    area = np.linalg.norm(edges[:, 0], axis=1) if dim == 2 else 0.5 * np.linalg.norm(
        np.cross(edges[:, 0], edges[:, 1]), axis=1)
    return np.bincount(mesh.cell_data["side"][1], area)


@pytest.mark.parametrize("curved", [False, True], ids=["linear", "quadratic"])
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("numbered", [False, True])
@pytest.mark.parametrize("host", ["meshio", "pyvista"])
def test_an_inlet_in_a_flat_side_has_its_size(host, numbered, dim, curved):
    mesh = labelled(dim, curved=curved)
    if numbered:
        count = [len(block.data) for block in mesh.cells]
        mesh.cell_data["CellIds"] = np.split(np.arange(sum(count)), [count[0]])
    before = sizes(mesh, dim)
    if host == "meshio":
        out = optimize(mesh, boundary="slide", free="periodic")
    else:
        pyvista = pytest.importorskip("pyvista")
        if dim == 2:
            mesh.points = np.pad(mesh.points, ((0, 0), (0, 1)))
        grid = optimize(pyvista.from_meshio(mesh), boundary="slide", free="periodic")
        out = pyvista.to_meshio(grid)
    moved = (out.points[:, dim - 1] == 1) & ~(np.abs(
        out.points[:, None, :dim] - mesh.points[None, :, :dim]).max(axis=2).min(axis=1) < 1e-9)
    assert moved.any()
    np.testing.assert_allclose(sizes(out, dim), before, rtol=1e-9)


@pytest.mark.parametrize("run", [
    lambda mesh: optimize(mesh, boundary="slide", free="periodic"),
    lambda mesh: remesh(mesh, scale=1.5, free="periodic"),
    lambda mesh: remesh(mesh, scale=0.8, free="periodic")])
@pytest.mark.parametrize("dim", [2, 3])
def test_a_poly_line_along_an_edge_ends_where_it_did(run, dim):
    pyvista = pytest.importorskip("pyvista")
    points, cells = boxes.box(dim, 6)
    points = np.pad(points**1.4, ((0, 0), (0, 3 - dim)))
    along = np.flatnonzero((points[:, 1:] == 0).all(axis=1))[:4]
    ends = points[along[[0, -1]]]
    if dim == 2:
        mesh = pyvista.PolyData(points, faces=np.insert(cells, 0, 3, axis=1).ravel(),
                                lines=[4, *along])
        out = run(mesh)
        now = out.points[out.lines[1:]]
    else:
        flat = np.concatenate([np.insert(cells, 0, 4, axis=1).ravel(), [4, *along]])
        mesh = pyvista.UnstructuredGrid(flat, [10] * len(cells) + [4], points)
        out = run(mesh)
        now = out.get_cell(int(np.flatnonzero(out.celltypes == 4)[0])).points
    np.testing.assert_array_equal(now[[0, -1]], ends)
    assert np.linalg.norm(np.diff(now, axis=0), axis=1).sum() == pytest.approx(ends[1, 0])
