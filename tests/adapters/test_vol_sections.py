"""Netgen's files of all geometries: what sections tell of points, edges and faces stays true."""

from __future__ import annotations

import re
import warnings

import meshio
import numpy as np
import pytest

from odt_plugins import optimize, remesh
from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.errors import DataNotKeptWarning

ng = pytest.importorskip("netgen.meshing")


def loaded(path):
    mesh = ng.Mesh()
    mesh.Load(str(path))
    return mesh


def a_ball():
    """A ball in a box; its poles are edges without length, which have numbers, too."""
    from netgen.occ import Box, Glue, OCCGeometry, Sphere

    ball, box = Sphere((0, 0, 0), 0.5).mat("ball"), Box((-1, -1, -1), (1, 1, 1)).mat("air")
    ball.faces.name, box.faces.name, box.edges.name = "skin", "far", "rim"
    return OCCGeometry(Glue([ball, box - ball])).GenerateMesh(maxh=0.4, optsteps3d=0)


def a_ring():
    """A round plate of one material in a square one of another."""
    from netgen.geom2d import SplineGeometry

    geometry = SplineGeometry()
    geometry.AddRectangle((-1, -1), (1, 1), bcs=["low", "right", "high", "left"], leftdomain=1)
    geometry.AddCircle((0, 0), 0.4, leftdomain=2, rightdomain=1, bc="ring")
    return geometry.GenerateMesh(maxh=0.2, optsteps2d=0)


def a_periodic_square():
    from netgen.geom2d import SplineGeometry

    geometry = SplineGeometry()
    a, b, c, d = (geometry.AppendPoint(*p) for p in [(0, 0), (1, 0), (1, 1), (0, 1)])
    geometry.Append(["line", a, b], bc="low")
    right = geometry.Append(["line", b, c], bc="right")
    geometry.Append(["line", c, d], bc="high")
    geometry.Append(["line", a, d], leftdomain=0, rightdomain=1, copy=right, bc="left")
    return geometry.GenerateMesh(maxh=0.12)


def measured(path):
    """What materials, boundaries and edges measure, by dimensions and names, by NGSolve."""
    from ngsolve import CF, Integrate, Mesh

    mesh = Mesh(loaded(path))
    out = {}
    for behind, names, part in ((0, mesh.GetMaterials, mesh.Materials),
                                (1, mesh.GetBoundaries, mesh.Boundaries),
                                (2, mesh.GetBBoundaries, mesh.BBoundaries)):
        if behind < 2 or mesh.dim == 3:
            out |= {(mesh.dim - behind, name): Integrate(CF(1), mesh, definedon=part(name))
                    for name in set(names())}
    return out


def named(mesh):
    """The same of a mesh that was read, whose several groups of a name have numbers behind it."""
    out = {}
    name = {(int(dim), int(number)): text.partition(" (")[0]
            for text, (number, dim) in mesh.field_data.items()}
    for block, label in zip(mesh.cells, mesh.cell_data["netgen:index"], strict=True):
        corners = mesh.points[block.data]
        sides = corners[:, 1:] - corners[:, :1]
        size = np.sqrt(np.linalg.det(sides @ sides.transpose(0, 2, 1)))
        size = size / [1, 2, 6][sides.shape[1] - 1]
        for number in np.unique(label):
            key = sides.shape[1], name.get((sides.shape[1], int(number)), "default")
            out[key] = out.get(key, 0) + size[label == number].sum()
    return out


def resized(source, target, scale, **options):
    mesh = remesh(read_file(source), scale=scale, **options)
    write_file(target, mesh)
    return mesh


def expect_edges(path):
    """Segments are edges of triangles, and rims of the plane have one each."""
    mesh = loaded(path)
    sides = {}
    for triangle in mesh.Elements2D():
        nodes = [v.nr for v in triangle.vertices]
        for pair in zip(nodes, nodes[1:] + nodes[:1], strict=True):
            sides[frozenset(pair)] = sides.get(frozenset(pair), 0) + 1
    segments = {frozenset(v.nr for v in segment.vertices) for segment in mesh.Elements1D()}
    assert segments <= {*sides}
    if mesh.dim == 2:
        assert {pair for pair, count in sides.items() if count == 1} <= segments


def test_edges_have_their_names(tmp_path):
    a_ball().Save(str(tmp_path / "a.vol"))
    expected = measured(tmp_path / "a.vol")
    assert named(read_file(tmp_path / "a.vol")) == pytest.approx(expected)
    assert expected[1, "rim"] == pytest.approx(24)


def test_netgen_finds_edges_and_directions_in_files_written_anew(tmp_path):
    a_ball().Save(str(tmp_path / "a.vol"))
    mesh = read_file(tmp_path / "a.vol")
    mesh.read_from = None
    with pytest.warns(DataNotKeptWarning, match="of the geometry"):
        write_file(tmp_path / "b.vol", mesh)
    assert measured(tmp_path / "b.vol") == pytest.approx(measured(tmp_path / "a.vol"))
    back = loaded(tmp_path / "b.vol")
    points = np.array(back.Coordinates())
    cells = back.Elements3D().NumPy()["nodes"][:, :4].astype(int) - 1
    assert (np.linalg.det(points[cells[:, 1:]] - points[cells[:, :1]]) < 0).all()


@pytest.mark.parametrize("scale", [0.7, 1.5])
def test_triangles_of_stl_geometries_keep_numbers(scale, tmp_path):
    from netgen.occ import Cylinder, OCCGeometry
    from netgen.stl import STLGeometry

    surface = OCCGeometry(Cylinder((0, 0, 0), (0, 0, 1), 0.5, 1)).GenerateMesh(
        maxh=0.2, perfstepsend=ng.MeshingStep.MESHSURFACE)
    surface.Export(str(tmp_path / "a.stl"), "STL Format")
    STLGeometry(str(tmp_path / "a.stl")).GenerateMesh(maxh=0.25).Save(str(tmp_path / "a.vol"))
    resized(tmp_path / "a.vol", tmp_path / "b.vol", scale)
    numbers = []
    for name in "ab":
        data = (tmp_path / f"{name}.vol").read_text()
        found = re.search(r"\nsurfaceelementsgi\n\d+\n((?:.*\S.*\n)*)", data)
        numbers.append({int(word) for line in found[1].splitlines() for word in line.split()[8:]})
    assert numbers[1] <= numbers[0]
    expected = measured(tmp_path / "a.vol")
    assert measured(tmp_path / "b.vol") == pytest.approx(expected, rel=0.01)
    expect_edges(tmp_path / "b.vol")


@pytest.mark.parametrize("scale", [0.6, 1.5])
def test_identified_points_of_the_plane_stay(scale, tmp_path):
    a_periodic_square().Save(str(tmp_path / "a.vol"))
    resized(tmp_path / "a.vol", tmp_path / "b.vol", scale)
    pairs = []
    for name in "ab":
        mesh = loaded(tmp_path / f"{name}.vol")
        points = np.array(mesh.Coordinates())
        pairs.append(sorted([*points[int(str(p)) - 1], *points[int(str(q)) - 1]]
                            for p, q, *_ in mesh.GetIdentifications()))
    assert pairs[0] == pairs[1]
    assert len(mesh.Points()) != len(loaded(tmp_path / "a.vol").Points())
    assert measured(tmp_path / "b.vol") == pytest.approx(measured(tmp_path / "a.vol"))


def test_faces_that_no_longer_correspond_are_not_identified(tmp_path):
    a_periodic_square().Save(str(tmp_path / "a.vol"))
    with pytest.warns(DataNotKeptWarning, match="keep which points of periodic faces correspond;"):
        resized(tmp_path / "a.vol", tmp_path / "b.vol", 0.6, free="periodic")
    assert not loaded(tmp_path / "b.vol").GetIdentifications()
    assert measured(tmp_path / "b.vol") == pytest.approx(measured(tmp_path / "a.vol"))


@pytest.mark.parametrize("form", ["two lines", "oldest", "crlf", "blanks"])
def test_segments_are_read_however_lines_end(form, tmp_path):
    a_ring().Save(str(tmp_path / "a.vol"))
    expected = measured(tmp_path / "a.vol")
    data = (tmp_path / "a.vol").read_bytes()
    if form == "crlf":
        data = data.replace(b"\n", b"\r\n")
    elif form == "blanks":
        data = re.sub(rb"\n(edgesegmentsgi3|points|bcnames|materials)\n(\d+)\n",
                      rb"\n \1 \n \2 \n", data)
    else:
        head = re.search(rb"edgesegmentsgi3\s+(\d+)\n", data)
        rows = [line.split() for line in data[head.end():].split(b"\n", int(head[1]))[:-1]]
        text = b"".join(b"%d 0 %s %s -1 -1\n1 0 %d %s %d %s\n" % (
            int(n) + 1, a, b, int(n) + 1, start, int(n) + 1, stop)
            for a, b, _, _, start, stop, n in rows)
        section = b"edgesegmentsgi2"
        if form == "oldest":
            section = b"edgesegments"
            text = b"".join(b"%d 0 %s %s\n" % (int(row[6]) + 1, *row[:2]) for row in rows)
        rest = data[head.end():].split(b"\n", int(head[1]))[-1]
        data = b"%s%s\n%d\n%s%s" % (data[: head.start()], section, len(rows), text, rest)
        for name in (b"edgedescriptors", b"face_colours", b"face_transparencies"):
            data = re.sub(name + rb"\n\s*\d+\s[\s\S]*?(?=\n#|\n[a-z])", b"", data)
    (tmp_path / "a.vol").write_bytes(data)
    assert named(read_file(tmp_path / "a.vol")) == pytest.approx(expected)
    resized(tmp_path / "a.vol", tmp_path / "b.vol", 1.5)
    expected = measured(tmp_path / "a.vol")
    assert measured(tmp_path / "b.vol") == pytest.approx(expected, rel=0.01)
    expect_edges(tmp_path / "b.vol")


@pytest.mark.parametrize("made", [a_ball, a_ring])
def test_curved_files_lose_no_more_than_how_they_are_curved(made, tmp_path):
    mesh = made()
    mesh.Save(str(tmp_path / "straight.vol"))
    mesh.Curve(3)
    mesh.Save(str(tmp_path / "a.vol"))
    with pytest.warns(DataNotKeptWarning, match="not keep the section curvedelements;"):
        resized(tmp_path / "a.vol", tmp_path / "b.vol", 1.5)
    expected = measured(tmp_path / "straight.vol")
    assert measured(tmp_path / "b.vol") == pytest.approx(expected, rel=0.01)
    assert b"curvedelements" not in (tmp_path / "b.vol").read_bytes()
    if made is a_ball:
        for name in ("straight", "b"):
            curved = loaded(tmp_path / f"{name}.vol")
            curved.Curve(3)
            curved.Save(str(tmp_path / f"{name}3.vol"))
        expected = measured(tmp_path / "straight3.vol")
        assert measured(tmp_path / "b3.vol") == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("boundary", ["fixed", "slide"])
def test_segments_beside_cells_of_second_order_stay(boundary, tmp_path):
    mesh = a_ring()
    mesh.SecondOrder()
    mesh.Save(str(tmp_path / "a.vol"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        write_file(tmp_path / "b.vol", optimize(read_file(tmp_path / "a.vol"), boundary=boundary))
    assert measured(tmp_path / "b.vol") == pytest.approx(measured(tmp_path / "a.vol"), rel=5e-3)
    expect_edges(tmp_path / "b.vol")


def test_wedges_follow_their_points(tmp_path):
    """Tetrahedra under a wedge, and points in a random order."""
    rng = np.random.default_rng(1)
    points = np.vstack([np.eye(4, 3, -1), [[1, 0, -1], [0, 1, -1], [0, 0, -1]],
                        rng.dirichlet([2, 2, 2, 2], 40) @ np.eye(4, 3, -1)])
    from scipy.spatial import Delaunay

    tetra = Delaunay(np.delete(points, [4, 5, 6], axis=0)).simplices
    tetra = np.delete(np.arange(len(points)), [4, 5, 6])[tetra]
    number = rng.permutation(len(points))
    mesh = meshio.Mesh(points[np.argsort(number)], [
        ("tetra", number[tetra]), ("wedge", number[[[0, 1, 2, 6, 4, 5]]])])
    meshio.write(tmp_path / "a.vol", mesh, file_format="netgen")
    source = read_file(tmp_path / "a.vol")
    after = optimize(source, insert=True, keep=())
    with pytest.warns(DataNotKeptWarning, match="cells of type wedge may refer"):
        write_file(tmp_path / "b.vol", after)
    wedge = [part.points[block.data] for part in (source, read_file(tmp_path / "b.vol"))
             for block in part.cells if block.type == "wedge"]
    assert np.array_equal(*wedge)


def a_core():
    """A ball in a cube."""
    from netgen.csg import CSGeometry, OrthoBrick, Pnt, Sphere

    geometry, ball = CSGeometry(), Sphere(Pnt(0.5, 0.5, 0.5), 0.3)
    geometry.Add((OrthoBrick(Pnt(0, 0, 0), Pnt(1, 1, 1)) - ball).mat("air"))
    geometry.Add(ball.mat("ball"))
    return geometry.GenerateMesh(maxh=0.3, optsteps3d=0)


@pytest.mark.parametrize("scale", [0.7, 1.4])
@pytest.mark.parametrize("made", [a_core, a_ring])
def test_segments_of_second_order_are_edges_of_the_resized_mesh(made, scale, tmp_path):
    mesh = made()
    mesh.SecondOrder()
    mesh.Save(str(tmp_path / "a.vol"))
    with warnings.catch_warnings():
        warnings.simplefilter("error", DataNotKeptWarning)
        write_file(tmp_path / "b.vol", remesh(read_file(tmp_path / "a.vol"), scale=scale,
                                              free="periodic"))
    lengths = []
    for path in (tmp_path / "a.vol", tmp_path / "b.vol"):
        mesh = loaded(path)
        points = np.array(mesh.Coordinates())
        rows = [[v.nr - 1 for v in cell.vertices] for cell in mesh.Elements2D()]
        edges = {frozenset(pair) for row in rows for pair in zip(row, row[1:] + row[:1],
                                                                 strict=True)}
        ends = [[v.nr - 1 for v in cell.vertices] for cell in mesh.Elements1D()]
        ends = [pair for pair in ends if pair[0] != pair[1]]
        assert all(frozenset(pair) in edges for pair in ends)
        length = {}
        for (a, b), cell in zip(ends, mesh.Elements1D(), strict=False):
            length[cell.index] = length.get(cell.index, 0) + np.linalg.norm(points[a] - points[b])
        lengths.append([len(ends), length])
    assert (lengths[1][0] > lengths[0][0]) == (scale < 1)
    assert sum(lengths[1][1].values()) == pytest.approx(sum(lengths[0][1].values()), rel=0.02)
