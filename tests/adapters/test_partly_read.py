"""Files of which a part is read: what is left out is named where they are written again."""

from __future__ import annotations

import gzip

import boxes
import contract
import meshio
import numpy as np
import pytest

from odt_plugins import optimize
from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.errors import DataNotKeptWarning, MeshFileError


def put(path):
    points, cells, _ = contract.grid(3, 2)
    write_file(path, meshio.Mesh(points, [("tetra", cells)]))
    return cells


def test_sets_and_tags_of_moab_are_named(tmp_path):
    h5py = pytest.importorskip("h5py")
    cells = put(tmp_path / "a.h5m")
    with h5py.File(tmp_path / "a.h5m", "a") as file:
        file["tstt/sets"]["list"] = [[4, -1, -1, 0]]
        file["tstt/tags"].create_group("MATERIAL_SET")["id_list"] = [9]
        file["tstt/elements/Tet4"].create_group("tags")["rho"] = [1.0] * len(cells)
    with pytest.warns(DataNotKeptWarning, match="1 sets, tag MATERIAL_SET, tag rho of elements"):
        write_file(tmp_path / "b.vtu", read_file(tmp_path / "a.h5m"))


def test_nodes_of_cgns_are_named(tmp_path):
    h5py = pytest.importorskip("h5py")
    put(tmp_path / "a.cgns")
    with h5py.File(tmp_path / "a.cgns", "a") as file:
        file["Base/Zone1"].create_group("ZoneBC")
        file["Base"].create_group("Steel")
    with pytest.warns(DataNotKeptWarning, match="the nodes Steel, ZoneBC"):
        write_file(tmp_path / "b.cgns", read_file(tmp_path / "a.cgns"))


@pytest.mark.parametrize("what", ["zones", "polygons"])
def test_other_zones_and_elements_of_cgns_are_refused(what, tmp_path):
    h5py = pytest.importorskip("h5py")
    put(tmp_path / "a.cgns")
    with h5py.File(tmp_path / "a.cgns", "a") as file:
        if what == "zones":
            file["Base"].create_group("Zone2").create_group("GridCoordinates")
        else:
            file["Base/Zone1/GridElements"][" data"][...] = [22, 0]
    said = {"zones": "it has 2 zones, expected one",
            "polygons": "it has elements of type number 22, expected some of 2, 3, "}[what]
    with pytest.raises(MeshFileError, match=said):
        read_file(tmp_path / "a.cgns")


@pytest.mark.parametrize("order", [1, 2])
def test_cgns_of_gmsh_is_read_with_its_sections(order, tmp_path):
    gmsh = pytest.importorskip("gmsh")
    gmsh.initialize()
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("Mesh.ElementOrder", order)
        occ = gmsh.model.occ
        occ.fragment([(3, occ.addBox(0, 0, 0, 1, 1, 1))], [(3, occ.addBox(1, 0, 0, 1, 1, 1))])
        occ.synchronize()
        gmsh.model.mesh.generate(3)
        for name in ("a.cgns", "a.msh"):
            gmsh.write(str(tmp_path / name))
    finally:
        gmsh.finalize()
    mesh, same = read_file(tmp_path / "a.cgns"), read_file(tmp_path / "a.msh")
    kind = ("tetra", "tetra10")[order - 1]
    corners = [np.sort(np.sort(one.points[one.cells_dict[kind]].round(9), axis=1), axis=0)
               for one in (mesh, same)]
    assert np.array_equal(*corners)
    volumes = [name for name in mesh.cell_sets if "V_" in name]
    assert len(volumes) == 2
    for name in volumes:
        inside = [rows for block, rows in zip(mesh.cells, mesh.cell_sets[name], strict=True)
                  if block.type == kind and len(rows)]
        assert len(inside) == 1
    better = optimize(mesh)
    for name in volumes:
        rows = next(block.data[part] for block, part in zip(
            better.cells, better.cell_sets[name], strict=True) if len(part))
        assert np.ptp(better.points[rows][:, :, 0]) <= 1.0 + 1e-9


def test_elements_of_cgns_that_tell_their_types_are_read(tmp_path):
    h5py = pytest.importorskip("h5py")
    cells = put(tmp_path / "a.cgns")
    with h5py.File(tmp_path / "a.cgns", "a") as file:
        section = file["Base/Zone1/GridElements"]
        section[" data"][...] = [20, 0]
        del section["ElementConnectivity"][" data"]
        rows = np.c_[np.full(len(cells), 10), cells + 1].ravel()
        section["ElementConnectivity"][" data"] = np.r_[5, 1, 2, 3, rows]
        file.move("Base", "part")
    mesh = read_file(tmp_path / "a.cgns")
    assert np.array_equal(mesh.cells_dict["tetra"], cells)
    assert mesh.cells_dict["triangle"].tolist() == [[0, 1, 2]]


@pytest.mark.parametrize("suffix", [".dato", ".post"])
def test_sections_of_permas_are_named(suffix, tmp_path):
    put(tmp_path / f"a{suffix}")
    text = (tmp_path / f"a{suffix}").read_text()
    (tmp_path / f"a{suffix}").write_text(text.replace(
        "$END STRUCTURE", "$ELPROP\n! none\n$MATERIAL NAME=M\n$END STRUCTURE"))
    with pytest.warns(DataNotKeptWarning, match="the sections ELPROP, MATERIAL"):
        write_file(tmp_path / f"b{suffix}", read_file(tmp_path / f"a{suffix}"))


def test_packed_permas_is_read_and_written(tmp_path):
    put(tmp_path / "a.dato")
    packed = tmp_path / "b.dato.gz"
    packed.write_bytes(gzip.compress((tmp_path / "a.dato").read_bytes()))
    plain, back = read_file(tmp_path / "a.dato"), read_file(packed)
    write_file(tmp_path / "c.post.gz", back)
    assert gzip.decompress((tmp_path / "c.post.gz").read_bytes()).startswith(b"!PERMAS")
    for mesh in (back, read_file(tmp_path / "c.post.gz")):
        assert np.array_equal(mesh.points, plain.points)
        assert np.array_equal(mesh.cells_dict["tetra"], plain.cells_dict["tetra"])


def test_permas_of_second_order_is_read_with_its_corners_first(tmp_path):
    """Its elements have corners and nodes of edges by turns, which meshio does not undo."""
    points, cells = boxes.quadratic(*boxes.box(3, 2))
    faces = np.array([[*cells[0, [0, 1, 2]], *cells[0, [4, 5, 6]]]])
    write_file(tmp_path / "a.dato", meshio.Mesh(points, [("tetra10", cells), ("triangle6", faces)]))
    back = read_file(tmp_path / "a.dato")
    assert np.array_equal(back.cells_dict["tetra10"], cells)
    assert np.array_equal(back.cells_dict["triangle6"], faces)
    assert optimize(back).cells_dict["tetra10"].shape == cells.shape
