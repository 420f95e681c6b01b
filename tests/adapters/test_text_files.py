"""Files of text: ends of lines, exponents, and sections that a run does not know."""

from __future__ import annotations

import re
import warnings
from functools import partial

import contract
import meshio
import numpy as np
import pytest
from surface_meshes import sphere

from odt_plugins import optimize, remesh
from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.api import optimize_file
from odt_plugins.errors import DataNotKeptWarning, InvalidMeshError

KINDS = [".su2", ".inp", ".mesh", ".bdf", ".msh", ".vol", ".avs", ".dato", ".f3grid", ".ele"]


def box(n, seed=4):
    """Tetrahedra of a box whose inner vertices are off their places."""
    points, cells, _ = contract.grid(3, n)
    inner = ((points > points.min(axis=0)) & (points < points.max(axis=0))).all(axis=1)
    step = points.max() / n
    points[inner] += np.random.default_rng(seed).uniform(-0.2, 0.2, (inner.sum(), 3)) * step
    return points, cells


@pytest.mark.parametrize("suffix", KINDS)
@pytest.mark.parametrize("end", [b"\r\n"])
def test_ends_of_lines_change_nothing(suffix, end, tmp_path):
    points, cells = box(4)
    plain, other = tmp_path / f"a{suffix}", tmp_path / f"b{suffix}"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        write_file(plain, meshio.Mesh(points, [("tetra", cells)]),
                   binary=False if suffix == ".msh" else None)
        names = [plain.name]
        if suffix == ".ele":
            names.append("a.node")
        for name in names:
            data = (tmp_path / name).read_bytes()
            (tmp_path / ("b" + name[1:])).write_bytes(data.replace(b"\n", end))
        one, two = read_file(plain), read_file(other)
    assert np.array_equal(one.points, two.points)
    assert np.array_equal(one.cells_dict["tetra"], two.cells_dict["tetra"])


@pytest.mark.parametrize("suffix", [".su2", ".inp", ".mesh", ".avs"])
def test_exponents_of_fortran_are_read(suffix, tmp_path):
    points, cells = box(4)
    plain, other = tmp_path / f"a{suffix}", tmp_path / f"b{suffix}"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        write_file(plain, meshio.Mesh(points * 1.1e-7, [("tetra", cells)]))
    text = plain.read_text()
    changed = re.sub(r"(?<=\d)e(?=-\d)", "D", text)
    assert changed != text
    other.write_text(changed)
    assert np.array_equal(read_file(plain).points, read_file(other).points)


def medit(path, points, cells, version=2, extra="", end="\n"):
    lines = [f"MeshVersionFormatted {version}", "# by hand", "Dimension", "3", "", "Vertices",
             str(len(points)), *("{!r} {!r} {!r} 7".format(*map(float, x)) for x in points),
             "Tetrahedra", str(len(cells)), *("{} {} {} {} 1".format(*t + 1) for t in cells),
             *extra.split("\n"), "End"]
    path.write_text(end.join(lines) + end, newline="")


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("version", [1, 2, 3, 4])
def test_medit_keeps_what_is_required_and_all_that_is_not_known(version, end, tmp_path):
    points, cells = box(5)
    inner = np.flatnonzero(((points > points.min(0)) & (points < points.max(0))).all(axis=1))
    extra = ("Corners\n2\n1\n2\nRequiredVertices\n4\n" + "\n".join(map(str, inner[:4] + 1))
             + "\nRequiredTetrahedra\n0\nSomethingElse\n1\n3 4 5")
    source, target = tmp_path / "a.mesh", tmp_path / "b.mesh"
    medit(source, points, cells, version, extra, end)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        write_file(target, read_file(source))
        assert target.read_bytes() == source.read_bytes()
        report = optimize_file(source, target)
    assert report.after.mean_quality > report.before.mean_quality
    old, new = source.read_bytes(), target.read_bytes()
    assert new.partition(b"Vertices")[0] == old.partition(b"Vertices")[0]
    assert new.partition(b"Corners")[2] == old.partition(b"Corners")[2]
    lines = [text.split(end.encode()) for text in (old, new)]
    first = lines[0].index(b"Vertices") + 2
    moved = [a != b for a, b in zip(*(part[first: first + len(points)] for part in lines),
                                    strict=True)]
    assert any(moved)
    assert not np.array(moved)[inner[:4]].any()
    assert lines[1][first + len(points) + 1] == str(report.after.n_cells).encode()


def test_gmsh_reads_the_medit_file_that_was_written(tmp_path):
    gmsh = pytest.importorskip("gmsh")
    points, cells = box(5)
    medit(tmp_path / "a.mesh", points, cells, extra="Corners\n1\n1")
    report = optimize_file(tmp_path / "a.mesh", tmp_path / "b.mesh")
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.open(str(tmp_path / "b.mesh"))
        found = len(gmsh.model.mesh.getElementsByType(4)[0])
    finally:
        gmsh.finalize()
    assert found == report.after.n_cells


def test_second_order_sections_of_medit_are_named_where_nothing_else_is_there(tmp_path):
    gmsh = pytest.importorskip("gmsh")
    source, target = tmp_path / "a.mesh", tmp_path / "b.mesh"
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
        gmsh.model.occ.synchronize()
        gmsh.model.mesh.generate(3)
        gmsh.model.mesh.setOrder(2)
        gmsh.write(str(source))
    finally:
        gmsh.finalize()
    with pytest.raises(InvalidMeshError, match=(
            r"no cells that can be read \(\d+ vertices, and the sections EdgesP2, TetrahedraP2, "
            r"TrianglesP2\); expected tetra or triangle, try a mesh of first order, or a \.msh or "
            r"\.vtu file")):
        optimize_file(source, target)
    assert not target.exists()


@pytest.mark.parametrize("encoding", ["utf-8", "latin-1"])
@pytest.mark.parametrize("suffix", [".inp", ".su2", ".mdpa"])
def test_names_of_groups_have_the_letters_of_the_file(suffix, encoding, tmp_path):
    points, cells = box(5)
    numbers = range(1, len(points) + 1)
    nodes = "".join(f"{i}, {x!r}, {y!r}, {z!r}\n"
                    for i, (x, y, z) in zip(numbers, points.tolist(), strict=True))
    if suffix == ".inp":
        text = "*NODE, NSET=voilà\n" + nodes + "*ELEMENT, TYPE=C3D4, ELSET=Stahl träge\n"
        text += "".join(f"{i}, {a}, {b}, {c}, {d}\n"
                        for i, (a, b, c, d) in enumerate((cells + 1).tolist(), 1))
    elif suffix == ".su2":
        text = f"NDIME= 3\nNELEM= {len(cells)}\n" + "".join(
            f"10 {a} {b} {c} {d}\n" for a, b, c, d in cells.tolist())
        text += f"NPOIN= {len(points)}\n" + "".join(
            f"{x!r} {y!r} {z!r}\n" for x, y, z in points.tolist())
        text += "NMARK= 1\nMARKER_TAG= Stahl träge\nMARKER_ELEMS= 0\n"
    else:
        text = "Begin Nodes\n" + nodes.replace(",", " ") + "End Nodes\nBegin Elements Element3D4N\n"
        text += "".join(f"{i} 0 {a} {b} {c} {d}\n"
                        for i, (a, b, c, d) in enumerate((cells + 1).tolist(), 1))
        text += "End Elements\nBegin SubModelPart Stahl träge\nBegin SubModelPartElements\n1\n2\n"
        text += "End SubModelPartElements\nEnd SubModelPart\n"
    source, target = tmp_path / f"a{suffix}", tmp_path / f"b{suffix}"
    source.write_bytes(text.encode(encoding))
    mesh = read_file(source)
    assert list(mesh.cell_sets) == ["Stahl träge"]
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*last digits", category=DataNotKeptWarning)
        write_file(target, remesh(mesh, scale=0.8))
    assert "Stahl träge".encode(encoding) in target.read_bytes()
    if suffix == ".inp":
        back = read_file(target)
        assert len(back.points) > len(mesh.points)
        assert len(back.point_sets["voilà"]) == len(back.points)


@pytest.mark.filterwarnings("ignore:.*the last digits of the coordinates")
@pytest.mark.parametrize("how", [optimize, partial(remesh, scale=0.8)])
@pytest.mark.parametrize("suffix", [".obj", ".off", ".ply", ".stl", ".vol", ".mesh", ".su2", ".msh",
                                    ".inp", ".bdf", ".ele"])
def test_files_whose_lines_end_as_those_of_windows_end_so_afterwards(suffix, how, tmp_path):
    points, cells = sphere(1, 0.05)
    mesh = meshio.Mesh(points, [("triangle", cells)])
    if suffix not in (".obj", ".off", ".ply", ".stl"):
        points, cells = box(3)
        mesh = meshio.Mesh(points, [("tetra", cells)])
    source, target = tmp_path / f"a{suffix}", tmp_path / f"b{suffix}"
    write_file(source, mesh, binary=False if suffix in (".ply", ".stl", ".msh") else None)
    if suffix == ".obj":
        words = source.read_text().split("\n")
        texture = [f"vt {x!r} {y!r}" for x, y, _ in points.tolist()]
        texture += [f"vn {x!r} {y!r} {z!r}" for x, y, z in points.tolist()]
        faces = ["f " + " ".join(f"{v}/{v}/{v}" for v in row) for row in (cells + 1).tolist()]
        source.write_text("\n".join([*(w for w in words if w[:2] == "v "), *texture, *faces]))
    for path in tmp_path.iterdir():
        path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    names = {path.name for path in tmp_path.iterdir()}
    write_file(target, how(read_file(source)))
    for path in tmp_path.iterdir():
        data = path.read_bytes()
        assert path.name in names or data.count(b"\n") == data.count(b"\r\n") > 9
