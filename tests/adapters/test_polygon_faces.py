"""Quadrilaterals and polygons beside triangles: they stay, and what is filled has them."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import pyvista
import trimesh

import odt_plugins
from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.errors import DataNotKeptWarning, UnsupportedMeshError

SIDES = {0: 4, 1: 5}
"""Columns of squares that are no triangles, and the corners of their faces."""


def plate(n=8):
    """Points of a plate and faces in its squares: quadrilaterals, pentagons, triangles."""
    x, y = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1), indexing="ij")
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    inner = (points[:, 0] > 2.5 / n) & (points[:, 0] < 1) & (points[:, 1] > 0) & (points[:, 1] < 1)
    noise = np.random.default_rng(5).uniform(-0.3 / n, 0.3 / n, (int(inner.sum()), 2))
    points[inner, :2] += noise
    more, faces = [], []
    for i in range(n):
        for j in range(n):
            a, b = i * (n + 1) + j, (i + 1) * (n + 1) + j
            if SIDES.get(i) == 4:
                faces.append([a, b, b + 1, a + 1])
            elif SIDES.get(i) == 5 and j == 0:
                more.append((points[a] + points[b]) / 2)
                faces.append([a, len(points), b, b + 1, a + 1])
            else:
                faces += [[a, b, b + 1], [a, b + 1, a + 1]]
    return np.concatenate([points, more]), faces


@pytest.mark.parametrize("scale", [0.7, 1.3])
def test_obj_of_other_sizes_keeps_polygons_with_groups_texture_and_normals(scale, tmp_path):
    points, faces = plate()
    text = ["mtllib a.mtl", *("v {!r} {!r} {!r}".format(*p) for p in points.tolist()),
            *("vt {!r} {!r}".format(*p[:2]) for p in points.tolist()), "vn 0 0 1"]
    for size, name in ((4, "quads"), (5, "pentagon"), (3, "triangles")):
        text += [f"g {name}", f"usemtl {name}"]
        text += ["f " + " ".join(f"{v + 1}/{v + 1}/1" for v in face)
                 for face in faces if len(face) == size]
    (tmp_path / "a.obj").write_text("\n".join(text) + "\n")
    with warnings.catch_warnings():
        warnings.simplefilter("error", DataNotKeptWarning)
        write_file(tmp_path / "b.obj", odt_plugins.remesh(read_file(tmp_path / "a.obj"),
                                                          scale=scale))
    lines = (tmp_path / "b.obj").read_text().splitlines()
    assert [x for x in lines if x[0] in "mgu"] == [x for x in text if x[0] in "mgu"]
    now = [[word.split("/") for word in x.split()[1:]] for x in lines if x[:2] == "f "]
    assert [sum(len(face) == size for face in now) for size in (4, 5)] == [8, 1]
    assert len(now) != len(faces)
    places = np.array([x.split()[1:] for x in lines if x[:2] == "v "], dtype=float)
    texture = np.array([x.split()[1:] for x in lines if x[:3] == "vt "], dtype=float)
    corners = np.array([word for face in now for word in face], dtype=int) - 1
    np.testing.assert_allclose(texture[corners[:, 1]], places[corners[:, 0], :2], atol=1e-8)
    assert {x for x in lines if x[:3] == "vn "} == {"vn 0 0 1"}
    parts = trimesh.load_scene(tmp_path / "b.obj", process=False, split_object=True,
                               group_material=True).geometry.values()
    assert sorted(part.area for part in parts) == pytest.approx([1 / 64, 8 / 64, 55 / 64])
    assert pyvista.read(tmp_path / "b.obj").area == pytest.approx(1.0)


@pytest.mark.parametrize("run", [odt_plugins.optimize, odt_plugins.remesh])
@pytest.mark.parametrize("bent", [False, True])
@pytest.mark.parametrize("plain", [False, True])
def test_polydata_keep_polygons_between_triangles(run, bent, plain):
    points, faces = plate()
    points[:, 2] = np.sqrt(4.0 - points[:, 0] ** 2) if bent else 0.0
    given = pyvista.PolyData(points, np.concatenate([[len(face), *face] for face in faces]))
    given.verts, given.lines = [1, 0], [2, 0, 1]
    given.cell_data["source"] = np.arange(given.n_cells) * 0.5
    given.cell_data["corners"] = [1, 2, *map(len, faces)]
    if plain:
        vtk = pytest.importorskip("vtkmodules.vtkCommonDataModel")
        data = vtk.vtkPolyData()
        data.DeepCopy(given)
    made = run(data if plain else given, **({} if run is odt_plugins.optimize else {"scale": 0.7}))
    assert type(made) is (type(data) if plain else pyvista.PolyData)
    made = pyvista.wrap(made)
    cells = [made.get_cell(i).point_ids for i in range(made.n_cells)]
    assert made.cell_data["corners"].tolist() == [len(cell) for cell in cells]
    for i, face in enumerate(faces):
        if len(face) > 3:
            at = int(np.flatnonzero(made.cell_data["source"] == 0.5 * (i + 2))[0])
            assert np.array_equal(made.points[cells[at]], points[face])
    rim = made.extract_feature_edges(feature_edges=False, manifold_edges=False)
    middle = rim.cell_centers().points
    assert (np.isclose(middle[:, :2], 0.0) | np.isclose(middle[:, :2], 1.0)).any(axis=1).all()
    assert made.area == pytest.approx(given.area, rel=1e-3)


def test_blocks_of_other_polygons_come_back_and_alone_are_named():
    points, faces = plate()
    plain = pyvista.PolyData(points, np.concatenate([[len(face), *face] for face in faces]))
    made = odt_plugins.optimize(pyvista.MultiBlock({"plate": plain, "cube": pyvista.Cube()}))
    assert made["cube"] == pyvista.Cube()
    assert made["plate"] != plain
    with pytest.raises(UnsupportedMeshError, match=r"6 other polygons; .*try mesh.triangulate"):
        odt_plugins.optimize(pyvista.Cube())


@pytest.mark.parametrize("left", [0.0, 2.0])
def test_polygons_of_a_surface_are_filled_and_their_names_are_on_the_boundary(left, tmp_path):
    pytest.importorskip("pytetwild")
    box = pyvista.Box((0, 1, 0, 1, 0, 1), level=2, quads=True).clean()
    faces = box.faces.reshape(-1, 5)[:, 1:]
    whole = box.points[faces].mean(axis=1)[:, 0] > 0.99 - left
    text = ["v {} {} {}".format(*p) for p in box.points.tolist()] + ["g whole"]
    text += ["f {} {} {} {}".format(*face) for face in faces[whole] + 1] + ["g halves"]
    text += ["f {} {} {}\nf {} {} {}".format(*face[[0, 1, 2, 0, 2, 3]])
             for face in faces[~whole] + 1]
    (tmp_path / "a.obj").write_text("\n".join(text) + "\n")
    made = odt_plugins.tetrahedralize(tmp_path / "a.obj", edge_length=0.3)
    p = made.points[made.cells_dict["tetra"]]
    volume = np.abs(np.linalg.det(p[:, 1:] - p[:, :1])).sum() / 6
    assert volume == pytest.approx(1.0, abs=0.01)
    if not left:
        p = made.points[made.cells_dict["triangle"][made.cell_sets["whole"][1]]]
        area = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1).sum() / 2
        assert area == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("run", [
    odt_plugins.optimize, lambda mesh: odt_plugins.remesh(mesh, scale=0.7),
    lambda mesh: odt_plugins.remesh(mesh, scale=1.4)])
@pytest.mark.parametrize("points_too", [False, True])
def test_obj_with_texture_on_one_material_alone_and_with_points(run, points_too, tmp_path):
    box = trimesh.creation.box().subdivide().subdivide()
    shake = np.random.default_rng(2).uniform(-0.04, 0.04, box.vertices.shape)
    points = box.vertices + np.where(np.abs(np.abs(box.vertices) - 0.5) < 1e-9, 0, shake)
    lid = box.face_normals[:, 2] > 0.5
    text = [*("v {!r} {!r} {!r}".format(*p) for p in points.tolist()),
            *("vt {!r} {!r}".format(*(p[:2] + 0.5).tolist()) for p in points), "usemtl paint",
            *("f " + " ".join(f"{v + 1}/{v + 1}" for v in face) for face in box.faces[lid]),
            "usemtl plain", *("f {} {} {}".format(*face) for face in box.faces[~lid] + 1)]
    inner = np.flatnonzero((np.abs(points[:, :2]) < 0.3).all(axis=1))[:2]
    text += ["p {} {} # sensors".format(*(inner + 1))] * points_too
    (tmp_path / "a.obj").write_text("\n".join(text) + "\n")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        write_file(tmp_path / "b.obj", run(read_file(tmp_path / "a.obj")))
    lines = (tmp_path / "b.obj").read_text().splitlines()
    places = np.array([x.split()[1:] for x in lines if x[:2] == "v "], dtype=float)
    texture = np.array([x.split()[1:] for x in lines if x[:3] == "vt "], dtype=float)
    materials = {"paint": [], "plain": []}
    own = []
    for line in lines:
        if line[:2] == "us":
            own = materials[line.partition(" ")[2]]
        if line[:2] == "f ":
            own.append([[int(n) - 1 for n in w.split("/")] for w in line.split()[1:]])
    paint, plain = (np.array(materials[key]) for key in ("paint", "plain"))
    assert paint.shape[1:] == (3, 2)
    assert plain.shape[1:] == (3, 1)
    np.testing.assert_allclose(texture[paint[..., 1]], places[paint[..., 0], :2] + 0.5, atol=1e-8)
    area = [np.linalg.norm(np.cross(*np.diff(places[rows[..., 0]], axis=1).transpose(1, 0, 2)),
                           axis=1).sum() / 2 for rows in (paint, plain)]
    assert area == pytest.approx([1.0, 5.0], abs=1e-3)
    if points_too:
        named = [line.split()[1:3] for line in lines if line[:2] == "p "]
        assert np.array_equal(places[np.array(named[0], dtype=int) - 1], points[inner])
