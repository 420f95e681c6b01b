"""Plain .vtu files: read and written as VTK does, and left to it where they are not plain."""

import itertools

import meshio
import numpy as np
import pytest

from odt_plugins.adapters import plain_vtu, vtk_files
from tests.helpers import contract

pyvista = pytest.importorskip("pyvista")


def same(one, two):
    assert one.points.dtype == two.points.dtype
    assert np.array_equal(one.points, two.points)
    assert [block.type for block in one.cells] == [block.type for block in two.cells]
    for a, b in zip(one.cells, two.cells, strict=True):
        assert a.data.dtype == b.data.dtype
        assert np.array_equal(a.data, b.data)
    for kind in ("point_data", "cell_data", "field_data"):
        first, second = getattr(one, kind), getattr(two, kind)
        assert list(first) == list(second)
        for name in first:
            pairs = ((first[name], second[name]),)
            if kind == "cell_data":
                pairs = zip(first[name], second[name], strict=True)
            for a, b in pairs:
                assert (a.dtype, a.shape) == (b.dtype, b.shape)
                assert np.array_equal(a, b)


def mixed():
    """Every type of number, one and several columns, two types of cells, field data."""
    rng = np.random.default_rng(7)
    mesh = contract.file_mesh(".vtu", 3)
    kinds = list(plain_vtu.WORDS)
    n, sizes = len(mesh.points), [len(block.data) for block in mesh.cells]
    mesh.point_data |= {f"p.{kind}": rng.integers(0, 100, (n, 3)).astype(kind) for kind in kinds}
    mesh.cell_data |= {f"c:{kind}": [rng.integers(0, 100, m).astype(kind) for m in sizes]
                       for kind in kinds}
    mesh.field_data = {"time": np.array([0.25]), "ids": np.arange(6).reshape(3, 2)}
    return mesh


def writer(**settings):
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

    sink = vtkXMLUnstructuredGridWriter()
    for name, value in settings.items():
        getattr(sink, f"Set{name}")(value)
    return sink


@pytest.mark.parametrize(
    ("mode", "encode", "packed", "order", "header"),
    itertools.product((1, 2), (0, 1), (0, 1), (0, 1), (32, 64)))
def test_what_vtk_writes_is_read_as_vtk_reads_it(mode, encode, packed, order, header, tmp_path):
    path = tmp_path / "in.vtu"
    sink = writer(DataMode=mode, EncodeAppendedData=encode, ByteOrder=order, HeaderType=header,
                  FileName=str(path), InputData=vtk_files._grid(mixed()), BlockSize=4096)
    (sink.SetCompressorTypeToZLib if packed else sink.SetCompressorTypeToNone)()
    sink.Write()
    found = plain_vtu.read(path)
    assert found is not None
    same(found, vtk_files.read(path, "vtu")[0])


def test_what_is_written_is_read_alike_by_all(tmp_path):
    path, mesh = tmp_path / "out.vtu", mixed()
    back = plain_vtu.write(path, mesh)
    same(back, vtk_files.read(path, "vtu")[0])
    assert vtk_files.second_look(path, "vtu", back) == ""
    assert np.array_equal(back.points, mesh.points)
    for name, values in mesh.point_data.items():
        assert np.array_equal(back.point_data[name], values)
    for name, values in mesh.cell_data.items():
        assert all(map(np.array_equal, back.cell_data[name], values))


def test_what_meshio_writes_is_read_as_vtk_reads_it(tmp_path):
    mesh = contract.file_mesh(".vtu", 3)
    meshio.write(tmp_path / "in.vtu", mesh)
    found = plain_vtu.read(tmp_path / "in.vtu")
    assert found is not None
    same(found, vtk_files.read(tmp_path / "in.vtu", "vtu")[0])


@pytest.mark.parametrize(
    ("old", "new"),
    [(b'"UnstructuredGrid"', b'"PolyData"'), (b'"0.1"', b'"2.2"'), (b"ZLib", b"LZ4"),
     (b'"LittleEndian"', b'"MiddleEndian"'), (b"<?xml", b"<!DOCTYPE a><?xml"),
     (b'Name="temperature"', b'Name="a&lt;b"'), (b'Name="temperature"', b'Name="velocity"'),
     (b'format="binary"', b'format="ascii"'), (b"</Piece>", b"</Piece><Piece></Piece>"),
     (b'type="Float64" Name="Points"', b'type="Float32" Name="Points"'),
     (b'NumberOfCells="', b'NumberOfCells="1'), (b'NumberOfPoints="', b'NumberOfPoints="1'),
     (b"<Cells>", b"<Cells><Array/>"),
     (b"</DataArray>", b"AAAA</DataArray>"), (b"</VTKFile>", b"")])
def test_what_is_not_plain_is_left_to_vtk(old, new, tmp_path):
    path = tmp_path / "in.vtu"
    plain_vtu.write(path, contract.file_mesh(".vtu", 3))
    content = path.read_bytes()
    assert old in content
    path.write_bytes(content.replace(old, new, 1))
    assert plain_vtu.read(path) is None


def test_broken_bytes_are_left_to_vtk_or_read_as_they_stand(tmp_path):
    path = tmp_path / "in.vtu"
    plain_vtu.write(path, contract.file_mesh(".vtu", 3))
    content = bytearray(path.read_bytes())
    rng = np.random.default_rng(3)
    for at in rng.integers(0, len(content), 200):
        broken = content.copy()
        broken[at] = rng.integers(32, 127)
        path.write_bytes(broken)
        found = plain_vtu.read(path)
        if found is not None:
            same(found, vtk_files.read(path, "vtu")[0])
    for end in rng.integers(0, len(content) - 1, 50):
        path.write_bytes(content[:end])
        assert plain_vtu.read(path) is None


@pytest.mark.parametrize("name", ["with space", "a<b", "ä", "%41"])
def test_other_names_are_left_to_vtk(name, tmp_path):
    mesh = contract.file_mesh(".vtu", 3)
    mesh.point_data[name] = np.zeros(len(mesh.points))
    assert plain_vtu.write(tmp_path / "out.vtu", mesh) is None


def test_cells_that_name_no_points_are_left_to_vtk(tmp_path):
    mesh = contract.file_mesh(".vtu", 3)
    mesh.cells[0].data[0, 0] = len(mesh.points)
    assert plain_vtu.write(tmp_path / "out.vtu", mesh) is None
