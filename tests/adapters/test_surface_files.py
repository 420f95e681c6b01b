"""Files of surfaces: what the run does not change stays, as other programs read it."""

from __future__ import annotations

import warnings

import meshio
import numpy as np
import open3d
import pymeshlab
import pytest
import trimesh

from odt_plugins import remesh
from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.api import optimize, optimize_file
from odt_plugins.errors import DataNotKeptWarning, MeshFileError


@pytest.fixture(scope="module")
def ball():
    """Vertices and triangles of a noisy sphere, and which triangles are at its top."""
    sphere = trimesh.creation.icosphere(2)
    points = sphere.vertices + np.random.default_rng(3).normal(0, 0.02, sphere.vertices.shape)
    cells = np.array(sphere.faces)
    return points, cells, points[cells].mean(axis=1)[:, 2] > 0.1


def facet(corners):
    return "facet normal 0 0 0\nouter loop\n" + "".join(
        "vertex {!r} {!r} {!r}\n".format(*map(float, v)) for v in corners) + "endloop\nendfacet\n"


def true_normals(points, cells):
    p = points[cells]
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    return normal / np.linalg.norm(normal, axis=1)[:, None]


def optimized(source, target):
    """Optimise a file; nothing is to be lost."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return optimize_file(source, target)


def solids(points, cells, top):
    return "".join(f"solid {name}\n" + "".join(facet(points[c]) for c in cells[of])
                   + f"endsolid {name}\n" for name, of in (("cap", top), ("body", ~top)))


def test_stl_of_text_keeps_its_solids_and_has_true_normals(ball, tmp_path):
    points, cells, top = ball
    source, target = tmp_path / "a.stl", tmp_path / "b.stl"
    source.write_text(solids(points, cells, top))
    report = optimized(source, target)
    assert report.after.mean_quality > report.before.mean_quality
    text = target.read_text()
    names = [line for line in text.splitlines() if "solid" in line]
    assert names == ["solid cap", "endsolid cap", "solid body", "endsolid body"]
    parts = {name: sum(line.startswith(b"facet") for line in part.encode().split(b"\n"))
             for name, part in zip(("cap", "body"), text.split("endsolid"), strict=False)}
    assert parts["cap"] >= top.sum() - 3
    numbers = np.array([line.split()[-3:] for line in text.splitlines()
                        if line.split()[:1] in (["vertex"], ["facet"])], dtype=float)
    rows = numbers.reshape(-1, 4, 3)
    exact = true_normals(rows[:, 1:].reshape(-1, 3), np.arange(3 * len(rows)).reshape(-1, 3))
    changed = np.abs(rows[:, 0]).max(axis=1) > 0
    assert changed.any()
    assert np.abs((rows[:, 0] - exact)[changed]).max() < 1e-6


def test_unchanged_triangles_of_a_text_stay_byte_for_byte(ball, tmp_path):
    points, cells, top = ball
    source, target = tmp_path / "a.stl", tmp_path / "b.stl"
    source.write_text(solids(points, cells, top).replace("\n", "\r\n"), newline="")
    write_file(target, read_file(source))
    assert target.read_bytes() == source.read_bytes()


def test_binary_stl_stays_binary_with_its_header_and_attributes(ball, tmp_path):
    points, cells, _ = ball
    row = np.zeros(len(cells), [("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    row["v"], row["a"] = points[cells], 7
    head = b"made by hand".ljust(80, b".") + np.uint32(len(cells)).tobytes()
    source, target = tmp_path / "a.stl", tmp_path / "b.stl"
    source.write_bytes(head + row.tobytes())
    optimized(source, target)
    data = target.read_bytes()
    assert data[:84] == head
    assert len(data) == len(head) + row.nbytes
    back = np.frombuffer(data, row.dtype, offset=84)
    assert (back["a"] == 7).all()
    assert np.abs(trimesh.load(target).volume) == pytest.approx(4.19, rel=0.1)


def test_obj_keeps_groups_materials_lines_and_relative_indices(ball, tmp_path):
    points, cells, top = ball
    n = len(points)
    text = ["# by hand", "mtllib g.mtl", *("v {!r} {!r} {!r}".format(*map(float, v))
                                           for v in points)]
    for name, of in (("cap", top), ("body", ~top)):
        text += [f"g {name}", f"usemtl {name}_paint", "s 1"]
        text += [f"f {a} {b} {c}" for a, b, c in cells[of] - (n if name == "cap" else -1)]
    source, target = tmp_path / "a.obj", tmp_path / "b.obj"
    source.write_text("\n".join(text) + "\n")
    report = optimized(source, target)
    assert report.regions_from == ("cap cap_paint", "body body_paint")
    other = [line for line in target.read_text().splitlines() if line[:2] not in ("v ", "f ")]
    assert other == [line for line in text if line[:2] not in ("v ", "f ")]
    scene = trimesh.load(target, process=False, split_object=True, group_material=True)
    parts = scene.geometry.values()
    assert sorted(len(part.faces) for part in parts) == sorted([top.sum(), (~top).sum()])


@pytest.mark.parametrize("scale", [0.7, 1.5])
def test_obj_of_other_sizes_keeps_materials_groups_colours_and_texture(scale, tmp_path):
    box = trimesh.creation.box().subdivide().subdivide()
    upper = box.face_normals[:, 2] > 0.5
    rows = [" ".join(f"{v + 1}/{v + 1}/{i + 1}" for v in face)
            for i, face in enumerate(box.faces.tolist())]
    text = ["# by hand", "mtllib a.mtl",
            *("v {} {} {} {} {} {}".format(*v, *(v + 0.5)) for v in box.vertices),
            *("vt {} {}".format(*(v[:2] + 0.5)) for v in box.vertices),
            *("vn {} {} {}".format(*n) for n in box.face_normals),
            "g lid", "usemtl red", *(f"f {rows[i]}" for i in np.flatnonzero(upper)),
            "g sides", "usemtl blue", *(f"f {rows[i]}" for i in np.flatnonzero(~upper))]
    (tmp_path / "a.obj").write_text("\n".join(text) + "\n")
    (tmp_path / "a.mtl").write_text("newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n")
    with warnings.catch_warnings():
        warnings.simplefilter("error", DataNotKeptWarning)
        write_file(tmp_path / "b.obj", remesh(read_file(tmp_path / "a.obj"), scale=scale))
    told = [line for line in (tmp_path / "b.obj").read_text().splitlines()
            if line[0] in "#mgu"]
    assert told == [line for line in text if line[0] in "#mgu"]
    back = open3d.io.read_triangle_mesh(str(tmp_path / "b.obj"))
    points = np.asarray(back.vertices)
    corners = points[np.asarray(back.triangles)]
    assert len(corners) != len(box.faces)
    assert np.asarray(back.triangle_uvs) == pytest.approx(
        corners.reshape(-1, 3)[:, :2] + 0.5, abs=1e-6)
    assert np.asarray(back.vertex_colors) == pytest.approx(points + 0.5, abs=0.01)
    scene = trimesh.load_scene(tmp_path / "b.obj", process=False, split_object=False,
                               group_material=True)
    assert sorted(part.area for part in scene.geometry.values()) == pytest.approx([1.0, 5.0])


@pytest.mark.parametrize("scale", [0.7, 1.5])
def test_obj_of_other_sizes_keeps_lines_of_creases_beside_texture(scale, tmp_path):
    box = trimesh.creation.box().subdivide().subdivide()
    text = [*("v {} {} {}".format(*v) for v in box.vertices),
            *("vt {} {}".format(*(v[:2] + 0.5)) for v in box.vertices), "g all"]
    text += ["f " + " ".join(f"{v + 1}/{v + 1}" for v in face) for face in box.faces.tolist()]
    text += ["o wires"]
    text += [f"l {a} {b}" for a, b in box.face_adjacency_edges[box.face_adjacency_angles > 1] + 1]
    (tmp_path / "a.obj").write_text("\n".join(text) + "\n")
    with warnings.catch_warnings():
        warnings.simplefilter("error", DataNotKeptWarning)
        write_file(tmp_path / "b.obj", remesh(read_file(tmp_path / "a.obj"), scale=scale))
    lines = (tmp_path / "b.obj").read_text().splitlines()
    points = np.array([line.split()[1:] for line in lines if line[:2] == "v "], dtype=float)
    ends = np.array([line.split()[1:] for line in lines if line[:2] == "l "], dtype=int) - 1
    assert len(points) != len(box.vertices)
    assert np.linalg.norm(points[ends[:, 1]] - points[ends[:, 0]], axis=1).sum() == (
        pytest.approx(12.0))
    assert np.isclose(np.abs(points[ends]), 0.5).all(axis=1).sum(axis=1).min() == 2
    assert lines.index("o wires") < next(i for i, x in enumerate(lines) if x[:2] == "l ")
    assert any(line.startswith("vt ") for line in lines)


def test_obj_keeps_colours_and_texture_of_a_seam_where_nothing_moved(ball, tmp_path):
    points, cells, _ = ball
    text = ["v {!r} {!r} {!r} 0.25 0.5 0.75".format(*map(float, v)) for v in points]
    text += ["vt 0 0", "vt 1 0", "vt 0 1", "vn 0 0 1"]
    text += [f"f {a}/1/1 {b}/2/1 {c}/3/1" for a, b, c in cells + 1]
    source, target = tmp_path / "a.obj", tmp_path / "b.obj"
    source.write_text("\n".join(text) + "\n")
    mesh = read_file(source)
    assert mesh.point_data["obj:colour"][0].tolist() == [0.25, 0.5, 0.75]
    assert mesh.cell_data["texcoord"][0][0].tolist() == [0, 0, 1, 0, 0, 1]
    write_file(target, mesh)
    assert target.read_bytes() == source.read_bytes()


@pytest.mark.parametrize("scale", [None, 0.7])
def test_texture_goes_into_an_obj_that_had_none(ball, scale, tmp_path):
    points, cells, _ = ball
    text = ["v {!r} {!r} {!r}".format(*map(float, v)) for v in points]
    text += [f"f {a} {b} {c}" for a, b, c in cells + 1]
    (tmp_path / "a.obj").write_text("\n".join(text) + "\n")
    mesh = read_file(tmp_path / "a.obj")
    mesh.cell_data["texcoord"] = [points[cells][:, :, :2].reshape(-1, 6)]
    if scale is not None:
        mesh = remesh(mesh, scale=scale)
    write_file(tmp_path / "b.obj", mesh)
    back = open3d.io.read_triangle_mesh(str(tmp_path / "b.obj"))
    assert len(back.triangles) == len(mesh.cells[0].data)
    corners = np.asarray(back.vertices)[np.asarray(back.triangles)]
    assert np.asarray(back.triangle_uvs) == pytest.approx(
        corners.reshape(-1, 3)[:, :2], abs=1e-6 if scale is None else 0.05)


def test_obj_texture_is_that_of_the_place_and_normals_are_of_the_new_surface(tmp_path):
    """A texture that is linear in the plane stays linear wherever vertices slide."""
    u = np.linspace(0, 1, 9)
    x, y = (a.ravel() for a in np.meshgrid(u, u, indexing="ij"))
    inside = (x > 0) & (x < 1) & (y > 0) & (y < 1)
    x[inside] += np.random.default_rng(5).uniform(-0.04, 0.04, inside.sum())
    index = np.arange(81).reshape(9, 9)
    a, b, c, d = (i.ravel() for i in (index[:-1, :-1], index[1:, :-1], index[1:, 1:],
                                      index[:-1, 1:]))
    cells = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]) + 1
    z = 0.02 * np.sin(3 * x)
    text = [f"v {p!r} {q!r} {r!r}" for p, q, r in zip(x.tolist(), y.tolist(), z.tolist(),
                                                        strict=True)]
    text += [f"vt {p!r} {q!r}" for p, q in zip(x.tolist(), y.tolist(), strict=True)]
    text += ["vn 0 0 1"] * 81
    text += ["f " + " ".join(f"{i}/{i}/{i}" for i in row) for row in cells]
    source, target = tmp_path / "a.obj", tmp_path / "b.obj"
    source.write_text("\n".join(text) + "\n")
    optimized(source, target)
    back = trimesh.load(target, process=False)
    assert np.abs(back.visual.uv - back.vertices[:, :2]).max() < 1e-6
    lines = [line.split()[1:] for line in target.read_text().splitlines() if line[:3] == "vn "]
    given = np.array(lines, dtype=float)
    assert np.allclose(np.linalg.norm(given, axis=1), 1)
    assert given[:, 0].min() < -0.03


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply_keeps_elements_comments_types_and_order_of_bytes(ball, tmp_path, kind):
    points, cells, top = ball
    order = ">" if kind == "binary_big_endian" else "<"
    vertex = np.zeros(len(points), [(k, order + "f8") for k in "xyz"] + [
        (k, "u1") for k in ("red", "green", "blue")] + [("id", order + "u2")])
    for i, k in enumerate("xyz"):
        vertex[k] = points[:, i]
    vertex["red"], vertex["id"] = 200, np.arange(len(points))
    face = np.zeros(len(cells), [("n", "u1"), ("v", order + "i4", 3), ("part", order + "i4")])
    face["n"], face["v"], face["part"] = 3, cells, top
    head = ["ply", f"format {kind} 1.0", "comment by hand", f"element vertex {len(points)}",
            "property double x", "property double y", "property double z", "property uchar red",
            "property uchar green", "property uchar blue", "property ushort id",
            f"element face {len(cells)}", "property list uchar int vertex_indices",
            "property int part", "element camera 1", "property float view", "end_header"]
    source, target = tmp_path / "a.ply", tmp_path / "b.ply"
    camera = np.array([0.5], order + "f4")
    if kind == "ascii":
        rows = [" ".join(map(repr, row)) for row in vertex.tolist()]
        rows += [" ".join(["3", *map(str, v), str(f)])
                 for v, f in zip(cells.tolist(), face["part"].tolist(), strict=True)]
        source.write_text("\n".join([*head, *rows, "0.5"]) + "\n")
    else:
        source.write_bytes(("\n".join(head) + "\n").encode() + vertex.tobytes() + face.tobytes()
                           + camera.tobytes())
    write_file(target, read_file(source))
    assert target.read_bytes() == source.read_bytes()
    report = optimized(source, target)
    assert report.after.mean_quality > report.before.mean_quality
    data = target.read_bytes()
    assert data.partition(b"end_header")[0] == source.read_bytes().partition(b"end_header")[0]
    assert data.endswith(b"0.5\n" if kind == "ascii" else camera.tobytes())
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(str(target))
    mesh = meshes.current_mesh()
    assert (mesh.vertex_number(), mesh.face_number()) == (len(points), len(cells))
    assert np.allclose(mesh.vertex_color_matrix()[:, 0], 200 / 255)


@pytest.mark.parametrize("scale", [0.7, 1.5])
@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply_of_other_sizes_keeps_kind_comments_elements_and_types(tmp_path, kind, scale):
    box = trimesh.creation.box().subdivide().subdivide()
    points, cells, upper = box.vertices, box.faces, box.face_normals[:, 2] > 0.5
    order = ">" if kind == "binary_big_endian" else "<"
    vertex = [(x, y, z, x + 0.5, y + 0.5, 200, 100, 50) for x, y, z in points.tolist()]
    face = [(3, v, i) for v, i in zip(cells.tolist(), upper.tolist(), strict=True)]
    kinds = [(k, order + "f4") for k in ("x", "y", "z", "s", "t")]
    vertices = np.array(vertex, [*kinds, ("red", "u1"), ("green", "u1"), ("blue", "u1")])
    faces = np.array(face, [("n", "u1"), ("v", "u1", 3), ("part", order + "i2")])
    head = ["ply", f"format {kind} 1.0", "comment by hand", "obj_info num_cols 7",
            "element camera 1", "property float view", f"element vertex {len(points)}",
            *(f"property float {k}" for k, _ in kinds),
            *(f"property uchar {k}" for k in ("red", "green", "blue")),
            f"element face {len(cells)}", "comment of faces",
            "property list uchar uchar vertex_indices", "property short part",
            "element marks 2", "property int vertex", "element stamp 1", "property uint day",
            "end_header"]
    source, target = tmp_path / "a.ply", tmp_path / "b.ply"
    if kind == "ascii":
        rows = ["0.5", *(" ".join(map(str, row)) for row in vertices.tolist()),
                *(f"3 {a} {b} {c} {int(i)}" for _, (a, b, c), i in face), "0", "1", "77"]
        source.write_text("\n".join([*head, *rows]) + "\n")
    else:
        first, marks, last = (np.array(v, order + t).tobytes() for v, t in (
            ([0.5], "f4"), ([0, 1], "i4"), ([77], "u4")))
        source.write_bytes(("\n".join(head) + "\n").encode() + first + vertices.tobytes()
                           + faces.tobytes() + marks + last)
    mesh = remesh(remesh(read_file(source), scale=scale), scale=0.5 if scale < 1 else 1.2)
    with pytest.warns(DataNotKeptWarning) as told:
        write_file(target, mesh)
    assert len(told) == 1
    assert "does not keep the element 'marks', which names vertices or faces of before;" in str(
        told[0].message)
    n, m = len(mesh.points), len(mesh.cells[0].data)
    assert (n > len(points)) == (scale < 1)
    wanted = [line for line in head if line not in ("element marks 2", "property int vertex")]
    wanted[wanted.index(f"element vertex {len(points)}")] = f"element vertex {n}"
    wanted[wanted.index(f"element face {len(cells)}")] = f"element face {m}"
    if n > 256:
        at = wanted.index("property list uchar uchar vertex_indices")
        wanted[at] = "property list uchar int vertex_indices"
    data = target.read_bytes()
    assert data.partition(b"end_header")[0].decode().splitlines() == wanted[:-1]
    assert data.endswith(b"77\n" if kind == "ascii" else np.array([77], order + "u4").tobytes())
    back = open3d.io.read_triangle_mesh(str(target))
    assert len(back.triangles) == m
    assert np.asarray(back.vertex_colors) == pytest.approx(
        np.tile([200, 100, 50], (n, 1)) / 255, abs=0.01)
    seen = read_file(target)
    assert seen.point_data["s"] == pytest.approx(seen.points[:, 0] + 0.5, abs=1e-6)
    normal = true_normals(seen.points, seen.cells[0].data)
    assert np.array_equal(seen.cell_data["part"][0] == 1, normal[:, 2] > 0.5)


def test_normals_of_a_ply_are_of_the_new_surface(ball, tmp_path):
    points, cells, _ = ball
    mesh = trimesh.Trimesh(points, cells, process=False)
    source, target = tmp_path / "a.ply", tmp_path / "b.ply"
    mesh.export(source, vertex_normal=True)
    optimized(source, target)
    back = read_file(target)
    exact = trimesh.Trimesh(back.points, back.cells[0].data, process=False)
    cosines = (back.point_data["Normals"] * exact.vertex_normals).sum(axis=1)
    assert cosines.min() > 0.99


def test_lines_are_edges_of_a_ply(ball, tmp_path):
    points, cells, _ = ball
    mesh = meshio.Mesh(points, [("triangle", cells), ("line", cells[:5, :2])])
    write_file(tmp_path / "a.ply", mesh)
    assert len(trimesh.load(tmp_path / "a.ply", process=False).faces) == len(cells)
    back = read_file(tmp_path / "a.ply")
    assert back.cells_dict["line"].tolist() == cells[:5, :2].tolist()


def test_a_ply_has_types_that_open3d_reads(ball, tmp_path):
    open3d = pytest.importorskip("open3d")
    points, faces, _ = ball
    mesh = meshio.Mesh(points, [("triangle", faces), ("line", faces[:3, :2])],
                       point_data={"few": np.arange(len(points))},
                       cell_data={"label": [np.arange(len(faces)), np.arange(3)]})
    with pytest.warns(DataNotKeptWarning, match="the values of cell data 'label' of line;"):
        write_file(tmp_path / "a.ply", mesh)
    seen = open3d.io.read_triangle_mesh(str(tmp_path / "a.ply"))
    assert np.array_equal(np.asarray(seen.triangles), faces)
    assert np.array_equal(read_file(tmp_path / "a.ply").point_data["few"], np.arange(len(points)))


@pytest.mark.parametrize("head", ["OFF # made by hand\n{} {} 0\n", "OFF {} {} 0\n",
                                  "OFF\n# comment\n\n{} {} 0\n", "OFF\r\n{}\t{} 0\r\n"])
def test_off_with_comments_and_colours_of_faces(ball, tmp_path, head):
    points, cells, top = ball
    text = head.format(len(points), len(cells))
    text += "".join("{!r} {!r} {!r}\n".format(*map(float, v)) for v in points)
    text += "".join("3 {} {} {} 10 20 {} # face\n".format(*c, 30 + t)
                    for c, t in zip(cells, top.astype(int), strict=True))
    source, target = tmp_path / "a.off", tmp_path / "b.off"
    source.write_text(text, newline="")
    write_file(target, read_file(source))
    assert target.read_bytes() == source.read_bytes()
    optimized(source, target)
    if "made" in head:
        assert len(trimesh.load(target, process=False).faces) == len(cells)
    else:
        meshes = pymeshlab.MeshSet()
        meshes.load_new_mesh(str(target))
        assert meshes.current_mesh().face_number() == len(cells)
    ends = [line.split("# ")[0].split()[4:] for line in target.read_text().splitlines()
            if line.endswith("# face")]
    assert sorted(e[2] for e in ends).count("31") >= top.sum() - 5


@pytest.mark.parametrize("scale", [0.7, 1.5])
@pytest.mark.parametrize("head", ["{}OFF # by hand\n# second\n{} {} 9\n",
                                  "# by hand\r\n{}OFF {} {} 0 # counts\r\n"])
def test_off_of_other_sizes_keeps_comments_colours_and_normals(tmp_path, head, scale):
    box = trimesh.creation.box().subdivide().subdivide()
    points, cells, upper = box.vertices, box.faces, box.face_normals[:, 2] > 0.5
    end = "\r\n" if "\r" in head else "\n"
    rows = [" ".join(map(repr, [x, y, z, 0.0, 0.0, 1.0, x + 0.5, y + 0.5, 0.25, 1.0]))
            for x, y, z in points.tolist()]
    rows += ["3 {} {} {}{}".format(*c, " 255 0 0 # lid" if i else " 0 0 255")
             for c, i in zip(cells.tolist(), upper, strict=True)]
    source, target = tmp_path / "a.off", tmp_path / "b.off"
    source.write_text(head.format("CN", len(points), len(cells)) + end.join(rows), newline="")
    with warnings.catch_warnings():
        warnings.simplefilter("error", DataNotKeptWarning)
        mesh = remesh(read_file(source), scale=scale)
        write_file(target, mesh)
    n, m = len(mesh.points), len(mesh.cells[0].data)
    text = target.read_bytes().decode()
    assert text.startswith(head.format("CN", n, m).replace(" 9\n", " 0\n"))
    assert text.count("\n") == head.count("\n") + n + m
    assert (text.count("\r") == 0) == ("\r" not in head)
    back = read_file(target)
    assert back.point_data["off:colour"][:, :2] == pytest.approx(back.points[:, :2] + 0.5, abs=1e-6)
    assert np.allclose(np.linalg.norm(back.point_data["Normals"], axis=1), 1)
    top = true_normals(back.points, back.cells[0].data)[:, 2] > 0.5
    assert np.array_equal(back.cell_data["off:colour"][0][:, 0] == 255, top)
    assert text.count("# lid") == top.sum()


def test_off_of_meshlab_with_colours_and_normals(ball, tmp_path):
    points, cells, _ = ball
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(points, cells.astype(np.int32),
                                   v_color_matrix=np.full((len(points), 4), 0.5)))
    meshes.save_current_mesh(str(tmp_path / "a.off"))
    optimized(tmp_path / "a.off", tmp_path / "b.off")
    meshes.load_new_mesh(str(tmp_path / "b.off"))
    assert meshes.current_mesh().vertex_number() == len(points)
    assert meshes.current_mesh().vertex_color_matrix()[:, 0].max() < 0.6


@pytest.mark.parametrize("name", ["a.stl", "a.obj", "a.ply", "a.off"])
def test_a_file_that_is_cut_off_is_refused(ball, tmp_path, name):
    points, cells, top = ball
    whole = tmp_path / f"whole{name[1:]}"
    if name == "a.stl":
        whole.write_text(solids(points, cells, top))
    else:
        write_file(whole, meshio.Mesh(points, [("triangle", cells)]))
    data = whole.read_bytes()
    cut = tmp_path / name
    cut.write_bytes(data[: len(data) // 3])
    with pytest.raises(MeshFileError, match="cannot read"):
        optimize(cut)


def test_only_of_cut_files_it_is_said_that_they_are_not_complete(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 x\n")
    with pytest.raises(MeshFileError, match=r"corner b'x'; expected a file that is one of obj"):
        optimize(tmp_path / "a.obj")
    (tmp_path / "a.stl").write_text("solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n")
    with pytest.raises(MeshFileError, match="expected a complete file"):
        optimize(tmp_path / "a.stl")
