"""Tecplot's files of text: all of the head stays, and no zone is lost without a word."""

from __future__ import annotations

import warnings

import contract
import meshio
import numpy as np
import pytest

from odt_plugins import remesh
from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.api import optimize_file
from odt_plugins.errors import DataNotKeptWarning, MeshFileError

HEAD = """# made by hand, N=1
TITLE     = "flow, E=3"
VARIABLES = "X"
"Y"
"Z"
"Static Pressure [Pa]"
"part"
"k"
DATASETAUXDATA Common.Unit="m"
ZONE T="Fluid N=3"
 STRANDID=1, SOLUTIONTIME=0.5
 Nodes={n}, Elements={m}, ZONETYPE=FETetrahedron
 DATAPACKING=BLOCK
 VARLOCATION=([5,6]=CELLCENTERED)
 AUXDATA N="me"
 DT=(SINGLE SINGLE SINGLE SINGLE SINGLE SINGLE )
"""
TAIL = 'TEXT\nX=1,Y=2,T="label"\n'


def blocks(path, change=str):
    """Write a file as Tecplot 360 does, with values of nodes and cells in blocks."""
    points, cells, labels = contract.grid(3, 3)
    columns = [*points.T, points @ [1, 2, 3], labels, np.arange(len(cells)) / 4]
    rows = [" ".join(map(repr, map(float, column[at: at + 5])))
            for column in columns for at in range(0, len(column), 5)]
    rows += [" ".join(map(str, row)) for row in (cells + 1).tolist()]
    head = HEAD.format(n=len(points), m=len(cells))
    path.write_text(change(head + "\n".join(rows) + "\n" + TAIL))
    return points, cells, labels


def nodes(path):
    """Write a file with a line for each node, in the words of older versions."""
    points, cells, _ = contract.grid(2, 6)
    rows = [f"{x}, {y}\t{x + y}" for x, y in points.tolist()]
    rows += [" ".join(map(str, row)) for row in (cells + 1).tolist()]
    path.write_text(f"VARIABLES = X, Y, u\nZONE N={len(points)}, E={len(cells)}, F=FEPOINT, "
                    "ET=TRIANGLE\n" + "\n".join(rows) + "\n")
    return points, cells


@pytest.mark.parametrize("scale", [None, 0.7])
def test_all_but_numbers_stays(scale, tmp_path):
    points, _, labels = blocks(tmp_path / "a.dat")
    before = read_file(tmp_path / "a.dat")
    assert np.array_equal(before.points, points)
    assert set(before.point_data) == {"Static Pressure [Pa]"}
    assert np.array_equal(before.cell_data["part"][0], labels)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DataNotKeptWarning)
        if scale is None:
            optimize_file(tmp_path / "a.dat", tmp_path / "b.dat")
        else:
            write_file(tmp_path / "b.dat", remesh(before, scale=scale, free="periodic"))
    after = read_file(tmp_path / "b.dat")
    text = (tmp_path / "b.dat").read_text()
    assert text.startswith(HEAD.format(n=len(after.points), m=len(after.cells[0].data)))
    assert text.endswith("\n" + TAIL)
    assert np.allclose(after.point_data["Static Pressure [Pa]"], after.points @ [1, 2, 3])
    assert set(after.cell_data["part"][0]) == set(labels)


def test_a_line_for_each_node_stays_one(tmp_path):
    nodes(tmp_path / "a.dat")
    optimize_file(tmp_path / "a.dat", tmp_path / "b.dat")
    lines = (tmp_path / "b.dat").read_text().splitlines()
    after, theirs = read_file(tmp_path / "b.dat"), meshio.read(tmp_path / "b.dat")
    assert lines[2].split() == [*map(repr, after.points[0].tolist()),
                                repr(float(after.point_data["u"][0]))]
    assert np.array_equal(theirs.points, after.points)
    assert np.array_equal(theirs.cells[0].data, after.cells[0].data)
    assert np.array_equal(theirs.point_data["u"], after.point_data["u"])


def test_vtk_reads_the_same(tmp_path):
    vtk = pytest.importorskip("vtkmodules.vtkIOGeometry")
    blocks(tmp_path / "a.dat", lambda text: text.replace(" STRANDID=1, SOLUTIONTIME=0.5\n", ""))
    optimize_file(tmp_path / "a.dat", tmp_path / "b.dat")
    after = read_file(tmp_path / "b.dat")
    reader = vtk.vtkTecplotReader()
    reader.SetFileName(str(tmp_path / "b.dat"))
    reader.Update()
    seen = reader.GetOutput().GetBlock(0)
    assert (seen.GetNumberOfPoints(), seen.GetNumberOfCells()) == (
        len(after.points), len(after.cells[0].data))
    part = seen.GetCellData().GetArray("part")
    assert [part.GetValue(i) for i in range(len(after.cells[0].data))] == [
        *after.cell_data["part"][0]]


def test_what_the_head_says_is_named_where_it_is_lost(tmp_path):
    blocks(tmp_path / "a.dat")
    with pytest.warns(DataNotKeptWarning, match="the records AUXDATA, DATASETAUXDATA, "
                      "SOLUTIONTIME, STRANDID, TEXT"):
        write_file(tmp_path / "b.vtu", read_file(tmp_path / "a.dat"))


def test_numbers_may_be_written_in_any_way(tmp_path):
    points, cells, _ = blocks(
        tmp_path / "a.dat", lambda text: text.replace("0.0 0.0 0.0 0.0 0.0\n", "5*0.0D0\r\n", 1))
    mesh = read_file(tmp_path / "a.dat")
    assert "5*0.0D0" in (tmp_path / "a.dat").read_text()
    assert np.array_equal(mesh.points, points)
    assert np.array_equal(mesh.cells[0].data, cells)


@pytest.mark.parametrize(("old", "new", "said"), [
    (TAIL, "ZONE N=3, E=1, F=FEPOINT, ET=TRIANGLE\n", "it has 2 zones, expected one, try a file"),
    ("ZONE ", "FIELD ", "it has no zone"),
    ("FETetrahedron", "FEPolyhedron", "its zone is of type FEPolyhedron"),
    ("Nodes=64, Elements=162, ZONETYPE=FETetrahedron", "I=4, J=4, K=4",
     "its zone has no numbers of nodes"),
    ('"X"\n', '"R"\n', "it has no variables X and Y among R, Y, Z"),
    ("Nodes=64", "Nodes=99", "it ends too early"),
    (" DT=(", " PASSIVEVARLIST=([4])\n DT=(", "its zone has PASSIVEVARLIST, which is not read"),
])
def test_what_is_not_read_is_refused(old, new, said, tmp_path):
    blocks(tmp_path / "a.tec", lambda text: text.replace(old, new))
    with pytest.raises(MeshFileError, match=said):
        read_file(tmp_path / "a.tec")
