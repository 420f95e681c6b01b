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

from odt_plugins import remesh
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
    with pytest.warns(DataNotKeptWarning, match="parameters of corners of triangles that moved"):
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
    mesh = geometry.GenerateMesh(maxh=0.4)
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


@pytest.mark.parametrize("d", [2, 3])
def test_names_stay_in_files_of_second_order_that_are_written_anew(d, tmp_path):
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
    with pytest.warns(DataNotKeptWarning) as caught:
        optimize_file(source, target)
    assert not re.search("field data|periodic|bcnames|materials", str(caught[0].message))

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


@pytest.mark.parametrize("scale", [0.7, 1.5])
def test_triangles_of_a_resized_file_tell_the_materials_beside_them(scale, tmp_path):
    two_boxes(tmp_path / "a.vol")
    with pytest.warns(DataNotKeptWarning, match="sections"):
        write_file(tmp_path / "b.vol", remesh(read_file(tmp_path / "a.vol"), scale=scale))
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
