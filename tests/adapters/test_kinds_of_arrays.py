"""Arrays of a type or a width that a format has not: they become others or go."""

from __future__ import annotations

import warnings

import meshio
import numpy as np
import pytest
from contract import grid

from odt_plugins import optimize
from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.errors import DataNotKeptWarning, InvalidMeshError, MeshFileError

KINDS = {
    "half": lambda k: np.linspace(0, 1, k).astype(np.float16),
    "long": lambda k: np.linspace(0, 1, k).astype(np.longdouble),
    "truth": lambda k: np.arange(k) % 3 == 0,
    "text": lambda k: np.array([f"part {i % 3}" for i in range(k)]),
    "complex": lambda k: np.linspace(0, 1, k) + 2j,
    "four": lambda k: np.arange(4.0 * k).reshape(k, 4),
    "tensor": lambda k: np.arange(9.0 * k).reshape(k, 3, 3),
    "none": lambda k: np.zeros((k, 0)),
    "object": lambda k: np.array([{}] * k),
}

SUFFIXES = (".vtu", ".vtk", ".msh", ".xdmf", ".med", ".avs", ".e", ".h5m", ".hmf", ".dat", ".xml")

GOES = {
    "text": SUFFIXES[2:], "complex": SUFFIXES[2:8] + SUFFIXES[9:], "none": SUFFIXES,
    "object": SUFFIXES,
}
"""Where arrays of these kinds must go."""


def mesh_with(kind):
    points = np.random.default_rng(3).random((5, 3))
    points[:4] = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    points[4] = [1, 1, 1]
    cells = np.array([[0, 1, 2, 3], [1, 2, 3, 4]])
    return meshio.Mesh(points, [("tetra", cells)], {"at_points": KINDS[kind](5)},
                       {"at_cells": [KINDS[kind](2)]})


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("kind", KINDS)
def test_an_array_that_a_format_has_no_type_for_does_not_stop_the_file(kind, suffix, tmp_path):
    mesh, path = mesh_with(kind), tmp_path / f"out{suffix}"
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        write_file(path, mesh)
    said = " ".join(str(one.message) for one in heard)
    back = read_file(path)
    assert sum(len(block.data) for block in back.cells) == 2
    for name, values, there in (("at_points", mesh.point_data["at_points"], back.point_data),
                                ("at_cells", mesh.cell_data["at_cells"][0], back.cell_data)):
        if name not in there or suffix in GOES.get(kind, ()):
            assert name not in there
            assert f"'{name}'" in said
            continue
        found = np.asarray(there[name] if name == "at_points" else there[name][0])
        if kind == "text":
            assert found.tolist() == values.tolist()
            continue
        if kind == "complex" and found.dtype.kind != "c":
            values = np.stack([values.real, values.imag], axis=-1)
        rounded = 1e-3 if kind == "half" else 1e-12
        assert np.allclose(found.reshape(values.shape), values.astype(found.dtype), atol=rounded)


@pytest.mark.parametrize("kind", ["truth", "four"])
def test_xdmf_of_truth_values_and_colours_is_read_by_meshio(kind, tmp_path):
    write_file(tmp_path / "out.xdmf", mesh_with(kind))
    back = meshio.read(tmp_path / "out.xdmf")
    assert np.array_equal(back.point_data["at_points"].reshape(5, -1),
                          np.reshape(KINDS[kind](5), (5, -1)))


def test_a_tensor_of_gmsh_is_read_by_gmsh(tmp_path):
    gmsh = pytest.importorskip("gmsh")
    write_file(tmp_path / "out.msh", mesh_with("tensor"))
    gmsh.initialize()
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.open(str(tmp_path / "out.msh"))
        values = gmsh.view.getModelData(gmsh.view.getTags()[0], 0)[2]
        assert np.array_equal(np.ravel(values), np.arange(45.0))
    finally:
        gmsh.finalize()


NAMES = ("p/rho", "T<T0 & \"x\"", "")


@pytest.mark.parametrize("suffix", [*SUFFIXES, ".vtp"])
@pytest.mark.parametrize("name", NAMES)
def test_a_name_that_a_format_cannot_have_becomes_another(name, suffix, tmp_path):
    mesh = mesh_with("truth")
    mesh.point_data, mesh.cell_data = {name: np.arange(5.0)}, {name: [np.arange(2.0)]}
    if suffix == ".vtp":
        mesh.cells[0] = meshio.CellBlock("triangle", mesh.cells[0].data[:, :3])
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        write_file(tmp_path / f"out{suffix}", mesh)
    back = read_file(tmp_path / f"out{suffix}")
    said = " ".join(str(one.message) for one in heard)
    for there, what in ((back.point_data, "point data"), (back.cell_data, "cell data")):
        assert name in there or f"{what} {name!r}" in said
    if suffix in (".vtu", ".vtp"):
        assert {name or "unnamed"} == set(back.point_data)
        assert {name or "unnamed"} == set(meshio.read(tmp_path / f"out{suffix}").point_data
                                          if suffix == ".vtu" else back.point_data)
    if suffix == ".med":
        assert len(back.point_data) == 1


def test_stl_takes_vertices_at_one_place_and_those_of_no_triangle(tmp_path):
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.1],
                       [5, 5, 5]])
    mesh = meshio.Mesh(points, [("triangle", np.array([[0, 1, 2], [3, 5, 4]]))])
    with pytest.warns(DataNotKeptWarning, match="does not keep 1 point of no cell; try"):
        write_file(tmp_path / "out.stl", mesh)
    back = read_file(tmp_path / "out.stl")
    assert np.array_equal(back.points[back.cells[0].data], points[mesh.cells[0].data])


@pytest.mark.parametrize("suffix", [".mesh", ".xdmf", ".med"])
@pytest.mark.parametrize("kind", [np.int64, np.float16])
def test_points_of_any_type_are_written(kind, suffix, tmp_path):
    mesh = mesh_with("truth")
    mesh.points = np.arange(15).reshape(5, 3).astype(kind)
    mesh.point_data, mesh.cell_data = {}, {}
    write_file(tmp_path / f"out{suffix}", mesh)
    assert np.array_equal(read_file(tmp_path / f"out{suffix}").points, mesh.points)


@pytest.mark.parametrize("width", [2, 3])
def test_wkt_takes_the_triangles_of_a_mesh_with_lines(width, tmp_path):
    mesh = meshio.Mesh(np.eye(3)[:, :width], [("line", np.array([[0, 1]])),
                                              ("triangle", np.array([[0, 1, 2]]))])
    with pytest.warns(DataNotKeptWarning, match="does not keep 1 cell of type line"):
        write_file(tmp_path / "out.wkt", mesh)
    back = read_file(tmp_path / "out.wkt")
    assert np.array_equal(back.points[back.cells[0].data][0, :, :width], mesh.points)


def test_a_format_that_nothing_reads_is_no_format_of_a_mesh_file(tmp_path):
    said = r"has no suffix of a mesh file; expected one of \.avs"
    with pytest.raises(MeshFileError, match=said) as told:
        write_file(tmp_path / "out.svg", mesh_with("truth"))
    assert " .svg" not in str(told.value)


def of_two_shapes(other):
    points, cells, _ = grid(3, 4, 1)
    half = len(cells) // 2
    parts = [np.arange(half, dtype=float), np.arange(half, len(cells)).reshape(-1, 1) * other]
    return meshio.Mesh(points, [("tetra", cells[:half]), ("tetra", cells[half:]),
                                ("triangle", np.zeros((0, 3), dtype=int))],
                       cell_data={"dose": [*parts, np.zeros((0, 2))]})


@pytest.mark.parametrize("suffix", [".vtu", ".vtk", ".msh", ".xdmf", ".e"])
def test_columns_of_one_number_are_as_rows_of_numbers_in_other_blocks(suffix, tmp_path):
    mesh = of_two_shapes(1.0)
    write_file(tmp_path / f"a{suffix}", mesh)
    assert [part.shape[1:] for part in mesh.cell_data["dose"]] == [(), (1,), (2,)]
    back = meshio.read(tmp_path / f"a{suffix}")
    found = np.concatenate([np.ravel(part) for part in back.cell_data["dose"]])
    assert np.array_equal(np.sort(found), np.arange(len(found)))
    better = optimize(mesh)
    assert [part.shape[1:] for part in better.cell_data["dose"]] == [(), (1,), (2,)]


def test_other_shapes_in_several_blocks_are_refused(tmp_path):
    mesh = of_two_shapes(np.ones((1, 3)))
    for call in (optimize, lambda mesh: write_file(tmp_path / "a.vtu", mesh)):
        with pytest.raises(InvalidMeshError, match=r"'dose' has blocks of shapes .* expected as"):
            call(mesh)
