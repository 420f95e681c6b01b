"""Cells of other shapes beside the optimised ones: what they share with these is there still."""

import boxes
import gmsh
import meshio
import numpy as np
import pytest
import pyvista

import odt_plugins

KINDS = {"tetra": 10, "wedge": 13, "triangle": 5, "quad": 9}


def extruded(curved, dim):
    """A square or cube, and quadrilaterals or wedges on its side at x = 1."""
    points, cells = boxes.box(dim, 4)
    key = np.sort(np.concatenate([np.delete(cells, i, axis=1) for i in range(dim + 1)]), axis=1)
    side = np.unique(key[(points[key][:, :, 0] == 1.0).all(axis=1)], axis=0)
    own, rows = np.unique(side, return_inverse=True)
    new = rows.reshape(side.shape) + len(points)
    if dim == 2:
        other = ("quad", np.concatenate([side, new[:, ::-1]], axis=1))
    else:
        other = ("wedge", np.concatenate([side, new], axis=1))
    points = np.concatenate([points, points[own] + np.eye(dim)[0] / 4])
    if curved:
        points = np.column_stack([points, 0.3 * np.sin(3 * points[:, 0])])
    return points, [("triangle" if dim == 2 else "tetra", cells), other]


def meshio_mesh(points, blocks):
    return meshio.Mesh(points, blocks)


def grid(points, blocks):
    return pyvista.UnstructuredGrid({KINDS[name]: rows for name, rows in blocks},
                                    np.pad(points, ((0, 0), (0, 3 - points.shape[1]))))


def polydata(points, blocks):
    return pyvista.PolyData.from_irregular_faces(
        np.pad(points, ((0, 0), (0, 3 - points.shape[1]))),
        [row for _, rows in blocks for row in rows.tolist()])


def blocks_of(mesh):
    if isinstance(mesh, meshio.Mesh):
        return {block.type: block.data for block in mesh.cells}
    if isinstance(mesh, pyvista.PolyData):
        faces = mesh.irregular_faces
        return {name: np.array([face for face in faces if len(face) == size])
                for name, size in (("triangle", 3), ("quad", 4))}
    return {name: mesh.cells_dict[kind] for name, kind in KINDS.items() if kind in mesh.cells_dict}


def shared(cells, others):
    """How many facets the simplices have with wedges or quadrilaterals in common."""
    r = cells.shape[1] - 1
    facets = np.concatenate([np.delete(np.sort(cells, axis=1), i, axis=1) for i in range(r + 1)])
    return len({*map(tuple, facets.tolist())} & {*map(tuple, np.sort(others[:, :r]).tolist())})


@pytest.mark.parametrize("run", [
    lambda mesh: odt_plugins.remesh(mesh, scale=0.5),
    lambda mesh: odt_plugins.remesh(mesh, scale=2, free="periodic"),
    lambda mesh: odt_plugins.optimize(mesh, boundary="slide", keep=()),
])
@pytest.mark.parametrize(("dim", "curved", "made"), [
    (2, False, meshio_mesh), (2, True, meshio_mesh), (3, False, meshio_mesh),
    (2, False, grid), (2, True, grid), (3, False, grid), (2, True, polydata),
])
def test_facets_that_simplices_share_with_cells_of_other_shapes_stay(dim, curved, made, run):
    mesh = made(*extruded(curved, dim))
    (cells, others), now = blocks_of(mesh).values(), blocks_of(run(mesh))
    assert len(now[list(now)[1]]) == len(others) == shared(cells, others)
    assert shared(*now.values()) == len(others)


@pytest.mark.parametrize("kind", ["triangle", "quad"])
@pytest.mark.parametrize("made", [meshio_mesh, grid])
def test_edges_that_tetrahedra_share_with_plates_that_stand_on_them_stay(kind, made):
    points, cells = boxes.box(3, 4)
    foot = np.flatnonzero((points[:, 1] == 0.5) & (points[:, 2] == 1.0))
    foot = foot[np.argsort(points[foot, 0])]
    head = np.arange(len(points), len(points) + len(foot))
    plate = np.column_stack([foot[:-1], foot[1:], head[1:], head[:-1]])
    rows = plate if kind == "quad" else np.concatenate([plate[:, :3], plate[:, [0, 2, 3]]])
    points = np.concatenate([points, points[foot] + [0, 0, 0.3]])
    mesh = made(points, [("tetra", cells), (kind, rows)])
    now = blocks_of(odt_plugins.remesh(mesh, scale=0.4))
    assert len(now["tetra"]) > 8 * len(cells)
    ends = now[kind][: len(foot) - 1, :2]
    assert shared_edges(now["tetra"], ends) == shared_edges(cells, plate[:, :2]) == 4


def baffle():
    """A cube of tetrahedra, and the quadrilaterals inside of it at x = 0.5 that facets fill."""
    points, cells = boxes.box(3, 4, plane=0.5)
    place = {tuple(key): i for i, key in enumerate(np.rint(4 * points).astype(int).tolist())}
    rows = [[place[2, y + j, z + k] for j, k in ((0, 0), (1, 0), (1, 1), (0, 1))]
            for y in (1, 2) for z in (1, 2)]
    return points, cells, np.array(rows)


def filled(cells, rows):
    """How many of the quadrilaterals two facets of tetrahedra fill."""
    facets = {tuple(sorted(np.delete(cell, i).tolist())) for cell in cells for i in range(4)}
    halves = (((0, 1, 2), (0, 2, 3)), ((0, 1, 3), (1, 2, 3)))
    return sum(any(all(tuple(sorted(row[[*half]].tolist())) in facets for half in pair)
                   for pair in halves) for row in rows)


RUNS = [
    lambda mesh: odt_plugins.remesh(mesh, scale=0.7),
    lambda mesh: odt_plugins.remesh(mesh, scale=2),
    lambda mesh: odt_plugins.optimize(mesh, insert=True, keep=()),
]


@pytest.mark.parametrize("run", RUNS)
@pytest.mark.parametrize("made", [meshio_mesh, grid])
def test_facets_that_fill_quadrilaterals_inside_of_a_region_stay(made, run):
    points, cells, rows = baffle()
    assert filled(cells, rows) == 4
    now = blocks_of(run(made(points, [("tetra", cells), ("quad", rows)])))
    assert len(now["tetra"]) != len(cells)
    assert filled(now["tetra"], now["quad"]) == 4


@pytest.mark.parametrize("run", RUNS)
def test_facets_that_fill_quadrilaterals_inside_of_a_volume_of_a_model_stay(run):
    points, cells, rows = baffle()
    gmsh.initialize()
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        for dim, kind, nodes in ((3, 4, cells), (2, 3, rows)):
            gmsh.model.addDiscreteEntity(dim, 1)
            if dim == 3:
                gmsh.model.mesh.addNodes(3, 1, np.arange(len(points)) + 1, points.ravel())
            gmsh.model.mesh.addElementsByType(1, kind, [], nodes.ravel() + 1)
        run(gmsh.model)
        cells, rows = (gmsh.model.mesh.getElementsByType(kind)[1].reshape(-1, 4).astype(int)
                       for kind in (4, 3))
        assert filled(cells, rows) == len(rows) == 4
    finally:
        gmsh.finalize()


def shared_edges(cells, ends):
    edges = np.sort(cells, axis=1)[:, [[i, j] for j in range(4) for i in range(j)]].reshape(-1, 2)
    return len({*map(tuple, edges.tolist())} & {*map(tuple, np.sort(ends, axis=1).tolist())})


def test_facets_that_triangles_share_with_quadrilaterals_of_a_model_stay():
    gmsh.initialize()
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        for x in (0, 1):
            gmsh.model.occ.addRectangle(x, 0, 0, 1, 1)
        gmsh.model.occ.fragment([(2, 1)], [(2, 2)])
        gmsh.model.occ.synchronize()
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.25)
        gmsh.model.mesh.setTransfiniteSurface(2)
        gmsh.model.mesh.setRecombine(2, 2)
        gmsh.model.mesh.generate(2)

        def of(kind):
            return gmsh.model.mesh.getElementsByType(kind)[1].reshape(-1, kind + 1).astype(int)

        def between():
            edges = [{tuple(sorted((row[i - 1], row[i]))) for row in of(kind).tolist()
                      for i in range(kind + 1)} for kind in (2, 3)]
            return edges[0] & edges[1]

        before, count = between(), len(of(2))
        odt_plugins.remesh(gmsh.model, scale=0.5)
        assert len(of(2)) > 2 * count
        assert between() == before
        assert before
    finally:
        gmsh.finalize()


def layered(dim, layers):
    """Two squares or cubes, with layers of quadrilaterals or wedges from one to the other."""
    points, [(kind, cells), (other, rows)] = extruded(False, dim)
    side = np.unique(rows[:, :dim])
    place = np.zeros(len(points), dtype=int)
    place[side] = np.arange(len(side))
    ends = np.concatenate([side[None], cells.max() + 1 + np.arange(layers * len(side)).reshape(
        layers, -1)])
    box = points[: cells.max() + 1]
    step = np.eye(dim)[0] / layers
    mirrored = box * [-1, *[1] * (dim - 1)] + 3 * np.eye(dim)[0]
    number = np.cumsum(~np.isin(np.arange(len(box)), side)) + ends[-1, -1]
    number[side] = ends[-1]
    one, two = (level[:, place[rows[:, :dim]]] for level in (ends[:-1], ends[1:]))
    if dim == 2:
        two = two[..., ::-1]
    points = np.concatenate([box, *(box[side] + step * i for i in range(1, layers + 1)),
                             np.delete(mirrored, side, axis=0)])
    twin = number[cells][:, [1, 0, *range(2, dim + 1)]]
    return points, [(kind, np.concatenate([cells, twin])),
                    (other, np.concatenate([one, two], axis=2).reshape(-1, 2 * dim))]


@pytest.mark.parametrize("layers", [1, 30])
@pytest.mark.parametrize("dim", [2, 3])
def test_point_sets_that_go_on_into_other_shapes_are_resized(dim, layers):
    points, blocks = layered(dim, layers)
    sets = {"all": np.arange(len(points)), "side": np.flatnonzero(points[:, 1] == 0.0),
            "part": np.flatnonzero((points[:, 1] == 0.0) & (points[:, 0] <= 2.0))}
    mesh = meshio.Mesh(points, blocks, point_sets=sets)
    for scale in (0.5, 2):
        found, report = odt_plugins.remesh_with_report(mesh, scale=scale, free="periodic")
        side = np.abs(found.points[:, 1]) < 1e-6
        expected = {"all": np.arange(len(found.points)), "side": np.flatnonzero(side),
                    "part": np.flatnonzero(side & (found.points[:, 0] < 2.0 + 1e-6))}
        assert {name: np.sort(found.point_sets[name]).tolist() for name in sets} == {
            name: rows.tolist() for name, rows in expected.items()}
        assert not [note for note in report.notes if "point set" in note]
