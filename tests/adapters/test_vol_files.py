"""Netgen's files: what a run does not change stays byte for byte, and Netgen reads it as before."""

from __future__ import annotations

import gzip
import re
import warnings

import contract
import meshio
import numpy as np
import pytest
from made_files import two_boxes

from odt_plugins import optimize, remesh
from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.api import optimize_file
from odt_plugins.errors import DataNotKeptWarning

ng = pytest.importorskip("netgen.meshing")


def loaded(path):
    mesh = ng.Mesh()
    mesh.Load(str(path))
    return mesh


def told(mesh):
    faces = [mesh.FaceDescriptor(i + 1) for i in range(mesh.GetNFaceDescriptors())]
    return {
        "identified": [tuple(map(str, pair)) for pair in mesh.GetIdentifications()],
        "segments": [(*map(str, e.vertices), e.index) for e in mesh.Elements1D()],
        "faces": [(f.domin, f.domout, f.bc, f.surfnr, f.color) for f in faces],
        "triangles": [(*map(str, e.vertices), e.index) for e in mesh.Elements2D()],
        "names": [mesh.GetMaterial(1), mesh.GetMaterial(2),
                  *(mesh.GetBCName(i) for i in range(len(faces)))],
        "materials": sorted({e.index for e in mesh.Elements3D()}),
    }


def around(data):
    """The file without its points and tetrahedra."""
    data = re.sub(rb"volumeelements\r?\n\d+\s[\s\S]*?(?=\r?\n#|\r?\n[a-z])", b"", data)
    return re.sub(rb"\npoints\r?\n\d+\s[\s\S]*?(?=\r?\n#|\r?\n[a-z])", b"", data)


@pytest.mark.parametrize("form", ["plain", "crlf", "packed"])
def test_all_sections_stay(form, tmp_path):
    suffix = ".vol.gz" if form == "packed" else ".vol"
    source, target = tmp_path / f"a{suffix}", tmp_path / f"b{suffix}"
    two_boxes(tmp_path / "plain.vol")
    data = (tmp_path / "plain.vol").read_bytes()
    if form == "crlf":
        data = data.partition(b"endmesh")[0] + b"endmesh\n"
        data = data.replace(b"\n", b"\r\n")
    source.write_bytes(gzip.compress(data) if form == "packed" else data)
    optimize_file(source, target)
    out = target.read_bytes()
    out = gzip.decompress(out) if form == "packed" else out
    assert around(out) == around(data)
    assert out != data
    assert told(loaded(source)) == told(loaded(target))
    before, after = loaded(source), loaded(target)
    assert len(before.Elements3D()) != len(after.Elements3D())
    old, new = np.array(before.Coordinates()), np.array(after.Coordinates())
    assert not np.array_equal(old, new)
    for mesh, points in ((before, old), (after, new)):
        rows = mesh.Elements3D().NumPy()["nodes"][:, :4].astype(int) - 1
        volumes = np.linalg.det(points[rows[:, 1:]] - points[rows[:, :1]]) / 6
        assert (volumes < 0).all()
        assert volumes.sum() == pytest.approx(-2)


def test_identified_faces_still_match_when_the_surface_slides(tmp_path):
    two_boxes(tmp_path / "a.vol")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        optimize_file(tmp_path / "a.vol", tmp_path / "b.vol", boundary="slide", free="periodic")
    report = optimize_file(tmp_path / "a.vol", tmp_path / "b.vol", boundary="slide")
    assert any("periodic" in note for note in report.notes)
    mesh = loaded(tmp_path / "b.vol")
    points = np.array(mesh.Coordinates())
    pairs = np.array([[int(str(p)) for p in pair] for pair in mesh.GetIdentifications()]) - 1
    assert np.allclose(points[pairs[:, 1]] - points[pairs[:, 0]], [2, 0, 0], atol=1e-12)


def test_in_the_plane_segments_stay(tmp_path):
    from netgen.geom2d import unit_square

    mesh = unit_square.GenerateMesh(maxh=0.15, optsteps2d=0)
    mesh.Save(str(tmp_path / "a.vol"))
    optimize_file(tmp_path / "a.vol", tmp_path / "b.vol")
    a, b = loaded(tmp_path / "a.vol"), loaded(tmp_path / "b.vol")
    one, two = told(a), told(b)
    assert one.pop("triangles") != two.pop("triangles")
    assert one == two
    assert b.dim == 2


def test_files_of_meshio_keep_the_direction_of_cells(tmp_path):
    points, cells, labels = contract.grid(3, 4)
    inner = ((points > points.min(0)) & (points < points.max(0))).all(axis=1)
    points[inner] += np.random.default_rng(2).uniform(-0.1, 0.1, (inner.sum(), 3))
    meshio.write(tmp_path / "a.vol", meshio.Mesh(points, [("tetra", cells)], cell_data={
        "netgen:index": [labels]}))
    optimize_file(tmp_path / "a.vol", tmp_path / "b.vol")
    back = read_file(tmp_path / "b.vol")
    rows = back.cells[0].data
    assert not np.array_equal(back.points, points)
    assert (np.linalg.det(back.points[rows[:, 1:]] - back.points[rows[:, :1]]) > 0).all()
    assert np.array_equal(np.unique(back.cell_data["netgen:index"][0]), np.unique(labels))


def test_lines_of_files_of_meshio_keep_their_labels(tmp_path):
    points, cells, _ = contract.grid(3, 3)
    lines = np.array([[0, 1], [1, 2], [0, 3]])
    meshio.write(tmp_path / "a.vol", meshio.Mesh(
        points, [("tetra", cells), ("line", lines)],
        cell_data={"netgen:index": [np.ones(len(cells), int), np.array([4, 4, 7])]}))
    write_file(tmp_path / "b.vol", anew(read_file(tmp_path / "a.vol")))
    for name in "ab":
        mesh = read_file(tmp_path / f"{name}.vol")
        found = [(set(row), label) for block, labels in zip(
            mesh.cells, mesh.cell_data["netgen:index"], strict=True) if block.type == "line"
            for row, label in zip(block.data.tolist(), labels.tolist(), strict=True)]
        assert sorted(found, key=str) == [({0, 1}, 4), ({0, 3}, 7), ({1, 2}, 4)]


@pytest.mark.parametrize("d", [2, 3])
def test_elements_of_second_order_keep_what_they_fill(d, tmp_path):
    from netgen.csg import CSGeometry, Pnt, Sphere
    from netgen.geom2d import SplineGeometry
    from ngsolve import CF, Integrate, Mesh

    if d == 2:
        geometry = SplineGeometry()
        geometry.AddCircle((0, 0), 1, leftdomain=1, bc="rim")
    else:
        geometry = CSGeometry()
        geometry.Add(Sphere(Pnt(0, 0, 0), 1))
    mesh = geometry.GenerateMesh(maxh=0.4, optsteps3d=0)
    mesh.SecondOrder()
    source, target = tmp_path / "a.vol", tmp_path / "b.vol"
    mesh.Save(str(source))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataNotKeptWarning)
        optimize_file(source, target)
    before, after = (Mesh(loaded(path)) for path in (source, target))
    assert Integrate(CF(1), after, order=6) == pytest.approx(
        Integrate(CF(1), before, order=6), rel=1e-12)
    if d == 2:
        assert after.GetMaterials() == before.GetMaterials()
        assert after.GetBoundaries() == before.GetBoundaries()


def anew(mesh):
    """A mesh that does not know from which file it is."""
    mesh.read_from = None
    return mesh


@pytest.mark.parametrize("again", [False, True])
@pytest.mark.parametrize("d", [2, 3])
def test_names_stay_in_files_of_second_order(d, again, tmp_path):
    """Names of materials with blanks, and the same ones of sides; several sides have one name."""
    from netgen.geom2d import SplineGeometry
    from netgen.occ import Box, Glue, OCCGeometry, X

    if d == 2:
        geometry = SplineGeometry()
        geometry.AddRectangle((0, 0), (1, 1), bcs=["a", "b", "air", "b"], leftdomain=1)
        geometry.SetMaterial(1, "air")
        mesh = geometry.GenerateMesh(maxh=0.15, optsteps2d=0)
    else:
        left, right = Box((0, 0, 0), (1, 1, 1)).mat("air"), Box((1, 0, 0), (2, 1, 1)).mat("my box")
        left.faces.Min(X).name, right.faces.Max(X).name = "b", "air"
        left.faces.Max(X).name = "b"
        mesh = OCCGeometry(Glue([left, right])).GenerateMesh(maxh=0.4, optsteps3d=0)
    mesh.SecondOrder()
    source, target = tmp_path / "a.vol", tmp_path / "b.vol"
    mesh.Save(str(source))
    if again:
        with pytest.warns(DataNotKeptWarning) as caught:
            write_file(target, anew(optimize(read_file(source))))
        assert not re.search("field data|periodic|bcnames|materials", str(caught[0].message))
    else:
        optimize_file(source, target)
        assert told(loaded(target))["faces"] == told(loaded(source))["faces"]

    def names(path):
        text = path.read_text()
        return [[line.split(None, 1) for line in re.search(
            rf"\n{what}\n\d+\n((?:\d.*\n)*)", text)[1].splitlines()]
            for what in ("materials", "bcnames")]

    assert [[name for name in part if name[1] != "default"] for part in names(target)] == [
        [name for name in part if name[1] != "default"] for part in names(source)]
    back = loaded(target)
    assert [back.GetMaterial(1), back.GetBCName(1)] == [mesh.GetMaterial(1), mesh.GetBCName(1)]
    with pytest.warns(DataNotKeptWarning):
        write_file(tmp_path / "b.inp", read_file(source))
    found = {*read_file(tmp_path / "b.inp").cell_sets}
    assert {"air (2D)"} <= found if d == 2 else {"air", "air (3D)", "my box", "b"} <= found


@pytest.mark.parametrize("again", [False, True])
@pytest.mark.parametrize("scale", [0.7, 1.5])
def test_triangles_of_a_resized_file_tell_the_materials_beside_them(scale, again, tmp_path):
    two_boxes(tmp_path / "a.vol")
    mesh = remesh(read_file(tmp_path / "a.vol"), scale=scale)
    if again:
        with pytest.warns(DataNotKeptWarning, match="sections"):
            write_file(tmp_path / "b.vol", anew(mesh))
    else:
        write_file(tmp_path / "b.vol", mesh)
    found = []
    for path in (tmp_path / "a.vol", tmp_path / "b.vol"):
        mesh = loaded(path)
        points = np.array(mesh.Coordinates())
        materials = {}
        for cell in mesh.Elements3D():
            nodes = [v.nr - 1 for v in cell.vertices]
            for k, tip in enumerate(nodes):
                side = frozenset(nodes[:k] + nodes[k + 1:])
                materials.setdefault(side, []).append((tip, cell.index))
        area = {}
        for triangle in mesh.Elements2D():
            a, b, c = (v.nr - 1 for v in triangle.vertices)
            normal = np.cross(points[b] - points[a], points[c] - points[a])
            face = mesh.FaceDescriptor(triangle.index)
            beside = [0, 0]
            for tip, index in materials[frozenset((a, b, c))]:
                beside[int(normal @ (points[tip] - points[a]) > 0)] = index
            assert [face.domin, face.domout] == beside
            key = (face.bcname, face.domin, face.domout)
            area[key] = area.get(key, 0) + np.linalg.norm(normal) / 2
        found.append(area)
    assert found[1] == pytest.approx(found[0], rel=1e-9)


def a_body():
    """A box of one material around a cylinder of another, with names of faces and edges."""
    from netgen.occ import Box, Cylinder, Glue, OCCGeometry

    box, inner = Box((0, 0, 0), (1, 1, 1)), Cylinder((0.5, 0.5, 0.2), (0, 0, 1), 0.2, 0.6)
    box.faces.name, box.edges.name, inner.faces.name, inner.edges.name = "out", "rim", "in", "ring"
    return OCCGeometry(Glue([(box - inner).mat("a"), inner.mat("b")])).GenerateMesh(
        maxh=0.2, optsteps3d=0)


def a_plate():
    """A square with a round hole, with names of its edges."""
    from netgen.geom2d import SplineGeometry

    geometry = SplineGeometry()
    geometry.AddRectangle((0, 0), (1, 1), bcs=["low", "right", "high", "left"])
    geometry.AddCircle((0.5, 0.5), 0.2, leftdomain=0, rightdomain=1, bc="hole")
    return geometry.GenerateMesh(maxh=0.1)


def measured(path, order):
    """What materials, boundaries and their edges measure, by their names, by NGSolve."""
    from ngsolve import CF, Integrate, Mesh

    mesh = loaded(path)
    if order > 1:
        mesh.Curve(order)
    mesh = Mesh(mesh)
    out = {name: Integrate(CF(1), mesh, definedon=mesh.Materials(name), order=6)
           for name in set(mesh.GetMaterials())}
    out |= {f"{name} on": Integrate(CF(1), mesh.Boundaries(name), order=6)
            for name in set(mesh.GetBoundaries())}
    if mesh.dim == 3:
        out |= {f"{name} along": Integrate(CF(1), mesh.BBoundaries(name), order=6)
                for name in set(mesh.GetBBoundaries())}
    return out


def without(data, *names):
    """A file without some sections."""
    for name in names:
        data = re.sub(name + rb"\r?\n\s*\d+\s[\s\S]*?(?=\r?\n#|\r?\n[a-z])", b"", data)
    return data


@pytest.mark.parametrize("scale", [0.7, 1.5])
@pytest.mark.parametrize("made", [a_body, a_plate])
def test_a_resized_file_has_its_boundaries_edges_and_geometry(made, scale, tmp_path):
    made().Save(str(tmp_path / "a.vol"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        write_file(tmp_path / "b.vol", remesh(read_file(tmp_path / "a.vol"), scale=scale))
    mesh = loaded(tmp_path / "b.vol")
    assert len(mesh.Points()) != len(loaded(tmp_path / "a.vol").Points())
    # Netgen stores no splines of the plane.
    for order in (1, 3) if made is a_body else (1,):
        before, after = (measured(tmp_path / f"{name}.vol", order) for name in "ab")
        assert after == pytest.approx(before, rel=6e-3 if order == 1 else 3e-3)
    sections = (rb"points", rb"pointelements", rb"edgesegmentsgi3", rb"surfaceelements\w*",
                rb"volumeelements")
    a, b = (without((tmp_path / f"{name}.vol").read_bytes(), *sections) for name in "ab")
    assert a.partition(b"endmesh")[2] == b.partition(b"endmesh")[2]
    assert a.split() == b.split()


def parameters(path):
    """Points (k, 3) of corners of triangles and their parameters (k, 2), by their surfaces."""
    data = path.read_bytes()
    points = np.array([line.split() for line in re.search(
        rb"\npoints\n\d+\n((?:.*\S.*\n)*)", data)[1].splitlines()], dtype=float)
    out = {}
    for line in re.search(rb"\nsurfaceelementsuv\n\d+\n((?:.*\S.*\n)*)", data)[1].splitlines():
        words = line.split()
        for k in range(3):
            place = points[int(words[5 + k]) - 1]
            out.setdefault(words[0], []).append(
                [*place, *map(float, words[8 + 2 * k : 10 + 2 * k])])
    return {name: (np.array(rows)[:, :3], np.array(rows)[:, 3:]) for name, rows in out.items()}


@pytest.mark.parametrize("run", [remesh, optimize])
def test_corners_of_triangles_have_parameters_of_their_places(run, tmp_path):
    """Those of a plane face are linear, those of a round one are within the turn of a triangle."""
    a_body().Save(str(tmp_path / "a.vol"))
    how = {"scale": 0.7} if run is remesh else {"boundary": "slide"}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        write_file(tmp_path / "b.vol", run(read_file(tmp_path / "a.vol"), **how))
    before, after = (parameters(tmp_path / f"{name}.vol") for name in "ab")
    assert {*before} == {*after}
    plane = 0
    for name, (points, values) in before.items():
        wide, narrow = (np.column_stack([p, np.ones(len(p))]) for p in (points, after[name][0]))
        fit = np.linalg.lstsq(wide, values, rcond=1e-9)[0]
        if np.abs(wide @ fit - values).max() < 1e-5:
            plane += 1
            assert narrow @ fit == pytest.approx(after[name][1], abs=1e-4)
        else:
            place, value = after[name][0], after[name][1][:, 0]
            angle = np.arctan2(place[:, 1] - 0.5, place[:, 0] - 0.5)
            turns = [np.exp(1j * (angle - sign * value)) for sign in (1, -1)]
            assert min(np.ptp(np.angle(z / z[0])) for z in turns) < 0.1
    assert plane == 8


def test_ends_of_segments_that_slide_have_parameters_of_their_places(tmp_path):
    """Those of straight edges are linear."""
    a_body().Save(str(tmp_path / "a.vol"))
    write_file(tmp_path / "b.vol", optimize(read_file(tmp_path / "a.vol"), boundary="slide"))
    found = []
    for name in "ab":
        data = (tmp_path / f"{name}.vol").read_bytes()
        head = re.search(rb"edgesegmentsgi3\n(\d+)\n", data)
        lines = data[head.end():].split(b"\n", int(head[1]))[:-1]
        rows = np.array([line.split() for line in lines], dtype=float)
        ends, told = rows[:, :2].astype(int).ravel() - 1, rows[:, 4:6].ravel()
        # The places are in the memory of the mesh.
        mesh = loaded(tmp_path / f"{name}.vol")
        found.append((np.array(mesh.Coordinates())[ends], told, np.repeat(rows[:, 6], 2)))
    (old, was, edge), (new, now, same) = found
    assert np.array_equal(edge, same)
    moved = (old != new).any(axis=1)
    assert moved.sum() > 10
    straight = 0
    for number in np.unique(edge):
        own = edge == number
        wide, narrow = (np.column_stack([p[own], np.ones(own.sum())]) for p in (old, new))
        fit = np.linalg.lstsq(wide, was[own], rcond=1e-9)[0]
        if np.abs(wide @ fit - was[own]).max() < 1e-5:
            straight += (moved & own).sum()
            assert narrow @ fit == pytest.approx(now[own], abs=1e-4)
    assert straight > 5


def test_segments_of_older_files_are_resized(tmp_path):
    """They tell a boundary by another word, and every parameter with the number of its edge."""
    a_plate().Save(str(tmp_path / "new.vol"))
    data = (tmp_path / "new.vol").read_bytes()
    head = re.search(rb"edgesegmentsgi3\s+(\d+)\s", data)
    lines = data[head.end():].split(b"\n", int(head[1]))
    edges = [int(line.split()[0]) for line in data.split(b"edgedescriptors")[1].splitlines()[2:10]]
    rows = []
    for line in lines[:-1]:
        one, two, _, _, start, stop, number = line.split()
        rows.append(b"%d 0 %s %s -1 -1 1 0 %d %s %d %s" % (
            edges[int(number)], one, two, int(number) + 1, start, int(number) + 1, stop))
    old = b"%sedgesegmentsgi2\n%d\n%s" % (
        data[: head.start()], len(rows), b"\n".join([*rows, lines[-1]]))
    (tmp_path / "a.vol").write_bytes(without(
        old, rb"edgedescriptors", rb"face_colours", rb"face_transparencies"))
    write_file(tmp_path / "b.vol", remesh(read_file(tmp_path / "a.vol"), scale=0.7))
    before, after = (measured(tmp_path / f"{name}.vol", 1) for name in "ab")
    assert after == pytest.approx(before, rel=6e-3)
    assert len(before) > 5
    number = len(loaded(tmp_path / "b.vol").Elements1D())
    assert number > len(rows)
    parameters = {}
    for line in re.search(rb"edgesegmentsgi2\n\d+\n((?:.*\n){%d})" % number,
                          (tmp_path / "b.vol").read_bytes())[1].splitlines():
        words = line.split()
        parameters.setdefault(words[8], []).append((float(words[9]), float(words[11])))
    for pairs in parameters.values():
        pairs.sort()
        assert [pairs[0][0], pairs[-1][1]] == [0, 1]
        assert [b for _, b in pairs[:-1]] == pytest.approx([a for a, _ in pairs[1:]], abs=4e-3)


def test_files_with_sections_that_name_points_are_written_anew(tmp_path):
    a_plate().Save(str(tmp_path / "a.vol"))
    data = (tmp_path / "a.vol").read_bytes()
    (tmp_path / "a.vol").write_bytes(
        data.replace(b"\nendmesh", b"\nsingular_points\n1\n3 0.5\n\nendmesh"))
    with pytest.warns(DataNotKeptWarning, match="singular_points"):
        write_file(tmp_path / "b.vol", remesh(read_file(tmp_path / "a.vol"), scale=1.5))


def test_labels_in_another_order_of_cells_are_not_called_lost(tmp_path):
    """Gmsh has the cells of an entity together."""
    points, cells, _ = contract.grid(3, 3)
    faces = np.sort(cells[:6, :3], axis=1)
    labels = [np.arange(len(rows)) // 3 % 2 + 1 for rows in (faces, cells)]
    mesh = meshio.Mesh(points, [("triangle", faces), ("tetra", cells)],
                       cell_data={"netgen:index": labels},
                       field_data={"one": np.array([1, 3]), "two": np.array([2, 3])})
    with pytest.warns(DataNotKeptWarning) as heard:
        write_file(tmp_path / "a.msh", mesh)
    assert len(heard) == 1
    assert "of tetra" not in str(heard[0].message)
