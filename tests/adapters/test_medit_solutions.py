"""MEDIT's solutions, .sol and .solb: both ways, and as mmg reads them."""

from __future__ import annotations

import shutil
import struct
import subprocess

import contract
import meshio
import numpy as np
import pytest
from strategies import jittered

import odt_plugins
from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.adapters.formats import REWRITERS
from odt_plugins.api import optimize_file
from odt_plugins.engine.cells import tensors as ts
from odt_plugins.errors import DataNotKeptWarning, MeshFileError


def made(d, folder, suffix=".mesh", **arrays):
    points, cells = jittered(d, 3, 0)
    mesh = meshio.Mesh(points, [("triangle" if d == 2 else "tetra", cells)], arrays)
    write_file(folder / f"a{suffix}", mesh)
    return mesh


def values(n, *width):
    return np.random.default_rng(0).normal(size=(n, *width))


@pytest.mark.parametrize("suffix", [".mesh", ".meshb"])
def test_solutions_come_back_to_the_last_bit(d, suffix, tmp_path):
    n, wide = 4**d, d * (d + 1) // 2
    mesh = made(d, tmp_path, suffix, sol1=values(n), sol2=values(n, d), sol3=values(n, wide))
    assert (tmp_path / f"a.sol{suffix[5:]}").is_file()
    back = read_file(tmp_path / f"a{suffix}")
    for name in ("sol1", "sol2", "sol3"):
        assert np.array_equal(back.point_data[name], mesh.point_data[name])
    # written into a copy of the file, or anew, and without arrays that were not asked for
    better = odt_plugins.optimize(back)
    target = tmp_path / f"b{suffix}"
    write_file(target, better)
    again = read_file(target)
    assert np.allclose(again.points, better.points)
    for name in ("sol1", "sol2", "sol3"):
        assert np.array_equal(again.point_data[name], better.point_data[name])
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(
        f"{stem}.{kind}{suffix[5:]}" for stem in "ab" for kind in ("mesh", "sol"))


def test_one_solution_is_called_sol_and_other_arrays_are_lost_as_before(tmp_path):
    with pytest.warns(DataNotKeptWarning, match="does not keep point data 'u'"):
        made(2, tmp_path, sol=values(16, 3), u=values(16))
    assert set(read_file(tmp_path / "a.mesh").point_data) == {"medit:ref", "sol"}
    (tmp_path / "a.sol").unlink()
    assert set(read_file(tmp_path / "a.mesh").point_data) == {"medit:ref"}


def test_what_others_write_is_read(tmp_path):
    made(3, tmp_path)
    (tmp_path / "a.sol").write_text(
        "# a comment\nMeshVersionFormatted\n2\nDimension\n3\nSolAtVertices\n64\n2 3 1\n"
        + "1 2D0 3 4 5 6 7\n" * 64 + "End\n", encoding="ascii")
    found = read_file(tmp_path / "a.mesh").point_data
    assert np.array_equal(found["sol1"][5], [1, 2, 3, 4, 5, 6])
    assert np.array_equal(found["sol2"], np.full(64, 7.0))
    (tmp_path / "a.sol").unlink()
    for order, version, real, place in ((">", 1, "f4", "i"), ("<", 3, "f8", "q"),
                                        (">", 4, "f8", "q")):
        at = 8 + 8 + struct.calcsize("<" + place)
        data = struct.pack(order + "iii" + place + "i", 1, version, 3, at, 3)
        count = "q" if version > 3 else "i"
        data += struct.pack(order + "i" + place + count + "ii", 62, 10**6, 64, 1, 2)
        data += np.arange(192.0).astype(order + real).tobytes()
        (tmp_path / "a.solb").write_bytes(data)
        assert np.array_equal(read_file(tmp_path / "a.mesh").point_data["sol"],
                              np.arange(192.0).reshape(64, 3)), version


def test_a_file_of_another_mesh_is_not_read_and_named(tmp_path):
    made(2, tmp_path, sol=values(16))
    text = (tmp_path / "a.sol").read_text(encoding="ascii")
    (tmp_path / "a.sol").write_text(text.replace("\n16\n", "\n15\n"), encoding="ascii")
    with pytest.warns(DataNotKeptWarning, match=r"a\.sol is not read, it has values for 15 "):
        mesh = read_file(tmp_path / "a.mesh")
    assert set(mesh.point_data) == {"medit:ref"}
    (tmp_path / "a.sol").write_text(text.replace("SolAtVertices", "SolAtTriangles"),
                                    encoding="ascii")
    with pytest.warns(DataNotKeptWarning, match=r"a\.sol is not read, it has none at vertices"):
        read_file(tmp_path / "a.mesh")
    for broken in (text[:200], text.replace("Dimension 2", ""), "",
                   text.replace("\n1 1\n", "\n1 9\n")):
        (tmp_path / "a.sol").write_text(broken, encoding="ascii")
        with pytest.raises(MeshFileError, match=r"a\.sol ends before the values that it says"):
            read_file(tmp_path / "a.mesh")


def test_mmg_reads_the_metric_that_was_written(d, tmp_path):
    """Cells are long in the direction (1, 1) or (1, 0, 1), four times as long as across."""
    pytest.importorskip("mmgpy")
    points, cells = jittered(d, 6 if d == 2 else 3, 0)
    long = np.array([1.0, 1.0] if d == 2 else [1.0, 0.0, 1.0]) / np.sqrt(2.0)
    fine = {2: 0.06, 3: 0.12}[d] ** -2.0
    metric = fine * (np.eye(d) - (15 / 16) * long[:, None] * long)
    tensors = ts.packed(np.broadcast_to(metric, (len(points), d, d)))
    kind = {2: "triangle", 3: "tetra"}[d]
    write_file(tmp_path / "a.mesh", meshio.Mesh(points, [(kind, cells)], {"sol": tensors}))
    files = [str(tmp_path / name) for name in ("a.mesh", "c.mesh")]
    subprocess.run([shutil.which(f"mmg{d}d_O3") or f"mmg{d}d", "-v", "0", "-hgrad", "-1",
                    "-hausd", "1", *files],
                   check=True, capture_output=True, timeout=60)
    found = read_file(tmp_path / "c.mesh")
    wide = d * (d + 1) // 2
    assert found.point_data["sol"].shape == (len(found.points), wide)
    rows = found.points[:, :d][found.cells_dict[kind]]
    edges = (rows - np.roll(rows, 1, axis=1)).reshape(-1, d)
    along = (edges @ long) ** 2
    assert along.mean() > 2.0 * ((edges**2).sum(axis=1) - along).mean() / (d - 1)


@pytest.mark.parametrize("harm", ["cut", "version", "field"])
def test_a_broken_binary_file_is_refused_in_one_sentence(harm, tmp_path):
    made(3, tmp_path, ".meshb")
    path = tmp_path / "a.meshb"
    data = bytearray(path.read_bytes())
    if harm == "cut":
        del data[len(data) // 2:]
    else:
        at = 4 if harm == "version" else 8
        data[at:at + 4] = struct.pack("<i", 77)
    path.write_bytes(data)
    with pytest.raises(MeshFileError, match="cannot read"):
        odt_plugins.quality(path)


@pytest.mark.parametrize("suffixes", [(".mesh", ".meshb"), (".meshb", ".mesh")])
def test_text_goes_into_binary_files_and_back(suffixes, tmp_path):
    points, cells, labels = contract.grid(3, 3)
    source, target = (tmp_path / f"{name}{suffix}" for name, suffix in zip("ab", suffixes,
                                                                           strict=True))
    write_file(source, meshio.Mesh(points, [("tetra", cells)], cell_data={"medit:ref": [labels]}))
    optimize_file(source, target)
    mesh = read_file(target)
    assert len(mesh.points) == len(points)
    assert {*mesh.cell_data["medit:ref"][0]} == {*labels}
    assert target.read_bytes().isascii() == (suffixes[1] == ".mesh")
    assert len(meshio.read(target).points) == len(points)


def test_a_copy_that_cannot_be_read_is_told_in_one_sentence(tmp_path, monkeypatch):
    points, cells, _ = contract.grid(3, 2)
    write_file(tmp_path / "a.mesh", meshio.Mesh(points, [("tetra", cells)]))
    mesh = read_file(tmp_path / "a.mesh")
    monkeypatch.setitem(REWRITERS, "medit", lambda _, target, change: target.write_text("x") and [])
    said = r"^cannot write b\.mesh as medit: the copy of .*a\.mesh cannot be read again"
    with pytest.raises(MeshFileError, match=said):
        write_file(tmp_path / "b.mesh", mesh)
    assert [path.name for path in tmp_path.iterdir()] == ["a.mesh"]


@pytest.mark.parametrize("suffix", [".sol", ".solb"])
def test_tensors_that_are_not_symmetric_come_back(d, suffix, tmp_path):
    full = values(4**d, d * d)
    mesh = made(d, tmp_path, suffix.replace("sol", "mesh"), sol1=values(4**d), sol2=full)
    target = tmp_path / f"a{suffix.replace('sol', 'mesh')}"
    back = read_file(target).point_data
    assert np.array_equal(back["sol2"], full)
    assert np.array_equal(back["sol1"], mesh.point_data["sol1"])
    kinds = b"2 1 4" if suffix == ".sol" else struct.pack("<iii", 2, 1, 4)
    assert kinds in (tmp_path / f"a{suffix}").read_bytes()


@pytest.mark.parametrize("text", [True, False])
def test_solutions_elsewhere_than_at_vertices_are_named(text, tmp_path):
    made(2, tmp_path, sol=values(16))
    if text:
        with (tmp_path / "a.sol").open("a", encoding="ascii") as file:
            file.write("SolAtTriangles\n1\n1 1\n5.0\nEnd\n")
    else:
        (tmp_path / "a.sol").unlink()
        data = struct.pack("<iiiii", 1, 2, 3, 20, 2)
        for code, count in ((64, 1), (62, 16)):
            at = len(data) + 8 + 12 + 8 * count
            data += struct.pack("<iiiii", code, at, count, 1, 1) + bytes(8 * count)
        # as mmg ends its files
        (tmp_path / "a.solb").write_bytes(data + struct.pack("<i", 54))
    with pytest.warns(DataNotKeptWarning, match=r"a\.solb? has SolAtTriangles, of which nothing "):
        assert read_file(tmp_path / "a.mesh").point_data["sol"].shape == (16,)


def test_solutions_of_the_plane_are_so_in_space(tmp_path):
    points, cells = jittered(2, 3, 0)
    write_file(tmp_path / "a.mesh", meshio.Mesh(
        np.column_stack([points, np.ones(16)]), [("triangle", cells)]))
    text = "MeshVersionFormatted 2\nDimension 2\nSolAtVertices\n16\n4 1 2 3 4\n"
    (tmp_path / "a.sol").write_text(text + "1 2 3 100 0 25 6 7 8 9\n" * 16, encoding="ascii")
    found = read_file(tmp_path / "a.mesh")
    for name, row in (("sol1", 1), ("sol2", [2, 3, 0]), ("sol3", [100, 0, 25, 0, 0, 0]),
                      ("sol4", [6, 7, 0, 8, 9, 0, 0, 0, 0])):
        assert np.array_equal(found.point_data[name][3], row)
    assert odt_plugins.optimize_with_report(found, metric="sol3")[1].after.mean_quality > 0.5
    write_file(tmp_path / "b.mesh", found)
    assert np.array_equal(read_file(tmp_path / "b.mesh").point_data["sol3"][3], [100, 0, 25, 0, 0,
                                                                                 0])


@pytest.mark.parametrize("left", [".sol", ".solb"])
def test_solutions_that_are_left_beside_another_mesh_are_named(left, tmp_path):
    mesh = made(2, tmp_path, left.replace("sol", "mesh"), sol=values(16))
    mesh.point_data = {}
    said = rf"a\.mesh: a\{left} beside it stays, and is read with it though it is no part of it"
    with pytest.warns(DataNotKeptWarning, match=said):
        write_file(tmp_path / "a.mesh", mesh)
    mesh.point_data = {"sol": values(16)}
    write_file(tmp_path / "a.mesh", mesh)
    with pytest.warns(DataNotKeptWarning) as told:
        write_file(tmp_path / "a.mesh", meshio.Mesh(mesh.points, mesh.cells, {"u": values(16)}))
    assert any("does not keep point data 'u'" in str(one.message) for one in told)
    assert any("a.sol beside it stays" in str(one.message) for one in told)


def sections_of(data):
    """Sections of a binary file of version 2: words (n, k) of 4 bytes, by their code."""
    head = struct.unpack_from("<iiii", data)
    found, at = {}, 8
    while (code := struct.unpack_from("<i", data, at)[0]) != 54:
        following = struct.unpack_from("<i", data, at + 4)[0]
        inside = np.frombuffer(data[at + 8:following], "<i4")
        found[code] = inside if code == 3 else inside[1:].reshape(inside[0], -1)
        at = following
    assert len(data) == at + 8
    return head[:3], found


def test_binary_meshes_are_of_version_2(d, tmp_path):
    points, cells, labels = contract.grid(d, 3)
    kind, code = {2: ("triangle", 6), 3: ("tetra", 8)}[d]
    write_file(tmp_path / "a.meshb", meshio.Mesh(points, [(kind, cells)],
                                                 cell_data={"medit:ref": [labels]}))
    head, found = sections_of((tmp_path / "a.meshb").read_bytes())
    assert head == (1, 2, 3)
    assert list(found) == [3, 4, code]
    assert found[3].tolist() == [d]
    assert found[4][:, :2 * d].copy().view("<f8").tolist() == points.tolist()
    assert found[code].tolist() == np.column_stack([cells + 1, labels]).tolist()
    back = read_file(tmp_path / "a.meshb")
    assert np.array_equal(back.points, points)
    assert np.array_equal(back.cells[0].data, cells)


def test_what_goes_into_no_file_of_version_2_is_written_as_before(tmp_path):
    points, cells, _ = contract.grid(3, 2)
    write_file(tmp_path / "a.meshb", meshio.Mesh(points, [("tetra", cells)], {
        "medit:ref": np.full(len(points), 2**40)}))
    assert read_file(tmp_path / "a.meshb").point_data["medit:ref"].tolist() == [2**40] * len(points)


def test_mmg_reads_binary_meshes_that_were_written(d, tmp_path):
    pytest.importorskip("mmgpy")
    points, cells = jittered(d, 3, 0)
    kind = {2: "triangle", 3: "tetra"}[d]
    write_file(tmp_path / "a.meshb", meshio.Mesh(points, [(kind, cells)], {
        "sol": np.full(len(points), 0.15)}))
    names = [str(tmp_path / name) for name in ("a.solb", "a.meshb", "c.meshb")]
    subprocess.run([shutil.which(f"mmg{d}d_O3") or f"mmg{d}d", "-v", "0", "-sol", *names],
                   check=True, capture_output=True, timeout=60)
    with pytest.warns(DataNotKeptWarning, match="doesn't know"):
        assert len(read_file(tmp_path / "c.meshb").cells_dict[kind]) > len(cells)
