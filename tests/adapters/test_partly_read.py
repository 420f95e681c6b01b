"""Files of which a part is read: what is left out is named where they are written again."""

from __future__ import annotations

import contract
import meshio
import pytest

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


@pytest.mark.parametrize("what", ["zones", "quadrilaterals"])
def test_other_zones_and_elements_of_cgns_are_refused(what, tmp_path):
    h5py = pytest.importorskip("h5py")
    put(tmp_path / "a.cgns")
    with h5py.File(tmp_path / "a.cgns", "a") as file:
        if what == "zones":
            file["Base"].create_group("Zone2").create_group("GridCoordinates")
        else:
            file["Base/Zone1/GridElements"][" data"] = [7, 0]
    said = {"zones": "it has 2 zones, expected one",
            "quadrilaterals": "it has elements of type number 7, expected 10"}[what]
    with pytest.raises(MeshFileError, match=said):
        read_file(tmp_path / "a.cgns")


@pytest.mark.parametrize("suffix", [".dato", ".post"])
def test_sections_of_permas_are_named(suffix, tmp_path):
    put(tmp_path / f"a{suffix}")
    text = (tmp_path / f"a{suffix}").read_text()
    (tmp_path / f"a{suffix}").write_text(text.replace(
        "$END STRUCTURE", "$ELPROP\n! none\n$MATERIAL NAME=M\n$END STRUCTURE"))
    with pytest.warns(DataNotKeptWarning, match="the sections ELPROP, MATERIAL"):
        write_file(tmp_path / f"b{suffix}", read_file(tmp_path / f"a{suffix}"))
