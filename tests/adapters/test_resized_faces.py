"""Lines and triangles beside the cells where their boundary has other sizes: labels stay on theirs.

What is compared are lengths, areas and sums of normals of every label, by other programs.
"""

from __future__ import annotations

import warnings

import boxes
import meshio
import numpy as np
import pytest
import pyvista
from gmsh_sessions import group_sizes, session, two_solids

from odt_plugins import remesh, remesh_with_report
from odt_plugins.adapters.files import read_file, write_file

SIZES = {"line": 2, "triangle": 3, "tetra": 4}
"""Corners of the cells that are looked at."""


def sizes(points, rows):
    """Lengths, areas or volumes of simplices."""
    edges = points[rows[:, 1:]] - points[rows[:, :1]]
    gram = np.linalg.det(np.einsum("nik,njk->nij", edges, edges))
    return np.sqrt(np.maximum(gram, 0)) / [1, 1, 2, 6][rows.shape[1] - 1]


def of_labels(mesh, name):
    """By kind and label: the size of all, and the sum of normals or of edges."""
    out = {}
    for block, labels in zip(mesh.cells, mesh.cell_data[name], strict=True):
        for label in np.unique(labels) if block.type in SIZES else ():
            rows = block.data[np.asarray(labels) == label]
            x = np.pad(mesh.points, ((0, 0), (0, 3 - mesh.points.shape[1])))[rows]
            along = np.cross(x[:, 1] - x[:, 0], x[:, -1] - x[:, 0]) * (rows.shape[1] == 3) + (
                (x[:, 1] - x[:, 0]) * (rows.shape[1] == 2))
            size, sums, count = out.get((block.type, int(label)), (0.0, np.zeros(3), 0))
            out[block.type, int(label)] = (size + sizes(mesh.points, rows).sum(),
                                           sums + along.sum(axis=0), count + len(rows))
    return out


def labelled_box(n=5):
    """A box, parted at z = .5; its skin has an inlet on top, walls, lines where x = 0 = y."""
    points, cells = boxes.box(3, n)
    points = np.asarray(points) / np.max(points)
    faces = np.sort(np.concatenate([np.delete(cells, i, axis=1) for i in range(4)]), axis=1)
    tips = np.concatenate([cells[:, i] for i in range(4)])
    _, first, count = np.unique(faces, axis=0, return_index=True, return_counts=True)
    skin, tip = faces[first[count == 1]], tips[first[count == 1]]
    x = points[skin]
    normal = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    inward = ((points[tip] - x[:, 0]) * normal).sum(axis=1) > 0
    skin[inward, 1], skin[inward, 2] = skin[inward, 2].copy(), skin[inward, 1].copy()
    middle = points[skin].mean(axis=1)
    inlet = (middle[:, 2] > 1 - 1e-9) & (np.abs(middle[:, :2] - 0.5).max(axis=1) < 0.31)
    on = np.flatnonzero((points[:, :2] < 1e-9).all(axis=1))
    on = on[np.argsort(points[on, 2])]
    lines = np.stack([on[:-1], on[1:]], axis=1)
    upper = points[lines].mean(axis=1)[:, 2] > 0.39
    return meshio.Mesh(points, [("tetra", cells), ("triangle", skin), ("line", lines)], cell_data={
        "tag": [np.full(len(cells), 7), np.where(inlet, 3, 4), np.where(upper, 1, 2)],
        "weight": [np.ones(len(cells)), middle[:, 0], np.ones(len(lines))]})


@pytest.fixture(scope="module", params=[1.7, 0.7], ids=["coarser", "finer"])
def both(request):
    before = labelled_box()
    return request.param, before, remesh(before, scale=request.param, envelope=0.01,
                                         free="periodic")


def test_faces_and_lines_of_a_box_keep_their_labels(both):
    scale, before, after = both
    was, now = of_labels(before, "tag"), of_labels(after, "tag")
    assert was.keys() == now.keys()
    for name, (size, sums, count) in was.items():
        # The border of the inlet is a line in the plane, whose corners stay.
        assert now[name][0] == pytest.approx(size, rel=1e-9)
        np.testing.assert_allclose(now[name][1], sums, atol=1e-9)
        if name[0] != "line":
            assert (now[name][2] < count) == (scale > 1)


def test_the_triangles_are_those_of_the_skin_each_once(both):
    _, _, after = both
    cells, skin = (np.sort(block.data, axis=1) for block in after.cells[:2])
    faces = np.concatenate([np.delete(cells, i, axis=1) for i in range(4)])
    unique, count = np.unique(faces, axis=0, return_counts=True)
    np.testing.assert_array_equal(np.unique(skin, axis=0), unique[count == 1])
    assert len(skin) == (count == 1).sum()


def test_a_triangle_has_the_data_of_one_near_it(both):
    _, before, after = both
    middle = after.points[after.cells[1].data].mean(axis=1)
    assert np.abs(after.cell_data["weight"][1] - middle[:, 0]).max() < 0.2
    assert set(after.cell_data["weight"][1]) <= set(before.cell_data["weight"][1])


def test_where_the_label_of_a_line_changes_the_vertex_stays(both):
    _, before, after = both
    ends = [set(np.unique(mesh.cells[2].data[np.asarray(mesh.cell_data["tag"][2]) == 1]).tolist())
            & set(np.unique(mesh.cells[2].data[np.asarray(mesh.cell_data["tag"][2]) == 2]).tolist())
            for mesh in (before, after)]
    (old,), (new,) = ends
    assert before.points[old].tobytes() == after.points[new].tobytes()


def test_numbers_that_tell_every_triangle_apart_hold_them():
    before = labelled_box(4)
    before.cell_data["number"] = [np.arange(len(block.data)) for block in before.cells]
    after = remesh(before, scale=1.5, envelope=0.01, free="periodic")
    assert len(after.points) < len(before.points)
    for i in (1, 2):
        np.testing.assert_array_equal(after.cell_data["number"][i], before.cell_data["number"][i])
        middle = [x.points[x.cells[i].data].mean(axis=1) for x in (before, after)]
        assert np.abs(middle[0] - middle[1]).max() < 0.2


@pytest.mark.parametrize("curved", [False, True])
def test_the_report_tells_of_lines_that_have_no_others_like_them(curved):
    points, cells = boxes.box(2, 8)
    points = np.pad(np.asarray(points, dtype=float), ((0, 0), (0, 1)))
    points[:, 2] = curved * 0.01 * points[:, 0] ** 2
    edges = np.sort(cells[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    every, count = np.unique(edges, axis=0, return_counts=True)
    rim = every[count == 1]
    kinds = np.ones(len(rim), dtype=int)

    def notes(blocks, data):
        mesh = meshio.Mesh(points, [("triangle", cells), *(("line", rows) for rows in blocks)],
                           cell_data={"tag": [np.ones(len(cells), dtype=int), *data]})
        return "; ".join(remesh_with_report(mesh, scale=2)[1].notes)

    assert "lines beside" not in notes([rim], [kinds])
    count = len(rim)
    assert f"{count} lines beside the triangles stay" in notes([rim], [np.arange(count)])
    alone = notes(np.split(rim, count), np.split(kinds, count))
    assert f"most of the {count} lines beside the triangles have no other" in alone


@pytest.mark.parametrize("quadratic", [False, True])
def test_the_report_tells_of_poly_lines_and_of_lines_of_another_order(quadratic):
    points, cells = boxes.box(2, 8)
    points = np.pad(np.asarray(points, dtype=float), ((0, 0), (0, 1)))
    side = np.flatnonzero(points[:, 1] == points[:, 1].min())
    side = side[np.argsort(points[side, 0])]
    if quadratic:
        ends, which = np.unique(np.sort(cells[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1),
                                axis=0, return_inverse=True)
        nodes = len(points) + which.reshape(-1, 3)
        mesh = meshio.Mesh(np.concatenate([points, points[ends].mean(axis=1)]), [
            ("triangle6", np.hstack([cells, nodes])),
            ("line", np.stack([side[:-1], side[1:]], axis=1))])
    else:
        mesh = pyvista.PolyData(points, faces=np.insert(cells, 0, 3, axis=1).ravel(),
                                lines=np.insert(side, 0, len(side)))
    notes = "; ".join(remesh_with_report(mesh, scale=2)[1].notes)
    assert f"{len(side) - 1} lines beside the triangles stay, since cells of another order" in notes


@pytest.mark.parametrize("kind", [float, np.float32, str, object])
def test_labels_of_faces_may_be_texts_or_whole_floats(kind):
    before = labelled_box()
    tags = before.cell_data.pop("tag")
    before.cell_data["kind"] = [np.asarray(tag).astype(kind) for tag in tags]
    if kind is object:
        before.cell_data["kind"] = [np.array([f"label {i}" for i in tag], dtype=object)
                                    for tag in tags]
    after = remesh(before, scale=1.7, envelope=0.01, free="periodic")
    assert len(after.cells[1].data) < len(before.cells[1].data)
    assert after.cell_data["kind"][1].dtype == before.cell_data["kind"][1].dtype
    for mesh in before, after:
        mesh.cell_data["tag"] = [np.unique(np.concatenate(mesh.cell_data["kind"]).astype(str),
                                           return_inverse=True)[1][start: start + len(block.data)]
                                 for start, block in zip(np.cumsum(
                                     [0, *(len(b.data) for b in mesh.cells[:-1])]), mesh.cells,
                                     strict=True)]
    was, now = of_labels(before, "tag"), of_labels(after, "tag")
    assert was.keys() == now.keys()
    for name, (size, sums, _) in was.items():
        assert now[name][0] == pytest.approx(size, rel=1e-9)
        np.testing.assert_allclose(now[name][1], sums, atol=1e-9)


def test_a_fixed_boundary_keeps_its_faces():
    before = labelled_box(4)
    after = remesh(before, scale=0.7, boundary="fixed")
    for i in (1, 2):
        assert before.points[before.cells[i].data].tobytes() == (
            after.points[after.cells[i].data].tobytes())


def test_the_rim_of_a_plane_mesh_keeps_the_labels_of_its_lines():
    points, cells = boxes.box(2, 8)
    points = np.asarray(points) / np.max(points)
    edges = np.concatenate([cells[:, pair] for pair in ([0, 1], [1, 2], [2, 0])])
    _, first, count = np.unique(np.sort(edges, axis=1), axis=0, return_index=True,
                                return_counts=True)
    rim = edges[first[count == 1]]
    middle = points[rim].mean(axis=1)
    labels = np.select([middle[:, 0] < 1e-9, middle[:, 0] < 0.5], [1, 2], 3)
    before = meshio.Mesh(points, [("triangle", cells), ("line", rim)],
                         cell_data={"tag": [np.ones(len(cells), int), labels]})
    for scale in (1.8, 0.6):
        after = remesh(before, scale=scale, free="periodic")
        was, now = of_labels(before, "tag"), of_labels(after, "tag")
        assert was.keys() == now.keys()
        for name, (size, sums, count) in was.items():
            assert now[name][0] == pytest.approx(size, rel=1e-9)
            assert (now[name][2] < count) == (scale > 1)
            if name[0] == "line":
                np.testing.assert_allclose(now[name][1], sums, atol=1e-9)


def gmsh_file(path, *, version):
    """Two boxes in named groups, by Gmsh, with one curve of their skin."""
    with session() as gmsh:
        skin = two_solids(gmsh.model)
        curve = gmsh.model.getBoundary([(2, skin[0])], oriented=False)[0][1]
        gmsh.model.addPhysicalGroup(1, [curve], 5, "edge")
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.3)
        gmsh.option.setNumber("Mesh.MshFileVersion", version)
        gmsh.model.mesh.generate(3)
        gmsh.write(str(path))


def by_gmsh(path):
    with session() as gmsh:
        gmsh.open(str(path))
        return {name: size for (_, _, name), size in group_sizes(gmsh).items()}


@pytest.mark.parametrize("version", [2.2, 4.1])
def test_gmsh_finds_its_groups_where_they_were(version, tmp_path):
    source, target = tmp_path / "a.msh", tmp_path / "b.msh"
    gmsh_file(source, version=version)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        before = read_file(source)
        after = remesh(before, scale=1.5, envelope=0.01, free="periodic")
        write_file(target, after)
    was, now = by_gmsh(source), by_gmsh(target)
    assert was.keys() == now.keys() == {"steel", "air", "inlet", "wall", "edge"}
    assert now == pytest.approx(was, rel=1e-9)
    count = [sum(len(block.data) for block in mesh.cells if block.type == "triangle")
             for mesh in (before, after)]
    assert count[1] < 0.7 * count[0]
    entities = after.point_data.get("gmsh:dim_tags")
    if entities is not None:
        # A node of a face is within a face, a line or a point of the model.
        for i, block in enumerate(after.cells):
            dim = SIZES[block.type] - 1
            assert (entities[block.data][..., 0] <= dim).all()
            inside = entities[block.data][..., 0] == dim
            tags = np.broadcast_to(np.asarray(after.cell_data["gmsh:geometrical"][i])[:, None],
                                   inside.shape)
            np.testing.assert_array_equal(entities[block.data][..., 1][inside], tags[inside])


@pytest.mark.parametrize("suffix", ["mesh", "med", "vtu", "inp", "bdf", "su2", "vol", "e"])
def test_files_are_written_with_the_new_faces(suffix, tmp_path):
    source, target = tmp_path / f"a.{suffix}", tmp_path / f"b.{suffix}"
    mesh = labelled_box(4)
    given = {"mesh": "medit:ref", "med": "cell_tags", "bdf": "nastran:ref", "su2": "su2:tag"}
    mesh.cell_data = {given.get(suffix, "tag"): mesh.cell_data["tag"]}
    mesh.cells = mesh.cells[:2]
    mesh.cell_data = {name: values[:2] for name, values in mesh.cell_data.items()}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        write_file(source, mesh)
        before = read_file(source)
        after = remesh(before, scale=1.6, envelope=0.01, free="periodic")
        write_file(target, after)
    back = read_file(target)
    assert len(back.points) < len(before.points)
    kinds = [{block.type for block in x.cells if len(block.data)} for x in (before, back)]
    assert kinds[0] == kinds[1]
    if "triangle" in kinds[0]:
        skin = [sum(sizes(x.points, block.data).sum() for block in x.cells
                    if block.type == "triangle") for x in (before, back)]
        assert skin[1] == pytest.approx(skin[0], rel=1e-6)
        count = [sum(len(block.data) for block in x.cells if block.type == "triangle")
                 for x in (before, back)]
        assert count[1] < count[0]
    for name, parts in before.cell_data.items():
        if all(np.asarray(part).dtype.kind in "iu" for part in parts):
            was, now = of_labels(before, name), of_labels(back, name)
            assert was.keys() == now.keys()
            for label, (size, _, _) in was.items():
                assert now[label][0] == pytest.approx(size, rel=1e-6)


@pytest.mark.parametrize("suffix", ["", "mesh", "med", "vtu", "inp", "msh"])
def test_where_edges_flip_and_no_vertex_comes_or_goes_triangles_are_faces(suffix, tmp_path):
    before = labelled_box(2)
    name = {"mesh": "medit:ref", "med": "cell_tags", "msh": "gmsh:physical"}.get(suffix, "tag")
    before = meshio.Mesh(before.points, before.cells[:2],
                         cell_data={name: before.cell_data["tag"][:2]})
    if suffix:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            write_file(tmp_path / f"a.{suffix}", before)
        before = read_file(tmp_path / f"a.{suffix}")
    fixed = np.random.default_rng(0).random(len(before.points)) < 0.3
    after = remesh(before, 0.6, fixed=fixed, keep=(), free="periodic")
    if suffix:
        write_file(tmp_path / f"b.{suffix}", after)
        after = read_file(tmp_path / f"b.{suffix}")
    assert len(before.points) == len(after.points)
    cells, skin = (np.sort(after.cells_dict[kind], axis=1) for kind in ("tetra", "triangle"))
    assert not np.array_equal(np.unique(skin, axis=0), np.unique(
        np.sort(before.cells_dict["triangle"], axis=1), axis=0))
    faces = np.concatenate([np.delete(cells, i, axis=1) for i in range(4)])
    unique, count = np.unique(faces, axis=0, return_counts=True)
    np.testing.assert_array_equal(np.unique(skin, axis=0), unique[count == 1])


def test_boundaries_of_scikit_fem_are_turned_as_they_were():
    skfem = pytest.importorskip("skfem")
    mesh = skfem.MeshTet().refined(2).with_subdomains({"low": lambda x: x[2] < 0.5})
    mesh = mesh.with_boundaries({"left": lambda x: x[0] == 0, "skin": mesh.facets_around("low")})
    after = remesh(mesh, scale=1.5, envelope=0.02, free="periodic")
    assert after.t.shape[1] < mesh.t.shape[1]
    for name in ("left", "skin"):
        fluxes = []
        for x in (mesh, after):
            basis = skfem.FacetBasis(x, skfem.ElementTetP1(), facets=x.boundaries[name])
            fluxes.append(((basis.normals * basis.global_coordinates().value).sum(axis=0)
                           * basis.dx).sum())
        assert len(after.boundaries[name]) < len(mesh.boundaries[name])
        # The divergence theorem: three times the volume of what the skin is around.
        assert fluxes[1] == pytest.approx(fluxes[0], abs=1e-9)
    low = [sizes(x.p.T, x.t.T[x.subdomains["low"]]).sum() for x in (mesh, after)]
    assert fluxes == pytest.approx([3 * low[0], 3 * low[1]])


def test_a_grid_of_vtk_has_new_triangles_with_their_data():
    pyvista = pytest.importorskip("pyvista")
    mesh = labelled_box()
    grid = pyvista.from_meshio(mesh)
    after = remesh(grid, scale=1.6, envelope=0.01, free="periodic")
    tables = []
    for x in (grid, after):
        measured = x.compute_cell_sizes()
        whole = np.asarray(measured["Length"]) + measured["Area"] + measured["Volume"]
        tables.append({(int(kind), int(tag)): float(whole[(x.celltypes == kind)
                                                          & (x["tag"] == tag)].sum())
                       for kind, tag in zip(x.celltypes, x["tag"], strict=True)})
    assert tables[0] == pytest.approx(tables[1], rel=1e-9)
    assert (after.celltypes == 5).sum() < (grid.celltypes == 5).sum()


@pytest.mark.parametrize("wrapped", [True, False], ids=["pyvista", "vtk"])
def test_lines_and_vertices_of_polydata_stay_on_the_surface(wrapped):
    pyvista = pytest.importorskip("pyvista")
    cube = pyvista.Cube().triangulate().subdivide(3).clean()
    rows = cube.regular_faces
    on = np.isclose(np.abs(cube.points), 0.5).sum(axis=1) > 1
    pairs = np.unique(np.sort(np.concatenate(
        [rows[:, pair] for pair in ([0, 1], [1, 2], [2, 0])]), axis=1), axis=0)
    crease = pairs[on[pairs].all(axis=1)]
    x = cube.points[crease]
    crease = crease[np.isclose(x[:, 0], x[:, 1]).sum(axis=1) == 2]
    corner = int(np.argmax(cube.points.sum(axis=1)))
    mesh = pyvista.PolyData(cube.points, cube.faces,
                            lines=np.insert(crease, 0, 2, axis=1).ravel())
    mesh.verts = [1, corner]
    mesh.cell_data["tag"] = np.concatenate([
        [9], (mesh.points[crease].mean(axis=1)[:, 2] > 0.4).astype(int), np.full(len(rows), 5)])
    if wrapped:
        after = remesh(mesh, scale=2.0)
    else:
        from vtkmodules.vtkCommonDataModel import vtkPolyData

        bare = vtkPolyData()
        bare.DeepCopy(mesh)
        after = pyvista.wrap(remesh(bare, scale=2.0))
    assert after.n_cells < mesh.n_cells / 2
    assert after.n_lines < mesh.n_lines
    assert after.points[after.verts[1]].tobytes() == mesh.points[corner].tobytes()
    for tag in (0, 1):
        lengths = []
        for y in (mesh, after):
            ends = y.lines.reshape(-1, 3)[:, 1:][y["tag"][1: 1 + y.n_lines] == tag]
            lengths.append(sizes(y.points, ends).sum())
        assert lengths[1] == pytest.approx(lengths[0], rel=1e-6)


def test_cells_that_stay_keep_their_faces_and_borders_run_through_them():
    before = labelled_box()
    middle = before.points[before.cells[0].data].mean(axis=1)
    after = remesh(before, scale=1.7, envelope=0.01, free="periodic", selection=middle[:, 0] < 0.6)
    was, now = of_labels(before, "tag"), of_labels(after, "tag")
    assert was.keys() == now.keys()
    for name, (size, sums, _) in was.items():
        assert now[name][0] == pytest.approx(size, rel=1e-9)
        np.testing.assert_allclose(now[name][1], sums, atol=1e-9)
    assert now["triangle", 3][2] > 4
    assert now["triangle", 4][2] < 0.7 * was["triangle", 4][2]
    places = [{tuple(sorted(map(tuple, x.points[row]))) for row in x.cells[1].data}
              for x in (before, after)]
    assert {place for place in places[0] if min(x for x, _, _ in place) > 0.81} <= places[1]
